"""Metrics of contacts and distances between people, and to walls."""

from torch import Tensor

from pedzoo.metrics import contact_functions
from pedzoo.metrics.ratios import Ratio, finite, mean, metric, once, ratio, share
from pedzoo.metrics.smoothness import WINDOW, velocities
from pedzoo.sim.rollout import Rollout


def untouched(rollout: Rollout) -> Tensor:
    """Return in which episodes scored people have no contact with people or walls (E,) bool."""
    touches = (rollout.agent_contact | rollout.wall_contact) & rollout.scored
    return ~touches.flatten(1).any(1)


def _events(rollout: Rollout, contact: Tensor) -> Tensor:
    return contact_functions.contact_events(contact & rollout.scored)


@once
def _nearest(rollout: Rollout) -> Tensor:
    return contact_functions.nearest(rollout.trace, rollout.present)


@metric()
def contact_free(rollout: Rollout) -> Ratio:
    """Share of episodes without any contact with people or walls."""
    return share(untouched(rollout))


@metric()
def agent_contacts_per_min(rollout: Rollout) -> Ratio:
    """Contacts with other people per minute that a person walks; one that lasts counts once."""
    return ratio(_events(rollout, rollout.agent_contact), contact_functions.person_minutes(rollout.scored))


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
    return ratio(_events(rollout, rollout.wall_contact), contact_functions.person_minutes(rollout.scored))


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
    return ratio(contact_functions.keeps_distance(_nearest(rollout), rollout.scored), rollout.scored)


@metric("ordinary")
def personal_space_igibson(rollout: Rollout) -> Ratio:
    """Personal space as iGibson counts it, mean over people.

    See `pedzoo.metrics.contact_functions.compliance_igibson`.
    """
    stored = contact_functions.compliance_igibson(_nearest(rollout), rollout.scored)
    return ratio(stored.where(rollout.mask, 0.0), rollout.mask)._replace(part=True)


@metric()
def least_distance_m(rollout: Rollout) -> Ratio:
    """Distance between centres of an episode's nearest two, mean over episodes in which people meet."""
    return finite(contact_functions.least_distance(_nearest(rollout), rollout.scored).amin(1))


@once
def _collisions(rollout: Rollout) -> tuple[Tensor, Tensor]:
    """Return seconds to collision at the ends of 0.4 s windows (E, A, S), and where people meet others."""
    velocity, there = velocities(rollout.path, rollout.met)
    ends = slice(WINDOW - 1, None, WINDOW)
    seconds = contact_functions.time_to_collision(rollout.trace[:, :, ends], velocity, there, rollout.radius)
    return seconds, seconds.isfinite() & rollout.scored[:, :, ends]


@metric()
def time_to_collision_s(rollout: Rollout) -> Ratio:
    """Time to collision if all kept their velocities, capped at 10 s, mean over people and 0.4 s windows."""
    return mean(*_collisions(rollout))


@metric()
def time_to_collision_capped(rollout: Rollout) -> Ratio:
    """Share of these times at the cap."""
    seconds, meets = _collisions(rollout)
    return mean(seconds >= contact_functions.HORIZON, meets)
