"""What physics backends are made of."""
