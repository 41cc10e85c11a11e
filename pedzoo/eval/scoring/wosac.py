"""The likelihood score of a policy, and its distance to the recording, over joint rollouts of 8 s."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from importlib.resources import files

import torch
import yaml
from torch import Tensor

from pedzoo.eval.rollout import Progress, prepare, walk
from pedzoo.eval.scoring.windows import JointRollouts, JointWindows, walked
from pedzoo.metrics.realism.distances import drawn_people
from pedzoo.metrics.realism.wosac import (
    MEASURED,
    ROLLOUTS,
    LogSums,
    Ranges,
    composite,
    contact_likelihood,
    displacement,
    measured_likelihood,
)
from pedzoo.policies.load import load_policy
from pedzoo.policies.walker import has_noise

BINS_FILE = "bins_v1.yaml"
"""Ends of bins, made by ``python -m tools.zoo.score_bins``; never changed, a new version is another file."""

OTHERS = "real others"
"""The row of other recorded people in the most similar situations: see `others_likelihood`."""

BEST_OF = 20
"""Rollouts of which the best counts for ``min_ade_20``."""

RESAMPLES = 500


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
