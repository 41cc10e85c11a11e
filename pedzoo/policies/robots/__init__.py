"""Policies of robots by name: one file each, found by the registry."""
