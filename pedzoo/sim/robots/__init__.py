"""Bodies of robots by name: one file each, found by the registry.

Their policies are in `pedzoo.policies.robots`, their shared parts in `pedzoo.sim.robot_parts`.
"""
