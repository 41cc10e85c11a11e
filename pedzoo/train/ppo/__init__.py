"""Proximal policy optimisation: one trainer for people and for robots."""
