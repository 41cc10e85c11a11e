"""Scores of simulated crowds against recorded ones."""
