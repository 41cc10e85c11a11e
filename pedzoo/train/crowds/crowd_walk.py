"""A policy walks in the place of recorded people, differentiably and without an environment."""

from collections.abc import Callable
from typing import NamedTuple, cast

import torch
from tensordict import TensorDictBase
from torch import Tensor

from pedzoo.core.batch import scene_batch
from pedzoo.core.geometry import limit_speed, passes_goal
from pedzoo.core.types import AHEAD_SECONDS, OBS_LEN, STEP_SECONDS
from pedzoo.maps.bank import MapBank
from pedzoo.maps.planning.guidance import Guidance
from pedzoo.maps.planning.planner import Planner
from pedzoo.policies.memory import Attempts, walks
from pedzoo.sim.recorded_people import top_speed_of
from pedzoo.train.crowds.excerpts import Excerpts

Policy = Callable[[TensorDictBase], TensorDictBase]
"""Writes each person's ``action`` (B, A, 2), m/s, into a scene batch."""


class CrowdWalk(NamedTuple):
    """A crowd in L frames, walked or recorded.

    Attributes:
        xy: Positions (B, A, L, 2), metres.
        there: Where people are there (B, A, L) bool.
        scored: Steps that are compared (B, A, L) bool, by the frame at their end: those that a policy walks,
            but for the one in which a person arrives.
        asked: Velocities before the safety layer (B, A, N, 2), m/s, and ...
        walked: ... after it, of the N steps with gradients; None for recorded people.
    """

    xy: Tensor
    there: Tensor
    scored: Tensor
    asked: Tensor | None = None
    walked: Tensor | None = None


def recorded(real: Excerpts, before: int = 0) -> CrowdWalk:
    """Return the recorded crowd, with ``scored`` as of `walked_on`."""
    frame = torch.arange(real.xy.shape[2], device=real.xy.device)
    moves = real.walks.unsqueeze(2) & (frame > real.taken.unsqueeze(2)) & real.there
    moves &= frame >= OBS_LEN
    before_it = real.xy.roll(1, 2)
    arrived = (passes_goal(before_it, real.xy, real.exit.unsqueeze(2)) & moves).cummax(2).values
    return CrowdWalk(real.xy, real.there, moves & ~arrived & (frame >= OBS_LEN + before))


def walked_on(policy: Policy, real: Excerpts, planner: Planner, key: Tensor, before: int = 0) -> CrowdWalk:
    """Return how the crowd goes on if a policy moves all people that it can.

    People are played back until the policy takes them over, 8 rows after they came. They leave within 0.3 m
    of their goal, or after twice the time that they really took, as in the scenario `replay`. The first
    ``before`` steps have no gradients and are not scored: the crowd is one that has walked on for a while.

    Args:
        policy: The policy, in most cases a `pedzoo.policies.walker.Walker`.
        real: The recorded crowd.
        planner: Of their ways to their goals.
        key: Keys of the scenes' draws (B,) long.
        before: Steps of 0.4 s.
    """
    steps = real.xy.shape[2] - OBS_LEN
    path = list(real.xy[:, :, :OBS_LEN].unbind(2))
    there = list(real.there[:, :, :OBS_LEN].unbind(2))
    scored = [torch.zeros_like(real.walks)] * OBS_LEN
    gone = real.last < OBS_LEN - 1
    row, fastest = planner.map_rows(real.map_id), float(real.pref_speed.max())

    def guide(here: Tensor, mine: Tensor) -> Guidance:
        goal_id = torch.where(mine, real.goal_id, -1)
        return planner.guidance(here, goal_id, row, real.pose, real.pref_speed, AHEAD_SECONDS, fastest)

    asked, walked = [], []
    attempts = Attempts.none(real.pref_speed)
    for number in range(steps):
        frame = OBS_LEN - 1 + number
        simulated = real.walks & (real.taken <= frame)
        gone = gone | (simulated & (frame >= real.until))
        mine = simulated & ~gone
        others = real.there[:, :, frame] & ~simulated
        with torch.set_grad_enabled(number >= before and torch.is_grad_enabled()):
            batch = _observed(real, planner.bank, guide, path, there, mine, mine | others, key, number)
            attempts = attempts.seen(~walks((path[-1] - path[-2]).detach()))
            batch["agents", "hindered"] = attempts.tried.unsqueeze(2)
            batch["agents", "pressing"] = attempts.pressing.unsqueeze(2)
            agents = cast("TensorDictBase", policy(batch)["agents"])
            here, command = path[-1], cast("Tensor", agents["action"])
            wanted = agents.get("unconstrained_action", command)
            velocities = agents.get("raw_action", wanted), wanted
            attempts = attempts.trying(
                *(STEP_SECONDS * torch.where(mine.unsqueeze(2), v, 0.0) for v in velocities)
            )
            command = limit_speed(command, top_speed_of(real.pref_speed))
            plays = real.there[:, :, frame + 1] & ~simulated
            place = torch.where(
                mine.unsqueeze(2),
                here + STEP_SECONDS * command,
                torch.where(plays.unsqueeze(2), real.xy[:, :, frame + 1], here.detach()),
            )
        arrives = mine & passes_goal(here.detach(), place.detach(), real.goal)
        gone = gone | arrives
        path.append(place)
        there.append(mine | plays)
        scored.append(mine & ~arrives if number >= before else torch.zeros_like(mine))
        if number >= before:
            asked.append(wanted)
            walked.append(command)
    return CrowdWalk(*(torch.stack(values, 2) for values in (path, there, scored, asked, walked)))


def _observed(
    real: Excerpts,
    maps: MapBank,
    guide: Callable[[Tensor, Tensor], Guidance],
    path: list[Tensor],
    there: list[Tensor],
    mine: Tensor,
    mask: Tensor,
    key: Tensor,
    number: int,
) -> TensorDictBase:
    """Return the scene batch that an environment with the scenario ``replay`` would give."""
    history, valid = torch.stack(path[-OBS_LEN:], 2), torch.stack(there[-OBS_LEN:], 2)
    here, frame = history[:, :, -1], OBS_LEN - 1 + number
    # as in the environment: before their first row people are where they come
    history = torch.where(valid.unsqueeze(3), history, real.head[:, :, :1])
    guidance = guide(here, mine)
    left = torch.where(guidance.distance.isfinite(), guidance.distance, real.path_length)
    batch = scene_batch(
        maps=maps,
        map_id=real.map_id.unsqueeze(1),
        pose=real.pose,
        history=history,
        valid=valid,
        mask=mask,
        group=torch.where(real.grouped <= frame, real.group, -1),
        pref_speed=real.pref_speed.unsqueeze(2),
        top_speed=top_speed_of(real.pref_speed).unsqueeze(2),
        velocity=(history[:, :, -1] - history[:, :, -2]) / STEP_SECONDS,
        goal=guidance.goal,
        desired_velocity=guidance.desired_velocity,
        remaining_path=left.unsqueeze(2),
        controlled=mine,
        key=key.unsqueeze(1),
        time=history.new_full((len(key), 1), number * STEP_SECONDS),
    )
    agents = cast("TensorDictBase", batch["agents"])
    agents["first_history"] = real.head
    agents["elapsed"] = ((frame - real.taken) * STEP_SECONDS).unsqueeze(2)
    agents["progress"] = (real.path_length - left).unsqueeze(2)
    return batch
