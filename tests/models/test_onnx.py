"""ONNX graphs: what they answer, for whom, and what is refused. Needs the extra ``onnx``."""

import json
from pathlib import Path
from typing import Any, NamedTuple, cast

import numpy as np
import pytest
import torch
from helpers.batches import make_batch, on_plan, random_weights
from tensordict import TensorDict

from pedzoo.cli.main import main
from pedzoo.core import errors
from pedzoo.core.batch import agents_of
from pedzoo.core.errors import UserError
from pedzoo.maps.bank import MapBank
from pedzoo.maps.formats import write_ros
from pedzoo.maps.grid import OccupancyGrid
from pedzoo.models.architectures.sgan import SGAN
from pedzoo.models.onnx import Graph, export_onnx, parity, plan_inputs
from pedzoo.models.zoo.loading import load, save_weights

STEPS = 12

OWN_MODELS = """
import torch
from pedzoo.models.base import Forecaster, arguments

class Still(Forecaster):
    stochastic = False
    def __init__(self):
        super().__init__()
        self.config = arguments(locals())
    def sample(self, batch, samples, steps, generator=None):
        mask = batch["agents", "mask"]
        path = torch.zeros(mask.shape[0], samples, mask.shape[1], steps, 2)
        return torch.where(mask[:, None, :, None, None], path + self.off(batch["agents", "history"]), 0.0)
    def off(self, history):
        return 0.0

class Branching(Still):
    def off(self, history):
        return 1.0 if history.sum() > 3 else 2.0

class Dicing(Still):
    stochastic = True
"""


class Written(NamedTuple):
    """An exported model: its weights, the graph, its floor plan as inputs, and what was said of it."""

    weights: Path
    graph: Path
    plan: Path
    report: dict[str, Any]


@pytest.fixture(scope="session")
def written(tmp_path_factory):
    """A model with everything: pooling, approaches, goal, map, trait, frames of its own, twelve steps."""
    for package in errors.EXTRAS["onnx"]:
        pytest.importorskip(package, reason="needs pedzoo[onnx]")
    folder = tmp_path_factory.mktemp("onnx")
    options: dict[str, Any] = {"goal_dim": 4, "goal_protocol": "destination", "bottleneck_dim": 4}
    options |= {"map": "rings", "map_dim": 4, "approach_dim": 4, "trait_dim": 4}
    model = SGAN.of(frame="way", residual="bent_line", **options)
    weights = folder / "mine.safetensors"
    save_weights(random_weights(model), weights, protocol={"pred_len": STEPS})
    write_ros(furnished(), folder / "room.yaml")
    command = [
        "export",
        str(weights),
        "--onnx",
        str(folder / "mine.onnx"),
        "--plan",
        str(folder / "room.yaml"),
    ]
    assert main([*command, "--json", str(folder / "said.json")]) == 0
    said = json.loads((folder / "said.json").read_text())
    return Written(weights, folder / "mine.onnx", folder / "mine.room.npz", said)


def furnished() -> OccupancyGrid:
    """A floor plan with a wall, an unknown corner and a turned origin."""
    cells = np.zeros((50, 70), dtype=np.uint8)
    cells[10:30, 20:24] = 1
    cells[40:, 60:] = 2
    return OccupancyGrid(cells, 0.2, (-6.0, -4.0, 0.3), name="room")


def answered(written: Written, batch: TensorDict, noise: torch.Tensor) -> np.ndarray:
    import onnxruntime

    session = onnxruntime.InferenceSession(written.graph)
    agents = agents_of(batch)
    feeds = {key: agents[key].numpy() for key in ("history", "mask", "goal", "desired_velocity")}
    return cast(
        "np.ndarray", session.run(None, feeds | {"noise": noise.numpy()} | dict(np.load(written.plan)))[0]
    )


def expected(written: Written, batch: TensorDict, noise: torch.Tensor | None) -> np.ndarray:
    grid, model = furnished(), load(written.weights)
    batch = on_plan(batch, MapBank([grid], "wall"))
    with torch.no_grad():
        return model.next_steps(batch, noise, STEPS, STEPS).numpy()


@pytest.mark.parametrize("sizes", [(1,), (2, 5, 1, 3), (40, 2)])
def test_a_graph_answers_as_torch_for_any_crowd_on_any_plan(written, sizes):
    batch = make_batch(sizes, padding=0.0)
    noise = torch.randn(len(sizes), max(sizes), 8, generator=torch.Generator().manual_seed(1))
    result = answered(written, batch, noise)
    assert result.shape == (len(sizes), max(sizes), STEPS, 2)
    assert np.abs(result - expected(written, batch, noise)).max() < 5e-5
    assert np.abs(result).max() > 0.1
    absent = ~cast("torch.Tensor", agents_of(batch)["mask"])
    assert not result[absent.numpy()].any()
    likely = answered(written, batch, torch.zeros_like(noise))  # without noise
    assert np.abs(likely - expected(written, batch, None)).max() < 5e-5


def test_padding_anywhere_and_of_any_value_changes_nothing(written):
    batch, noise = make_batch((3,)), torch.ones(1, 3, 8)
    alone = answered(written, batch, noise)
    wide = make_batch((5,))
    there = torch.tensor([[False, True, True, False, True]])
    for key, value in agents_of(batch).items():
        of_wide = cast("torch.Tensor", agents_of(wide)[key])
        of_wide.fill_(float("nan") if of_wide.is_floating_point() else 0.0)
        of_wide[:, there[0]] = value
    result = answered(written, wide, torch.ones(1, 5, 8))
    assert np.abs(result[:, there[0].numpy()] - alone).max() < 1e-6
    assert not result[:, ~there[0].numpy()].any()


def test_far_from_the_origin_padding_costs_no_digits(written):
    """Pooling takes differences of positions, from the scene's first slot: it must not be at zero."""
    batch = make_batch((4,), seed=2)
    for key in ("history", "goal"):
        agents_of(batch)[key] += 5000
    agents_of(batch)["mask"][0, 0] = False
    agents_of(batch)["history"][0, 0] = 0
    noise = torch.zeros(1, 4, 8)
    assert np.abs(answered(written, batch, noise) - expected(written, batch, noise)).max() < 1e-3


def test_the_file_says_all_that_must_be_known(written):
    import onnxruntime

    session = onnxruntime.InferenceSession(written.graph)
    said = {key: json.loads(value) for key, value in session.get_modelmeta().custom_metadata_map.items()}
    assert said["config"] == {
        "architecture": "sgan",
        "goal": "destination",
        "init": load(written.weights).config,
    }
    assert said["goal_protocol"] == "destination" and said["name"] == str(written.weights)
    assert (said["step_seconds"], said["obs_len"], said["pred_len"]) == (0.4, 8, STEPS)
    inputs = {one.name: one.shape for one in session.get_inputs()}
    assert inputs.keys() == said["inputs"].keys()
    assert inputs["history"] == ["scenes", "people", 8, 2]
    assert inputs["map_image"] == [1, "rows", "columns"]
    assert [(one.name, one.shape) for one in session.get_outputs()] == [
        ("displacements", ["scenes", "people", STEPS, 2])
    ]
    sizes = [(check["scenes"], check["people"]) for check in written.report["parity"]]
    assert len(set(sizes)) == 4 and sizes[0] == (1, 1)
    assert all(check["difference"] < 5e-5 for check in written.report["parity"])
    assert written.report["files"] == [str(written.graph), str(written.plan)]


@pytest.fixture
def own(tmp_path):
    path = tmp_path / "own.py"
    path.write_text(OWN_MODELS)
    return path


@pytest.mark.usefixtures("written")  # hence skipped without the packages
@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("Branching", "Branching cannot be made an ONNX graph .* must depend neither on the numbers"),
        ("Dicing", "Dicing draws its own noise, and a graph needs it as an input"),
    ],
)
def test_what_no_graph_can_answer_is_refused(own, tmp_path, name, message):
    with pytest.raises(UserError, match=message):
        export_onnx(load(f"{own}:{name}"), tmp_path / "own.onnx")
    assert not (tmp_path / "own.onnx").exists()


def test_a_graph_of_other_weights_is_refused(written):
    other = random_weights(load(written.weights), seed=1)
    with pytest.raises(UserError, match=r"of SGAN differs from torch by .* nothing was written"):
        parity(written.graph.read_bytes(), other, Graph(other, STEPS))


def test_a_graph_of_fixed_sizes_is_refused():
    helper = pytest.importorskip("onnx.helper", reason="needs pedzoo[onnx]")
    model = load("constant_velocity")
    graph = Graph(model, 8)
    assert list(graph.ports) == ["history", "mask"]
    sides = {"history": (1, 3, 5, 8, 2), "mask": (9, 3, 5), "displacements": (1, 3, 5, 8, 2)}
    tensors = [helper.make_tensor_value_info(name, kind, side) for name, (kind, *side) in sides.items()]
    same = helper.make_node("Identity", ["history"], ["displacements"])
    opset = helper.make_opsetid("", 20)
    fixed = helper.make_graph([same], "fixed", tensors[:2], tensors[2:])
    data = helper.make_model(fixed, ir_version=10, opset_imports=[opset])
    with pytest.raises(UserError, match=r"fails with 1 scenes of 1 people .* take sizes from x\.shape\[0\]"):
        parity(data.SerializeToString(), model, graph)


@pytest.mark.parametrize("kind", ["patch", "rings", "alexnet"])
def test_a_plan_as_input_is_seen_as_one_of_a_bank(kind, alexnet):
    """Before any tracing: the floor plan's image and affine against the bank's atlas."""
    grid, model = furnished(), random_weights(SGAN.of(map=kind, map_dim=4))
    graph, bank = Graph(model, 8), MapBank([grid], "wall")
    batch = on_plan(make_batch((6, 4), goal=False), bank)
    agents, noise = agents_of(batch), torch.ones(2, 6, 8)
    inputs: dict[str, Any] = {"history": agents["history"], "mask": agents["mask"], "noise": noise}
    inputs |= {key: torch.from_numpy(value) for key, value in plan_inputs(model, bank, grid).items()}
    with torch.no_grad():
        (result,) = graph(inputs)
        assert torch.allclose(result, model.next_steps(batch, noise, 8, 8), atol=1e-5)
        inputs["map_image"] = torch.zeros_like(inputs["map_image"])
        assert not torch.allclose(result, graph(inputs)[0], atol=1e-3)
