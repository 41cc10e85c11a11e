"""Datasets that others publish: where their files lie, and how they come into a folder that datasets read."""
