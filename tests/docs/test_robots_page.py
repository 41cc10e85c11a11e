"""The code of docs/robots.md runs as it stands there."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import pytest
import torch

import pedzoo
from pedzoo.sim.gym import IDS

PAGE = (Path(__file__).parents[2] / "docs" / "robots.md").read_text()
*CALLS, OWN = re.findall(r"```python\n(.*?)```", PAGE, re.DOTALL)


@pytest.mark.parametrize("code", CALLS, ids=lambda code: code.strip().splitlines()[0])
def test_the_code_runs(code: str) -> None:
    exec(compile(code, "docs/robots.md", "exec"), {})


def test_a_robot_a_sensor_and_a_reward_of_ones_own(elsewhere: Path) -> None:
    (elsewhere / "mine.py").write_text(OWN)
    own: dict[str, Any] = {"robot": "mine.py:Scooter:top_speed=2", "sensors": ["goal", "mine.py:Clock"]}
    own |= {"reward": {"mine.py:Hurry": 0.5}, "people": "go_to_goal"}
    env: Any = pedzoo.make_robot_env("circle:people=4", **own)
    seen = env.reset(seed=0)
    assert env.action_spec["robots", "action"].space.high[0, 0].tolist() == [2.0, 2.0]
    for _ in range(5):
        seen["robots", "action"] = torch.tensor([[[2.0, 0.0]]])
        seen = env.step(seen)["next"]
    assert seen["robots", "observation", "clock"].item() == pytest.approx(1.0)
    assert seen["robots", "reward"].item() == pytest.approx(0.5 * 2.0, rel=0.05)


def test_the_page_names_all_ids() -> None:
    assert set(re.findall(r"`(pedzoo/\w+-v0)`", PAGE)) == set(IDS)
