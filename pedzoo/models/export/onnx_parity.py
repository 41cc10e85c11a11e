"""Whether an ONNX graph answers as torch does."""

import io
from contextlib import redirect_stdout
from typing import Any, NamedTuple, cast

import numpy as np
import torch
from tensordict import TensorDict

from pedzoo.core.batch import agents_of
from pedzoo.core.errors import UserError
from pedzoo.data.datamodule import TrajectoryDataModule
from pedzoo.models.base import Forecaster
from pedzoo.models.export.graph import Graph
from pedzoo.models.export.graph_plan import plan_inputs

TOLERANCE = 1e-4
"""Metres per step by which a graph may differ from torch."""


class Parity(NamedTuple):
    """How far a graph was from torch on some scenes.

    Attributes:
        scenes: How many.
        people: Slots for people in each.
        difference: The largest of all displacements', metres per step.
    """

    scenes: int
    people: int
    difference: float


@torch.no_grad()
def parity(data: bytes, model: Forecaster, graph: Graph) -> list[Parity]:
    """Return how far a graph is from torch on scenes of the embedded recording.

    On one person, one scene, all scenes of a batch, and a single scene with all people of the batch.

    Raises:
        UserError: The graph cannot be run with these numbers of scenes and people, or differs from torch by
            more than `TOLERANCE`.
    """
    import onnxruntime
    from onnxruntime.capi.onnxruntime_pybind11_state import Fail, InvalidArgument, RuntimeException

    options = onnxruntime.SessionOptions()
    options.log_severity_level = 4  # what goes wrong is said by the exception
    session = onnxruntime.InferenceSession(data, options, providers=["CPUExecutionProvider"])
    batch, plan = _embedded(model)
    generator = torch.Generator().manual_seed(0)
    checks, name = [], f"the ONNX graph of {type(model).__name__}"
    for scenes in (_cut(batch, 1, 1), _cut(batch, 1), batch, _crowd(batch)):
        agents = agents_of(scenes)
        noise = torch.randn(*agents.shape, model.noise_dim, generator=generator)
        given = plan | {key: value.numpy() for key, value in {**agents, "noise": noise}.items()}
        try:
            result = session.run(list(graph.outputs), {key: given[key] for key in graph.ports})
        except (Fail, InvalidArgument, RuntimeException) as error:
            reason = " ".join(str(error).split())
            raise UserError(
                f"{name} fails with {agents.shape[0]} scenes of {agents.shape[1]} people ({reason}): in the "
                "model, take sizes from x.shape[0] and not from len(x), which the graph does not follow"
            ) from error
        expected = graph.answers(model, scenes, noise)
        apart = [_difference(a, b.numpy()) for a, b in zip(result, expected, strict=True)]
        checks.append(Parity(agents.shape[0], agents.shape[1], max(apart)))
    worst = max(checks, key=lambda check: check.difference)
    if worst.difference > TOLERANCE:
        raise UserError(
            f"{name} differs from torch by {worst.difference:.2g} m per step with {worst.scenes} scenes of "
            f"{worst.people} people; at most {TOLERANCE:g} is rounding, so nothing was written"
        )
    return checks


def _difference(result: Any, expected: np.ndarray) -> float:
    return float(np.nan_to_num(np.abs(result - expected), nan=np.inf).max())


def _embedded(model: Forecaster) -> tuple[TensorDict, dict[str, Any]]:
    """Return a batch of the embedded recording, and its floor plan as ``model`` sees it."""
    data = TrajectoryDataModule(fold="embedded", goal="window_end" if "goal" in model.needs else "none")
    with redirect_stdout(io.StringIO()):  # counts of windows and people, which say nothing here
        data.setup("test")
    plan = plan_inputs(model, data.bank, data.bank.grids[0]) if "map" in model.needs else {}
    return next(iter(data.test_dataloader())), plan


def _cut(batch: TensorDict, scenes: int, people: int | None = None) -> TensorDict:
    """Return the first scenes of a batch, and the first people of each."""
    some = cast("TensorDict", batch[:scenes].clone())
    some["agents"] = agents_of(some)[:, :people]
    return some


def _crowd(batch: TensorDict) -> TensorDict:
    """Return one scene with all people of a batch; padding stays in place."""
    one, agents = _cut(batch, 1), agents_of(batch)
    people = {key: value.flatten(0, 1).unsqueeze(0) for key, value in agents.items()}
    one["agents"] = TensorDict(people, batch_size=(1, agents.numel()))
    return one
