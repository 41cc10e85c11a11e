"""Collects the closed-loop metrics of a rollout, which `arrival`, `contacts`, `door` and others define."""

from collections.abc import Callable, Sequence
from inspect import unwrap
from traceback import extract_tb
from typing import Any

import torch
from torch import Tensor

from pedzoo.core.errors import UserError
from pedzoo.core.registry import METRICS
from pedzoo.metrics.arrival import time_ratios
from pedzoo.metrics.ratios import Interval, Ratio, bootstrap_quantile, quantiles, summarised
from pedzoo.sim.rollout import Rollout

_SHIPPED = {name: METRICS.get(name) for name in METRICS.names()}

NAMES = tuple(sorted(_SHIPPED, key=lambda name: getattr(_SHIPPED[name], "scenes", "all") == "doors"))
"""Every metric that the registry finds, in the order of tables: those of doors come last."""


def named(metrics: Sequence[str]) -> dict[str, Callable[[Rollout], Any]]:
    """Return the functions of ``path/to/file.py:f`` among names of metrics, by the names of their columns.

    Raises:
        UserError: An unknown metric, file or function, or two metrics of one name.
    """
    functions = {}
    for text in dict.fromkeys(metrics):
        function = METRICS.get(text)
        if text in NAMES:
            continue
        if (name := function.__name__) in NAMES or name in functions:
            raise UserError(f"metric {text!r}: there is a metric {name!r} already; rename the function")
        functions[name] = function
    return functions


def closed_loop(rollout: Rollout, metrics: Sequence[str] = ()) -> dict[str, Ratio]:
    """Return every metric that applies to a rollout, by its name, in the order of `NAMES`.

    The function of that name in `pedzoo.metrics` says what it is; more are given as ``path/to/file.py:f``.

    Raises:
        UserError: As of `named`, or a function does not return two sums per episode.
    """
    return _results(_SHIPPED, rollout) | own_metrics(rollout, metrics)


def measure(
    rollout: Rollout | tuple[Rollout, Any], metrics: Sequence[str] = ()
) -> tuple[dict[str, float], dict[str, Interval]]:
    """Return the values of all metrics of a rollout and their 95 % intervals; see `closed_loop`.

    ``measure(pedzoo.rollout("orca", "door"))`` works, too: of what that returns the first is the rollout.
    """
    rollout = rollout[0] if isinstance(rollout, tuple) else rollout
    return summarised(closed_loop(rollout, metrics))


def own_metrics(rollout: Rollout, metrics: Sequence[str]) -> dict[str, Ratio]:
    """Return the metrics that functions in files are; errors as of `closed_loop`, or what they raise."""
    return _results(named(metrics), rollout)


def _results(functions: dict[str, Callable[[Rollout], Any]], rollout: Rollout) -> dict[str, Ratio]:
    kinds = {"all"} if rollout.replayed else {"all", "ordinary"}
    if not rollout.replayed and rollout.gate is not None:
        kinds.add("doors")
    result = {}
    for name in dict.fromkeys((*NAMES, *functions)):
        function = functions.get(name)
        if function is None or getattr(function, "scenes", "all") not in kinds:
            continue
        try:
            sums = function(rollout)
        except Exception as error:
            if name in NAMES:  # a mistake of ours; a function from a file may raise anything
                raise
            file = unwrap(function).__code__.co_filename
            lines = [frame.lineno for frame in extract_tb(error.__traceback__) if frame.filename == file]
            where = f"{file}, line {lines[-1]}" if lines else file
            raise UserError(f"metric {name} ({where}) raised {type(error).__name__}: {error}") from error
        result[name] = _checked(name, sums, len(rollout.failed))
    return result


def _checked(name: str, result: Any, episodes: int) -> Ratio:
    """Return the two sums that a metric gave."""

    def kind(value: Any) -> str:
        return (
            f"a tensor of shape {tuple(value.shape)}" if isinstance(value, Tensor) else type(value).__name__
        )

    sums, more = (result[:2], result[2:]) if isinstance(result, tuple) else ((), ())
    right = len(sums) == 2 and all(isinstance(v, Tensor) and v.shape == (episodes,) for v in sums)
    right &= len(more) <= 1 + isinstance(result, Ratio) and all(isinstance(one, bool) for one in more)
    if not right:
        given = f"({', '.join(map(kind, result))})" if isinstance(result, tuple) else kind(result)
        raise UserError(
            f"metric {name}: expected two tensors (sum, count) of shape ({episodes},), a value of each "
            f"episode, got {given}: pedzoo.metrics.ratios.ratio makes them"
        )
    above, below = (value.double() for value in sums)
    if not bool((above.isfinite() & below.isfinite()).all()):
        raise UserError(f"metric {name}: a sum is not finite; expected 0 and 0 for episodes without a value")
    if bool((below < 0).any()):
        raise UserError(f"metric {name}: a count is below 0; expected how many its sum is over")
    if any(more) and bool(((above < 0) | (above > below)).any()):
        raise UserError(f"metric {name}: a share is outside 0 to 1; pedzoo.metrics.ratios.ratio makes others")
    return Ratio(above, below, *more)


def time_ratio_median(rollout: Rollout) -> tuple[dict[str, float], dict[str, Interval]]:
    """Return ``time_ratio_median``, the lower median over people of `time_ratios`, and its 95 % interval.

    A median is no ratio of sums: it is not in `NAMES`. Both are empty where no person arrives.
    """
    value, known = time_ratios(rollout)
    if not known.any():
        return {}, {}
    values, episode, episodes = value[known], known.nonzero()[:, 0], len(known)
    middle = float(quantiles(values, episode, torch.ones(1, episodes), (0.5,)))
    key, ends = "time_ratio_median", bootstrap_quantile(values, episode, episodes, 0.5)
    return {key: middle}, {key: ends} if ends else {}
