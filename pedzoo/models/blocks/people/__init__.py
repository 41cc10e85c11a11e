"""Blocks that look at people around."""
