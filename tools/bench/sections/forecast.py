"""Forecasts: milliseconds of 20 futures of one scene, the networks with anchors beside Social GAN."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial

import torch
from tensordict import TensorDict
from torch import Tensor
from torch.nn import functional

from pedzoo.core.batch import scene_batch
from pedzoo.core.geometry import identity_pose
from pedzoo.core.types import OBS_LEN, STEP_SECONDS
from pedzoo.maps.bank import MapBank
from pedzoo.models.base import Forecaster
from pedzoo.models.zoo.loading import load
from tools.bench.figures import Measured, Row
from tools.bench.section import Section
from tools.bench.turns import in_turns, ratio, repeated

SGAN = "sgan.zara1_pred12"
NAMES = (SGAN, "anchors.zara1_pred12", "anchor_mlp.zara1_pred12", "anchor_net.zara1_pred12")
CROWDS = (1, 2, 20, 50, 200)
SAMPLES, STEPS = 20, 12


class Forecast(Section):
    """All people of one scene, 12 steps of each, as tables of a best of 20 ask for them."""

    takes = 7, 133

    def rows(self) -> Iterator[Row]:
        """Measure all networks in turns, with few people and with many."""
        models = {name: load(name) for name in NAMES}
        for people in CROWDS[1:3] if self.settings.quick else CROWDS:
            batch = crowd(people)
            sides = {
                name: repeated(partial(futures, model, batch), 1.0, self.settings.clock)
                for name, model in models.items()
            }
            speeds = in_turns(sides, self.settings.turns, self.settings.seconds)
            for name, per_second in speeds.items():
                metrics = {
                    "scene_ms": Measured.of([1e3 / value for value in per_second]),
                    "times_sgan": ratio(per_second, speeds[SGAN]),
                }
                yield Row("forecast", name, {"people": people}, metrics)


@torch.no_grad()
def futures(model: Forecaster, batch: TensorDict) -> Tensor:
    """Return 20 futures of everybody (1, 20, A, 12, 2)."""
    return model.candidates(batch, SAMPLES, STEPS, torch.Generator().manual_seed(0))


def crowd(people: int) -> TensorDict:
    """Return one scene in which people walk straight, one in 4 square metres."""
    random = torch.Generator().manual_seed(people)
    side = 2 * people**0.5
    here = side * torch.rand(1, people, 1, 2, generator=random)
    way = functional.normalize(torch.randn(1, people, 1, 2, generator=random), dim=-1)
    speed = 1.3 + 0.2 * torch.randn(1, people, 1, 1, generator=random)
    steps = torch.arange(1.0 - OBS_LEN, 1.0).view(1, 1, -1, 1)
    there = torch.ones(1, people, dtype=torch.bool)
    return scene_batch(
        maps=MapBank(),
        map_id=torch.full((1, 1), -1),
        pose=identity_pose(1),
        history=here + speed * way * steps * STEP_SECONDS,
        valid=there.unsqueeze(-1).expand(-1, -1, OBS_LEN).clone(),
        mask=there,
        pref_speed=speed[..., 0, 0],
    )
