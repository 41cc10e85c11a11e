"""Contacts with people and walls, distances between people, and what a safety layer changes.

E episodes of A people (padded), T trace points. Scored people (E, A, T) may come near all who are present.
"""

from collections.abc import Callable

import torch
from torch import Tensor

from pedzoo.core.types import BODY_RADIUS, TRACE_SECONDS
from pedzoo.metrics.ratios import Ratio, finite, mean, metric, once, ratio, share
from pedzoo.metrics.smoothness import WINDOW, velocities
from pedzoo.sim.rollout import Rollout

PERSONAL_SPACE, IGIBSON_POINTS = 0.5, 500
"""Metres between centres, and steps of 0.1 s after which an episode of iGibson's ends."""

HORIZON = 10.0
"""Seconds: collisions farther away count as if they were then."""

NOTICED = 0.02
"""Metres by which a step is changed at least."""

GRAZING = 1e-3
"""m^4/s^2: below, when two people touch changes too fast for a gradient."""

_AT_ONCE = 100_000
"""Pairs of positions that are compared at once: several such tensors fit a cache."""


def contact_events(contact: Tensor) -> Tensor:
    """Return how often each person begins to touch (E, A) long, for touches in 0.1 s (E, A, T) bool."""
    return begins(contact).sum(-1)


def begins(when: Tensor) -> Tensor:
    """Return where something begins (E, A, T) bool, such as touches, given when it is so (E, A, T) bool."""
    return when & ~torch.nn.functional.pad(when[..., :-1], (1, 0))


def person_minutes(scored: Tensor) -> Tensor:
    """Return how long each person was scored (E, A), minutes."""
    return scored.sum(-1) * TRACE_SECONDS / 60


def nearest(trace: Tensor, present: Tensor) -> Tensor:
    """Return the distance between centres to the nearest other (E, A, T), metres; infinite without one."""

    def squares(xy: Tensor) -> Tensor:
        x, y = (xy.unsqueeze(1) - xy.unsqueeze(2)).unbind(-1)
        return x.square().addcmul_(y, y)

    return _least_over_others(squares, present, trace).sqrt()


def time_to_collision(
    position: Tensor, velocity: Tensor, there: Tensor, radius: Tensor | None = None
) -> Tensor:
    """Return the least `collision_seconds` over all others ``there`` (E, A, S); infinite of people alone.

    Positions and velocities (E, A, S, 2), metres and m/s; radii (E, A), those of people if None.
    """
    own = position.new_full(position.shape[:2], BODY_RADIUS) if radius is None else radius.to(position)

    def seconds(xy: Tensor, moves: Tensor, size: Tensor) -> Tensor:
        away, relative = (one.unsqueeze(1) - one.unsqueeze(2) for one in (xy, moves))
        return collision_seconds(away, relative, size.unsqueeze(1) + size.unsqueeze(2))

    return _least_over_others(seconds, there, position, velocity, own.unsqueeze(2).expand_as(there))


def collision_seconds(away: Tensor, velocity: Tensor, reach: Tensor) -> Tensor:
    """Return when pairs (...) that keep their velocities touch, seconds: 0 to 10, and 10 for never.

    The smaller root of ``|p + v t| = R``: p and v (..., 2) are the position and velocity of the other less
    those of the one, metres and m/s, R is the sum of radii (...), metres.
    """
    closing, gap, under = _approach(away, velocity, reach)
    # in the form that does not cancel and needs no |v| > 0
    seconds = gap.clamp(min=0.0) / (under.clamp(min=0.0).sqrt() + closing)
    never = (closing <= 0) | (under < 0)
    return seconds.masked_fill(never, HORIZON).clamp(max=HORIZON).masked_fill(gap <= 0, 0.0)


def touch_seconds(away: Tensor, velocity: Tensor, reach: Tensor | float) -> Tensor:
    """Return `collision_seconds` with gradients, of pairs that touch; a little less of who only graze."""
    closing, gap, under = _approach(away, velocity, reach)
    return gap / (under.clamp_min(GRAZING).sqrt() + closing.clamp_min(1e-3))


def _approach(away: Tensor, velocity: Tensor, reach: Tensor | float) -> tuple[Tensor, Tensor, Tensor]:
    """Return ``-p.v``, ``|p|^2 - R^2`` and the term under the root, see `collision_seconds`."""
    (x, y), (vx, vy) = away.unbind(-1), velocity.unbind(-1)
    closing, gap = -(x * vx).addcmul(y, vy), x.square().addcmul(y, y) - reach**2
    return closing, gap, -(vx.square().addcmul(vy, vy) * gap).addcmul(closing, closing, value=-1)


def _least_over_others(of_pairs: Callable[..., Tensor], there: Tensor, *values: Tensor) -> Tensor:
    """Return the least of values of pairs (F, A, A) over the others that are there (E, A, T)."""
    episodes, agents, points = there.shape
    size, parts = max(1, _AT_ONCE // max(1, agents**2)), []
    frames = [one.transpose(1, 2).flatten(0, 1) for one in values]
    # x and y of all frames lie apart, which is twice as fast
    frames = [one.movedim(-1, 0).contiguous().movedim(0, -1) if one.dim() > 2 else one for one in frames]
    absent = values[0].new_zeros(len(frames[0]), agents)
    absent.masked_fill_(~there.transpose(1, 2).flatten(0, 1), torch.inf)
    for missing, *some in zip(*(one.split(size) for one in (absent, *frames)), strict=True):
        pairs = of_pairs(*some).add_(missing.unsqueeze(1))
        pairs.diagonal(dim1=1, dim2=2).fill_(torch.inf)
        parts.append(pairs.amin(2))
    result = torch.cat(parts).view(episodes, points, agents).transpose(1, 2)
    return result.masked_fill(~there, torch.inf)


def untouched(rollout: Rollout) -> Tensor:
    """Return in which episodes scored people have no contact with people or walls (E,) bool."""
    touches = (rollout.agent_contact | rollout.wall_contact) & rollout.scored
    return ~touches.flatten(1).any(1)


@once
def _touches(rollout: Rollout) -> tuple[Tensor, Tensor]:
    """Return how often each scored person begins to touch people and walls (E, A) long."""
    agents, walls = (one & rollout.scored for one in (rollout.agent_contact, rollout.wall_contact))
    return contact_events(agents), contact_events(walls)


@once
def _nearest(rollout: Rollout) -> Tensor:
    return nearest(rollout.trace, rollout.present)


def least_distance(rollout: Rollout) -> Tensor:
    """Return the least distance of scored people to another (E, A), metres; infinite for a person alone."""
    return _nearest(rollout).masked_fill(~rollout.scored, torch.inf).amin(-1)


@metric()
def contact_free(rollout: Rollout) -> Ratio:
    """Share of episodes without any contact with people or walls."""
    return share(untouched(rollout))


@metric()
def agent_contacts_per_min(rollout: Rollout) -> Ratio:
    """Contacts with other people per minute that a person walks; one that lasts counts once."""
    return ratio(_touches(rollout)[0], person_minutes(rollout.scored))


@metric()
def agent_contacts_per_episode(rollout: Rollout) -> Ratio:
    """Contacts with other people of all people."""
    return ratio(_touches(rollout)[0].sum(1))


@metric()
def agent_contact_episodes(rollout: Rollout) -> Ratio:
    """Share of episodes with any contact with other people."""
    return share(_touches(rollout)[0].any(1))


@metric()
def wall_contacts_per_min(rollout: Rollout) -> Ratio:
    """Contacts with walls per minute that a person walks; one that lasts counts once."""
    return ratio(_touches(rollout)[1], person_minutes(rollout.scored))


@metric()
def wall_contacts_per_episode(rollout: Rollout) -> Ratio:
    """Contacts with walls of all people."""
    return ratio(_touches(rollout)[1].sum(1))


@metric()
def wall_contact_episodes(rollout: Rollout) -> Ratio:
    """Share of episodes with any contact with walls."""
    return share(_touches(rollout)[1].any(1))


@metric()
def personal_space(rollout: Rollout) -> Ratio:
    """Share of people's 0.1 s points at which no other person is within 0.5 m."""
    return mean(_nearest(rollout) >= PERSONAL_SPACE, rollout.scored)


@metric("ordinary")
def personal_space_igibson(rollout: Rollout) -> Ratio:
    """Personal space as iGibson counts it, mean over people.

    ``1 - points with another person within 0.5 m / 500``, not below 0, however short the episode is.
    """
    intruded = (_nearest(rollout) < PERSONAL_SPACE) & rollout.scored
    kept = (1 - intruded.sum(-1) / IGIBSON_POINTS).clamp_min(0.0)
    return mean(kept, rollout.mask)._replace(part=True)


@metric()
def least_distance_m(rollout: Rollout) -> Ratio:
    """Distance between centres of an episode's nearest two, mean over episodes in which people meet."""
    return finite(least_distance(rollout).amin(1))


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


def _changes(rollout: Rollout) -> tuple[Tensor, Tensor]:
    """Return metres by which a layer changes steps, and which count (E, A, T); none without a layer."""
    if rollout.changed is None:
        return torch.zeros(rollout.scored.shape), torch.zeros_like(rollout.scored)
    return rollout.changed, rollout.scored


@metric()
def intervention_share(rollout: Rollout) -> Ratio:
    """Share of people's steps that the safety layer changes by more than 2 cm."""
    changed, known = _changes(rollout)
    return mean(changed > NOTICED, known)


@metric()
def intervention_m(rollout: Rollout) -> Ratio:
    """Metres by which the safety layer changes a step, mean over all steps of people."""
    return mean(*_changes(rollout))
