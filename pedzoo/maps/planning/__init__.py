"""The global planner: paths to goals, next waypoints, carrots."""
