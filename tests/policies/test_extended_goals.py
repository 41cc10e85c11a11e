"""Goals as far ahead as people walk: by hand, in any frame, and what it changes round corners."""

from __future__ import annotations

import math

import pytest
import torch
from tensordict import TensorDict
from torch import Tensor

from pedzoo.core.geometry import rotate
from pedzoo.eval.rollout import rollout
from pedzoo.metrics.closed_loop import ClosedLoopScore
from pedzoo.policies.walker import extend_goals


def scene(goal: Tensor, desired: Tensor, position: Tensor) -> TensorDict:
    """Return one scene of people (A, 2) who stand at ``position``."""
    agents = {
        "history": position.unsqueeze(1).expand(-1, 8, -1),
        "goal": goal,
        "desired_velocity": desired,
    }
    return TensorDict({"agents": TensorDict(agents, [len(goal)]).unsqueeze(0)}, [1])


HERE = torch.tensor([[1.0, 1.0], [0.0, 0.0], [0.0, 0.0], [2.0, 0.0], [0.0, 0.0]])
GOAL = torch.tensor([[2.0, 1.0], [5.0, 0.0], [3.2, 0.0], [2.0, 0.0], [0.0, 0.5]])
DESIRED = torch.tensor([[1.0, 0.0], [1.0, 0.0], [1.0, 0.0], [0.0, 0.5], [0.0, 0.0]])


def test_a_goal_is_at_least_as_far_as_the_desired_velocity_leads() -> None:
    """A near one is moved out, a far and a fitting one stay; on it people go on; who wants to stand stays."""
    given = scene(GOAL, DESIRED, HERE)
    result = extend_goals(given)["agents", "goal"][0]
    expected = torch.tensor([[4.2, 1.0], [5.0, 0.0], [3.2, 0.0], [2.0, 1.6], [0.0, 0.5]])
    torch.testing.assert_close(result, expected, atol=1e-5, rtol=0)
    assert torch.equal(given["agents", "goal"][0], GOAL)  # the scene is another one


def test_goals_are_moved_out_along_the_line_to_them() -> None:
    """To the left of where the next waypoint is: it stays to the left."""
    goal, desired = torch.tensor([[1.0, 1.0]]), torch.tensor([[1.0, 0.0]])
    result = extend_goals(scene(goal, desired, torch.zeros(1, 2)))["agents", "goal"][0, 0]
    assert float(result.norm()) == pytest.approx(3.2, abs=0.01)
    assert math.atan2(result[1], result[0]) == pytest.approx(math.pi / 4, abs=0.06)


def test_turning_the_scene_turns_the_goals() -> None:
    axis = torch.tensor([math.cos(2.0), math.sin(2.0)]).expand(len(GOAL), 2)
    turned = extend_goals(scene(*(rotate(of, axis) for of in (GOAL, DESIRED, HERE))))["agents", "goal"][0]
    result = extend_goals(scene(GOAL, DESIRED, HERE))["agents", "goal"][0]
    torch.testing.assert_close(turned, rotate(result, axis), atol=1e-5, rtol=0)


def test_scenes_without_goals_stay_as_they_are() -> None:
    agents = TensorDict({"history": torch.zeros(1, 2, 8, 2)}, [1, 2])
    batch = TensorDict({"agents": agents}, [1])
    assert extend_goals(batch) is batch


def test_models_of_recordings_do_not_creep_round_corners() -> None:
    """The same weights, alone in an apartment: with extended goals they walk as fast again."""

    def speed(settings: str) -> float:
        scenario = "goals:map=apartment.0,people=1,goals=1,pool=6"
        walked, _ = rollout(f"sgan_goal_map.controller_open:{settings}", scenario, "compiled", episodes=6)
        score = ClosedLoopScore()
        score.update(walked)
        return float(score.compute()["speed_m_per_s"])

    assert speed("extend_goal=true") > 1.5 * speed("extend_goal=false")
