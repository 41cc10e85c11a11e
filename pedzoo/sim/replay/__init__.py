"""Recorded crowds that are played back."""
