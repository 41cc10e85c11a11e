"""A forecaster as a function of plain tensors, traced into a graph for programs without pedzoo."""

from copy import deepcopy
from typing import NamedTuple

import torch
from tensordict import TensorDict
from torch import Tensor, nn

from pedzoo.core import geometry
from pedzoo.core.batch import scene_batch
from pedzoo.core.errors import UserError
from pedzoo.core.types import OBS_LEN, STEP_SECONDS
from pedzoo.maps.bank import MapBank
from pedzoo.models.base import Forecaster
from pedzoo.models.blocks.floor_plan import alexnet
from pedzoo.models.export.graph_plan import PlanInput, alexnet_of, reading_from_plan


class Port(NamedTuple):
    """An input or output of a graph.

    Attributes:
        shape: Its sizes; those with names are free, and equal for equal names.
        about: Its meaning.
        dtype: Type of its numbers.
    """

    shape: tuple[int | str, ...]
    about: str
    dtype: torch.dtype = torch.float32


class Graph(nn.Module):
    """Calls a forecaster with a scene batch that is made from plain tensors.

    All scenes of a call are on one floor plan. It is an input, too, so the same graph serves every plan.
    ``steps`` are predicted; ``ports`` and ``outputs`` are its inputs and outputs by name.
    """

    def __init__(self, model: Forecaster, steps: int) -> None:
        """Take a forecaster, which stays as it is, and how many steps it shall predict.

        Raises:
            UserError: The model draws its noise itself, which no graph repeats.
        """
        super().__init__()
        if model.stochastic and not model.noise_dim:
            raise UserError(
                f"{type(model).__name__} draws its own noise, and a graph needs it as an input: give the "
                "model a noise_dim and next_steps, see pedzoo.models.base.Forecaster"
            )
        self.ports, self.outputs, self.steps = _inputs(model), _outputs(model, steps), steps
        self.model = reading_from_plan(deepcopy(model).eval())
        self._no_plans = MapBank()

    def forward(self, inputs: dict[str, Tensor]) -> tuple[Tensor, ...]:
        """Return the ``outputs`` of ``inputs``, which are as ``ports`` says."""
        mask, history = inputs["mask"], inputs["history"]
        scenes = history.shape[0]
        # padding stands where a person of the scene is: far away it would cost digits of differences
        first = history[torch.arange(scenes), mask.long().argmax(1)]
        history = torch.where(mask[..., None, None], history, first.unsqueeze(1))
        maps = self._no_plans
        if "map_image" in inputs:
            maps = PlanInput(inputs["map_image"], inputs["map_affine"])
        batch = scene_batch(
            maps=maps,
            map_id=torch.zeros(scenes, 1, dtype=torch.long),
            pose=geometry.identity_pose(scenes),
            history=history,
            valid=mask.unsqueeze(2).expand(history.shape[:3]),
            mask=mask,
            pref_speed=history.diff(dim=2).norm(dim=-1).mean(2, keepdim=True) / STEP_SECONDS,
            goal=inputs.get("goal"),
            desired_velocity=inputs.get("desired_velocity"),
        )
        result = self.answers(self.model, batch, inputs.get("noise"))
        return tuple(torch.where(mask[..., None, None], path, 0.0) for path in result)

    def answers(self, model: Forecaster, batch: TensorDict, noise: Tensor | None) -> tuple[Tensor, ...]:
        """Return the ``outputs`` of ``model`` for a batch, each (B, A, steps, 2)."""
        some = model.next_steps(batch, noise, self.steps, self.steps)
        return (some, model.mode(batch, self.steps)[:, 0]) if len(self.outputs) > 1 else (some,)

    def example(self, sizes: dict[str, int]) -> dict[str, Tensor]:
        """Return some inputs, whose free sizes are ``sizes`` by name."""
        return {
            name: torch.ones([s if isinstance(s, int) else sizes[s] for s in port.shape]).to(port.dtype)
            for name, port in self.ports.items()
        }


def _inputs(model: Forecaster) -> dict[str, Port]:
    result = {
        "history": Port(("scenes", "people", OBS_LEN, 2), "positions, metres, oldest first, every 0.4 s"),
        "mask": Port(("scenes", "people"), "which people are present; the others are padding", torch.bool),
    }
    if "goal" in model.needs:
        result["goal"] = Port(("scenes", "people", 2), "short-term goal, metres, where history is, too")
        result["desired_velocity"] = Port(("scenes", "people", 2), "preferred speed along the way to it, m/s")
    if "map" in model.needs:
        channels, seen = 1, "distances to the nearest wall, metres, negative inside walls, from -5 to 5"
        if alexnet_of(model):
            channels, seen = alexnet.CHANNELS, "AlexNet's features"
        result["map_image"] = Port((channels, "rows", "columns"), f"floor plan of all scenes: {seen}")
        result["map_affine"] = Port((2, 3), "from positions to (column, row) of map_image, whole at centres")
    if model.noise_dim:
        drawn = "independent standard normal numbers, the same for a person all along"
        result["noise"] = Port(("scenes", "people", model.noise_dim), drawn)
    return result


def _outputs(model: Forecaster, steps: int) -> dict[str, Port]:
    shape = "scenes", "people", steps, 2
    about = (
        "metres per step of 0.4 s, zero for padding: the first one over 0.4 s is the velocity to walk with"
    )
    if model.noise_dim and model.mode_at_zero:
        about += "; noise zero gives the most likely future"
    result = {"displacements": Port(shape, about)}
    if model.noise_dim and not model.mode_at_zero:
        result["most_likely"] = Port(shape, "the most likely future, for every noise")
    return result
