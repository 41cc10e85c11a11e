"""How people queue at a door, get through it, and turn there. See `pedzoo.metrics.door` for shapes."""

import math

import torch
from torch import Tensor

from pedzoo.core.types import STEP_SECONDS, TRACE_SECONDS
from pedzoo.metrics.door import from_door, passing_seconds
from pedzoo.metrics.ratios import Ratio, finite, mean, metric, once, ratio, share
from pedzoo.sim.rollout import Rollout

NEAR = 1.5
"""Metres before a door's wall within which people wait for it."""

HELD_UP = 0.2
"""m/s towards the door: people who are slower wait."""

ABOUT = 3.0
"""Metres around a door within which turns count."""

WALKS = 0.5
"""m/s: turns of slower people do not count."""

SHARP = math.radians(45)
"""Angle of a turn within 0.4 s beyond which it is sharp."""


def headways(seconds: Tensor, at: float) -> Tensor:
    """Return a quantile ``at`` of the times from person to person through a door (E,), seconds.

    ``seconds`` (E, A) are those at which people passed it; NaN where fewer than two did.
    """
    gaps = seconds.sort(1).values.diff(dim=1)
    if not gaps.shape[1]:  # one person alone
        return seconds.new_full((len(seconds),), torch.nan)
    return gaps.where(gaps.isfinite(), torch.nan).nanquantile(at, dim=1)


def wall_drift(path: Tensor, scored: Tensor, gate: Tensor, seconds: Tensor) -> tuple[Tensor, Tensor]:
    """Return how far people go along the wall while they wait before a door (E, A), metres, and which wait.

    People wait before they pass, within 1.5 m of the wall, while they come nearer to it by less than 0.2 m/s.
    ``seconds`` (E, A) is when they pass.
    """
    ahead, beside = from_door(path, gate)
    off = ahead * -ahead[..., :1].sign()  # below 0 on the side where a person begins
    now = TRACE_SECONDS * torch.arange(1, path.shape[2], device=path.device)
    waits = scored & (now < seconds.unsqueeze(2)) & (off[..., 1:] < 0) & (off[..., 1:] > -NEAR)
    waits &= off.diff(dim=2) < HELD_UP * TRACE_SECONDS
    return beside.diff(dim=2).abs().where(waits, 0.0).sum(2), waits.any(2)


def sharp(path: Tensor, scored: Tensor, gate: Tensor) -> tuple[Tensor, Tensor]:
    """Return where people turn by more than 45 degrees within 0.4 s (E, A, S), and where they walk (E, A, S).

    They walk if they are faster than 0.5 m/s both before and after, within 3 m of the door.
    """
    lag = round(STEP_SECONDS / TRACE_SECONDS)
    velocity = path.diff(dim=2) / TRACE_SECONDS
    about = scored & ((path[:, :, 1:] - gate[:, None, None, :2]).norm(dim=-1) < ABOUT)
    walks = about & (velocity.norm(dim=-1) > WALKS)
    both = walks[..., :-lag] & walks[..., lag:]
    cosine = torch.cosine_similarity(velocity[:, :, :-lag], velocity[:, :, lag:], dim=-1)
    return both & (cosine < math.cos(SHARP)), both


@once
def _passed(rollout: Rollout) -> Tensor:
    assert rollout.gate is not None
    return passing_seconds(rollout.path, rollout.scored, rollout.gate)


@metric("doors")
def through(rollout: Rollout) -> Ratio:
    """Share of people who get through the door, in time or not."""
    return share(_passed(rollout).isfinite() & rollout.mask, rollout.mask)


@metric("doors")
def all_through(rollout: Rollout) -> Ratio:
    """Share of episodes in which all people do."""
    return share((_passed(rollout).isfinite() | ~rollout.mask).all(1))


@metric("doors")
def headway_p05_s(rollout: Rollout) -> Ratio:
    """Time from person to person through the door, quantile of 0.05, mean over episodes."""
    return finite(headways(_passed(rollout), 0.05))


@metric("doors")
def headway_p50_s(rollout: Rollout) -> Ratio:
    """The same, median."""
    return finite(headways(_passed(rollout), 0.5))


@metric("doors")
def headway_p95_s(rollout: Rollout) -> Ratio:
    """The same, quantile of 0.95."""
    return finite(headways(_passed(rollout), 0.95))


@metric("doors")
def wall_drift_m(rollout: Rollout) -> Ratio:
    """Way along the wall of people who wait before the door, mean over people."""
    assert rollout.gate is not None
    return mean(*wall_drift(rollout.path, rollout.scored, rollout.gate, _passed(rollout)))


@metric("doors")
def sharp_turns(rollout: Rollout) -> Ratio:
    """Share of moments about the door at which walking people turn by more than 45 degrees within 0.4 s."""
    assert rollout.gate is not None
    return ratio(*sharp(rollout.path, rollout.scored, rollout.gate))
