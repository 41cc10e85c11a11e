"""All displacement metrics of a forecaster in one pass over scene batches."""

from typing import cast

import torch
from tensordict import TensorDict
from torch import Tensor, nn
from torchmetrics import Metric, MetricCollection

from pedzoo.metrics import displacement as d
from pedzoo.metrics.forecast_nll import CalibrationError, NegativeLogLikelihood
from pedzoo.models.base import Forecaster, known_displacements


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
