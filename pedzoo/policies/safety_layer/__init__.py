"""The safety layer: the least change of the next step with which no person touches another or a robot."""
