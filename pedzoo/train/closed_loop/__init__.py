"""Training in the loop: walks with gradients, and their losses."""
