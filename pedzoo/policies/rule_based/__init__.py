"""Policies by name that are not learned: one file each."""
