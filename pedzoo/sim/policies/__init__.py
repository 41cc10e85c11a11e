"""Policies that are no forecasters: one file each, found by its name."""
