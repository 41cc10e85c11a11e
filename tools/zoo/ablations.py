"""What each part of the paper's network does: one is changed at a time, on fold zara1.

    python tools/zoo/ablations.py train | table [--runs runs/ablations] [--seeds 3] [--jobs 2]

``train`` runs ``pedzoo fit`` for every change and seed, and goes on where it was interrupted. ``table``
writes checkpoints/results/ABLATIONS.md and .json. The recordings are found by PEDZOO_DATA.
"""

from __future__ import annotations

import argparse
import json
from concurrent.futures import ThreadPoolExecutor
from functools import lru_cache, partial
from pathlib import Path
from typing import Any

import torch
from tensordict import TensorDictBase
from torch import Tensor

from pedzoo.core.machine import versions
from pedzoo.core.paths import shipped, write_atomically
from pedzoo.core.spec import with_settings
from pedzoo.core.types import STEP_SECONDS
from pedzoo.data.datamodule import TrajectoryDataModule
from pedzoo.eval.evaluate import evaluate
from pedzoo.eval.forecast import forecast_row, input_rows
from pedzoo.maps.bank import MapBank
from pedzoo.models.architectures.sgan import SGAN, Architecture
from pedzoo.models.base import Walking
from pedzoo.models.blocks import alexnet, map_encoders
from pedzoo.models.blocks.map_encoders import AlexNetEncoder, Viewpoints
from pedzoo.models.blocks.variety import VarietyLoss
from pedzoo.models.zoo.loading import load
from pedzoo.policies.policy import Policy
from pedzoo.policies.walker import Walker
from pedzoo.train.run import RunFolder
from tools.pages.tables import table as markdown
from tools.zoo.robots import fit_whole, is_finished, over_seeds, with_spread

EPOCHS = 24
"""Less than half of what the zoo's weights have: the changes are compared with one another."""

NETWORK = "model.generator.architecture."
CHANGES: dict[str, dict[str, str]] = {
    "as published": {},
    "no pooling": {f"{NETWORK}bottleneck_dim": "0"},
    "no discriminator": {"model.adversarial_weight": "0"},
    "residual on the bent line": {f"{NETWORK}residual": "bent_line"},
    "no floor plan": {"config": "sgan_goal"},
    "rings in place of AlexNet": {f"{NETWORK}map": "rings"},
    "AlexNet of the whole plan": {"model.generator": f"{__file__}:WholePlan"},
    "goals of a planner": {"data.goal": "planner", f"{NETWORK}goal_protocol": "planner"},
    "goals: destinations": {"data.goal": "destination", f"{NETWORK}goal_protocol": "destination"},
}
"""Options of ``pedzoo fit --config sgan_goal_map`` by what they change."""

COLUMNS = {
    "ade_m": "ADE, m", "shift_m": "shift without others, m", "gain_m": "ADE better with others by, m",
    "others of another scene": "with people of another scene in their place, m",
    "map": "ADE better with the floor plan by, m", "success": "people who reach their goals",
    "agent_contacts_per_min": "touches of people per minute", "wall_contacts_per_min": "of walls",
}  # fmt: skip

HEADER = f"""# What each part of the paper's network does

Made by `python tools/zoo/ablations.py train && python tools/zoo/ablations.py table`; as JSON: ABLATIONS.json.
`pedzoo fit --config sgan_goal_map` on fold zara1 with one change each, {EPOCHS} epochs; mean of the seeds,
their standard deviation behind ±. ADE is of the most likely forecast, 8 steps, on the test scene; without
others, of people with somebody within 2 m: see `pedzoo.metrics.inputs`. Walks: suite `goals`,
`--quick`, without a safety layer.
Numbers under different goals are of different tasks.
"""


@lru_cache(4)
def means(bank: MapBank, weights: str | None, cell: float) -> Tensor:
    """Return AlexNet's mean features (R + 1, 256) of every floor plan of a bank; the last is for none."""
    tensors = alexnet.load(weights)
    plans = [map_encoders.encode(grid, bank, tensors, cell).mean((1, 2)) for grid in bank.grids]
    return torch.stack([*plans, torch.zeros(alexnet.CHANNELS)])


class _WholePlan(AlexNetEncoder):
    """AlexNet's features of a whole floor plan, the same for everybody on it."""

    def features(self, at: Viewpoints) -> Tensor:
        """Return the mean over the plan (P, 5, 256), five times: the layer is as wide as of five places."""
        whole = means(at.bank, self.weights, self.cell)[at.bank.index(at.map_id)]
        return whole.unsqueeze(1).expand(-1, 5, -1)


class WholePlan(SGAN):
    """The paper's network with AlexNet's features of the whole floor plan."""

    def __init__(
        self,
        architecture: Architecture = Architecture(),
        losses: VarietyLoss = VarietyLoss(),
        walking: Walking = Walking(),
    ) -> None:
        """Take the settings of `SGAN`."""
        super().__init__(architecture, losses, walking)
        self.map = _WholePlan(dim=architecture.map_dim)


class Blind(Policy):
    """The network that was taught in the loop, without a safety layer; one of its inputs is taken away."""

    def __init__(self, taken: str) -> None:
        """Give it the features of free floor (``map``), or of somebody alone (``pooling``)."""
        super().__init__(STEP_SECONDS)
        self.walker = Walker(load("sgan_goal_map.indoor"), safety=False)
        part = self.walker.model.get_submodule(taken)
        nothing = part.get_parameter("head.bias") if taken == "map" else torch.zeros(())
        part.register_forward_hook(lambda *seen: nothing.expand_as(seen[-1]))

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Write each person's velocity (B, A, 2), m/s."""
        return self.walker(tensordict)


def run_of(change: str, seed: int, root: Path) -> RunFolder:
    """Return the run folder that ``pedzoo fit`` chooses."""
    config = CHANGES[change].get("config", "sgan_goal_map")
    return RunFolder(root / change.replace(" ", "_").replace(":", "") / config / f"zara1-seed{seed}")


def train(one: tuple[int, str], root: Path) -> None:
    """Train a change with a seed, if that is not done."""
    seed, change = one
    run = run_of(change, seed, root)
    if is_finished(run):
        return
    runs = run.path.parents[1]
    options = {"config": "sgan_goal_map", "data.fold": "zara1", "rollout.scenarios": "null"}
    options |= {"trainer.max_epochs": str(EPOCHS), "seed_everything": str(seed), "runs": str(runs)}
    fit_whole(run, options | CHANGES[change], root / f"{runs.name}-{seed}.log")
    print(f"{change}, seed {seed}", flush=True)


def row(change: str, seeds: list[int], root: Path) -> dict[str, Any]:
    """Return the numbers of a change, of every seed that is trained."""
    by_seed = []
    for seed in seeds:
        path = str(run_of(change, seed, root).best)
        if code := CHANGES[change].get("model.generator"):
            path = f"{code}:weights={path}"
        model = load(path)
        data = TrajectoryDataModule(fold="zara1", goal=model.goal_protocol or "none")
        numbers = {"ade_m": forecast_row(change, model, data, samples=0)["metrics"]["ade_m"]}
        for taken in input_rows(change, model, data):
            case, metrics = taken["case"]["without"], taken["metrics"]
            if case == "others":
                numbers |= {key: metrics[key] for key in ("shift_m", "gain_m")}
            elif case in COLUMNS:
                numbers[case] = metrics["gain_m"]
        report = evaluate([with_settings(path, {"safety": False})], ["goals"], quick=True)
        walk = report["summary"][0]["metrics"]
        by_seed.append(numbers | {key: walk[key] for key in COLUMNS if key in walk})
    return {"name": change, "seeds": len(seeds)} | over_seeds(by_seed)


def main() -> None:
    """Parse and run."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("what", choices=["train", "table"])
    parser.add_argument("--runs", type=Path, default=Path("runs/ablations"))
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--jobs", type=int, default=2, help="trainings at a time")
    given = parser.parse_args()
    wanted = [(seed, change) for seed in range(given.seeds) for change in CHANGES]
    if given.what == "train":
        with ThreadPoolExecutor(given.jobs) as pool:
            list(pool.map(partial(train, root=given.runs), wanted))
        return
    done = {
        change: [seed for seed in range(given.seeds) if is_finished(run_of(change, seed, given.runs))]
        for change in CHANGES
    }
    rows = [row(change, seeds, given.runs) for change, seeds in done.items() if seeds]
    cells = [[one["name"], str(one["seeds"]), *(with_spread(one, key) for key in COLUMNS)] for one in rows]
    page = HEADER + "\n" + markdown(["change", "seeds", *COLUMNS.values()], cells)
    target = shipped("checkpoints") / "results"
    report = {"command": "tools/zoo/ablations.py table", "versions": versions(), "rows": rows}
    write_atomically(target / "ABLATIONS.json", (json.dumps(report, separators=(",", ":")) + "\n").encode())
    write_atomically(target / "ABLATIONS.md", page.encode())
    print(page)


if __name__ == "__main__":
    main()
