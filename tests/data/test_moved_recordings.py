"""Forecasts and replays are the same wherever in the world a recording lies."""

import shutil
from pathlib import Path
from typing import cast

import numpy as np
import pytest
import torch
import yaml
from numpy.typing import NDArray

import pedzoo
from pedzoo.core.batch import agents_of
from pedzoo.core.registry import MODELS
from pedzoo.data import datasets
from pedzoo.data.datamodule import TrajectoryDataModule
from pedzoo.maps.bank import MapBank
from pedzoo.maps.grid import OccupancyGrid
from pedzoo.models.base import Forecaster
from pedzoo.policies.load import load_policy
from pedzoo.sim.make import make_env
from pedzoo.sim.scenarios.goals import Goals
from pedzoo.sim.scenarios.replay import Replay

PLAZA = Path(datasets.__file__).parents[1] / "embedded"
FAR = [np.array([10_000.37, -9_871.11]), np.array([500_000.5, 4_649_776.25])]
"""Metres; the last is where map projections put central Europe."""

FORECASTERS = (
    *("anchor_mlp.zara1", "anchor_net_goal.zara1", "anchors.zara1", "bent_line", "constant_velocity"),
    *("sgan_nopool.zara1", "sgan.zara1", "approach_net_goal_map.indoor"),
    *("social_vrnn.zara1", "social_walker.eth_ucy", "straight_line", "mdn_walker.likelihood"),
)
"""Weights of every architecture, with and without a goal and a floor plan."""

WALKERS = ("orca", "approach_net_goal_map.indoor", "social_walker.eth_ucy")


def plaza(folder: Path, offset: NDArray[np.float64], frames: int = 60) -> tuple[str, str]:
    """Write the begin of a recording and its floor plan, moved, and return both files."""
    rows = np.loadtxt(PLAZA / "plaza_test.csv", delimiter=",", skiprows=1)
    rows = rows[rows[:, 0] < rows[0, 0] + frames] + [0, 0, *offset]
    np.savetxt(folder / "walks.csv", rows, delimiter=",", header="frame,agent,x,y", comments="", fmt="%.6f")
    plan = yaml.safe_load((PLAZA / "plaza.yaml").read_text())
    plan["origin"] = [*(np.array(plan["origin"][:2]) + offset).tolist(), plan["origin"][2]]
    (folder / "plan.yaml").write_text(yaml.safe_dump(plan))
    shutil.copy(PLAZA / "plaza.png", folder)
    return str(folder / "walks.csv"), str(folder / "plan.yaml")


@pytest.fixture(scope="module")
def batches(tmp_path_factory):
    """The same windows at their place, and moved."""
    result = []
    for offset in (np.zeros(2), *FAR):
        walks, plan = plaza(tmp_path_factory.mktemp("plaza"), offset)
        data = TrajectoryDataModule(
            files=[walks], dt=0.4, map=plan, goal="destination", keep_people="present", split="0,0,1"
        )
        result.append(next(iter(data.test_dataloader())))
    return result


def test_weights_of_all_architectures_forecast():
    assert {type(cast("Forecaster", pedzoo.load(name))) for name in FORECASTERS} == {
        MODELS.get(name) for name in MODELS.names()
    }


@pytest.mark.parametrize("name", FORECASTERS)
@torch.no_grad()
def test_forecasts_are_the_same_10_km_away(name, batches):
    model = cast("Forecaster", pedzoo.load(name))
    mode, sample = (
        [answer(batch) for batch in batches]
        for answer in (
            lambda batch: model.mode(batch, 8),
            lambda batch: model.sample(batch, 3, 8, torch.Generator().manual_seed(0)),
        )
    )
    assert mode[0].cumsum(3).norm(dim=-1).max() > 1
    for near, *far in (mode, sample):
        for moved in far:
            assert (moved.cumsum(3) - near.cumsum(3)).abs().max() < 1e-3


def test_recordings_near_the_origin_stay_as_they_are(tmp_path):
    walks, plan = plaza(tmp_path, np.zeros(2))
    data = TrajectoryDataModule(files=[walks], dt=0.4, map=plan, split="0,0,1")
    data.setup("test")
    rows = data.source.recordings("test")[0].tracks.xy
    assert torch.equal(data.sets["test"].xy, torch.from_numpy(rows).float())
    assert data.bank.grids[0].origin == (-12.0, -8.0, 0.0)


def walked(name: str, scenario: str, offset: tuple[float, float], folder: Path) -> torch.Tensor:
    """Return the positions (T, A, 2) of a scene's people over 10 s, on the plan; 0 for absent ones."""
    folder = folder / f"{offset}"
    folder.mkdir(exist_ok=True)
    walks, plan = plaza(folder, np.array(offset))
    scene = (
        Goals(map=plan, people=4, pool=8) if scenario == "goals" else Replay(files=[walks], dt=0.4, map=plan)
    )
    policy = load_policy(name)
    env = make_env(scene, seed=1, decision_dt=policy.decision_dt)
    corner = torch.tensor(np.array(env.bank.grids[0].origin[:2]) - (-12.0, -8.0))
    batch, places = env.reset(), []
    for _ in range(round(10 / policy.decision_dt)):
        _, batch = env.step_and_maybe_reset(policy(batch))
        here, there = agents_of(batch)["history"][0, :, -1].double(), agents_of(batch)["mask"][0]
        places.append(torch.where(there.unsqueeze(1), here - corner, 0.0))
    return torch.stack(places)


@pytest.mark.parametrize("scenario", ["goals", "replay"])
@pytest.mark.parametrize("name", WALKERS)
@torch.no_grad()
def test_walks_of_environments_are_the_same_1_km_away(name, scenario, tmp_path):
    near = walked(name, scenario, (0.0, 0.0), tmp_path)
    assert (near[-1] - near[0]).norm(dim=-1).max() > 1
    assert (walked(name, scenario, (1000.25, -700.0), tmp_path) - near).abs().max() < 5e-3


def test_floor_plans_in_a_bank_are_not_moved():
    grid = OccupancyGrid(np.zeros((4, 4), np.uint8), 1.0, (1000.0, 0.0, 0.0))
    assert MapBank([grid]).grids[0].origin == (1000.0, 0.0, 0.0)
    assert grid.at_home().origin == (-2.0, -2.0, 0.0) and grid.home.tolist() == [1002.0, 2.0]
