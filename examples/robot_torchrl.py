"""A robot with a lidar among learned people in TorchRL: 16 scenes at once, a rule and a network.

pip install .; python examples/robot_torchrl.py
"""

from __future__ import annotations

from typing import Any

import torch
from tensordict.nn import NormalParamExtractor, TensorDictModule
from torch import nn
from torchrl.modules import ProbabilisticActor, TanhNormal

import pedzoo
from pedzoo.policies.load import load_robot_policy


class Network(nn.Sequential):
    """Layers on everything that the robot reads."""

    def forward(self, *readings: torch.Tensor) -> Any:
        """Return the mean and the spread of the action."""
        return super().forward(torch.cat(readings, -1))


def main(scenes: int = 16, decisions: int = 100) -> None:
    """Compare a robot that goes straight with an untrained network, and print how they fare."""
    env: Any = pedzoo.make_robot_env(
        "door:width=1.0,people=3",
        robot="diff_drive:radius=0.25",
        people="approach_net_goal_map.indoor",
        sensors=["goal", "odometry", "lidar:beams=32"],
        reward={"progress": 1.0, "success": 5.0, "collision": 5.0},
        num_envs=scenes,
    )
    inputs: list[Any] = [("robots", "observation", name) for name in ("goal", "velocity", "lidar")]
    outputs: list[Any] = [("robots", "loc"), ("robots", "scale")]
    layers = Network(nn.Linear(2 + 2 + 32, 64), nn.Tanh(), nn.Linear(64, 4), NormalParamExtractor())
    limits = env.action_spec["robots", "action"].space
    actor = ProbabilisticActor(
        TensorDictModule(layers, inputs, outputs),
        in_keys=outputs,
        out_keys=[("robots", "action")],
        distribution_class=TanhNormal,
        distribution_kwargs={"low": limits.low[0, 0], "high": limits.high[0, 0]},
    )
    for name, policy in {"straight": load_robot_policy("straight"), "untrained": actor}.items():
        env.set_seed(0)
        with torch.no_grad():
            steps = env.rollout(decisions, policy, break_when_any_done=False)["next", "robots"]
        ended, reward = steps["done"].sum(), steps["reward"].sum() / scenes
        success = steps["info", "success"].sum()
        print(f"{name}: {int(success)} of {int(ended)} arrived, reward {float(reward):.1f} a scene")


if __name__ == "__main__":
    main()
