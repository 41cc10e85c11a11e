"""Agents with wheels: against values computed by hand, in every backend."""

import math
from typing import Any

import pytest
import torch
from helpers.bodies import BACKENDS, Yard, yard
from torch import Tensor

from pedzoo.core.bodies import DIFF_DRIVE, HOLONOMIC, UNICYCLE
from pedzoo.core.errors import UserError
from pedzoo.sim import kernel
from pedzoo.sim.env import PedestrianEnv
from pedzoo.sim.make import make_env

pytestmark = pytest.mark.parametrize("physics", BACKENDS)

LIMITS: dict[str, Any] = {
    "acceleration": [1.0],
    "turn_acceleration": [2.0],
    "heading": [0.0],
    "top_speed": [1.2],
}


def drive(env: PedestrianEnv, *decisions: list[float]) -> tuple[Tensor, Tensor]:
    """Return the trace (T, 2) of the first agent, and its heading after every decision."""
    env.reset()
    state, traces, headings = env.state, [], []
    for command in decisions:
        action = torch.tensor([[command] * state.mask.shape[1]])
        state, _, events = kernel.step(state, action, env.physics, env.rules)
        traces.append(events.trace[0, 0])
        headings.append(state.heading[0, 0])
    env.physics.close()
    return torch.cat(traces), torch.stack(headings)


@pytest.fixture(autouse=True)
def needs(physics: str) -> None:
    if physics == "bullet":
        pytest.importorskip("pybullet")


def test_a_unicycle_speeds_up_and_turns_by_its_limits(physics: str) -> None:
    """At 1 m/s^2 its speeds are 0.1, 0.2, 0.3, 0.4 m/s; at the top speed of 1.2 m/s it stays.

    At 2 rad/s^2 its rates are 0.2, 0.4, 0.6, 0.8 rad/s: 0.2 rad after 0.4 s, then 1 rad/s.
    """
    trace, heading = drive(yard(physics, drive=[UNICYCLE], **LIMITS), *[[5.0, 0.0]] * 4)
    speed = torch.cat((torch.zeros(1), trace[:, 0])).diff() / 0.1
    assert torch.allclose(speed, torch.linspace(0.1, 1.6, 16).clamp_max(1.2), atol=1e-4)
    assert trace[:, 1].abs().max() < 1e-6 and heading.abs().max() < 1e-6
    trace, heading = drive(yard(physics, drive=[UNICYCLE], **LIMITS), *[[0.0, 1.0]] * 2)
    assert trace.abs().max() < 1e-6
    assert heading.tolist() == pytest.approx([0.2, 0.6], abs=1e-5)


def test_a_differential_drive_is_commanded_by_its_wheels(physics: str) -> None:
    """Wheels 0.5 m apart: (-0.2, 0.2) turns at 0.8 rad/s in place, (0.4, 0.6) drives an arc of 1.25 m."""
    free: dict[str, Any] = {"heading": [math.pi / 2], "track": [0.5], "top_speed": [1.2]}
    trace, heading = drive(yard(physics, drive=[DIFF_DRIVE], **free), [-0.2, 0.2])
    assert trace.abs().max() < 1e-6 and float(heading[0]) == pytest.approx(math.pi / 2 + 0.32, abs=1e-5)
    trace, heading = drive(yard(physics, drive=[DIFF_DRIVE], **free), [0.4, 0.6])
    turned = 0.4 * 0.4
    assert float(heading[0]) == pytest.approx(math.pi / 2 + turned, abs=1e-5)
    # it goes up, and to the left: a chord of the circle of 0.5 / 0.4 = 1.25 m
    arc = torch.tensor([1.25 * (math.cos(turned) - 1), 1.25 * math.sin(turned)])
    assert torch.allclose(trace[-1], arc, atol=1e-4)


def test_wheels_never_slip_sideways(physics: str) -> None:
    generator = torch.Generator().manual_seed(0)
    env = yard(physics, drive=[UNICYCLE], decision_dt=0.1, **LIMITS)
    env.reset()
    state, slips = env.state, []
    for _ in range(100):
        action = torch.randn(1, 1, 2, generator=generator)
        after, _, _ = kernel.step(state, action, env.physics, env.rules)
        moved = (after.position - state.position)[0, 0]
        middle = (after.heading + state.heading)[0, 0] / 2
        slips.append(moved[1] * middle.cos() - moved[0] * middle.sin())
        turn = (after.turn_rate - state.turn_rate).abs()
        assert float(turn) <= 2.0 * 0.1 + 1e-5 and float(moved.norm()) <= 0.1 * 1.2 + 1e-5
        state = after
    assert torch.stack(slips).abs().max() < 1e-5
    assert state.position.abs().max() > 0.05
    env.physics.close()


def test_holonomic_agents_have_a_limit_and_face_ahead(physics: str) -> None:
    """Beside a robot: from rest at 2 m/s^2 to (0, 1) m/s takes 0.5 s, and the person turns to it."""
    both: dict[str, Any] = {
        "drive": [HOLONOMIC, UNICYCLE],
        "acceleration": [2.0, 1.0],
        "heading": [0.0, 0.0],
        "radius": [0.15, 0.5],
    }
    env = yard(physics, 2, **both)
    trace, heading = drive(env, [0.0, 1.0], [0.0, 1.0])
    speed = torch.cat((torch.zeros(1), trace[:, 1])).diff() / 0.1
    assert (speed.diff().abs() <= 0.2 + 1e-4).all() and float(speed[-1]) == pytest.approx(1.0, abs=1e-4)
    assert heading.tolist() == pytest.approx([math.pi / 2] * 2, abs=1e-3)


def test_robots_stand_and_face_as_told_in_the_warm_start(physics: str) -> None:
    env = make_env(
        Yard(2, drive=[HOLONOMIC, UNICYCLE], heading=[0.0, 2.0], kind=[0, 1], radius=[0.15, 0.5]), 1, physics
    )
    now = env.reset()
    state = env.state
    moved = state.past[0].diff(dim=1).norm(dim=-1).sum(1)
    assert float(moved[1]) == 0 and float(moved[0]) > 2
    assert float(state.heading[0, 1]) == 2.0 and abs(float(state.heading[0, 0])) < 0.1
    assert now["agents", "heading"][0, 1] == 2.0
    assert now["agents", "radius"][0, :, 0].tolist() == pytest.approx([0.15, 0.5])
    assert state.controlled.all()
    env.physics.close()


@pytest.mark.parametrize(
    ("bodies", "message"),
    [
        ({"radius": [0.05]}, r"radius 0\.05 m of an agent in Yard: expected at least 0\.1"),
        ({"top_speed": [9.0]}, r"top_speed 9 m/s of an agent in Yard: expected at most 3"),
        ({"drive": [UNICYCLE]}, r"expected Yard\.wheels = True"),
    ],
)
def test_bodies_that_a_scenario_does_not_announce_are_refused(
    physics: str, bodies: dict[str, Any], message: str, monkeypatch
) -> None:
    monkeypatch.setattr(Yard, "wheels", "drive" not in bodies)
    with pytest.raises(UserError, match=message):
        yard(physics, **bodies).reset()


def test_sub_steps_heed_the_smallest_body(physics: str) -> None:
    assert 3.0 * 0.1 / yard(physics).rules.substeps <= 0.1 / 2 + 1e-9
