"""Training on whole recorded crowds: a policy walks in the place of all people, and is compared with them."""
