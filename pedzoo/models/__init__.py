"""Forecasters: shared blocks, one file per architecture, and the zoo that loads them by name."""
