"""Robots among people: bodies, sensors, rewards, scenes with robots, and the environment."""
