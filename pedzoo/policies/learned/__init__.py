"""Forecasters that walk, and the safety layer under them."""
