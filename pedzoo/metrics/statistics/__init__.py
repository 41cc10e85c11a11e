"""Intervals, quantiles and means of numbers that were summed over episodes and processes."""
