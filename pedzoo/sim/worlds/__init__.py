"""Worlds answer who touches what, how far it is, and what rays and cameras see; they move nobody."""
