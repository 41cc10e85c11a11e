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
from pedzoo.eval.rollout import Progress, walked
from pedzoo.metrics.ratios import drawn_people
from pedzoo.metrics.realism.distances import displacement
from pedzoo.metrics.realism.features import every_step
from pedzoo.metrics.realism.wosac import (
    CONTACTS,
    MEASURED,
    ROLLOUTS,
    Ranges,
    composite,
    contact_likelihood,
    measured_likelihood,
    step_values,
)
from pedzoo.policies.load import load_policy
from pedzoo.policies.walker import has_noise
from pedzoo.sim.recorded_people import CONTROLLED, SHORT, STAYED, RecordedPeople, without_goals
from pedzoo.sim.rollout import Rollout
from pedzoo.sim.scenarios.replay import PreparedReplay
from pedzoo.sim.script import Script, ScriptScenes, occupants_of

STEPS = 20
"""Simulated steps of a window: 8 s."""

BINS_FILE = "bins_v1.yaml"
"""Ends of bins, made by ``python -m tools.zoo.score_bins``; never changed, a new version is another file."""

OTHERS = "real others"
"""The row of other recorded people in the most similar situations: see `others_likelihood`."""

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
        values: Of `step_values` (K, W, A, S), NaN where a person is not scored, and of `CONTACTS` (K, W, A).
        xy: Positions (K, W, A, S, 2), metres; the exit once a person has left.
        scored: Which steps count (K, W, A, S) bool.
        people: Which people were simulated (W, A) bool.
    """

    values: dict[str, Tensor]
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
        begins += [(number, begin) for begin in range(OBS_LEN - 1, max(last - STEPS, OBS_LEN) + 1, STEPS)]
    if len(begins) > 60:  # of a longer recording as many, evenly spread
        begins = [begins[i] for i in torch.linspace(0, len(begins) - 1, 60).round().long().tolist()]
    count = people.last - people.first + 1
    of_row = torch.arange(len(count)).repeat_interleave(count)
    frame = torch.arange(len(xy)) - (count.cumsum(0) - count)[of_row] + people.first[of_row]
    cut, kept = [], []
    for number, begin in begins:  # frames count from the first of a window's history, agents are row numbers
        at = frame - (begin - OBS_LEN + 1)
        rows = (people.recording[of_row] == number) & (at >= 0) & (at < OBS_LEN + STEPS)
        # people who are there in one row only have no velocity
        rows &= torch.bincount(of_row[rows], minlength=len(count))[of_row] > 1
        if rows.any():
            cut.append(Tracks("window", at[rows].numpy(), of_row[rows].numpy(), xy[rows].double().numpy()))
            kept.append((number, begin))
    parts, places = without_goals(cut)
    parts, (number, begin) = _with_roles(parts, people), torch.tensor(kept).T
    script = Script(parts, places, *_scenes(parts, len(kept)))
    where = {"planner": real.planner, "tables": real.tables[number], "home": real.home[number]}
    scenario = PreparedReplay(scenario=real.scenario, script=script, **where)
    who = script.people_in_slots(torch.arange(len(kept)), torch.full((len(kept),), OBS_LEN - 1))
    who = torch.where((who >= 0) & parts.controlled[who], who, -1)
    return JointWindows(scenario, begin, number, who, parts.goal[who].float())


def _with_roles(parts: RecordedPeople, people: RecordedPeople) -> RecordedPeople:
    """Return the people of windows with the exits that they have in the recording."""
    who = parts.agent
    same = {
        key: getattr(people, key)[who] for key in ("goal", "exit", "goal_id", "path_length", "pref_speed")
    }
    taken = (parts.first == 0) & (parts.last >= OBS_LEN)
    role = people.what[who]
    role = torch.where(~taken & (role == CONTROLLED), SHORT, role)
    there = (same["goal"] - parts.start).norm(dim=1) <= GOAL_RADIUS
    role = torch.where(there & (role == CONTROLLED), STAYED, role)
    return parts._replace(what=role, **same)


def _scenes(parts: RecordedPeople, windows: int) -> tuple[Tensor, ScriptScenes]:
    """Return who is in which slot, and the scenes of windows."""
    number = torch.arange(windows)
    occupants = occupants_of(parts.recording, parts.first, parts.removal.clamp_max(OBS_LEN + STEPS))
    begin = torch.full_like(number, OBS_LEN - 1)
    return occupants, ScriptScenes.of_excerpts(number, begin, STEPS)


def joint_rollouts(windows: JointWindows, parts: Iterable[Rollout]) -> JointRollouts:
    """Return what happened in rollouts of all windows, round after round, in parts of some episodes."""
    count, bank, first = len(windows.begin), windows.scenario.bank, 0
    columns: dict[str, list[Tensor]] = {}

    def full(value: Tensor, missing: float | None = None) -> Tensor:
        """Return values (E, A, S, ...) of the simulated steps; absent are ``missing``, or the last."""
        value = value[:, :, 2 : 2 + STEPS]
        fill = value[:, :, -1:].expand(-1, -1, STEPS - value.shape[2], *value.shape[3:])
        return torch.cat((value, fill if missing is None else torch.full_like(fill, missing)), 2)

    for part in parts:
        window = (first + torch.arange(len(part.failed))) % count
        first += len(window)
        own, goal = windows.person[window].unsqueeze(2), windows.goal[window].unsqueeze(2)
        steps = every_step(part)
        wall = bank.signed_distance(steps.xy.flatten(1, 2), part.map_id, part.pose)
        wall = wall.view(steps.person.shape).where((part.map_id >= 0).view(-1, 1, 1), torch.nan)
        there = steps.person == own
        values = {name: full(value, torch.nan) for name, value in step_values(steps, wall).items()}
        for name in CONTACTS:
            values[name] = (getattr(part, name) & part.underway & (part.person == own)).any(2)
        values["xy"] = full(torch.where(there.unsqueeze(3), steps.xy, goal))
        values["scored"] = full(steps.scored & there, False)
        for name, value in values.items():
            columns.setdefault(name, []).append(value)
    rounds = {name: torch.cat(value).unflatten(0, (-1, count)) for name, value in columns.items()}
    return JointRollouts(rounds, rounds.pop("xy"), rounds.pop("scored"), windows.person >= 0)


def recorded_windows(windows: JointWindows) -> JointRollouts:
    """Return what people really did in the windows."""
    return joint_rollouts(windows, windows.scenario.real_parts())


def policy_windows(
    policy: str, windows: JointWindows, seed: int, physics: str, progress: Progress | None = None
) -> JointRollouts:
    """Return what a policy does in them: `ROLLOUTS` times if it has noise, else once."""
    episodes = len(windows.begin) * (ROLLOUTS if has_noise(load_policy(policy)) else 1)
    return joint_rollouts(
        windows, walked(policy, windows.scenario, physics, episodes, seed, progress=progress)
    )


@cache
def _bins() -> dict[str, Ranges]:
    return yaml.safe_load((files("pedzoo.eval.scoring") / BINS_FILE).read_text())["folds"]


def bins(against: str) -> Ranges:
    """Return the ends of bins for a recorded crowd: from all recordings but those of that fold."""
    return _bins().get(against, _bins()["all"])


def likelihood(mine: JointRollouts, real: JointRollouts, against: str) -> dict[str, Tensor]:
    """Return the numbers (1 + R,) of rollouts beside what people really did.

    The first is of all windows, the others of resamples of windows. ``against`` is the fold of the windows.
    """
    ends, true = bins(against), {name: value[0] for name, value in real.values.items()}
    scored = real.people & real.scored[0].any(2)
    sums = {name: contact_likelihood(mine.values[name], true[name], scored) for name in CONTACTS}
    for name in MEASURED:
        sums[name] = measured_likelihood(mine.values[name], true[name], ends[name])
    windows = len(real.people)
    weights = torch.cat((torch.ones(1, windows, dtype=torch.float64), drawn_people(windows, RESAMPLES)))
    error = displacement(mine.xy, real.xy[0], real.scored[0])
    result = composite(sums, weights)
    for name, value in (("ade_8s_m", error.mean(0)), ("min_ade_20_8s_m", error[:20].amin(0))):
        known = (~value.isnan()).sum(1).double()
        result[name] = weights @ value.nan_to_num().sum(1) / (weights @ known)
    return result


def others_likelihood(real: JointRollouts, windows: JointWindows, against: str) -> dict[str, Tensor]:
    """Return the likelihood of what people did under that of others in the most similar situations.

    The bound by a second set of real people: a histogram of each person holds `ROLLOUTS` windows of other
    recorded people. These are the nearest in speed, distance to the exit, distance to the nearest other and
    to the nearest wall when the window begins, in units of their standard deviations.
    """
    first = [real.values[name][0, ..., 0] for name in ("speed", "nearest_distance", "wall_distance")]
    first.append((windows.goal - real.xy[0, ..., 0, :]).norm(dim=-1))
    window, slot = (real.people & real.scored[0, ..., 0]).nonzero().unbind(1)
    agent = windows.scenario.persons.agent[windows.person[window, slot]]
    value = torch.stack(first, -1)[window, slot].nan_to_num(20.0)
    value = value / value.std(0).clamp_min(1e-6)
    apart = torch.cdist(value, value).masked_fill(agent.unsqueeze(1) == agent, torch.inf)
    near = apart.topk(min(ROLLOUTS, len(agent)), largest=False).indices.T
    others = {}
    for name, (true,) in real.values.items():
        missing = False if true.dtype == torch.bool else torch.nan
        others[name] = torch.full((len(near), *true.shape), missing, dtype=true.dtype)
        others[name][:, window, slot] = true[window[near], slot[near]]
    mine = real._replace(values=others, xy=real.xy.expand(len(near), *real.xy.shape[1:]))
    result = likelihood(mine, real, against)
    return {key: value for key, value in result.items() if key.startswith("likelihood")}


def ranges(walks: Sequence[JointRollouts]) -> dict[str, tuple[float, float]]:
    """Return the ends of bins: all but half a percent of the values on either side lie between them."""
    result = {}
    for name in MEASURED:
        value = torch.cat([one.values[name].flatten() for one in walks])
        value = value[~value.isnan()].double().sort().values
        low, high = (float(value[int(share * (len(value) - 1))]) for share in (0.005, 0.995))
        result[name] = (round(low, 3), round(high, 3))
    return result
