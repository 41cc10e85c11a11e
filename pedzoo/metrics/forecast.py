"""All displacement metrics of a forecaster in one pass over scene batches."""

from collections.abc import Callable
from typing import Any, cast

import torch
from tensordict import TensorDict
from torch import Tensor
from torchmetrics import Metric

from pedzoo.core.geometry import unrotate
from pedzoo.metrics import displacement as d
from pedzoo.models.base import Forecaster, known_displacements

BINS = 20
"""Classes of the probability integral transform."""

NATS = "nll_nats_per_step"


def negative_log_likelihood(log_likelihood: Tensor, known: Tensor) -> tuple[Tensor, Tensor]:
    """Return minus the log density of what people did (B,), nats of metres, and the steps that it is of (B,).

    All steps of a person are judged together, and the sum is divided by their number: a model gains by
    knowing that slow people stay slow. Log densities (B, A) are of the ``known`` steps (B, A, T) bool.
    """
    value = -log_likelihood.where(known.any(-1), 0)
    return value.sum(1, dtype=torch.float64), known.sum((1, 2))


def places(ends: Tensor, history: Tensor, future: Tensor, valid: Tensor) -> Tensor:
    """Return how often the truth has each place among samples (2, BINS + 1), in the last column all.

    A place is the share of samples behind the true last position, ahead and to the side of where a person
    walked. A share on the border of two classes counts half in each, samples at the truth count half.

    Args:
        ends: Last positions of samples (B, K, A, 2).
        history: Observed positions (B, A, 8, 2).
        future: True ones (B, A, T, 2).
        valid: Which of these are known (B, A, T) bool.
    """
    there = valid[..., -1]
    moved = (history[:, :, -1] - history[:, :, 0])[there]
    ahead = torch.nn.functional.normalize(moved + moved.new_tensor([1e-6, 0.0]), dim=-1)
    off = ends.transpose(1, 2)[there] - future[:, :, -1][there].unsqueeze(1)  # (P, K, 2)
    off = unrotate(off, ahead.unsqueeze(1))
    share = ((off < 0).double() + 0.5 * (off == 0)).mean(1)
    counts = share.new_zeros(2, BINS + 1)
    for offset in (1e-9, -1e-9):
        place = ((share + offset) * BINS).floor().long().clamp(0, BINS - 1)
        for axis in range(2):
            counts[axis, :BINS] += 0.5 * torch.bincount(place[:, axis], minlength=BINS)
    counts[:, BINS] = len(share)
    return counts


def calibration_error(counts: Tensor) -> Tensor:
    """Return how far `places` are from uniform ones, 0 to 0.5: 0 is calibrated, .25 a single guess.

    They are uniform if the truth is like a sample (probability integral transform; Gneiting, Balabdaoui and
    Raftery, JRSS B 2007). The result is the mean distance of their distribution function from the uniform
    one, over both directions.
    """
    reached = counts[:, :BINS].cumsum(1) / counts[:, BINS:].clamp_min(1)
    uniform = torch.arange(1, BINS + 1, device=reached.device, dtype=reached.dtype) / BINS
    return (reached - uniform)[:, :-1].abs().mean()


class ForecastScore(Metric):
    """ADE, FDE and next-step error of a model's one best guess, and of K random samples.

    ``ade_m``, ``fde_m`` and ``next_step_m`` judge the mode (for SGAN: noise zero); ``ade_sampled_m`` and
    ``fde_sampled_m`` are what one random sample costs on average. ``min_*`` take the best of K, ADE and FDE
    each of a sample of its own; ``fde_of_min_ade_*`` is the FDE of the sample that is best by ADE.
    ``miss_rate_*`` is the share of people of whom all K end more than 2 m off. ``calibration_error``: see
    the function. ``nll_nats_per_step`` is there for models with a density, see `Forecaster.log_likelihood`.

    Sums are in float64, and are added over processes.

    Attributes:
        latest: Sums and counts (B,) of every mean, for each scene of the last batch.
    """

    full_state_update = False
    sums: Tensor
    places: Tensor
    latest: dict[str, tuple[Tensor, Tensor]]

    def __init__(self, samples: int, spread: bool = True) -> None:
        """Score ``samples`` per scene (0: only the mode); ``spread`` adds the distance between samples."""
        super().__init__()
        self.samples, self.spread = samples, spread and samples > 1
        errors = {"ade": d.average, "fde": d.final}
        self._mode = {"ade_m": (d.average,), "fde_m": (d.final,), "next_step_m": (d.next_step,)}
        self._sampled = {f"{name}_sampled_m": (of,) for name, of in errors.items()}
        self._best: dict[str, tuple[Callable[..., Any], ...]] = {
            f"min_{name}_{samples}_{who}_m": (of, over)
            for who, over in (("scene", d.min_per_scene), ("agent", d.min_per_agent))
            for name, of in errors.items()
        }
        self._best[f"fde_of_min_ade_{samples}_agent_m"] = (d.final_of_best,)
        self._best[f"miss_rate_{samples}"] = (d.missed,)
        self._names = [*self._mode, *([*self._sampled, *self._best] if samples else ())]
        self._names += [*["sample_distance_m"] * self.spread, NATS]
        zeros = torch.zeros(len(self._names), 2, dtype=torch.float64)
        self.add_state("sums", zeros, dist_reduce_fx="sum")
        self.add_state("places", torch.zeros(2, BINS + 1, dtype=torch.float64), dist_reduce_fx="sum")

    @torch.no_grad()
    def update(self, model: Forecaster, batch: TensorDict, generator: torch.Generator | None = None) -> None:
        """Let ``model`` predict a batch of recorded scenes and add its errors."""
        agents = cast("TensorDict", batch["agents"])
        history, future, valid = agents["history"], agents["future"], agents["future_valid"]
        steps = future.shape[2]
        # a deterministic model has one future, which is the mode and every sample
        samples = self.samples if model.stochastic else min(self.samples, 1)
        mode = model.mode(batch, steps)
        error = d.displacement_error(mode, history, future)
        self.latest = {name: d.scene_sums(error, valid, *how) for name, how in self._mode.items()}
        nats = model.log_likelihood(batch, generator)
        if nats is not None:
            self.latest[NATS] = negative_log_likelihood(nats, known_displacements(batch))
        if samples:
            prediction = model.sample(batch, samples, steps, generator) if model.stochastic else mode
            error = d.displacement_error(prediction, history, future)
            self.latest |= {name: d.scene_sums(error, valid, *how) for name, how in self._sampled.items()}
            if self.samples > 1:
                ends = d.positions(prediction, history)[..., -1, :]
                self.places += places(ends, history, future, valid)
            if type(model).candidates is not Forecaster.candidates:
                made = model.candidates(batch, samples, steps, generator)
                error = d.displacement_error(made, history, future)
            self.latest |= {name: d.scene_sums(error, valid, *how) for name, how in self._best.items()}
            if self.spread:
                self._add("sample_distance_m", *d.sample_distance(prediction, agents["mask"]))
        for name, (value, count) in self.latest.items():
            self._add(name, value.sum(), count.sum())

    def _add(self, name: str, value: Tensor, count: Tensor) -> None:
        self.sums[self._names.index(name)] += torch.stack((value, count.to(value)))

    def compute(self) -> dict[str, float]:
        """Return all metrics by name; a deterministic model has sample distance 0."""
        above, below = self.sums.unbind(1)
        means = dict(zip(self._names, (above / below).tolist(), strict=True))
        if not below[-1]:
            del means[NATS]
        calibration = {"calibration_error": float(calibration_error(self.places))}
        return means | (calibration if self.samples > 1 else {})
