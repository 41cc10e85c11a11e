"""Order and flow of people through a door: metrics, and pure functions over the trace of their episodes.

E episodes of A people (padded), T trace points. Nothing depends on which way a normal points. Arguments:

* ``path`` (E, A, 1 + T, 2): positions from where the episode begins, metres.
* ``scored`` (E, A, T) bool: which people count at each point but the first.
* ``gate`` (E, 5): the door's centre c, x and y, the unit normal of its wall, x and y, and its clear width.
* ``pair`` (E, 2) long: one person from each side, those who are nearest to c when the episode begins.
* ``seconds`` (E, A), of a pair (E, 2): when they passed the door, infinite for people not through.
"""

import math
from typing import NamedTuple

import torch
from torch import Tensor

from pedzoo.core.types import STEP_SECONDS, TRACE_SECONDS
from pedzoo.metrics import smoothness
from pedzoo.metrics.ratios import Ratio, finite, mean, metric, once, ratio, share
from pedzoo.sim.rollout import Rollout

NEAR, HELD_UP = 1.5, 0.2
"""People wait within so many metres before a door's wall if they come nearer to it more slowly, m/s."""

ABOUT, WALKS, SHARP = 3.0, 0.5, math.radians(45)
"""Turns count within so many metres of a door, of people faster, m/s; beyond this angle they are sharp."""


def passing_seconds(path: Tensor, scored: Tensor, gate: Tensor) -> Tensor:
    """Return when each person passed the door for good (E, A), seconds; infinite for people not through.

    That is the last of an odd number of crossings of the door line, interpolated between two trace points.
    """
    ahead, beside = from_door(path, gate)
    side = ahead >= 0
    at = ahead[..., :-1] / (ahead[..., :-1] - ahead[..., 1:])  # share of the step that is before the line
    between = beside[..., :-1] + at * beside.diff(dim=2)
    crossed = side[..., 1:] != side[..., :-1]
    crossed &= scored & (between.abs() <= gate[:, 4, None, None] / 2)
    step = torch.arange(crossed.shape[2], device=path.device)
    seconds = ((step + at.double()) * TRACE_SECONDS).masked_fill(~crossed, -torch.inf)
    return torch.where(crossed.sum(2) % 2 == 1, seconds.amax(2), torch.inf)


def pair(start: Tensor, mask: Tensor, gate: Tensor) -> tuple[Tensor, Tensor]:
    """Return the pair of an episode's people ``mask`` (E, A), and where there is one (E,) bool."""
    ahead, _ = from_door(start.unsqueeze(2), gate)
    away = (start - gate[:, None, :2]).norm(dim=-1)
    sides = torch.stack((ahead[..., 0] < 0, ahead[..., 0] >= 0), dim=1) & mask.unsqueeze(1)
    nearest = away.unsqueeze(1).masked_fill(~sides, torch.inf).min(2)
    return nearest.indices, nearest.values.isfinite().all(1)


def index_of_symmetry(path: Tensor, scored: Tensor, gate: Tensor, pair: Tensor) -> tuple[Tensor, Tensor]:
    """Return the `asymmetry` of a pair by its mean distance from c at the begin (E,), and where it is known.

    0: they are mirror images in c (ORCA, started alike). About 1: one waits until the other is through.
    """
    metres, known = asymmetry(path, scored, gate, pair)
    size = (of_pair(path, pair)[:, :, 0] - gate[:, None, :2]).norm(dim=-1).mean(1)
    return metres / size.clamp_min(1e-9), known & (size > 0)


def asymmetry(path: Tensor, there: Tensor, gate: Tensor, pair: Tensor) -> tuple[Tensor, Tensor]:
    """Return the mean of ``|p1 + p2 - 2c|`` while both are ``there`` (E,), metres, and where it is known."""
    two, both = of_pair(path, pair), of_pair(there, pair).all(1)
    off = (two.sum(1) - 2 * gate[:, None, :2]).norm(dim=-1)[:, 1:]
    points = both.sum(1)
    return off.where(both, 0.0).sum(1, dtype=torch.float64) / points.clamp_min(1), points > 0


def delay(seconds: Tensor) -> Tensor:
    """Return how much later the second of a pair passes (E,), seconds; infinite unless both are through."""
    return torch.where(seconds.isfinite().all(1), seconds.diff(dim=1).abs().squeeze(1), torch.inf)


def faster_is_first(seconds: Tensor, pref_speed: Tensor) -> tuple[Tensor, Tensor]:
    """Return where the person who prefers the higher speed passes first (E,) bool, and where that is known.

    That is where both are through and their preferred speeds (E, 2) differ by more than 0.05 m/s.
    """
    faster = pref_speed.diff(dim=1).squeeze(1)
    known = seconds.isfinite().all(1) & (faster.abs() > 0.05)
    later = seconds.where(known.unsqueeze(1), 0.0).diff(dim=1).squeeze(1)
    return known & (later * faster < 0), known


def yielder_speed(velocity: Tensor, known: Tensor, seconds: Tensor) -> Tensor:
    """Return the least speed of the second of a pair before passing the door (E,), m/s; infinite of none.

    The pair's ``velocity`` (E, 2, S, 2), m/s, and ``known`` (E, 2, S) are those of `smoothness.velocities`.
    """
    end = STEP_SECONDS * torch.arange(1, velocity.shape[2] + 1, device=velocity.device)
    before = known & (end <= seconds.unsqueeze(2))
    least = velocity.norm(dim=-1).masked_fill(~before, torch.inf).amin(2)
    second = seconds.argmax(1, keepdim=True)
    return torch.where(seconds.isfinite().all(1), least.gather(1, second).squeeze(1), torch.inf)


def flow(seconds: Tensor, gate: Tensor) -> tuple[Tensor, Tensor]:
    """Return how many people got through (E,) long, and the door's width times the time they took (E,), m s.

    Their ratio is the specific flow from the first to the last passing, N / (T w), PedPy's `compute_flow` by
    the width. 0 and 0 where fewer than two got through, or all in the same moment.
    """
    through = seconds.isfinite()
    last = seconds.where(through, -torch.inf).amax(1)
    took = (last - seconds.amin(1)).nan_to_num(0.0, posinf=0.0, neginf=0.0)
    counts = (through.sum(1) >= 2) & (took > 0)
    return through.sum(1).where(counts, 0), (took * gate[:, 4]).where(counts, 0.0)


def headways(seconds: Tensor, at: float) -> Tensor:
    """Return a quantile ``at`` of the times from person to person (E,), seconds; NaN of fewer than two."""
    gaps = seconds.sort(1).values.diff(dim=1)
    if not gaps.shape[1]:  # one person alone
        return seconds.new_full((len(seconds),), torch.nan)
    return gaps.where(gaps.isfinite(), torch.nan).nanquantile(at, dim=1)


def wall_drift(path: Tensor, scored: Tensor, gate: Tensor, seconds: Tensor) -> tuple[Tensor, Tensor]:
    """Return how far people go along the wall while they wait for the door (E, A), metres, and who waits."""
    ahead, beside = from_door(path, gate)
    off = ahead * -ahead[..., :1].sign()  # below 0 on the side where a person begins
    now = TRACE_SECONDS * torch.arange(1, path.shape[2], device=path.device)
    waits = scored & (now < seconds.unsqueeze(2)) & (off[..., 1:] < 0) & (off[..., 1:] > -NEAR)
    waits &= off.diff(dim=2) < HELD_UP * TRACE_SECONDS
    return beside.diff(dim=2).abs().where(waits, 0.0).sum(2), waits.any(2)


def sharp(path: Tensor, scored: Tensor, gate: Tensor) -> tuple[Tensor, Tensor]:
    """Return where people turn by over 45 degrees in 0.4 s (E, A, S), and where they walk until then."""
    lag = round(STEP_SECONDS / TRACE_SECONDS)
    velocity = path.diff(dim=2) / TRACE_SECONDS
    about = scored & ((path[:, :, 1:] - gate[:, None, None, :2]).norm(dim=-1) < ABOUT)
    walks = about & (velocity.norm(dim=-1) > WALKS)
    both = walks[..., :-lag] & walks[..., lag:]
    cosine = torch.cosine_similarity(velocity[:, :, :-lag], velocity[:, :, lag:], dim=-1)
    return both & (cosine < math.cos(SHARP)), both


def of_pair(value: Tensor, pair: Tensor) -> Tensor:
    """Return a value of the pair (E, 2, ...) from that of all people (E, A, ...)."""
    return value[torch.arange(len(pair), device=pair.device).unsqueeze(1), pair]


def from_door(path: Tensor, gate: Tensor) -> tuple[Tensor, Tensor]:
    """Return how far positions (E, A, N, 2) are along the normal and along the wall (E, A, N), metres."""
    off = path - gate[:, None, None, :2]
    normal = gate[:, None, None, 2:4]
    ahead = (off * normal).sum(-1)
    return ahead, off[..., 1] * normal[..., 0] - off[..., 0] * normal[..., 1]


class _Door(NamedTuple):
    gate: Tensor
    passed: Tensor
    pair: Tensor
    met: Tensor
    theirs: Tensor


@once
def _door(rollout: Rollout) -> _Door:
    assert rollout.gate is not None
    passed = passing_seconds(rollout.path, rollout.scored, rollout.gate)
    two, met = pair(rollout.path[:, :, 0], rollout.mask, rollout.gate)
    theirs = of_pair(passed, two).where(met.unsqueeze(1), torch.inf)
    return _Door(rollout.gate, passed, two, met, theirs)


@metric("doors")
def symmetry_index(rollout: Rollout) -> Ratio:
    """0: the two walk as mirror images in the door; about 1: one waits until the other is through."""
    at = _door(rollout)
    index, known = index_of_symmetry(rollout.path, rollout.scored, at.gate, at.pair)
    return mean(index, known & at.met)


@metric("doors")
def symmetry_m(rollout: Rollout) -> Ratio:
    """Distance of the middle of the two from the door's centre, times two, mean until the first arrives."""
    at = _door(rollout)
    metres, known = asymmetry(rollout.path, rollout.scored & rollout.underway, at.gate, at.pair)
    return mean(metres, known & at.met)


@metric("doors")
def yield_delay_s(rollout: Rollout) -> Ratio:
    """How much later than the first the second passes."""
    return finite(delay(_door(rollout).theirs))


@metric("doors")
def faster_first(rollout: Rollout) -> Ratio:
    """Share of episodes in which the person who prefers the higher speed passes first."""
    at = _door(rollout)
    return share(*faster_is_first(at.theirs, of_pair(rollout.pref_speed, at.pair)))


@metric("doors")
def yielder_speed_m_per_s(rollout: Rollout) -> Ratio:
    """Least speed of the second before the door."""
    at = _door(rollout)
    velocity, known = (of_pair(value, at.pair) for value in smoothness.moves(rollout))
    return finite(yielder_speed(velocity, known, at.theirs))


@metric("doors")
def specific_flow_per_m_s(rollout: Rollout) -> Ratio:
    """All people who get through, divided by width of the door and time."""
    return ratio(*flow(_door(rollout).passed, _door(rollout).gate))


@metric("doors")
def through(rollout: Rollout) -> Ratio:
    """Share of people who get through the door, in time or not."""
    return share(_door(rollout).passed.isfinite() & rollout.mask, rollout.mask)


@metric("doors")
def all_through(rollout: Rollout) -> Ratio:
    """Share of episodes in which all people do."""
    return share((_door(rollout).passed.isfinite() | ~rollout.mask).all(1))


@metric("doors")
def headway_p05_s(rollout: Rollout) -> Ratio:
    """Time from person to person through the door, quantile of 0.05, mean over episodes."""
    return finite(headways(_door(rollout).passed, 0.05))


@metric("doors")
def headway_p50_s(rollout: Rollout) -> Ratio:
    """The same, median."""
    return finite(headways(_door(rollout).passed, 0.5))


@metric("doors")
def headway_p95_s(rollout: Rollout) -> Ratio:
    """The same, quantile of 0.95."""
    return finite(headways(_door(rollout).passed, 0.95))


@metric("doors")
def wall_drift_m(rollout: Rollout) -> Ratio:
    """Way along the wall of people who wait before the door, mean over people."""
    at = _door(rollout)
    return mean(*wall_drift(rollout.path, rollout.scored, at.gate, at.passed))


@metric("doors")
def sharp_turns(rollout: Rollout) -> Ratio:
    """Share of moments about the door at which walking people turn by more than 45 degrees within 0.4 s."""
    return ratio(*sharp(rollout.path, rollout.scored, _door(rollout).gate))
