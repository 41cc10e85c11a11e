"""All displacement metrics of a forecaster in one pass over scene batches."""

from typing import cast

import torch
from tensordict import TensorDict
from torch import Tensor, nn
from torchmetrics import Metric, MetricCollection

from pedzoo.core.geometry import unrotate
from pedzoo.metrics import displacement as d
from pedzoo.models.base import Forecaster, known_displacements

BINS = 20
"""Classes of the probability integral transform."""


class NegativeLogLikelihood(d.SceneMean):
    """Mean of minus the log density of what people did, per person and step: nats, of metres.

    All steps of a person are judged together, and the sum is divided by their number: a model gains by
    knowing that slow people stay slow.
    """

    def update(self, log_likelihood: Tensor, known: Tensor) -> None:
        """Add a batch: log densities (B, A), and which steps (B, A, T) bool they are of."""
        self.add(-log_likelihood.where(known.any(-1), 0), known.sum((1, 2)))


class CalibrationError(Metric):
    """How far the truth's place among the samples is from a uniform one: 0 is calibrated, .25 a single guess.

    The share of samples behind the true last position, ahead and to the side of where a person walked, is
    uniform on [0, 1] if the truth is like a sample (probability integral transform; Gneiting, Balabdaoui and
    Raftery, JRSS B 2007). The result is the mean distance of its distribution function from the uniform one,
    over both directions. Samples at the same place as the truth count half.
    """

    full_state_update = False
    higher_is_better = False
    counts: Tensor

    def __init__(self) -> None:
        """Begin without people."""
        super().__init__()
        self.add_state("counts", torch.zeros(2, BINS + 1, dtype=torch.float64), dist_reduce_fx="sum")

    def update(self, ends: Tensor, history: Tensor, future: Tensor, valid: Tensor) -> None:
        """Add a batch.

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
        # a share on the border of two classes counts half in each
        for offset in (1e-9, -1e-9):
            place = ((share + offset) * BINS).floor().long().clamp(0, BINS - 1)
            for axis in range(2):
                self.counts[axis, :BINS] += 0.5 * torch.bincount(place[:, axis], minlength=BINS)
        self.counts[:, BINS] += len(share)

    def compute(self) -> Tensor:
        """Return the mean distance of the distribution functions, 0 to 0.5."""
        reached = self.counts[:, :BINS].cumsum(1) / self.counts[:, BINS:].clamp_min(1)
        uniform = torch.arange(1, BINS + 1, device=reached.device, dtype=reached.dtype) / BINS
        return (reached - uniform)[:, :-1].abs().mean()


class ForecastScore(nn.Module):
    """ADE, FDE and next-step error of a model's one best guess, and of K random samples.

    ``ade_m``, ``fde_m`` and ``next_step_m`` judge the mode (for SGAN: noise zero); ``ade_sampled_m`` and
    ``fde_sampled_m`` are what one random sample costs on average. ``min_*`` take the best of K, ADE and FDE
    each of a sample of its own; ``fde_of_min_ade_*`` is the FDE of the sample that is best by ADE.
    ``miss_rate_*`` is the share of people of whom all K end more than 2 m off. ``calibration_error``: see
    `CalibrationError`.
    ``nll_nats_per_step`` is there for models with a density, see `Forecaster.log_likelihood`.
    """

    def __init__(self, samples: int, spread: bool = True) -> None:
        """Score ``samples`` per scene (0: only the mode); ``spread`` adds the distance between samples."""
        super().__init__()
        self.samples = samples
        self.of_mode = _collection({"ade_m": d.ADE(), "fde_m": d.FDE(), "next_step_m": d.NextStepError()})
        of_samples = {"ade_sampled_m": d.ADE(), "fde_sampled_m": d.FDE()}
        self.of_samples = _collection(of_samples if samples else {})
        of_candidates = {
            f"min_ade_{samples}_scene_m": d.MinADEScene(),
            f"min_fde_{samples}_scene_m": d.MinFDEScene(),
            f"min_ade_{samples}_agent_m": d.MinADEAgent(),
            f"min_fde_{samples}_agent_m": d.MinFDEAgent(),
            f"fde_of_min_ade_{samples}_agent_m": d.FinalOfBestADE(),
            f"miss_rate_{samples}": d.MissRate(),
        }
        self.of_candidates = _collection(of_candidates if samples else {})
        self.calibration = CalibrationError() if samples > 1 else None
        self.spread = d.SampleDistance() if samples > 1 and spread else None
        self.likelihood = NegativeLogLikelihood()

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
        self.of_mode.update(error, valid)
        nats = model.log_likelihood(batch, generator)
        if nats is not None:
            self.likelihood.update(nats, known_displacements(batch))
        if not samples:
            return
        prediction = model.sample(batch, samples, steps, generator) if model.stochastic else mode
        error = d.displacement_error(prediction, history, future)
        self.of_samples.update(error, valid)
        if self.calibration is not None:
            self.calibration.update(d.positions(prediction, history)[..., -1, :], history, future, valid)
        if type(model).candidates is not Forecaster.candidates:
            error = d.displacement_error(model.candidates(batch, samples, steps, generator), history, future)
        self.of_candidates.update(error, valid)
        if self.spread is not None:
            self.spread.update(prediction, agents["mask"])

    def compute(self) -> dict[str, float]:
        """Return all metrics by name; a deterministic model has sample distance 0."""
        result = {
            name: float(value)
            for of in (self.of_mode, self.of_samples, self.of_candidates)
            for name, value in of.compute().items()
        }
        if self.spread is not None:
            result["sample_distance_m"] = float(self.spread.compute())
        if self.calibration is not None:
            result["calibration_error"] = float(self.calibration.compute())
        if self.likelihood.update_called:
            result["nll_nats_per_step"] = float(self.likelihood.compute())
        return result

    def latest(self) -> dict[str, tuple[Tensor, Tensor]]:
        """Return sums and counts (B,) of every mean, for each scene of the last batch."""
        items = (item for of in (self.of_mode, self.of_samples, self.of_candidates) for item in of.items())
        result = {name: metric.latest for name, metric in items if isinstance(metric, d.AgentMean)}
        if self.likelihood.update_called:
            result["nll_nats_per_step"] = self.likelihood.latest
        return result

    def reset(self) -> None:
        """Forget all batches."""
        for metric in (
            *(self.of_mode, self.of_samples, self.of_candidates),
            *(self.spread, self.calibration, self.likelihood),
        ):
            if metric is not None:
                metric.reset()


def _collection(metrics: dict[str, Metric]) -> MetricCollection:
    # no compute groups: the states differ, and finding that out would compute everything twice
    return MetricCollection(dict(metrics), compute_groups=False)
