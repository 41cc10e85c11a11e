"""A robot among people in Gymnasium: a rule in one scene, then 64 scenes at once.

pip install '.[gym]'; python examples/robot_gym.py

With Stable-Baselines3: ``PPO("MultiInputPolicy", gymnasium.make("pedzoo/Goals-v0")).learn(100_000)``
"""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np

import pedzoo.sim.gym  # noqa: F401 (makes the ids known)


def decide(seen: dict[str, Any], columns: dict[str, slice]) -> np.ndarray:
    """Go to the next waypoint, and wait for people who are less than 1 m ahead."""
    waypoint = seen["robot"][..., columns["waypoint"]]
    ahead = waypoint / np.linalg.norm(waypoint, axis=-1, keepdims=True).clip(1e-6)
    place = seen["people"][..., :2]
    forward = (place * ahead[..., None, :]).sum(-1)
    near = seen["mask"].astype(bool) & (forward > 0) & (np.linalg.norm(place, axis=-1) < 1.0)
    return np.where(near.any(-1)[..., None], 0.0, ahead).astype(np.float32)


def main(decisions: int = 300) -> None:
    """Walk one robot to its goal, then many, and print what became of them."""
    env = gymnasium.make("pedzoo/Goals-v0", people="orca", sensors=["goal", "odometry", "people:most=5"])
    columns = env.unwrapped.batched.observations.columns  # type: ignore[attr-defined]
    seen, info = env.reset(seed=0)
    for _ in range(decisions):
        seen, _, terminated, truncated, info = env.step(decide(seen, columns))
        if terminated or truncated:
            break
    print({name: info[name] for name in ("SUCCESS", "COLLISION_HUMAN", "TIMEOUT", "SPL", "STL")})

    many = gymnasium.make_vec("pedzoo/Door-v0", num_envs=64)
    seen, _ = many.reset(seed=0)
    ended = arrived = 0
    for _ in range(decisions):
        seen, _, terminated, truncated, infos = many.step(decide(seen, columns))
        ended += (terminated | truncated).sum()
        arrived += infos["final_info"]["SUCCESS"].sum() if "final_info" in infos else 0
    print(f"{arrived} of {ended} robots came through the door")


if __name__ == "__main__":
    main()
