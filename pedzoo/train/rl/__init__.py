"""Reinforcement learning: PPO."""
