"""How models are trained: LightningModules, losses in the loop, PPO, validation in the loop."""

from pedzoo.core.errors import need

need("train", "training")
