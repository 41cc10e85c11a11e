"""Optimal reciprocal collision avoidance, batched."""
