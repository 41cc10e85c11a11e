"""Physics backends: one file each, found by the registry. What they share is in `pedzoo.sim.engine`."""
