"""Contacts with people and walls, distances between people, and what a safety layer changes.

Pure functions over the 0.1 s trace of closed-loop episodes, and the metrics made of them. E episodes of A
people (padded), T trace points. Scored people (E, A, T) may come near all people who are present (E, A, T).
``nearest`` (E, A, T) are distances to the nearest other, metres.
"""

from collections.abc import Iterator

import torch
from torch import Tensor

from pedzoo.core.types import BODY_RADIUS, TRACE_SECONDS
from pedzoo.metrics.ratios import Ratio, finite, mean, metric, once, ratio, share
from pedzoo.metrics.smoothness import WINDOW, velocities
from pedzoo.sim.rollout import Rollout

PERSONAL_SPACE = 0.5
"""Metres between centres (iGibson's)."""

IGIBSON_POINTS = 500
"""Steps of 0.1 s after which an episode of iGibson's ends."""

HORIZON = 10.0
"""Seconds: collisions farther away count as if they were then."""

NOTICED = 0.02
"""Metres by which a step is changed at least."""


GRAZING = 1e-3
"""m^4/s^2: below, when two people touch changes too fast for a gradient."""

_AT_ONCE = 100_000
"""Pairs of positions that are compared at once: several such tensors fit a cache."""


def contact_events(contact: Tensor) -> Tensor:
    """Return how often each person begins to touch (E, A) long, for touches in 0.1 s (E, A, T) bool.

    A touch that lasts counts once. Two people who touch each other have one event each.
    """
    return begins(contact).sum(-1)


def begins(when: Tensor) -> Tensor:
    """Return where something begins (E, A, T) bool, such as touches, given when it is so (E, A, T) bool."""
    before = torch.cat((torch.zeros_like(when[..., :1]), when[..., :-1]), dim=-1)
    return when & ~before


def person_minutes(scored: Tensor) -> Tensor:
    """Return how long each person was scored (E, A), minutes."""
    return scored.sum(-1) * TRACE_SECONDS / 60


def nearest(trace: Tensor, present: Tensor) -> Tensor:
    """Return the distance between centres to the nearest other (E, A, T), metres; infinite without one."""
    parts = []
    for x, y, absent in _frames(present, trace):
        apart = (x.unsqueeze(2) - x.unsqueeze(1)).square_()
        across = y.unsqueeze(2) - y.unsqueeze(1)
        apart = apart.addcmul_(across, across).add_(absent)
        apart.diagonal(dim1=1, dim2=2).fill_(torch.inf)
        parts.append(apart.amin(2).sqrt_())
    return _of_people(parts, present)


def least_distance(nearest: Tensor, scored: Tensor) -> Tensor:
    """Return the least distance to another (E, A), metres between centres; infinite for a person alone."""
    return nearest.masked_fill(~scored, torch.inf).amin(-1)


def keeps_distance(nearest: Tensor, scored: Tensor) -> Tensor:
    """Return at which points no other is within 0.5 m of each scored person (E, A, T) bool.

    Their share of all scored points is personal-space compliance per frame.
    """
    return (nearest >= PERSONAL_SPACE) & scored


def compliance_igibson(nearest: Tensor, scored: Tensor) -> Tensor:
    """Return each person's personal-space compliance as iGibson counts it (E, A), 0 to 1.

    ``1 - points with another person within 0.5 m / 500``, not below 0. 500 is the number of 0.1 s steps that
    an episode of iGibson's social navigation may take, so short episodes look better.
    """
    intruded = (nearest < PERSONAL_SPACE) & scored
    return (1 - intruded.sum(-1) / IGIBSON_POINTS).clamp_min(0.0)


def time_to_collision(
    position: Tensor, velocity: Tensor, there: Tensor, radius: Tensor | None = None
) -> Tensor:
    """Return after how long each person would touch another if all kept their velocities (E, A, S), seconds.

    The smaller root of ``|p + v t| = R``: 0 where they touch already, 10 for later than 10 s and for never. R
    is the sum of two radii (E, A), those of people if None. A person's time is the least over all others
    ``there`` (E, A, S), infinite for people alone or absent. Positions and velocities (E, A, S, 2), metres
    and m/s.
    """
    own = position.new_full(position.shape[:2], BODY_RADIUS) if radius is None else radius.to(position)
    own = own[..., None, None].expand(*position.shape[:3], 1)
    parts = []
    for *values, size, absent in _frames(there, position, velocity, own):
        x, y, vx, vy = (value.unsqueeze(1) - value.unsqueeze(2) for value in values)
        reach = size.unsqueeze(1) + size.unsqueeze(2)
        seconds = collision_seconds(x, y, vx, vy, reach).add_(absent)
        seconds.diagonal(dim1=1, dim2=2).fill_(torch.inf)
        parts.append(seconds.amin(2))
    return _of_people(parts, there)


def collision_seconds(x: Tensor, y: Tensor, vx: Tensor, vy: Tensor, reach: Tensor) -> Tensor:
    """Return when pairs (...) that keep their velocities touch, at most 10 s; see `time_to_collision`.

    Positions and velocities are those of the other less those of the one, and ``reach`` is the sum of radii.
    The memory of all arguments is used for the result.
    """
    closing = (x * vx).addcmul_(y, vy).neg_()  # -p.v
    gap = x.square_().addcmul_(y, y).sub_(reach**2)  # |p|^2 - R^2
    under = vx.square_().addcmul_(vy, vy).mul_(gap).neg_().addcmul_(closing, closing)
    # the smaller root, in the form that does not cancel and needs no |v| > 0
    seconds = gap.clamp(min=0.0).div_(under.clamp(min=0.0).sqrt_().add_(closing))
    never = (closing <= 0) | (under < 0)
    return seconds.masked_fill_(never, HORIZON).clamp_(max=HORIZON).masked_fill_(gap <= 0, 0.0)


def touch_seconds(away: Tensor, velocity: Tensor, reach: Tensor | float) -> Tensor:
    """Return when pairs (M,) touch that do so within `HORIZON`, with gradients; see `collision_seconds`.

    They are ``away`` from each other, with a relative ``velocity`` (M, 2). Times of those who only graze each
    other are a little too small.
    """
    closing = -(away * velocity).sum(-1)
    gap = away.square().sum(-1) - reach**2
    under = closing.square() - velocity.square().sum(-1) * gap
    return gap / (under.clamp_min(GRAZING).sqrt() + closing.clamp_min(1e-3))


def _frames(there: Tensor, *vectors: Tensor) -> Iterator[list[Tensor]]:
    """Yield the points of all episodes, F at once so that their pairs fit a cache.

    Args:
        there: Which people are present (E, A, T) bool.
        vectors: (E, A, T, D) each.

    Yields:
        Each component of each of the vectors (F, A). Last, what to add to values of
        pairs (F, A, A): 0 for others that are there, infinity for absent ones (F, 1, A).
    """
    agents = there.shape[1]
    by_frame = [
        value for one in vectors for value in one.permute(3, 0, 2, 1).reshape(one.shape[3], -1, agents)
    ]
    absent = torch.zeros_like(by_frame[0]).masked_fill_(~there.transpose(1, 2).reshape(-1, agents), torch.inf)
    size = max(1, _AT_ONCE // max(1, agents**2))
    for first in range(0, max(1, len(absent)), size):
        some = slice(first, first + size)
        yield [*(value[some] for value in by_frame), absent[some].unsqueeze(1)]


def _of_people(parts: list[Tensor], there: Tensor) -> Tensor:
    """Return values of the frames (F, A) as (E, A, T), infinite for absent people."""
    episodes, agents, points = there.shape
    result = torch.cat(parts).view(episodes, points, agents).transpose(1, 2)
    return result.masked_fill(~there, torch.inf)


def untouched(rollout: Rollout) -> Tensor:
    """Return in which episodes scored people have no contact with people or walls (E,) bool."""
    touches = (rollout.agent_contact | rollout.wall_contact) & rollout.scored
    return ~touches.flatten(1).any(1)


def _events(rollout: Rollout, contact: Tensor) -> Tensor:
    return contact_events(contact & rollout.scored)


@once
def _nearest(rollout: Rollout) -> Tensor:
    return nearest(rollout.trace, rollout.present)


@metric()
def contact_free(rollout: Rollout) -> Ratio:
    """Share of episodes without any contact with people or walls."""
    return share(untouched(rollout))


@metric()
def agent_contacts_per_min(rollout: Rollout) -> Ratio:
    """Contacts with other people per minute that a person walks; one that lasts counts once."""
    return ratio(_events(rollout, rollout.agent_contact), person_minutes(rollout.scored))


@metric()
def agent_contacts_per_episode(rollout: Rollout) -> Ratio:
    """Contacts with other people of all people."""
    return ratio(_events(rollout, rollout.agent_contact).sum(1))


@metric()
def agent_contact_episodes(rollout: Rollout) -> Ratio:
    """Share of episodes with any contact with other people."""
    return share((_events(rollout, rollout.agent_contact) > 0).any(1))


@metric()
def wall_contacts_per_min(rollout: Rollout) -> Ratio:
    """Contacts with walls per minute that a person walks; one that lasts counts once."""
    return ratio(_events(rollout, rollout.wall_contact), person_minutes(rollout.scored))


@metric()
def wall_contacts_per_episode(rollout: Rollout) -> Ratio:
    """Contacts with walls of all people."""
    return ratio(_events(rollout, rollout.wall_contact).sum(1))


@metric()
def wall_contact_episodes(rollout: Rollout) -> Ratio:
    """Share of episodes with any contact with walls."""
    return share((_events(rollout, rollout.wall_contact) > 0).any(1))


@metric()
def personal_space(rollout: Rollout) -> Ratio:
    """Share of people's 0.1 s points at which no other person is within 0.5 m."""
    return ratio(keeps_distance(_nearest(rollout), rollout.scored), rollout.scored)


@metric("ordinary")
def personal_space_igibson(rollout: Rollout) -> Ratio:
    """Personal space as iGibson counts it, mean over people.

    See `pedzoo.metrics.compliance_igibson`.
    """
    stored = compliance_igibson(_nearest(rollout), rollout.scored)
    return ratio(stored.where(rollout.mask, 0.0), rollout.mask)._replace(part=True)


@metric()
def least_distance_m(rollout: Rollout) -> Ratio:
    """Distance between centres of an episode's nearest two, mean over episodes in which people meet."""
    return finite(least_distance(_nearest(rollout), rollout.scored).amin(1))


@once
def _collisions(rollout: Rollout) -> tuple[Tensor, Tensor]:
    """Return seconds to collision at the ends of 0.4 s windows (E, A, S), and where people meet others."""
    velocity, there = velocities(rollout.path, rollout.continuous)
    ends = slice(WINDOW - 1, None, WINDOW)
    seconds = time_to_collision(rollout.trace[:, :, ends], velocity, there, rollout.radius)
    return seconds, seconds.isfinite() & rollout.scored[:, :, ends]


@metric()
def time_to_collision_s(rollout: Rollout) -> Ratio:
    """Time to collision if all kept their velocities, capped at 10 s, mean over people and 0.4 s windows."""
    return mean(*_collisions(rollout))


@metric()
def time_to_collision_capped(rollout: Rollout) -> Ratio:
    """Share of these times at the cap."""
    seconds, meets = _collisions(rollout)
    return mean(seconds >= HORIZON, meets)


def _nothing(rollout: Rollout) -> Ratio:
    return ratio(torch.zeros(len(rollout.failed)), torch.zeros(len(rollout.failed)))


@metric()
def intervention_share(rollout: Rollout) -> Ratio:
    """Share of people's steps that the safety layer changes by more than 2 cm."""
    if rollout.changed is None:
        return _nothing(rollout)
    return mean(rollout.changed > NOTICED, rollout.scored)


@metric()
def intervention_m(rollout: Rollout) -> Ratio:
    """Metres by which the safety layer changes a step, mean over all steps of people."""
    if rollout.changed is None:
        return _nothing(rollout)
    return mean(rollout.changed, rollout.scored)
