"""Physics backends: one file each. What they share is in `pedzoo.sim.physics_parts`."""
