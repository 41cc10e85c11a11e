"""How near simulated people are to recorded ones."""
