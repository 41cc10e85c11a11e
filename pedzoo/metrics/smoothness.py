"""How people move: metrics, and pure functions over the 0.1 s trace of their closed-loop episodes.

E episodes of A people (padded), T trace points. Speeds and their changes are taken over windows of 0.4 s, as
long as a model's decisions: window s of S is from point ``4 s`` to ``4 s + 4`` of the path. ``path`` (E, A,
1 + T, 2) is in metres, ``velocity`` (E, A, S, 2) in m/s; ``known`` (E, A, S) are windows that count.
"""

import math

import torch
from torch import Tensor

from pedzoo.core.types import GOAL_RADIUS, STEP_SECONDS, TRACE_SECONDS
from pedzoo.metrics.ratios import Ratio, mean, metric, once, ratio
from pedzoo.sim.rollout import Rollout

WINDOW = round(STEP_SECONDS / TRACE_SECONDS)
"""Trace points in a window."""

STANDS = 0.1
"""m/s: people slower than this in a window have no heading in it."""


def velocities(path: Tensor, scored: Tensor) -> tuple[Tensor, Tensor]:
    """Return velocities (E, A, S, 2) in windows of 0.4 s, m/s, and which are known."""
    windows = scored.shape[2] // WINDOW
    known = scored[..., : windows * WINDOW].unflatten(2, (windows, WINDOW)).all(-1)
    corners = path[:, :, : windows * WINDOW + 1 : WINDOW]
    return corners.diff(dim=2) / (WINDOW * TRACE_SECONDS), known


def acceleration(velocity: Tensor, known: Tensor, dt: float = STEP_SECONDS) -> tuple[Tensor, Tensor]:
    """Return the amount of acceleration (E, A, S - 1), m/s^2, windows of ``dt``, and where it is known."""
    return velocity.diff(dim=2).norm(dim=-1) / dt, known[..., 1:] & known[..., :-1]


def jerk(velocity: Tensor, known: Tensor, dt: float = STEP_SECONDS) -> tuple[Tensor, Tensor]:
    """Return the amount of jerk (E, A, S - 2), m/s^3, and where it is known; see `acceleration`."""
    known = known[..., 2:] & known[..., 1:-1] & known[..., :-2]
    return velocity.diff(n=2, dim=2).norm(dim=-1) / dt**2, known


def heading_rate(velocity: Tensor, known: Tensor, dt: float = STEP_SECONDS) -> tuple[Tensor, Tensor]:
    """Return how fast headings turn, left or right (E, A, S - 1), rad/s, and where people walk all along."""
    angle, walks = _headings(velocity, known)
    return _wrapped(angle.diff(dim=2)) / dt, walks[..., 1:] & walks[..., :-1]


def turning(velocity: Tensor, known: Tensor) -> Tensor:
    """Return by how much each person turned in all (E, A), radians, to either side, also at stops."""
    angle, walks = _headings(velocity, known)
    number = torch.arange(walks.shape[2], device=walks.device).expand_as(walks)
    latest = torch.where(walks, number, -1).cummax(2).values[..., :-1]
    before = latest.clamp_min(0)
    gaps = (~known).cumsum(2)
    joined = (latest >= 0) & (gaps[..., 1:] == gaps.gather(2, before))
    turned = _wrapped(angle[..., 1:] - angle.gather(2, before))
    return turned.where(joined & walks[..., 1:], 0.0).sum(2)


def length(velocity: Tensor, known: Tensor, dt: float = STEP_SECONDS) -> Tensor:
    """Return how far each person went in the windows that are known (E, A), metres."""
    return velocity.norm(dim=-1).where(known, 0.0).sum(2) * dt


def _headings(velocity: Tensor, known: Tensor) -> tuple[Tensor, Tensor]:
    return torch.atan2(velocity[..., 1], velocity[..., 0]), known & (velocity.norm(dim=-1) > STANDS)


def _wrapped(angle: Tensor) -> Tensor:
    return torch.remainder(angle + math.pi, 2 * math.pi).sub(math.pi).abs()


@once
def moves(rollout: Rollout) -> tuple[Tensor, Tensor]:
    """Return the velocities of scored people; see `velocities`."""
    return velocities(rollout.path, rollout.scored)


@metric()
def speed_m_per_s(rollout: Rollout) -> Ratio:
    """Speed, mean over people and 0.4 s windows."""
    velocity, known = moves(rollout)
    return mean(velocity.norm(dim=-1), known)


@metric()
def acceleration_m_per_s2(rollout: Rollout) -> Ratio:
    """Amount of acceleration, likewise."""
    return mean(*acceleration(*moves(rollout)))


@metric()
def jerk_m_per_s3(rollout: Rollout) -> Ratio:
    """Amount of jerk, likewise."""
    return mean(*jerk(*moves(rollout)))


@metric()
def heading_rate_rad_per_s(rollout: Rollout) -> Ratio:
    """How fast headings turn, left or right, likewise."""
    return mean(*heading_rate(*moves(rollout)))


@metric()
def path_irregularity_rad_per_m(rollout: Rollout) -> Ratio:
    """Total turning divided by total path length."""
    return ratio(turning(*moves(rollout)), length(*moves(rollout)))


@metric("ordinary")
def standing_drift_m(rollout: Rollout) -> Ratio:
    """Greatest distance from the place where a person waits until another goal comes, mean over people."""
    place = rollout.goal[:, :, :1]
    there = ((rollout.goal == place).all(-1) & rollout.controlled).cummin(2).values
    off = (rollout.trace - place).norm(dim=-1).where(there, torch.zeros(()))
    waits = rollout.mask & (rollout.first_path_length < GOAL_RADIUS) & there[..., 0]
    return mean(off.amax(2), waits)
