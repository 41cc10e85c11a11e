"""Forecasters: shared blocks, one file per architecture, the zoo that loads them by name, and export."""
