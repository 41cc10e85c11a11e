"""Models as ONNX files: traced from plain tensors, checked against torch, and only then written."""

import io
import json
import logging
import warnings
from contextlib import redirect_stdout
from copy import deepcopy
from pathlib import Path
from typing import Any, NamedTuple, cast

import numpy as np
import torch
from numpy.typing import NDArray
from tensordict import TensorDict
from torch import Tensor, nn
from torch.nn import functional

from pedzoo import __version__
from pedzoo.core import geometry
from pedzoo.core.adapters import untraceable_error
from pedzoo.core.batch import agents_of, scene_batch
from pedzoo.core.errors import UserError, need
from pedzoo.core.paths import write_atomically
from pedzoo.core.types import OBS_LEN, PRED_LEN, STEP_SECONDS
from pedzoo.data.datamodule import TrajectoryDataModule
from pedzoo.maps.bank import MAX_DISTANCE, MapBank
from pedzoo.maps.grid import OccupancyGrid
from pedzoo.models.base import Forecaster
from pedzoo.models.blocks import alexnet
from pedzoo.models.blocks.map_encoders import AlexNetEncoder, Viewpoints, encode, map_to_feature
from pedzoo.models.zoo.loading import config_of

TOLERANCE = 1e-4  # metres per step by which a graph may differ from torch

_ABOUT = "metres per step of 0.4 s, zero for padding: the first one over 0.4 s is the velocity to walk with"

_SIZES = {"scenes": 3, "people": 5, "rows": 11, "columns": 13}
"""Sizes that a graph is traced with; it runs with all others, too."""


class Port(NamedTuple):
    """An input or output of a graph; sizes of its shape with names are free, and equal for equal names."""

    shape: tuple[int | str, ...]
    about: str
    dtype: torch.dtype = torch.float32


class Parity(NamedTuple):
    """How far a graph was from torch, metres per step at most, on some scenes with slots for people."""

    scenes: int
    people: int
    difference: float


class Exported(NamedTuple):
    """A graph that was written: inputs and outputs by name, bytes of the file, agreement with torch."""

    inputs: dict[str, Port]
    outputs: dict[str, Port]
    size: int
    parity: list[Parity]


class Graph(nn.Module):
    """Calls a forecaster with a scene batch that is made from plain tensors, ``ports`` by name.

    All scenes of a call are on one floor plan. It is an input, too, so the same graph serves every plan.
    """

    def __init__(self, model: Forecaster, steps: int) -> None:
        """Take a forecaster, which stays as it is, and how many steps it shall predict.

        Raises UserError: it draws its noise itself, which no graph repeats.
        """
        super().__init__()
        if model.stochastic and not model.noise_dim:
            raise UserError(
                f"{type(model).__name__} draws its own noise, and a graph needs it as an input: give the "
                "model a noise_dim and next_steps, see pedzoo.models.base.Forecaster"
            )
        self.ports, self.steps = _inputs(model), steps
        shape = "scenes", "people", steps, 2
        self.outputs = {"displacements": Port(shape, _ABOUT)}
        if model.noise_dim and model.mode_at_zero:
            self.outputs["displacements"] = Port(shape, f"{_ABOUT}; noise zero gives the most likely future")
        elif model.noise_dim:
            self.outputs["most_likely"] = Port(shape, "the most likely future, for every noise")
        self.model = deepcopy(model).eval()
        for part in self.model.modules():
            if isinstance(part, AlexNetEncoder):
                part.__class__ = _InputReader  # with the weights that it has
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


def export_onnx(
    model: Forecaster, path: str | Path, steps: int = PRED_LEN, about: dict[str, Any] | None = None
) -> Exported:
    """Write a model as an ONNX graph that takes any number of scenes and people, see `Graph`.

    The file's metadata, JSON by key, say what else must be known: ``config`` and ``goal_protocol`` of the
    model, ``step_seconds``, ``obs_len``, ``pred_len``, and what each of ``inputs`` and ``outputs`` is.

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
    buffer = io.BytesIO()
    np.savez_compressed(buffer, **cast("dict[str, Any]", plan_inputs(model, MapBank([grid], "wall"), grid)))
    write_atomically(Path(path), buffer.getvalue())


def _traced(graph: Graph, metadata: dict[str, str]) -> bytes:
    """Return the ONNX file of a graph."""
    from torch.fx.experimental.symbolic_shapes import GuardOnDataDependentSymNode

    free, shapes, example = {name: torch.export.Dim(name) for name in _SIZES}, {}, {}
    for name, port in graph.ports.items():
        shapes[name] = {i: free[side] for i, side in enumerate(port.shape) if isinstance(side, str)}
        sizes = [side if isinstance(side, int) else _SIZES[side] for side in port.shape]
        example[name] = torch.ones(sizes).to(port.dtype)
    before = logging.root.manager.disable
    logging.disable(logging.WARNING)
    try:
        with torch.no_grad(), warnings.catch_warnings(action="ignore"):
            # not by torch.onnx.export alone, which turns every LSTM into a loop
            program = torch.export.export(graph, (example,), dynamic_shapes={"inputs": shapes})
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
    finally:
        logging.disable(before)
    assert onnx is not None
    proto = onnx.model_proto  # made anew each time it is asked for
    for part in (*proto.graph.node, *proto.graph.value_info, *proto.graph.input, *proto.graph.output):
        del part.metadata_props[:]  # lines of our code, with the folders of this machine
    for key, value in metadata.items():
        proto.metadata_props.add(key=key, value=value)
    return proto.SerializeToString(deterministic=True)


def plan_inputs(model: nn.Module, bank: MapBank, grid: OccupancyGrid) -> dict[str, NDArray[np.float32]]:
    """Return the inputs ``map_image`` (C, rows, columns) and ``map_affine`` (2, 3) of a floor plan.

    The model says which maps it reads, the bank what unknown cells mean. Raises UserError: AlexNet's weights
    are missing.
    """
    if encoder := alexnet_of(model):
        image = encode(grid, bank, alexnet.load(encoder.weights), encoder.cell).numpy()
        affine = map_to_feature(grid, encoder.cell)
    else:
        image = grid.signed_distance(bank.unknown)[None].clip(-MAX_DISTANCE, MAX_DISTANCE)
        affine = grid.map_to_cell()
    return {"map_image": image, "map_affine": affine.astype(np.float32)}


def alexnet_of(model: nn.Module) -> AlexNetEncoder | None:
    """Return the encoder with which a model sees AlexNet's features; None where it does not."""
    return next((part for part in model.modules() if isinstance(part, AlexNetEncoder)), None)


class PlanInput(MapBank):
    """A bank whose only floor plan is the ``map_image`` and ``map_affine`` of `plan_inputs`.

    It is that of every ``map_id``. Scenes lie on it as they are: their pose is the identity.
    """

    def __init__(self, image: Tensor, affine: Tensor) -> None:
        """Take the inputs of the graph."""
        super().__init__()
        self._image, self._affine = image, affine

    def __eq__(self, other: object) -> bool:
        return self is other

    def __hash__(self) -> int:
        return id(self)

    def to(self, device: torch.device | str) -> MapBank:
        """Return the bank itself."""
        return self

    def signed_distance(self, points: Tensor, map_id: Tensor, pose: Tensor) -> Tensor:
        """Return the distances (N, ...), as `MapBank.signed_distance`."""
        return self.read(points)[..., 0]

    def read(self, points: Tensor) -> Tensor:
        """Return the image's values (N, n, C) at positions (N, n, 2), as `pedzoo.maps.bank.Atlas` does."""
        pixel = points @ self._affine[:, :2].t() + self._affine[:, 2]
        rows, columns = self._image.shape[1:]
        where = torch.stack((2 * pixel[..., 0] / (columns - 1), 2 * pixel[..., 1] / (rows - 1)), -1) - 1
        result = functional.grid_sample(self._image[None], where[None], "bilinear", "border", True)
        return result[0].permute(1, 2, 0)


class _InputReader(AlexNetEncoder):
    """An `AlexNetEncoder` whose features are the image of a `PlanInput`."""

    def features(self, at: Viewpoints) -> Tensor:
        assert isinstance(at.bank, PlanInput)
        return at.bank.read(at.points(self.get_buffer("offsets")))


@torch.no_grad()
def parity(data: bytes, model: Forecaster, graph: Graph) -> list[Parity]:
    """Return how far a graph is from torch on the embedded recording.

    On one person, one scene, all scenes of a batch, and a single scene with all people of the batch.

    Raises:
        UserError: The graph cannot be run on these, or differs from torch by more than `TOLERANCE`.
    """
    import onnxruntime
    from onnxruntime.capi.onnxruntime_pybind11_state import Fail, InvalidArgument, RuntimeException

    options = onnxruntime.SessionOptions()
    options.log_severity_level = 4  # what goes wrong is said by the exception
    session = onnxruntime.InferenceSession(data, options, providers=["CPUExecutionProvider"])
    data_module = TrajectoryDataModule(
        fold="embedded", goal="window_end" if "goal" in model.needs else "none"
    )
    with redirect_stdout(io.StringIO()):  # counts of windows and people, which say nothing here
        data_module.setup("test")
    bank, plan = data_module.bank, {}
    if "map" in model.needs:
        plan = plan_inputs(model, bank, bank.grids[0])
    batch = next(iter(data_module.test_dataloader()))
    first, agents = batch[:1], agents_of(batch)
    everybody = {key: value.flatten(0, 1).unsqueeze(0) for key, value in agents.items()}
    crowd = TensorDict(everybody, batch_size=(1, agents.numel()))  # padding stays in place
    generator = torch.Generator().manual_seed(0)
    checks, name = [], f"the ONNX graph of {type(model).__name__}"
    for some, people in ((first, agents[:1, :1]), (first, agents[:1]), (batch, agents), (first, crowd)):
        scenes = cast("TensorDict", some.clone())
        scenes["agents"] = agents = cast("TensorDict", people)
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
        apart = [np.abs(a - b.numpy()) for a, b in zip(result, expected, strict=True)]
        worst = max(float(np.nan_to_num(values, nan=np.inf).max()) for values in apart)
        checks.append(Parity(agents.shape[0], agents.shape[1], worst))
    worst = max(checks, key=lambda check: check.difference)
    if worst.difference > TOLERANCE:
        raise UserError(
            f"{name} differs from torch by {worst.difference:.2g} m per step with {worst.scenes} scenes of "
            f"{worst.people} people; at most {TOLERANCE:g} is rounding, so nothing was written"
        )
    return checks
