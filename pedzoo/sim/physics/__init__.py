"""Physics backends: one file each. Their shared parts are in `pedzoo.sim.physics_parts`."""
