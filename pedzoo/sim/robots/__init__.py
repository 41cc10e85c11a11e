"""Robots by name: one file each, found by the registry. What they share is in `pedzoo.sim.robot_parts`."""
