"""Walls: exact distances, rays, outlines, look-ups for people."""
