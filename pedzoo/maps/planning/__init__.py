"""The global planner: ways to goals, next waypoints, carrots."""
