"""Robots among people: one policy per file, from what a robot sees to its next velocity."""
