"""The likelihood of what people did under joint rollouts of 8 s, and how far these are from the recording.

In windows of a recording all who are there are simulated at once, from 3.2 s of history. W windows of A
slots, S = STEPS steps of 0.4 s, M of a recording's people.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from functools import cache
from importlib.resources import files
from typing import NamedTuple

import torch
import yaml
from torch import Tensor

from pedzoo.core.types import GOAL_RADIUS, OBS_LEN
from pedzoo.data.tracks import Tracks
from pedzoo.eval.rollout import Progress, prepare, walk
from pedzoo.metrics.realism.distances import displacement
from pedzoo.metrics.realism.features import every_step
from pedzoo.metrics.realism.wosac import (
    CONTACTS,
    MEASURED,
    ROLLOUTS,
    LogSums,
    Ranges,
    composite,
    contact_likelihood,
    measured_likelihood,
    step_values,
)
from pedzoo.metrics.statistics import drawn_people
from pedzoo.policies.load import load_policy
from pedzoo.policies.walker import has_noise
from pedzoo.sim.recorded_people import CONTROLLED, SHORT, STAYED, RecordedPeople, without_goals
from pedzoo.sim.rollout import Rollout
from pedzoo.sim.scenarios.replay import PreparedReplay
from pedzoo.sim.script import Script, ScriptScenes, slots, table

STEPS = 20
"""Simulated steps of a window: 8 s."""

MOST = 60
"""Windows: of a longer recording as many, evenly spread."""

BINS_FILE = "bins_v1.yaml"
"""Ends of bins, made by ``python -m tools.zoo.score_bins``; never changed, a new version is another file."""

OTHERS = "real others"
"""The row of other recorded people in the most similar situations: see `others_likelihood`."""

BEST_OF = 20
"""Rollouts of which the best counts for ``min_ade_20``."""

RESAMPLES = 500


class JointWindows(NamedTuple):
    """The windows of a recording.

    Attributes:
        scenario: One scene each, all equally long.
        begin: The recording's frame at which each is simulated from (W,) long.
        recording: Which recording each is of (W,) long.
        person: Simulated person in each slot (W, A) long, -1 for none.
        goal: Their exits (W, A, 2), metres.
    """

    scenario: PreparedReplay
    begin: Tensor
    recording: Tensor
    person: Tensor
    goal: Tensor


class JointRollouts(NamedTuple):
    """K rollouts of all windows.

    Attributes:
        values: Of `step_values` (K, W, A, S), NaN where a person is not scored.
        contacts: Of `CONTACTS` (K, W, A) bool.
        xy: Positions (K, W, A, S, 2), metres; the exit once a person has left.
        scored: Which steps count (K, W, A, S) bool.
        people: Which people were simulated (W, A) bool.
    """

    values: dict[str, Tensor]
    contacts: dict[str, Tensor]
    xy: Tensor
    scored: Tensor
    people: Tensor


def windows_of(real: PreparedReplay) -> JointWindows:
    """Return the windows of a recording; people keep the exits that they have in it.

    Windows follow one another without overlap. People who are seen for all 3.2 s before are simulated, all
    others are played back.
    """
    assert real.script is not None
    people, xy = real.script.people, real.script.xy
    begins = []
    for number in people.recording.unique().tolist():
        last = int(people.last[people.recording == number].max())
        frames = torch.arange(OBS_LEN - 1, max(last - STEPS, OBS_LEN) + 1, STEPS)
        begins.append(torch.stack((torch.full_like(frames, number), frames), 1))
    windows = torch.cat(begins)
    if len(windows) > MOST:
        windows = windows[torch.linspace(0, len(windows) - 1, MOST).round().long()]
    count = people.last - people.first + 1
    of_row = torch.arange(len(count)).repeat_interleave(count)
    frame = torch.arange(len(xy)) - (count.cumsum(0) - count)[of_row] + people.first[of_row]
    cut = [_cut(windows[i], of_row, frame, xy, people) for i in range(len(windows))]
    windows = windows[torch.tensor([len(part.frame) > 0 for part in cut])]
    parts, places = without_goals([part for part in cut if len(part.frame)])
    parts = _with_roles(parts, people)
    script = Script(parts, places, *_scenes(parts, len(windows)))
    tables = real.tables[windows[:, 0]]
    home = real.home[windows[:, 0]]
    scenario = PreparedReplay(
        scenario=real.scenario, planner=real.planner, tables=tables, script=script, home=home
    )
    who = script.people_in_slots(torch.arange(len(windows)), torch.full((len(windows),), OBS_LEN - 1))
    who = torch.where((who >= 0) & parts.controlled[who], who, -1)
    return JointWindows(scenario, windows[:, 1], windows[:, 0], who, parts.goal[who].float())


def walked(windows: JointWindows, parts: Iterable[Rollout]) -> JointRollouts:
    """Return what happened in rollouts of all windows, round after round, in parts of some episodes."""
    count, bank = len(windows.begin), windows.scenario.bank
    columns: dict[str, list[Tensor]] = {}
    first = 0
    for part in parts:
        window = (first + torch.arange(len(part.failed))) % count
        first += len(window)
        own, goal = windows.person[window].unsqueeze(2), windows.goal[window].unsqueeze(2)
        steps = every_step(part)
        wall = bank.signed_distance(steps.xy.flatten(1, 2), part.map_id, part.pose)
        wall = wall.view(steps.person.shape).where((part.map_id >= 0).view(-1, 1, 1), torch.nan)
        there = steps.person == own
        values = {name: _full(value, torch.nan) for name, value in step_values(steps, wall).items()}
        for name in CONTACTS:
            touches = getattr(part, name) & part.underway & (part.person == own)
            values[name] = touches.any(2)
        xy = torch.where(there.unsqueeze(3), steps.xy, goal)
        values |= {"x": _full(xy[..., 0]), "y": _full(xy[..., 1])}
        values["scored"] = _full(steps.scored & there, False)
        for name, value in values.items():
            columns.setdefault(name, []).append(value)
    rounds = {name: torch.cat(value) for name, value in columns.items()}
    rounds = {name: value.view(-1, count, *value.shape[1:]) for name, value in rounds.items()}
    return JointRollouts(
        {name: rounds[name] for name in MEASURED},
        {name: rounds[name] for name in CONTACTS},
        torch.stack((rounds["x"], rounds["y"]), -1),
        rounds["scored"],
        windows.person >= 0,
    )


def _full(value: Tensor, missing: float | None = None) -> Tensor:
    """Return values (E, A, 2 + S') of the S steps (E, A, S); absent ones are ``missing``, or as the last."""
    value = value[..., 2 : 2 + STEPS]
    fill = value[..., -1:].expand(*value.shape[:-1], STEPS - value.shape[-1])
    return torch.cat((value, fill if missing is None else torch.full_like(fill, missing)), -1)


def _cut(window: Tensor, of_row: Tensor, frame: Tensor, xy: Tensor, people: RecordedPeople) -> Tracks:
    """Return the rows of one window; frames count from the first of its history, agents are row numbers."""
    number, begin = window.tolist()
    at = frame - (begin - OBS_LEN + 1)
    keep = (people.recording[of_row] == number) & (at >= 0) & (at < OBS_LEN + STEPS)
    # people who are there in one row only have no velocity
    rows = torch.bincount(of_row[keep], minlength=len(people.first))
    keep &= rows[of_row] > 1
    agent = of_row[keep].numpy()
    return Tracks("window", at[keep].numpy(), agent, xy[keep].double().numpy())


def _with_roles(parts: RecordedPeople, people: RecordedPeople) -> RecordedPeople:
    """Return the people of windows with the exits that they have in the recording."""
    who = parts.agent
    goal = people.goal[who]
    role = people.what[who].clone()
    taken = (parts.first == 0) & (parts.last >= OBS_LEN)
    role = torch.where(~taken & (role == CONTROLLED), SHORT, role)
    there = (goal - parts.start).norm(dim=1) <= GOAL_RADIUS
    role = torch.where(there & (role == CONTROLLED), STAYED, role)
    return parts._replace(
        what=role,
        goal=goal,
        exit=people.exit[who],
        goal_id=people.goal_id[who],
        path_length=people.path_length[who],
        pref_speed=people.pref_speed[who],
    )


def _scenes(parts: RecordedPeople, windows: int) -> tuple[Tensor, ScriptScenes]:
    """Return who is in which slot, and the scenes of windows."""
    end = OBS_LEN + STEPS
    gone = parts.removal.clamp_max(end)
    slot = torch.full_like(parts.first, -1)
    for number in range(windows):
        mine = (parts.recording == number).nonzero()[:, 0]
        slot[mine] = slots(parts.first[mine], gone[mine])
    tables = []
    for number in range(windows):
        here = torch.where(parts.recording == number, slot, -1)
        tables.append(table(here, parts.first, gone, end + 1, int(slot.max()) + 1))
    number = torch.arange(windows)
    begin = torch.full_like(number, OBS_LEN - 1)
    no_lead, others = torch.full_like(number, -1), torch.ones_like(number, dtype=torch.bool)
    ends = begin + STEPS + 1, begin, begin + STEPS
    scenes = ScriptScenes(number, begin, *ends, no_lead, others)
    return torch.stack(tables), scenes


def bins(against: str) -> Ranges:
    """Return the ends of bins for a recorded crowd: from all recordings but those of that fold."""
    known = _bins()
    return known.get(against, known["all"])


@cache
def _bins() -> dict[str, Ranges]:
    text = (files("pedzoo.eval.scoring") / BINS_FILE).read_text()
    folds = yaml.safe_load(text)["folds"]
    return {fold: {name: (low, high) for name, (low, high) in ends.items()} for fold, ends in folds.items()}


def recorded_windows(windows: JointWindows) -> JointRollouts:
    """Return what people really did in the windows."""
    return walked(windows, windows.scenario.real_parts())


def policy_windows(
    policy: str, windows: JointWindows, seed: int, physics: str, progress: Progress | None = None
) -> JointRollouts:
    """Return what a policy does in them: `ROLLOUTS` times if it has noise, else once."""
    rounds = ROLLOUTS if has_noise(load_policy(policy)) else 1
    episodes = rounds * len(windows.begin)
    walks, env = prepare(policy, windows.scenario, physics, episodes, seed)
    try:
        return walked(windows, walk(walks, env, episodes, progress=progress))
    finally:
        env.physics.close()


def likelihood(mine: JointRollouts, real: JointRollouts, against: str) -> dict[str, Tensor]:
    """Return the numbers of rollouts (1 + R,): the first of all windows, then of resamples of windows.

    Args:
        mine: Rollouts.
        real: What people really did.
        against: The fold that the windows are of.
    """
    ends, true = bins(against), {name: value[0] for name, value in real.values.items()}
    scored = real.people & real.scored[0].any(2)
    sums: dict[str, LogSums] = {}
    for name, value in real.contacts.items():
        sums[name] = contact_likelihood(mine.contacts[name], value[0], scored)
    for name in MEASURED:
        sums[name] = measured_likelihood(mine.values[name], true[name], ends[name])
    weights = _weights(len(real.people))
    error = displacement(mine.xy, real.xy[0], real.scored[0])
    result = composite(sums, weights)
    result["ade_8s_m"] = _mean(error.mean(0), weights)
    best = error[:BEST_OF].amin(0)
    result[f"min_ade_{BEST_OF}_8s_m"] = _mean(best, weights)
    return result


def others_likelihood(real: JointRollouts, windows: JointWindows, against: str) -> dict[str, Tensor]:
    """Return the likelihood of what people did under that of others in the most similar situations.

    The bound by a second set of real people: a histogram of each person holds `ROLLOUTS` windows of other
    recorded people. These are the nearest in speed, distance to the exit, distance to the nearest other and
    to the nearest wall when the window begins, in units of their standard deviations.
    """
    first = torch.stack(
        [real.values[name][0, ..., 0] for name in ("speed", "nearest_distance", "wall_distance")]
        + [(windows.goal - real.xy[0, ..., 0, :]).norm(dim=-1)],
        -1,
    )
    window, slot = (real.people & real.scored[0, ..., 0]).nonzero().unbind(1)
    agent = windows.scenario.persons.agent[windows.person[window, slot]]
    value = first[window, slot].nan_to_num(20.0)
    value = value / value.std(0).clamp_min(1e-6)
    apart = torch.cdist(value, value).masked_fill(agent.unsqueeze(1) == agent, torch.inf)
    near = apart.topk(min(ROLLOUTS, len(agent)), largest=False).indices.T
    shape = (len(near), *real.people.shape)

    def of_others(true: Tensor, missing: float | bool) -> Tensor:
        result = torch.full((*shape, *true.shape[2:]), missing, dtype=true.dtype)
        result[:, window, slot] = true[window[near], slot[near]]
        return result

    mine = JointRollouts(
        {name: of_others(value[0], torch.nan) for name, value in real.values.items()},
        {name: of_others(value[0], False) for name, value in real.contacts.items()},
        real.xy.expand(len(near), *real.xy.shape[1:]),
        real.scored,
        real.people,
    )
    result = likelihood(mine, real, against)
    return {key: value for key, value in result.items() if key.startswith("likelihood")}


def _weights(windows: int) -> Tensor:
    once = torch.ones(1, windows, dtype=torch.float64)
    return torch.cat((once, drawn_people(windows, RESAMPLES)))


def _mean(value: Tensor, weights: Tensor) -> Tensor:
    """Return the mean (R,) over people of values (W, A), NaN for none, for weights of windows (R, W)."""
    known = ~value.isnan()
    return weights @ value.nan_to_num().sum(1) / (weights @ known.sum(1).double())


def ranges(walks: Sequence[JointRollouts]) -> dict[str, tuple[float, float]]:
    """Return the ends of bins: all but half a percent of the values on either side lie between them."""
    result = {}
    for name in MEASURED:
        value = torch.cat([one.values[name].flatten() for one in walks])
        value = value[~value.isnan()].double().sort().values
        low, high = (float(value[int(share * (len(value) - 1))]) for share in (0.005, 0.995))
        result[name] = (round(low, 3), round(high, 3))
    return result
