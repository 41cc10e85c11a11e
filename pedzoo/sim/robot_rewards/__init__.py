"""Terms of a robot's reward by name: one file each, found by the registry."""
