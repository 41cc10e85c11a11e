"""Numbers that a change of structure must not move: walks, trainings, scores and forecasts.

Processors round sums differently, and walks that pass closely part from there: `goldens.json` has the
numbers of two kinds. `python tests/test_goldens.py` writes those of this processor anew, for a change that
is meant to move them; the other kind's have to be made there.
"""

import csv
import json
import tempfile
from pathlib import Path
from platform import machine
from typing import Any

import pytest
import torch
from helpers.training import SHORT

import pedzoo
from pedzoo.cli.main import main
from pedzoo.metrics.realism.two_sample import TREES

FILE = Path(__file__).with_name("goldens.json")
POLICIES = ["orca:dt=0.4", "social_force", "approach_net_goal_map.indoor", "social_walker.styled"]
SCENES = ["door", "goals:people=4,goals=2,pool=8", "two_way"]
TRAININGS = ["sgan", "sgan_goal", "closed_loop/social_walker", "robot/ppo"]
SCORED = ["orca:radius=0.3", "approach_net_goal_map.indoor", "social_walker.styled"]
CARDS = [
    "sgan_nopool.zara1",
    "sgan_goal.zara1",
    "approach_net_goal_map.indoor",
    "social_vrnn.zara1",
    "anchor_net_goal.zara1",
    "social_walker.styled",
]


def walked(policy: str, scene: str) -> list[float]:
    """Return where the first three agents of two scenes are after 1.5, 3 and 4.5 s, metres."""
    walk, _ = pedzoo.rollout(policy, scene, "compiled", 2, seed=3)
    places = walk.trace[:, :3, [15, 30, 45]]
    return [round(value, 6) for value in places.flatten().tolist()]


def trained(config: str) -> dict[str, float]:
    """Return the training losses that a short training logs."""
    with tempfile.TemporaryDirectory() as runs:
        words = [f"--runs={runs}", *SHORT]
        if config.startswith("robot/"):
            words += ["--model.envs=4", "--model.episodes=2", "--model.minibatches=2", "--model.steps=4"]
        else:
            words += ["--data.fold=embedded", "--rollout.scenarios=null"]
            words += ["--model.steps=2"] * config.startswith("closed_loop/")
        assert main(["fit", "--config", config, *words]) == 0
        (file,) = Path(runs).glob("*/*/metrics.csv")
        with file.open() as lines:
            rows = list(csv.DictReader(lines))
    losses = {key: value for row in rows for key, value in row.items() if value}
    return {
        key: float(value) for key, value in losses.items() if key.startswith("train/") and "per_s" not in key
    }


def scored() -> dict[str, float]:
    """Return what `pedzoo score` says of policies among the embedded people, without the classifier's."""
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "score.json"
        words = ["--against", "embedded", "--rollouts", "1", "--json", str(file)]
        assert main(["score", *SCORED, *words]) == 0
        rows = [row for row in json.loads(file.read_text())["rows"] if row["name"] in SCORED]
    numbers = {f"{row['name']} {key}": value for row in rows for key, value in row["metrics"].items()}
    return {name: value for name, value in numbers.items() if "auc" not in name}


def forecast(weights: str) -> dict[str, float]:
    """Return the errors of a model's forecasts on the embedded recordings, metres."""
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "forecast.json"
        words = ["--data.fold", "embedded", "--samples", "3", "--json", str(file)]
        assert main(["forecast", weights, *words]) == 0
        rows = json.loads(file.read_text())["rows"]
    return next(row["metrics"] for row in rows if row["name"] == weights)


def processor() -> str:
    """Return who made this one: ``AuthenticAMD``, ``GenuineIntel``, or its kind where nobody says it."""
    lines = Path("/proc/cpuinfo").read_text().splitlines() if Path("/proc/cpuinfo").is_file() else []
    return next((line.split(":")[1].strip() for line in lines if "vendor_id" in line), machine())


KINDS: dict[str, tuple[Any, list[tuple[str, ...]]]] = {
    "walks": (walked, [(policy, scene) for policy in POLICIES for scene in SCENES]),
    "losses": (trained, [(config,) for config in TRAININGS]),
    "scores": (scored, [()]),
    "forecasts": (forecast, [(weights,) for weights in CARDS]),
}


CASES = [(kind, case) for kind, (_, cases) in KINDS.items() for case in cases]


@pytest.mark.parametrize("kind,case", CASES, ids=[" ".join((kind, *case)) for kind, case in CASES])
def test_numbers_have_not_moved(kind: str, case: tuple[str, ...], monkeypatch) -> None:
    monkeypatch.setitem(TREES, "max_iter", 5)  # the classifier's numbers are not here
    known = [numbers[kind][" ".join(case)] for numbers in json.loads(FILE.read_text()).values()]
    got = KINDS[kind][0](*case)
    assert any(got == pytest.approx(one, abs=1e-5, rel=1e-5, nan_ok=True) for one in known), got


if __name__ == "__main__":
    torch.set_num_threads(1)
    numbers = {kind: {" ".join(case): make(*case) for case in cases} for kind, (make, cases) in KINDS.items()}
    known = json.loads(FILE.read_text()) | {processor(): numbers}
    FILE.write_text(json.dumps(known, separators=(",", ":")) + "\n")
