"""Gradient boosted trees: a small classifier of tables, compiled by numba.

Friedman, "Greedy function approximation: a gradient boosting machine", Annals of Statistics 29, 2001, with
the second-order gains and histograms of XGBoost and LightGBM. N rows, F features, B bins.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from pedzoo.core.compiled import jit
from pedzoo.core.errors import need

TREES, DEPTH, RATE = 100, 5, 0.1
"""Size of the ensemble, and by how much each tree is believed."""

BINS = 64
"""Values of a feature are distinguished by so many of its quantiles."""

LEAST = 20
"""Rows in a leaf."""


class Trees(NamedTuple):
    """Complete trees of `DEPTH` levels; node n has children 2 n + 1 and 2 n + 2.

    Attributes:
        edges: Upper ends of the bins of each feature (F, B - 1).
        feature: Feature at which each node splits (trees, nodes) int64, -1 for a leaf.
        bin: Rows up to this bin go to the first child (trees, nodes) int64.
        value: Log-odds that a leaf adds (trees, nodes).
        gain: What the splits at each feature have gained in all (F,).
    """

    edges: np.ndarray
    feature: np.ndarray
    bin: np.ndarray
    value: np.ndarray
    gain: np.ndarray


def fit(rows: np.ndarray, label: np.ndarray, weight: np.ndarray) -> Trees:
    """Return trees that say how likely the label of a row is 1.

    Args:
        rows: (N, F), finite.
        label: 0 or 1 (N,).
        weight: How much each row counts (N,).
    """
    need("fast", "a score of realism")
    edges = np.quantile(rows, np.arange(1, BINS) / BINS, axis=0, method="inverted_cdf").T
    edges = np.ascontiguousarray(edges)
    binned, odds = _binned(rows, edges), np.zeros(len(rows))
    nodes, gain = 2 ** (DEPTH + 1) - 1, np.zeros(rows.shape[1])
    feature, cut = (np.full((TREES, nodes), -1, dtype=np.int64) for _ in range(2))
    value = np.zeros((TREES, nodes))
    for tree in range(TREES):
        share = 1 / (1 + np.exp(-odds))
        slope, bend = weight * (share - label), weight * share * (1 - share)
        leaf = _grown(binned, slope, bend, feature[tree], cut[tree], value[tree], gain)
        odds += value[tree][leaf]
    return Trees(edges, feature, cut, value, gain)


def log_odds(trees: Trees, rows: np.ndarray) -> np.ndarray:
    """Return the log-odds (N,) of label 1 for rows (N, F)."""
    binned, odds = _binned(rows, trees.edges), np.zeros(len(rows))
    for feature, cut, value in zip(trees.feature, trees.bin, trees.value, strict=True):
        odds += value[_leaves(binned, feature, cut)]
    return odds


def _binned(rows: np.ndarray, edges: np.ndarray) -> np.ndarray:
    """Return the bin of every value (N, F) uint8."""
    columns = [np.searchsorted(edge, column) for edge, column in zip(edges, rows.T, strict=True)]
    return np.column_stack(columns).astype(np.uint8)


@jit
def _leaves(binned, feature, cut):
    """Return the leaf of every row (N,)."""
    result = np.zeros(len(binned), dtype=np.int64)
    for row in range(len(binned)):
        node = 0
        while feature[node] >= 0:
            node = 2 * node + 1 + (binned[row, feature[node]] > cut[node])
        result[row] = node
    return result


@jit
def _grown(binned, slope, bend, feature, cut, value, gain):
    """Grow one tree in place, level after level, and return the leaf of every row (N,)."""
    rows, columns = binned.shape
    at = np.zeros(rows, dtype=np.int64)
    for level in range(DEPTH + 1):
        first, width = 2**level - 1, 2**level
        tried = columns if level < DEPTH else 1  # the last level only needs its leaves' sums
        sums = np.zeros((width, tried, BINS, 3))
        for row in range(rows):
            node = at[row] - first
            if node >= 0:
                for column in range(tried):
                    place = sums[node, column, binned[row, column]]
                    place[0] += slope[row]
                    place[1] += bend[row]
                    place[2] += 1
        for node in range(width):
            whole = sums[node, 0].sum(0)
            if whole[2] == 0:
                continue
            value[first + node] = -RATE * whole[0] / (whole[1] + 1e-9)
            best = 1e-9
            for column in range(columns if level < DEPTH else 0):
                part = np.zeros(3)
                for one in range(BINS - 1):
                    part += sums[node, column, one]
                    rest = whole - part
                    if part[2] < LEAST or rest[2] < LEAST or part[1] < 1e-6 or rest[1] < 1e-6:
                        continue
                    more = part[0] ** 2 / part[1] + rest[0] ** 2 / rest[1] - whole[0] ** 2 / whole[1]
                    if more > best:
                        best = more
                        feature[first + node], cut[first + node] = column, one
            if feature[first + node] >= 0:
                gain[feature[first + node]] += best
        for row in range(rows):
            node = at[row]
            if node >= first and feature[node] >= 0:
                at[row] = 2 * node + 1 + (binned[row, feature[node]] > cut[node])
    return at
