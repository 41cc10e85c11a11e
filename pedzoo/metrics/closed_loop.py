"""All closed-loop metrics of a rollout, each as a ratio of two sums over episodes."""

from __future__ import annotations

import torch
from torch import Tensor
from torchmetrics import Metric

from pedzoo.core.types import STEP_SECONDS
from pedzoo.metrics import door, navigation, safety, smoothness
from pedzoo.metrics.intervals import Interval, bootstrap_quantile
from pedzoo.metrics.quantiles import quantiles
from pedzoo.metrics.ratios import Ratio, finite, mean, of_sums, ratio, share
from pedzoo.metrics.runs import Runs
from pedzoo.sim.rollout import Rollout

NAMES = (
    *("success", "episode_success", "clean", "contact_free", "failed", "deadlock"),
    *("goals_per_person", "goals_per_person_min", "goals_per_person_max", "goals_parity"),
    *("time_s", "decisions", "time_ratio", "path_ratio", "spl", "stl"),
    *("agent_contacts_per_min", "wall_contacts_per_min"),
    *("agent_contacts_per_episode", "wall_contacts_per_episode"),
    *("agent_contact_episodes", "wall_contact_episodes"),
    *("personal_space", "personal_space_igibson", "least_distance_m"),
    *("time_to_collision_s", "time_to_collision_capped"),
    *("speed_m_per_s", "acceleration_m_per_s2", "jerk_m_per_s3", "heading_rate_rad_per_s"),
    "path_irregularity_rad_per_m",
    *("symmetry_index", "symmetry_m", "yield_delay_s", "faster_first", "yielder_speed_m_per_s"),
    "specific_flow_per_m_s",
)
"""Every metric there is, in the order of tables; `closed_loop` says what each of them is."""


def closed_loop(rollout: Rollout, decision_dt: float) -> dict[str, Ratio]:
    """Return every metric that applies to a rollout, by its name, in the order of `NAMES`.

    Whatever has no value (nobody arrived, nobody else was there, ...) is in neither sum of its ratio.

    Of all scored people, over the points or windows at which they are:

    * ``agent_contacts_per_min``, ``wall_contacts_per_min``: events per minute that a person walks, for
      everybody who touches; ``..._per_episode`` their number; ``..._contact_episodes`` the share of episodes
      with any. See `contact_events`. ``contact_free``: the share of episodes with neither.
    * ``personal_space``: share of 0.1 s points at which nobody is within 0.5 m.
    * ``least_distance_m``: between an episode's nearest two, mean over episodes in which people meet.
    * ``time_to_collision_s``: mean over people and 0.4 s windows in which anybody else is there, capped at
      10 s; ``time_to_collision_capped`` the share of these at the cap.
    * ``speed_m_per_s``, ``acceleration_m_per_s2``, ``jerk_m_per_s3``, ``heading_rate_rad_per_s``: means over
      people and 0.4 s windows; ``path_irregularity_rad_per_m``: all turning by all way.

    Of goals. In a replay, in which people come and go, there are ``success``, ``deadlock``, ``failed``,
    ``path_ratio`` and ``spl``, of people from when the policy takes over until they leave; the rest of it and
    of what follows is of ordinary scenes only.

    * ``success``, ``deadlock``: shares of people; ``episode_success`` (all succeed) and ``failed`` (the
      policy gave no number): of episodes. ``clean``: of episodes in which all succeed and nobody touches
      anybody or any wall: success, no agent contact and no wall contact together.
    * ``goals_per_person``, and ``..._min`` and ``..._max`` of an episode's person with the fewest and the
      most; ``goals_parity``: fewest by most, mean over episodes in which anybody reached a goal.
    * ``time_s``: when the last person arrives, mean over episodes in which all do in time; ``decisions``:
      that in steps of the policy.
    * ``path_ratio``, ``time_ratio``: ratios of sums over people who arrive. All their ways by all planned
      ways; all their times by those of free walking, each planned way at the preferred speed. So a short way
      counts little. ``spl``, ``stl``: see `weighted`, means over people. A policy that
      decides rarely walks on after a goal before it hears of the next one: that counts as walked.
    * ``personal_space_igibson``: mean over people, see `compliance_igibson`.
    * At a door: see `pedzoo.metrics.door`; ``symmetry_m`` until the first of the two arrives. Means over
      episodes in which they are known; ``faster_first`` is a share of these, ``specific_flow_per_m_s`` all
      people who got through by all width and time.

    Args:
        rollout: Some episodes.
        decision_dt: Seconds between two decisions of the policy.
    """
    scored = rollout.scored
    near = safety.nearest(rollout.trace, rollout.present)
    moves = smoothness.velocities(rollout.path, scored)
    result = _meeting(rollout, scored, near) | _ahead(rollout, scored) | _moving(*moves)
    if rollout.replayed:
        result |= _leaving(rollout, scored)
    else:
        result |= _arriving(rollout, scored, decision_dt)
        kept = safety.compliance_igibson(near, scored).where(rollout.mask, 0.0)
        result["personal_space_igibson"] = ratio(kept, rollout.mask)
        if rollout.gate is not None:
            result |= _at_door(rollout, scored, rollout.gate, *moves)
    return {name: result[name] for name in NAMES if name in result}


def _arriving(rollout: Rollout, scored: Tensor, decision_dt: float) -> dict[str, Ratio]:
    """Return what is about goals."""
    mask, reached, goals = rollout.mask, rollout.reached, rollout.goals
    arrived = navigation.success(reached, goals, rollout.overdue, rollout.failed, mask)
    seconds = navigation.finish_seconds(reached, goals)
    time = navigation.episode_seconds(seconds, arrived, mask)
    walked = navigation.walked_metres(rollout.path, scored, reached, goals)
    planned = navigation.planned_metres(rollout.planned, reached, goals)
    needed, taken = planned / rollout.pref_speed, seconds - rollout.stood
    fewest, most = navigation.fewest_goals(reached, mask), navigation.most_goals(reached, mask)
    stuck = navigation.deadlocked(rollout.trace, rollout.goal, scored)
    everybody = (arrived | ~mask).all(1) & ~rollout.failed
    return {
        "success": share(arrived, mask),
        "episode_success": share(everybody),
        "clean": share(everybody & _untouched(rollout, scored)),
        "failed": share(rollout.failed),
        "deadlock": share(stuck, mask),
        "goals_per_person": ratio(reached[..., -1].where(mask, 0), mask),
        "goals_per_person_min": ratio(fewest),
        "goals_per_person_max": ratio(most),
        "goals_parity": mean(fewest.double() / most.clamp_min(1), most > 0),
        "time_s": finite(time),
        "decisions": finite((time / decision_dt - 1e-6).ceil()),
        "time_ratio": of_sums(taken, needed, arrived),
        "path_ratio": of_sums(walked, planned, arrived),
        "spl": ratio(navigation.weighted(arrived, planned, walked), mask),
        "stl": ratio(navigation.weighted(arrived, needed, taken), mask),
    }


def time_ratios(rollout: Rollout) -> tuple[Tensor, Tensor]:
    """Return each person's time by that of free walking (E, A), and whose is known: of who arrives in time.

    Free walking is the planned way at one's preferred speed. Who stands before they set out has no time then.
    """
    reached, goals = rollout.reached, rollout.goals
    arrived = navigation.success(reached, goals, rollout.overdue, rollout.failed, rollout.mask)
    planned = navigation.planned_metres(rollout.planned, reached, goals)
    seconds = navigation.finish_seconds(reached, goals) - rollout.stood
    return seconds * rollout.pref_speed / planned, arrived & (planned > 0)


def time_ratio_median(rollout: Rollout) -> tuple[dict[str, float], dict[str, Interval]]:
    """Return ``time_ratio_median``, the median over people of `time_ratios`, and its 95 % interval.

    Of two middle ones the lower. Both are empty where nobody arrives, as in `summarised`. A median is no
    ratio of sums: it is not in `NAMES`, and belongs to all episodes together.
    """
    value, known = time_ratios(rollout)
    if not known.any():
        return {}, {}
    values, episode, episodes = value[known], known.nonzero()[:, 0], len(known)
    middle = float(quantiles(values, episode, torch.ones(1, episodes), (0.5,)))
    low, high = bootstrap_quantile(values, episode, episodes, 0.5)
    key = "time_ratio_median"
    return {key: middle}, {key: (low, high)} if low < high else {}


def _leaving(rollout: Rollout, scored: Tensor) -> dict[str, Ratio]:
    """Return what is about goals of people who come and go: a replay takes out who is late."""
    runs = Runs.of(scored)
    there = runs.there
    arrived = there & (runs.last(rollout.reached) >= rollout.goals) & ~rollout.failed[:, None, None]
    steps = rollout.path.diff(dim=2).norm(dim=-1).where(rollout.underway, 0.0)
    walked, planned = runs.sums(steps), runs.last(rollout.planned)
    return {
        "success": share(arrived, there),
        "failed": share(rollout.failed),
        "deadlock": share(runs.any(navigation.stuck(rollout.trace, rollout.goal, scored)), there),
        "path_ratio": of_sums(walked, planned, arrived),
        "spl": ratio(navigation.weighted(arrived, planned, walked), there),
    }


def _meeting(rollout: Rollout, scored: Tensor, near: Tensor) -> dict[str, Ratio]:
    """Return contacts and distances."""
    result = {}
    minutes = safety.person_minutes(scored)
    for what, contact in (("agent", rollout.agent_contact), ("wall", rollout.wall_contact)):
        events = safety.contact_events(contact & scored)
        result[f"{what}_contacts_per_min"] = ratio(events, minutes)
        result[f"{what}_contacts_per_episode"] = ratio(events.sum(1))
        result[f"{what}_contact_episodes"] = share((events > 0).any(1))
    return result | {
        "contact_free": share(_untouched(rollout, scored)),
        "personal_space": ratio(safety.keeps_distance(near, scored), scored),
        "least_distance_m": finite(safety.least_distance(near, scored).amin(1)),
    }


def _untouched(rollout: Rollout, scored: Tensor) -> Tensor:
    """Return in which episodes no scored person touches anybody or any wall (E,) bool."""
    touches = (rollout.agent_contact | rollout.wall_contact) & scored
    return ~touches.flatten(1).any(1)


def _ahead(rollout: Rollout, scored: Tensor) -> dict[str, Ratio]:
    """Return what would happen if all kept their velocities, at the ends of the 0.4 s windows."""
    velocity, there = smoothness.velocities(rollout.path, rollout.met)
    ends = slice(smoothness.WINDOW - 1, None, smoothness.WINDOW)
    seconds = safety.time_to_collision(rollout.trace[:, :, ends], velocity, there, rollout.radius)
    meets = seconds.isfinite() & scored[:, :, ends]
    return {
        "time_to_collision_s": mean(seconds, meets),
        "time_to_collision_capped": mean(seconds >= safety.HORIZON, meets),
    }


def _moving(velocity: Tensor, known: Tensor) -> dict[str, Ratio]:
    """Return how people move in 0.4 s windows."""
    turned, length = smoothness.turning(velocity, known), smoothness.length(velocity, known)
    return {
        "speed_m_per_s": mean(velocity.norm(dim=-1), known),
        "acceleration_m_per_s2": mean(*smoothness.acceleration(velocity, known)),
        "jerk_m_per_s3": mean(*smoothness.jerk(velocity, known)),
        "heading_rate_rad_per_s": mean(*smoothness.heading_rate(velocity, known)),
        "path_irregularity_rad_per_m": ratio(turned, length),
    }


def _at_door(
    rollout: Rollout, scored: Tensor, gate: Tensor, velocity: Tensor, known: Tensor
) -> dict[str, Ratio]:
    """Return who goes first through the door, and how many."""
    passed = door.passing_seconds(rollout.path, scored, gate)
    pair, met = door.pair(rollout.path[:, :, 0], rollout.mask, gate)
    theirs = door.of_pair(passed, pair).where(met.unsqueeze(1), torch.inf)
    index, walked = door.symmetry_index(rollout.path, scored, gate, pair)
    metres, came = door.asymmetry(rollout.path, scored & rollout.underway, gate, pair)
    slowest = door.yielder_speed(
        door.of_pair(velocity, pair), door.of_pair(known, pair), theirs, STEP_SECONDS
    )
    through, room = door.flow(passed, gate)
    return {
        "symmetry_index": mean(index, walked & met),
        "symmetry_m": mean(metres, came & met),
        "yield_delay_s": finite(door.yield_delay(theirs)),
        "faster_first": share(*door.faster_first(theirs, door.of_pair(rollout.pref_speed, pair))),
        "yielder_speed_m_per_s": finite(slowest),
        "specific_flow_per_m_s": ratio(through, room),
    }


class ClosedLoopScore(Metric):
    """All closed-loop metrics over any number of rollouts; sums in float64, added over processes."""

    full_state_update = False
    above: Tensor
    below: Tensor

    def __init__(self) -> None:
        """Nothing to set."""
        super().__init__()
        for state in ("above", "below"):
            self.add_state(state, torch.zeros(len(NAMES), dtype=torch.float64), dist_reduce_fx="sum")

    def update(self, rollout: Rollout, decision_dt: float) -> None:
        """Add episodes whose policy decided every ``decision_dt`` seconds."""
        for name, (above, below, _) in closed_loop(rollout, decision_dt).items():
            self.above[NAMES.index(name)] += above.sum()
            self.below[NAMES.index(name)] += below.sum()

    def compute(self) -> dict[str, Tensor]:
        """Return every metric about which an episode said something, as `NAMES` orders them."""
        values = (self.above / self.below).unbind()
        known = (self.below > 0).tolist()
        return {name: value for name, value, is_known in zip(NAMES, values, known, strict=True) if is_known}
