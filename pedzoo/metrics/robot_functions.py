"""How robots drive, how near they come to people, and what they do to people. See `pedzoo.metrics.robots`.

Positions are (E, R, T, 2) and (E, N, T, 2), paths from where the episode begins (E, R, 1 + T, 2), metres, and
headings (E, R, 1 + T), radians. ``there`` (E, R, T): the robot is on its way; ``present`` (E, N, T): the
person is there. ``reach`` (E, R, N) are sums of radii, ``distance`` (E, R, N, T) is between centres, metres.

The effect on people is against the same scenes of the same seed without robots. Both begin alike: the robots
are taken out after the warm start. People's noise is the same, too.
"""

from typing import NamedTuple

import torch
from torch import Tensor

from pedzoo.core.types import TRACE_SECONDS
from pedzoo.metrics.contacts import collision_seconds

STANDS, STANDS_TURN = 0.01, 0.02
"""m/s and rad/s: a robot that is slower in both does not move (HuNav's)."""


def heading_changes(heading: Tensor, there: Tensor) -> Tensor:
    """Return by how much each robot turned (E, R), radians, left and right added up (HuNav)."""
    return _turns(heading).abs().where(there, 0.0).sum(-1)


def seconds_standing(path: Tensor, heading: Tensor, there: Tensor) -> Tensor:
    """Return how long each robot was slower than 0.01 m/s and 0.02 rad/s (E, R), seconds (HuNav)."""
    slow = path.diff(dim=2).norm(dim=-1) < STANDS * TRACE_SECONDS
    steady = _turns(heading).abs() < STANDS_TURN * TRACE_SECONDS
    return (slow & steady & there).sum(-1) * TRACE_SECONDS


def goal_distances(trace: Tensor, goal: Tensor, there: Tensor) -> tuple[Tensor, Tensor]:
    """Return the least and the final distance to the goal (E, R), metres (HuNav, SEAN 2.0)."""
    away = (trace - goal).norm(dim=-1)
    least = away.masked_fill(~there, torch.inf).amin(-1)
    last = (there.sum(-1, keepdim=True) - 1).clamp_min(0)
    return least, away.gather(-1, last).squeeze(-1)


def _turns(heading: Tensor) -> Tensor:
    """Return the turns between two points (E, R, T), -pi to pi."""
    turned = heading.diff(dim=-1)
    return torch.atan2(turned.sin(), turned.cos())


SPACES = {"intimate": (-torch.inf, 0.45), "personal": (0.45, 1.2), "social": (1.2, 3.6)}
"""Spaces of proxemics (Hall 1966), metres, as in HuNav."""

DISCOMFORT = 0.2
"""Metres between bodies within which people feel uncomfortable (CrowdNav's)."""

FUTURE_STEPS, FUTURE_SECONDS = 5, 0.25
"""How far ahead people's ways are that robots should keep clear of (CrowdNav++'s)."""

SOCIAL_FACTOR, LAMBDA, GAMMA, ANGULAR, VELOCITY = 2.1, 2.0, 0.35, 2.0, 3.0
"""Parameters of the social force (HuNav's): its factor, lambda, gamma, n and n'."""


def distances(robots: Tensor, people: Tensor, there: Tensor, present: Tensor) -> Tensor:
    """Return distances between centres (E, R, N, T), metres; infinite where either is not there."""
    apart = (robots.unsqueeze(2) - people.unsqueeze(1)).norm(dim=-1)
    return apart.masked_fill(~(there.unsqueeze(2) & present.unsqueeze(1)), torch.inf)


def in_space(distance: Tensor, radius: Tensor, space: str) -> Tensor:
    """Return when the nearest person is in a space, one of `SPACES`, of the robot (E, R, T) bool (HuNav).

    The share of a robot's points is HuNav's intrusion: distances from the robot's body to people's centres.
    """
    low, high = SPACES[space]
    away = distance.amin(2) - radius.unsqueeze(-1)
    return (away >= low) & (away < high)


def intrusions(robots: Tensor, people: Tensor, present: Tensor, reach: Tensor) -> tuple[Tensor, Tensor]:
    """Return when robots are where people are about to go (E, R, T) bool, and how near (E, R, T), metres.

    At point t a robot intrudes whose body touches a person's body of 0.25, 0.5, ... 1.25 s later. The share
    of an episode's points, mean over episodes, is CrowdNav++'s intrusion ratio. The distance is the least one
    between centres of those that touch, infinite for none; its mean over intrusions is CrowdNav++'s, too.
    There people's future is simulated ahead; here it is what they really did until the episode's end.
    """
    points = people.shape[2]
    least = torch.full(robots.shape[:3], torch.inf)
    for step in range(1, FUTURE_STEPS + 1):
        ahead = step * FUTURE_SECONDS / TRACE_SECONDS
        first, share = int(ahead), ahead - int(ahead)
        last = first + (share > 0)
        if last >= points:
            break
        later = people[:, :, first : points - last + first]
        later = torch.lerp(later, people[:, :, last:], share)
        apart = (robots[:, :, : points - last].unsqueeze(2) - later.unsqueeze(1)).norm(dim=-1)
        there = present[:, :, last:].unsqueeze(1) & (apart < reach.unsqueeze(-1))
        nearest = apart.masked_fill(~there, torch.inf).amin(2)
        least[..., : points - last] = torch.minimum(least[..., : points - last], nearest)
    return least.isfinite(), least


def social_force(apart: Tensor, velocity: Tensor) -> Tensor:
    """Return the amounts of the social force between pairs (...), m/s^2: of either on the other.

    The model of Moussaid et al. (Proc. R. Soc. B 276, 2009) with the parameters of HuNav, which sums it over
    people and steps for ``social_force_on_robot`` and ``social_force_on_agents``. ``d`` is the distance,
    ``e`` the direction, ``D = 2 v + e``, ``B = 0.35 |D|``, ``a`` the angle from e to D. Then the force is
    ``2.1 sqrt(exp(-d/B - (3 B a)^2)^2 + exp(-d/B - (2 B a)^2)^2)``, without the second term where a is 0.

    Args:
        apart: From one to the other (..., 2), metres.
        velocity: Of the one less that of the other (..., 2), m/s.
    """
    distance = apart.norm(dim=-1)
    toward = torch.nn.functional.normalize(apart, dim=-1)
    interaction = LAMBDA * velocity + toward
    reach = GAMMA * interaction.norm(dim=-1)
    cross = toward[..., 0] * interaction[..., 1] - toward[..., 1] * interaction[..., 0]
    angle = torch.atan2(cross, (toward * interaction).sum(-1))
    decay = -distance / reach.clamp_min(1e-9)
    ahead = (decay - (VELOCITY * reach * angle) ** 2).exp()
    aside = (decay - (ANGULAR * reach * angle) ** 2).exp().where(angle != 0, 0.0)
    return SOCIAL_FACTOR * torch.hypot(ahead, aside)


def drives_into(apart: Tensor, robot: Tensor, person: Tensor) -> Tensor:
    """Return where it is the robot that drives into the person (...) bool: it moves faster towards them.

    After SEAN 2.0's "robot on person collision" (Tsoi et al., RA-L 2022), which HuNav has, too. ``apart`` is
    from the robot to the person, metres.
    """
    return (robot * apart).sum(-1) >= -(person * apart).sum(-1)


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
