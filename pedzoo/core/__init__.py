"""Shared parts: the scene batch, errors, drop-ins by name, settings, paths, downloads, geometry."""
