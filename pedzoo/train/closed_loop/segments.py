"""A differentiable piece of an episode: a policy's decisions in some environment, step by step."""

from collections.abc import Callable
from typing import NamedTuple, cast

import torch
from tensordict import TensorDict, TensorDictBase
from torch import Tensor

from pedzoo.sim.env import PedestrianEnv
from pedzoo.sim.state import CONTACT_COST

Policy = Callable[[TensorDictBase], TensorDictBase]
"""Writes each person's ``action`` (B, A, 2), m/s, into the observation."""


class Segment(NamedTuple):
    """T decisions in B scenes of A people, with S trace points each. Differentiable.

    Attributes:
        trace: Positions (T, B, A, 1 + S, 2), metres: where people were at a decision, and every 0.1 s after.
        asked: Velocities that the policy asked for (T, B, A, 2), m/s.
        action: Those that its safety layer left, if it has one (T, B, A, 2), m/s.
        velocity: Theirs when they decided (T, B, A, 2), m/s.
        progress: Way to the goal that was made (T, B, A), metres.
        pref_speed: The speed that people like (T, B, A), m/s.
        radius: Radii of their bodies (T, B, A), metres.
        goal: Their short-term goals (T, B, A, 2), metres.
        present: Which people are present when a decision is made (T, B, A) bool.
        moved: Which people the policy moves then (T, B, A) bool.
        agent_contact: Which agents touch another in the step (T, B, A) bool.
        wall_contact: Which agents touch a wall in it (T, B, A) bool.
        done: Scenes that are over at the end (B,) bool.
        map_id: Floor plans (B,) long.
        pose: Scene poses (B, 4).
    """

    trace: Tensor
    asked: Tensor
    action: Tensor
    velocity: Tensor
    progress: Tensor
    pref_speed: Tensor
    radius: Tensor
    goal: Tensor
    present: Tensor
    moved: Tensor
    agent_contact: Tensor
    wall_contact: Tensor
    done: Tensor
    map_id: Tensor
    pose: Tensor


def unrolled(env: PedestrianEnv, policy: Policy, seen: TensorDictBase, steps: int) -> Segment:
    """Return the segment of T steps of a policy in an environment, with its observations, with gradients.

    ``seen`` is the current observation, as `PedestrianEnv.reset` and `PedestrianEnv.cut` return it. Scenes
    that are over, or were before, stay as they are; no agent moves in them.
    """
    result: list[tuple[Tensor, ...]] = []
    over = torch.zeros(env.batch_size[0], dtype=torch.bool, device=seen["map_id"].device)
    map_id, pose = seen["map_id"][:, 0], seen["scene_pose"]
    for _ in range(steps):
        agents = cast("TensorDict", seen["agents"])
        there = agents["mask"] & ~over.unsqueeze(1)
        before = agents["history"][:, :, -1:]
        after = env.step(policy(seen))["next"]
        info = after["agents", "info"]
        agent_contact, wall_contact = info["agent_contact"].any(-1), info["wall_contact"].any(-1)
        moved = there & agents["controlled"]
        reward = after["agents", "reward"][..., 0]
        progress = torch.where(moved, reward + CONTACT_COST * (agent_contact | wall_contact), 0.0)
        result.append(
            (
                torch.cat((before, info["trace"]), 2),
                agents.get("unconstrained_action", agents["action"]),
                agents["action"],
                agents["velocity"],
                progress,
                agents["pref_speed"][..., 0],
                agents["radius"][..., 0],
                agents["goal"],
                there,
                moved,
                agent_contact & moved,
                wall_contact & moved,
            )
        )
        over = over | after["done"][:, 0]
        seen = after
        if bool(over.all()):
            break
    stacked = [torch.stack(values) for values in zip(*result, strict=True)]
    return Segment(*stacked, done=over, map_id=map_id, pose=pose)
