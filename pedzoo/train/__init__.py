"""How models are trained: LightningModules, losses in the loop, PPO, validation in the loop."""
