"""Forecasters that walk."""
