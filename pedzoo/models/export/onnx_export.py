"""Models as ONNX files: traced, checked against torch, and only then written."""

import io
import json
import logging
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import torch

from pedzoo import __version__
from pedzoo.core.adapters import untraceable_error
from pedzoo.core.errors import UserError, need
from pedzoo.core.paths import write_atomically
from pedzoo.core.types import OBS_LEN, PRED_LEN, STEP_SECONDS
from pedzoo.maps.bank import MapBank
from pedzoo.maps.grid import OccupancyGrid
from pedzoo.models.base import Forecaster
from pedzoo.models.export.graph import Graph, Port
from pedzoo.models.export.graph_plan import plan_inputs
from pedzoo.models.export.onnx_parity import Parity, parity
from pedzoo.models.zoo.loading import config_of

_SIZES = {"scenes": 3, "people": 5, "rows": 11, "columns": 13}
"""Sizes that a graph is traced with; it runs with all others, too."""


class Exported(NamedTuple):
    """A graph that was written: inputs and outputs by name, bytes of the file, agreement with torch."""

    inputs: dict[str, Port]
    outputs: dict[str, Port]
    size: int
    parity: list[Parity]


def export_onnx(
    model: Forecaster, path: str | Path, steps: int = PRED_LEN, about: dict[str, Any] | None = None
) -> Exported:
    """Write a model as an ONNX graph that takes any number of scenes and people.

    Inputs and outputs are those of `pedzoo.models.export.graph.Graph`. The file's metadata, JSON by key, say
    what else must be known: ``config`` and ``goal_protocol`` of the model, ``step_seconds``, ``obs_len``,
    ``pred_len``, and what each of ``inputs`` and ``outputs`` is.

    Args:
        model: The model.
        path: The file.
        steps: How many steps it predicts: as many as in training, for goals lie that far ahead.
        about: More metadata, such as the name.

    Raises:
        UserError: The optional packages are missing, the model cannot be traced, or the graph does not answer
            as torch does. No file is written then.
    """
    need("onnx", "an ONNX graph")
    graph = Graph(model, steps)
    facts = (about or {}) | {
        "config": config_of(model),
        "goal_protocol": model.goal_protocol,
        "step_seconds": STEP_SECONDS,
        "obs_len": OBS_LEN,
        "pred_len": steps,
        "inputs": {name: port.about for name, port in graph.ports.items()},
        "outputs": {name: port.about for name, port in graph.outputs.items()},
        "pedzoo": __version__,
    }
    data = _traced(graph, {key: json.dumps(value, sort_keys=True) for key, value in facts.items()})
    checks = parity(data, model, graph)
    write_atomically(Path(path), data)
    return Exported(graph.ports, graph.outputs, len(data), checks)


def save_plan(model: Forecaster, grid: OccupancyGrid, path: str | Path) -> None:
    """Write a floor plan's ``map_image`` and ``map_affine`` for the graph of ``model`` into an ``.npz`` file.

    Unknown cells are walls, as indoors everywhere in pedzoo.

    Raises:
        UserError: The model sees no floor plan, or AlexNet's weights are missing.
    """
    if "map" not in model.needs:
        raise UserError(f"this {type(model).__name__} sees no floor plan: leave out {grid.name!r}")
    arrays: dict[str, Any] = {**plan_inputs(model, MapBank([grid], "wall"), grid)}
    buffer = io.BytesIO()
    np.savez_compressed(buffer, **arrays)
    write_atomically(Path(path), buffer.getvalue())


def _traced(graph: Graph, metadata: dict[str, str]) -> bytes:
    """Return the ONNX file of a graph."""
    from torch.fx.experimental.symbolic_shapes import GuardOnDataDependentSymNode

    free = {name: torch.export.Dim(name) for name in _SIZES}
    shapes = {
        name: {i: free[side] for i, side in enumerate(port.shape) if isinstance(side, str)}
        for name, port in graph.ports.items()
    }
    try:
        with torch.no_grad(), _quiet():
            # not by torch.onnx.export alone, which turns every LSTM into a loop
            program = torch.export.export(graph, (graph.example(_SIZES),), dynamic_shapes={"inputs": shapes})
            onnx = torch.onnx.export(
                program,
                input_names=list(graph.ports),
                output_names=list(graph.outputs),
                dynamic_shapes={"inputs": shapes},  # gives the free sizes their names
                verbose=False,
            )
    except (untraceable_error(), GuardOnDataDependentSymNode, torch.onnx.OnnxExporterError) as error:
        reason = str(error).strip().splitlines()[0]
        raise UserError(
            f"{type(graph.model).__name__} cannot be made an ONNX graph ({reason}): what it does must depend "
            "neither on the numbers in its inputs nor on how many people there are, and sizes must be taken "
            "from x.shape[0], not from len(x)"
        ) from error
    assert onnx is not None
    proto = onnx.model_proto  # made anew each time it is asked for
    for part in (*proto.graph.node, *proto.graph.value_info, *proto.graph.input, *proto.graph.output):
        del part.metadata_props[:]  # lines of our code, with the folders of this machine
    for key, value in metadata.items():
        proto.metadata_props.add(key=key, value=value)
    return proto.SerializeToString(deterministic=True)


@contextmanager
def _quiet() -> Iterator[None]:
    """Keep the exporter's own output from the terminal."""
    before = logging.root.manager.disable
    logging.disable(logging.WARNING)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            yield
    finally:
        logging.disable(before)
