"""Metrics of forecasts: displacement errors, likelihood and calibration, over scene batches.

``error`` is always the distance to the truth (B, K, A, T), metres; ``valid`` (B, A, T) bool says which of it
is known. Minima over samples come in two forms that must never share a column: *per scene*, one sample for
all people of a window together (Gupta et al., "Social GAN", CVPR 2018), and *per agent*.
"""

from collections.abc import Callable
from typing import Any, cast

import torch
from tensordict import TensorDict
from torch import Tensor
from torchmetrics import Metric

from pedzoo.core.errors import UserError
from pedzoo.core.geometry import unrotate
from pedzoo.models.base import Forecaster, known_displacements

MISS = 2.0
"""Metres: a forecast that ends farther off has missed."""

BINS = 20
"""Classes of the probability integral transform."""

NATS = "nll_nats_per_step"

Sums = tuple[Tensor, Tensor]
"""Values and whether they are known, or sums and counts."""


def positions(prediction: Tensor, history: Tensor) -> Tensor:
    """Return where displacements (B, K, A, T, 2) lead from the last observed positions: (B, K, A, T, 2)."""
    return history[:, None, :, -1:, :] + prediction.cumsum(-2)


def displacement_error(prediction: Tensor, history: Tensor, future: Tensor) -> Tensor:
    """Return distances (B, K, A, T) of predicted displacements (B, K, A, T, 2) from the true future.

    Raises:
        UserError: They have another shape: torch would stretch them silently.
    """
    given = tuple(prediction.shape) if isinstance(prediction, Tensor) else ()
    if given[:1] + given[2:] != future.shape:
        scenes, *rest = future.shape
        raise UserError(
            f"a model returned {given or type(prediction).__name__}: expected displacements (B, K, A, T, 2), "
            f"here {(scenes, 'K', *rest)}; pedzoo.models.base.for_all_samples makes them from one path"
        )
    return (positions(prediction, history) - future.unsqueeze(1)).norm(dim=-1)


def average(error: Tensor, valid: Tensor) -> Sums:
    """Return per-agent means over the known steps (B, K, A) and whether there is any (B, A): ADE."""
    known = valid.unsqueeze(1)
    count = known.sum(-1)
    return error.where(known, 0).sum(-1) / count.clamp(min=1), (count > 0).squeeze(1)


def final(error: Tensor, valid: Tensor) -> Sums:
    """Return the error (B, K, A) at the last step and whether the truth is known there (B, A): FDE."""
    return error[..., -1], valid[..., -1]


def next_step(error: Tensor, valid: Tensor) -> Sums:
    """Return the error (B, K, A) at the first step, the only one that a simulation walks."""
    return error[..., 0], valid[..., 0]


def final_of_best(error: Tensor, valid: Tensor) -> Sums:
    """Return the final error (B, 1, A) of the sample that is best by ADE: what minima apart leave out."""
    best = average(error, valid)[0].argmin(1, keepdim=True)
    return error[..., -1].gather(1, best), valid[..., -1]


def missed(error: Tensor, valid: Tensor) -> Sums:
    """Return 1 for people of whom no sample ends within `MISS` metres of the truth, else 0 (B, 1, A)."""
    return (error[..., -1].amin(1, keepdim=True) > MISS).to(error.dtype), valid[..., -1]


def min_per_scene(per_agent: Tensor, there: Tensor) -> Tensor:
    """Return each agent's error (B, A) in the one sample that is best for their whole scene."""
    best = per_agent.where(there.unsqueeze(1), 0).sum(-1).argmin(1)
    return per_agent[torch.arange(len(best), device=best.device), best]


def min_per_agent(per_agent: Tensor, there: Tensor) -> Tensor:
    """Return each agent's smallest error (B, A) over their own samples."""
    return per_agent.amin(1)


def mean_over_samples(per_agent: Tensor, there: Tensor) -> Tensor:
    """Return each agent's mean error (B, A) over the samples: what one random sample costs."""
    return per_agent.mean(1)


def scene_sums(
    error: Tensor,
    valid: Tensor,
    of: Callable[[Tensor, Tensor], Sums] = average,
    over_samples: Callable[[Tensor, Tensor], Tensor] = mean_over_samples,
) -> Sums:
    """Return the sum of an error, such as `average`, over each scene's people (B,) float64, and their number.

    ``over_samples`` reduces samples, such as `min_per_agent`.
    """
    per_agent, there = of(error, valid)
    value = over_samples(per_agent, there).where(there, 0)
    return value.sum(1, dtype=torch.float64), there.sum(1)


def sample_distance(prediction: Tensor, mask: Tensor) -> Sums:
    """Return the mean distance between the positions of two samples, metres: sum and count, () float64 each.

    Of the same person, ``mask`` (B, A), at the same step of displacements (B, K, A, T, 2); 0 without noise.
    """
    people = prediction.cumsum(-2).movedim(1, -2)[mask]  # (P, T, K, 2)
    first, second = torch.triu_indices(prediction.shape[1], prediction.shape[1], 1, device=mask.device)
    total, count = torch.zeros(2, dtype=torch.float64, device=mask.device)
    # a few people at a time: all pairs of all people at once would not fit a cache
    for some in people.split(256) if len(first) else ():  # one sample stands for all, at distance 0
        apart = (some[..., first, :] - some[..., second, :]).norm(dim=-1)
        total = total + apart.mean(-1).sum(dtype=torch.float64)
    return total, count + people.shape[0] * people.shape[1]


def negative_log_likelihood(log_likelihood: Tensor, known: Tensor) -> Sums:
    """Return minus the log density of what people did (B,), nats of metres, and the steps that it is of (B,).

    Log densities (B, A) are of all ``known`` steps (B, A, T) bool of a person together: a model gains by
    knowing that slow people stay slow.
    """
    value = -log_likelihood.where(known.any(-1), 0)
    return value.sum(1, dtype=torch.float64), known.sum((1, 2))


def places(ends: Tensor, history: Tensor, future: Tensor, valid: Tensor) -> Tensor:
    """Return how often the truth has each place among samples' ends (B, K, A, 2): (2, BINS + 1), at last all.

    A place is the share of samples behind the true last position, ahead and to the side of where a person
    walked. A share on the border of two classes counts half in each, samples at the truth count half.
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
    Raftery, JRSS B 2007). It is the mean distance of both distribution functions from the uniform one.
    """
    reached = counts[:, :BINS].cumsum(1) / counts[:, BINS:].clamp_min(1)
    uniform = torch.arange(1, BINS + 1, device=reached.device, dtype=reached.dtype) / BINS
    return (reached - uniform)[:, :-1].abs().mean()


class ForecastScore(Metric):
    """ADE, FDE and next-step error of a model's one best guess, and of K random samples.

    ``ade_m``, ``fde_m`` and ``next_step_m`` judge the mode (for SGAN: noise zero); ``ade_sampled_m`` and
    ``fde_sampled_m`` are what one random sample costs on average. ``min_*`` take the best of K, ADE and FDE
    each of a sample of its own. ``nll_nats_per_step`` is there for models with a density.
    """

    full_state_update = False
    sums: Tensor
    places: Tensor
    latest: dict[str, Sums]
    """Sums and counts (B,) of every mean, for each scene of the last batch."""

    def __init__(self, samples: int, spread: bool = True) -> None:
        """Score ``samples`` per scene (0: only the mode); ``spread`` adds the distance between samples."""
        super().__init__()
        self.samples, self.spread = samples, spread and samples > 1
        self._mode = {"ade_m": (average,), "fde_m": (final,), "next_step_m": (next_step,)}
        self._sampled = {"ade_sampled_m": (average,), "fde_sampled_m": (final,)}
        self._best: dict[str, tuple[Callable[..., Any], ...]] = {
            f"min_{name}_{samples}_{who}_m": (of, over)
            for who, over in (("scene", min_per_scene), ("agent", min_per_agent))
            for name, of in (("ade", average), ("fde", final))
        }
        self._best[f"fde_of_min_ade_{samples}_agent_m"] = (final_of_best,)
        self._best[f"miss_rate_{samples}"] = (missed,)
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
        steps, self.latest = future.shape[2], {}

        def add(prediction: Tensor, kinds: dict[str, tuple[Callable[..., Any], ...]]) -> None:
            error = displacement_error(prediction, history, future)
            self.latest |= {name: scene_sums(error, valid, *how) for name, how in kinds.items()}

        # a deterministic model has one future, which is the mode and every sample
        samples = self.samples if model.stochastic else min(self.samples, 1)
        mode = model.mode(batch, steps)
        add(mode, self._mode)
        nats = model.log_likelihood(batch, generator)
        if nats is not None:
            self.latest[NATS] = negative_log_likelihood(nats, known_displacements(batch))
        if samples:
            prediction = model.sample(batch, samples, steps, generator) if model.stochastic else mode
            own = type(model).candidates is not Forecaster.candidates
            add(prediction, self._sampled if own else self._sampled | self._best)
            if self.samples > 1:
                self.places += places(positions(prediction, history)[..., -1, :], history, future, valid)
            if own:
                add(model.candidates(batch, samples, steps, generator), self._best)
            if self.spread:
                self._add("sample_distance_m", *sample_distance(prediction, agents["mask"]))
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
