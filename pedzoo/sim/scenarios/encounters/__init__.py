"""Encounters of Francis et al. 2023: people whose ways cross, one file each, found by its name."""
