"""What robots do to people, against the same scenes of the same seed without robots.

Both begin alike: the robots are taken out after the warm start. People's noise is the same, too. See
`pedzoo.metrics.robots` for E, N, R, T.
"""

from typing import NamedTuple

import torch
from torch import Tensor

from pedzoo.core.types import TRACE_SECONDS
from pedzoo.metrics.contact_functions import collision_seconds

ENCOUNTER = 3.0
"""Seconds: a robot and a person with a shorter time to collision meet."""

FROM_REST = round(1.0 / TRACE_SECONDS)
"""Trace points in which robots set out, 1 s: that is no answer to people."""

LASTS = round(6.0 / TRACE_SECONDS)
"""Trace points in which those who meet pass each other, 6 s."""

YIELDS = 0.1
"""m/s: a smaller change of velocity is no yielding."""


class WalkProgress(NamedTuple):
    """How far people had come when the robot's episode ended (E, N).

    Attributes:
        arrived: They had reached all their goals, bool.
        seconds: When they had, infinite for others.
        covered: Metres of the planner's ways that they had covered; all of them for people who arrived.
        walked: Metres that they walked until then.
    """

    arrived: Tensor
    seconds: Tensor
    covered: Tensor
    walked: Tensor


def delay(joined: WalkProgress, alone: WalkProgress, pref_speed: Tensor, ended: Tensor) -> Tensor:
    """Return how much later people arrive because of the robot (E, N), seconds; below 0: earlier.

    A person who had arrived at the end of the robot's episode did so at a known time. For others it is that
    end plus what was left of their planned way at the speed that they like. Their delay is the difference
    of the two times, with the robot less without. So it is

    * of people who arrived in both: the difference of both times;
    * of people who arrived in neither: the planned way that they covered less, by their preferred speed.

    Args:
        joined: With the robot.
        alone: Without.
        pref_speed: The speed that people like (E, N), m/s.
        ended: When the robot's episode ended (E,), seconds.
    """
    whole = _whole(joined, alone)
    times = [
        torch.where(
            one.arrived,
            one.seconds.where(one.arrived, 0.0),
            ended.unsqueeze(1) + (whole - one.covered) / pref_speed,
        )
        for one in (joined, alone)
    ]
    return times[0] - times[1]


def detour(joined: WalkProgress, alone: WalkProgress) -> Tensor:
    """Return how much farther people walk for the same progress (E, N), metres; below 0: less far.

    What they walked less what they covered of the planner's paths, with the robot less without. So a person
    who only waits has a delay, and no detour.
    """
    return (joined.walked - joined.covered) - (alone.walked - alone.covered)


def _whole(joined: WalkProgress, alone: WalkProgress) -> Tensor:
    """Return the length of whole planned ways (E, N), metres: of those who arrived; for others it cancels."""
    return torch.where(joined.arrived, joined.covered, alone.covered)


class RobotEncounters(NamedTuple):
    """Pairs of a robot and a person who met (E, R, N).

    Attributes:
        met: Their time to collision fell below 3 s, bool.
        robot: By how much the robot changed its velocity at most until the closest approach, m/s.
        person: By how much the person did.
    """

    met: Tensor
    robot: Tensor
    person: Tensor

    @property
    def known(self) -> Tensor:
        """Which encounters are solved by one of the two (E, R, N) bool: one changes by at least 0.1 m/s."""
        return self.met & (torch.maximum(self.robot, self.person) >= YIELDS)

    @property
    def person_yields(self) -> Tensor:
        """In which of these the person changes more (E, R, N) bool."""
        return self.known & (self.person > self.robot)


def encounters(
    robots: Tensor, people: Tensor, there: Tensor, moved: Tensor, reach: Tensor
) -> RobotEncounters:
    """Return which pairs met, and which of the two changed its velocity more.

    An encounter of a pair begins where the time after which they would touch, if both kept their velocities,
    first falls below 3 s, but not in the first second, in which robots set out. It ends at the closest
    approach of the next 6 s. A change is the largest ``|v(t) - v(begin)|`` in between. A pair has one
    encounter in an episode, the first. Only people that a policy ``moved`` can yield.
    """
    mine, theirs = robots.diff(dim=2) / TRACE_SECONDS, people.diff(dim=2) / TRACE_SECONDS
    apart = people[:, :, 1:].unsqueeze(1) - robots[:, :, 1:].unsqueeze(2)
    closing = theirs.unsqueeze(1) - mine.unsqueeze(2)
    both = there.unsqueeze(2) & moved.unsqueeze(1)
    x, y = (value.clone() for value in apart.unbind(-1))  # their memory is used
    vx, vy = (value.clone() for value in closing.unbind(-1))
    seconds = collision_seconds(x, y, vx, vy, reach.unsqueeze(-1))
    near = (seconds < ENCOUNTER) & both
    point = torch.arange(near.shape[-1])
    near = near & (point >= FROM_REST)
    begin = near.long().argmax(-1, keepdim=True)
    after = both & (point >= begin) & (point <= begin + LASTS)
    closest = apart.norm(dim=-1).masked_fill(~after, torch.inf).argmin(-1, keepdim=True)
    during = after & (point <= closest)
    robot, person = (
        _change(velocity.expand(*near.shape, 2), begin, during)
        for velocity in (mine.unsqueeze(2), theirs.unsqueeze(1))
    )
    return RobotEncounters(near.any(-1), robot, person)


def _change(velocity: Tensor, begin: Tensor, during: Tensor) -> Tensor:
    """Return the largest change of velocities (E, R, N, T, 2) since ``begin`` (E, R, N, 1), m/s."""
    first = velocity.gather(3, begin.unsqueeze(-1).expand(*begin.shape, 2))
    return (velocity - first).norm(dim=-1).where(during, 0.0).amax(-1)
