"""Scenes that run backwards in time: people's paths stay such as people walk."""

import torch
from tensordict import TensorDict

from pedzoo.core.batch import agents_of
from pedzoo.core.types import STEP_SECONDS, GoalProtocol


def reversed_in_time(batch: TensorDict, goal: GoalProtocol | None) -> TensorDict:
    """Return a batch of recorded scenes that run backwards, with the people who are known throughout.

    A destination lies outside of the window: batches with other goals than ``window_end`` stay as they are.
    """
    if goal not in (None, "none", "window_end"):
        return batch
    agents = agents_of(batch)
    observed = agents["history"].shape[2]
    place = torch.cat((agents["history"], agents["future"]), 2).flip(2)
    known = torch.cat((agents["valid"], agents["future_valid"]), 2).all(2) & agents["mask"]
    history, future = place[:, :, :observed], place[:, :, observed:]
    valid = known.unsqueeze(2)
    changed = {
        "history": history,
        "future": future,
        "valid": valid.expand(history.shape[:3]),
        "future_valid": valid.expand(future.shape[:3]),
        "velocity": (history[:, :, -1] - history[:, :, -2]) / STEP_SECONDS,
        "mask": known,
    }
    if goal == "window_end":
        to_goal = torch.nn.functional.normalize(future[:, :, -1] - history[:, :, -1], dim=-1)
        changed |= {"goal": future[:, :, -1], "desired_velocity": agents["pref_speed"] * to_goal}
    result = batch.clone(recurse=False)
    result["agents"] = agents.clone(recurse=False).update(changed)
    return result
