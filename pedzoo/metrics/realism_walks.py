"""What each recorded person did in each round of a replay, beside what they did in the recording.

P people, K rounds of the scenes of a recording; E episodes of A slots, S steps of 0.4 s.
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from pedzoo.metrics.navigation import stuck
from pedzoo.metrics.realism_features import Steps
from pedzoo.metrics.realism_paths import closed_loop_error, dtw, padded
from pedzoo.metrics.rollout import Rollout
from pedzoo.types import GOAL_RADIUS, TRACE_SECONDS


class Walks(NamedTuple):
    """What P people did in K rounds, (K, P) each.

    Attributes:
        expected: Who takes part: whose scene was run (K, P) bool.
        deadlock: Who once moved less than 0.1 m in 5 s, more than 0.5 m from the goal (K, P) bool.
        seconds: From when the policy took over until within 0.3 m of the goal; NaN for who never was.
        real_seconds: The same of the recorded walk (P,).
        ade: Mean distance to the recorded positions of the same times, metres; NaN without any.
        dtw: Dynamic time warping distance to the recorded walk, metres; NaN likewise.
    """

    expected: Tensor
    deadlock: Tensor
    seconds: Tensor
    real_seconds: Tensor
    ade: Tensor
    dtw: Tensor

    @property
    def success(self) -> Tensor:
        """Who arrived (K, P) bool; a replay removes whoever takes more than twice the recorded time."""
        return self.expected & ~self.seconds.isnan()


def walks_of(rollout: Rollout, steps: Steps, real: Rollout, real_steps: Steps, people: int) -> Walks:
    """Return the walks of a rollout.

    Args:
        rollout: Scenes 0, 1, ... of all rounds, each round as many as the recording has.
        steps: The same every 0.4 s.
        real: The recorded crowd in the same slots, one round.
        real_steps: The same every 0.4 s.
        people: P.
    """
    scenes = len(real.failed)
    rounds = -(-len(rollout.failed) // scenes)
    scene = torch.full((people,), len(rollout.failed))
    scene[real.person[real.controlled]] = real.controlled.nonzero()[:, 0]
    expected = scene + scenes * torch.arange(rounds).unsqueeze(1) < len(rollout.failed)
    still = stuck(rollout.trace, rollout.goal, rollout.controlled)
    deadlock = torch.zeros_like(expected)
    deadlock[still.nonzero()[:, 0] // scenes, rollout.person[still]] = True
    return Walks(
        expected,
        deadlock,
        _seconds(rollout, scenes, (rounds, people)),
        _seconds(real, scenes, (1, people))[0],
        *_paths(steps, real_steps, expected),
    )


def _seconds(rollout: Rollout, scenes: int, shape: tuple[int, int]) -> Tensor:
    """Return after how long each person was at the goal for the first time (K, P), seconds or NaN.

    Recorded people were not taken out there, so they are looked for; whose exit was moved a little has
    ``reached`` it at the end.
    """
    there = (rollout.trace - rollout.goal).norm(dim=-1) < GOAL_RADIUS
    there |= rollout.reached > 0
    first = []
    for when in (rollout.controlled, rollout.controlled & there):
        episode, _, point = when.nonzero().unbind(1)
        walk = episode // scenes * shape[1] + rollout.person[when]
        never = torch.full((shape[0] * shape[1],), torch.nan, dtype=torch.float64)
        first.append(never.scatter_reduce(0, walk, point.double(), "amin", include_self=False).view(shape))
    return (first[1] - first[0] + 1) * TRACE_SECONDS


def _paths(steps: Steps, real: Steps, expected: Tensor) -> tuple[Tensor, Tensor]:
    """Return closed-loop ADE and DTW (K, P) of everybody who is ``expected`` (K, P)."""
    scenes, people = len(real.person), expected.shape[1]
    number = torch.full_like(expected, -1, dtype=torch.long)
    who = expected.nonzero()[:, 1]
    number[expected] = torch.arange(len(who))

    episode = torch.arange(len(steps.person))
    walk = number[(episode // scenes).view(-1, 1, 1), steps.person.clamp_min(0)]
    shared = min(steps.person.shape[2], real.person.shape[2])
    true, mine = (Steps(*(value[:, :, :shared] for value in some)) for some in (real, steps))
    same = episode % scenes
    both = mine.scored & true.scored[same] & (mine.person == true.person[same])
    error = closed_loop_error(mine.xy, true.xy[same], both, walk[..., :shared], len(who))

    walked, points = padded(steps.xy[steps.scored], walk[steps.scored], len(who))
    recorded, others = padded(real.xy[real.scored], real.person[real.scored], people)
    warped = dtw(walked, points, recorded[who], others[who])
    found = torch.full((2, *expected.shape), torch.nan, dtype=torch.float64)
    found[:, expected] = torch.stack((error, warped))
    return found[0], found[1]
