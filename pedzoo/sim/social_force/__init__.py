"""The social force model of Helbing and Molnar (1995): forces between people and from walls, in torch."""
