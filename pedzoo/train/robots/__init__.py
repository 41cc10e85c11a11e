"""Robots that learn among people: PPO."""
