"""Floor plans: files, occupancy grids, procedural plans, walls, and the planner of ways to goals."""
