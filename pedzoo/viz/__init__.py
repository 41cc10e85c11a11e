"""Pictures: plots, trajectories, videos, floor plans."""
