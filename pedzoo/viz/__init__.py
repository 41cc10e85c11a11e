"""Plots, trajectories, videos."""
