"""Blocks that look at the floor plan."""
