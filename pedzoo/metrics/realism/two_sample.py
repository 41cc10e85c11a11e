"""The classifier two-sample test: can a small classifier tell simulated people from real ones?

Lopez-Paz and Oquab, "Revisiting classifier two-sample tests", ICLR 2017, with the area under the ROC curve
(AUC) in place of the accuracy. 0.5: it cannot distinguish them; 1: always.
"""

from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from pedzoo.core.adapters import split_gains
from pedzoo.core.errors import need
from pedzoo.core.types import STEP_SECONDS
from pedzoo.metrics.realism.features import CHANNELS, Clips

FOLDS = 4
"""Parts of the people; each is judged by a classifier that was trained on the others."""

BINS = 64
"""Values of a feature are distinguished by so many of its quantiles."""

TREES = {
    "max_iter": 100,
    "max_depth": 5,
    "max_leaf_nodes": None,
    "learning_rate": 0.1,
    "max_bins": BINS,
    "min_samples_leaf": 20,
    "early_stopping": False,
    "random_state": 0,
}
"""Settings of scikit-learn's gradient boosted trees."""

MOST = 12_000
"""Clips of either crowd that are used: larger crowds are thinned evenly."""

_CLIPS = 16
"""Of each person, by which the nearest other is found."""

_SAME = 0.002
"""Metres: positions that are rounded to 1 mm differ by so much."""


class Verdict(NamedTuple):
    """What the classifiers said of the W clips of both crowds, each of people whom they had not seen."""

    odds: Tensor  # log-odds that the clip is simulated (W,)
    simulated: Tensor  # which clips are (W,) bool
    person: Tensor  # whose they are (W,) long, in either crowd's own numbers
    gain: Tensor  # share of each of `CHANNELS` in what the classifiers go by (C,), adds up to 1

    @property
    def telling(self) -> dict[str, float]:
        """The three channels that distinguish most, with their shares."""
        order = self.gain.argsort(descending=True)[:3].tolist()
        return {CHANNELS[channel]: round(float(self.gain[channel]), 3) for channel in order}


def two_sample(simulated: Clips, real: Clips, parts: Tensor, real_parts: Tensor) -> Verdict:
    """Return what classifiers say that are trained to tell two crowds apart; both crowds count the same.

    ``parts`` (P,) and ``real_parts`` (Q,) long, below `FOLDS`, are those of the people of each crowd: who is
    in both has to be in the same part.

    Raises:
        UserError: scikit-learn is not installed.
    """
    need("score", "a score of realism")
    simulated, real = (
        Clips(*(value[:: max(1, -(-len(one.person) // MOST))] for value in one)) for one in (simulated, real)
    )
    rows = torch.cat((simulated.value, real.value)).double().numpy()
    label = np.concatenate((np.ones(len(simulated.person)), np.zeros(len(real.person))))
    part = torch.cat((parts[simulated.person], real_parts[real.person])).numpy()
    odds, gain = np.full(len(rows), np.nan), np.zeros(len(CHANNELS))
    for number in range(FOLDS):
        test, train = part == number, part != number
        if not (test.any() and len(np.unique(label[train])) == 2):
            continue
        weight = np.where(label == 1, 0.5 / label[train].mean(), 0.5 / (1 - label[train].mean()))
        odds[test], gains = boosted(rows[train], label[train], weight[train], rows[test])
        gain += gains.reshape(-1, len(CHANNELS)).sum(0)
    judged = torch.from_numpy(~np.isnan(odds))
    person = torch.cat((simulated.person, real.person))
    said, is_simulated = torch.from_numpy(odds)[judged], torch.from_numpy(label)[judged] == 1
    return Verdict(said, is_simulated, person[judged], torch.from_numpy(gain / max(gain.sum(), 1e-9)))


def boosted(
    rows: np.ndarray, label: np.ndarray, weight: np.ndarray, test: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return the log-odds (M,) of label 1 of ``test`` (M, F) by boosted trees, and features' gains (F,).

    Rows (N, F), with labels 0 or 1 and weights (N,), train them: Friedman, "Greedy function approximation: a
    gradient boosting machine", Annals of Statistics 29, 2001.
    """
    from sklearn.ensemble import HistGradientBoostingClassifier
    from threadpoolctl import threadpool_limits

    # bins of its own take three times as long as the trees: it has slow quantiles where rows are weighted
    edges = np.quantile(rows, np.arange(1, BINS) / BINS, axis=0, method="inverted_cdf").T
    binned, judged = (
        np.column_stack([np.searchsorted(*pair) for pair in zip(edges, table.T, strict=True)])
        for table in (rows, test)
    )
    with threadpool_limits(1, "openmp"):
        trees = HistGradientBoostingClassifier(**TREES).fit(binned, label, sample_weight=weight)
        return trees.decision_function(judged), split_gains(trees, rows.shape[1])


def nearest_parts(simulated: Clips, real: Clips, real_parts: Tensor, people: int) -> Tensor:
    """Return the part of each simulated person (P,): that of the recorded person whose walk is nearest.

    Else a copy of a recorded walk is in one part and the walk in another: classifiers learn that it is real.
    The distance of two people is the mean over the clips of one of the least difference to a clip of the
    other, in how far apart the points of the way are. Among those who are about as near decide the places of
    others and of the exit. No part gets more than half of the people: the nearest walks come first.
    """
    (way, around), (true, theirs) = _shapes(simulated), _shapes(real)
    owner = real.person.expand(_CLIPS, -1)
    apart = torch.full((people, FOLDS), torch.inf, dtype=torch.float64)
    for person in simulated.person.unique().tolist():
        mine = (simulated.person == person).nonzero()[:, 0]
        mine = mine[torch.linspace(0, len(mine) - 1, min(len(mine), _CLIPS)).long()]
        nothing = torch.full((len(mine), len(real_parts)), torch.inf, dtype=torch.float64)
        own, other = (
            nothing.scatter_reduce(1, owner[: len(mine)], torch.cdist(one[mine], two), "amin").mean(0)
            for one, two in ((way, true), (around, theirs))
        )
        like = own <= 1.5 * own.min() + _SAME
        own = own.where(~like, own.min() * (1 + other / 1e6))
        apart[person] = apart[person].scatter_reduce(0, real_parts, own, "amin")
    result, room = torch.zeros(people, dtype=torch.long), torch.full((FOLDS,), -(-people // 2))
    for person in apart.amin(1).argsort(stable=True).tolist():
        result[person] = apart[person].where(room > 0, torch.inf).argmin()
        room[result[person]] -= 1
    return result


def _shapes(one: Clips) -> tuple[Tensor, Tensor]:
    """Return distances along clips (W, 15), and of others and the exit (W, 40), metres, in whatever frame."""
    step = one.value.double().unflatten(1, (-1, len(CHANNELS)))
    place = STEP_SECONDS * step[..., :2].cumsum(1)
    ends = torch.cat((place, place[:, -1:] - place[:, :-1]), 1).norm(dim=2)
    return ends, step[..., [4, 5, 6, 7, 13]].abs().flatten(1)


def auc(verdict: Verdict, mine: Tensor, theirs: Tensor) -> Tensor:
    """Return the area under the ROC curve (R,) for weights of people (R, P), (R, Q); NaN without clips.

    The probability that the classifier finds a simulated clip more like simulation than a real one.
    """
    values, place = verdict.odds.unique(return_inverse=True)
    sums = []
    for weights, which in ((mine, verdict.simulated), (theirs, ~verdict.simulated)):
        each = weights[:, verdict.person[which]].double()
        total = torch.zeros(len(weights), len(values), dtype=torch.float64)
        sums.append(total.index_add_(1, place[which], each))
    above, below = sums
    before = below.cumsum(1) - below / 2
    return (above * before).sum(1) / (above.sum(1) * below.sum(1))
