"""Floor plans: files, occupancy grids, procedural plans, walls, and the planner of paths to goals."""
