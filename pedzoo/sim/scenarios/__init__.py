"""Scenarios, found by their file's name, or as classes of `encounters`. Interface: `pedzoo.sim.scenario`."""
