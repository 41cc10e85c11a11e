"""Forecasts that begin with anchors: typical futures of the training data."""
