"""People walk on a GPU as on the CPU, and models train there. Without a GPU: skipped (CI has none)."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
import torch
from torch import Tensor

from pedzoo.cli.main import main
from pedzoo.policies.load import load_policy
from pedzoo.sim.make import make_env

pytestmark = [
    pytest.mark.skipif(not torch.cuda.is_available(), reason="torch finds no GPU"),
    pytest.mark.usefixtures("elsewhere"),
    pytest.mark.filterwarnings("ignore:.*LeafSpec"),  # Lightning 2.6 beside torch 2.13
    pytest.mark.filterwarnings("ignore:.*does not have many workers"),
]

SCENES = {
    "planner and walls": "goals:map=apartment.7,people=5,goals=2,pool=6",
    "several maps": "door:people=4,width=[0.8,1.2]",
    "no walls": "circle:people=4",
    "people who wait": "waiting",
    "groups": "groups",
    "recorded people": "replay:fold=embedded",
}
POLICIES = ("go_to_goal:safety=true", "orca", "social_force", "sgan_goal_map.indoor", "social_walker.styled")


@torch.no_grad()
def places(policy: str, scene: str, device: str) -> Tensor:
    """Return where all are after 12 decisions (B, A, 2), m."""
    env = make_env(scene, num_envs=4, device=device)
    decide = load_policy(policy).to(device)
    now: Any = env.reset(seed=0)
    for _ in range(12):
        now = env.step(decide(now))["next"]
    assert env.state.position.device.type == torch.device(device).type
    return env.state.position.cpu()


@pytest.mark.parametrize("scene", SCENES)
@pytest.mark.parametrize("policy", POLICIES)
def test_people_walk_there_as_on_the_cpu(policy: str, scene: str) -> None:
    """The same draws on both. A rounding at a wall may send one person elsewhere, so the median counts."""
    there, here = (places(policy, SCENES[scene], device) for device in ("cuda", "cpu"))
    apart = (there - here).norm(dim=-1)
    assert torch.equal(there.isnan(), here.isnan())
    assert float(apart[~apart.isnan()].median()) < 1e-2


@pytest.mark.parametrize(
    "config", ["sgan", "sgan_goal_map", "closed_loop/sgan_goal_map", "closed_loop/social_walker_styled"]
)
def test_models_train_there(config: str) -> None:
    few = ["--trainer.limit_train_batches", "2", "--trainer.max_epochs", "1"]
    few += ["--trainer.check_val_every_n_epoch", "1", "--trainer.limit_val_batches", "1"]
    quiet = ["--trainer.enable_progress_bar", "false", "--rollout.scenarios", "null"]
    chosen_by = ["--monitor", "val/ade", "--monitor_mode", "min"] if config.endswith("sgan_goal_map") else []
    given = ["--config", config, "--data.fold", "embedded", "--trainer.accelerator", "gpu", *chosen_by]
    assert main(["fit", *given, *few, *quiet]) == 0
    (weights,) = Path("runs").rglob("last.ckpt")
    saved = torch.load(weights, map_location="cpu", weights_only=True)
    assert all(value.isfinite().all() for value in saved["state_dict"].values() if value.is_floating_point())
