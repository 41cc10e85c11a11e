"""Robots in pybullet: a Husky of a URDF file (1.007 m long, 0.685 m wide over its wheels), and cameras."""

import math
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
import torch
from helpers.bodies import put, yard
from torch import Tensor

import pedzoo
from pedzoo.core.batch import PERSON, ROBOT
from pedzoo.core.bodies import DIFF_DRIVE, HOLONOMIC
from pedzoo.core.errors import UserError
from pedzoo.core.geometry import heading_of, identity_pose, move_to_scene
from pedzoo.maps.bank import MapBank
from pedzoo.sim import kernel
from pedzoo.sim.drawing import FLOOR, OUTSIDE, Lens
from pedzoo.sim.env import PedestrianEnv
from pedzoo.sim.make import make_physics
from pedzoo.sim.physics._base import Bodies
from pedzoo.sim.robots.env import RobotEnv
from pedzoo.sim.state import Events, MotionInput, State

pytest.importorskip("pybullet")

HUSKY = "bullet:urdf=husky/husky.urdf"
AHEAD, ASIDE = 0.5037 + 0.15, 0.3426 + 0.15
"""Metres between centres at which a Husky touches a person."""


def beside(
    place: list[float], heading: float, kind: int = PERSON, physics: str = HUSKY
) -> tuple[PedestrianEnv, State]:
    """Return the open floor with a Husky at (5, 5) and another agent at a place from there."""
    bodies: dict[str, Any] = {
        "kind": [ROBOT, kind], "drive": [DIFF_DRIVE, HOLONOMIC], "heading": [heading, 0.0],
        "radius": [0.598, 0.15], "track": [0.57, 0.5],
    }  # fmt: skip
    env = yard(physics, 2, decision_dt=0.2, **bodies)
    env.reset()
    centre = torch.tensor([5.0, 5.0])
    return env, put(env.state, torch.stack((centre, centre + torch.tensor(place))).unsqueeze(0))


def driven(env: PedestrianEnv, state: State, left: float, right: float) -> tuple[State, Events]:
    """Return what comes of a decision in which the other agent stands."""
    command = torch.tensor([[[left, right], [0.0, 0.0]]])
    state, _, events = kernel.step(state, command, env.physics, env.rules)
    return state, events


@pytest.mark.parametrize("heading", [0.0, math.pi / 2, -2.5])
@pytest.mark.parametrize(
    ("ahead", "left", "touches"),
    [
        (AHEAD - 0.01, 0.0, True), (AHEAD + 0.01, 0.0, False),
        (-AHEAD + 0.01, 0.0, True), (-AHEAD - 0.01, 0.0, False),
        # beside a wheel, and in the gap between two wheels
        (0.256, ASIDE - 0.01, True), (0.256, ASIDE + 0.01, False), (0.0, ASIDE - 0.01, False),
        # the corner of its disc
        (0.5, 0.5, False),
    ],
)  # fmt: skip
def test_the_shape_at_its_heading_decides_who_touches(
    heading: float, ahead: float, left: float, touches: bool
) -> None:
    c, s = math.cos(heading), math.sin(heading)
    env, state = beside([c * ahead - s * left, s * ahead + c * left], heading)
    _, events = driven(env, state, 0.0, 0.0)
    assert bool(events.agent_contact[0, 0].all()) == touches
    assert torch.equal(events.agent_contact[0, 0], events.agent_contact[0, 1])
    env.physics.close()


def test_it_touches_while_it_turns_in_place() -> None:
    """Beside it there is room for a person at 0.55 m, ahead there is not."""
    env, state = beside([0.0, 0.55], 0.0)
    assert not driven(env, state, 0.0, 0.0)[1].agent_contact.any()
    touched = []
    for _ in range(4):
        state, events = driven(env, state, -0.3, 0.3)
        touched.append(bool(events.agent_contact.any()))
    assert float(state.heading[0, 0]) == pytest.approx(0.8 * 0.6 / 0.57, abs=0.01)
    assert not touched[0] and touched[-1] and touched == sorted(touched)
    env.physics.close()


def test_two_robots_touch_by_their_shapes() -> None:
    for distance, touches in ((0.70, False), (0.67, True)):
        env, state = beside([0.0, distance], 0.0, ROBOT)
        _, events = driven(env, state, 0.0, 0.0)
        assert events.agent_contact[0].any(-1).tolist() == [touches, touches]
        env.physics.close()


def test_wheels_drive_straight_and_turn_to_the_left() -> None:
    """At 3 m/s^2 it is at 0.5 m/s after 0.17 s: 0.46 m in 1 s. Wheels that skid turn it less."""
    env, state = beside([0.0, 4.0], 0.4, physics=f"{HUSKY},drive=wheels")
    state = state._replace(acceleration=torch.full_like(state.radius, 3.0))
    begin = state.position[0, 0]
    for _ in range(5):
        state, events = driven(env, state, 0.5, 0.5)
    way = state.position[0, 0] - begin
    assert float(way.norm()) == pytest.approx(0.46, abs=0.02)
    assert math.atan2(way[1], way[0]) == pytest.approx(0.4, abs=0.02)
    assert float(state.velocity[0, 0].norm()) == pytest.approx(0.5, abs=0.02)
    assert float(state.heading[0, 0]) == pytest.approx(0.4, abs=0.01) and not events.agent_contact.any()
    for _ in range(5):
        state, _ = driven(env, state, -0.3, 0.3)
    assert 0.1 < float(state.heading[0, 0]) - 0.4 < 0.6 / 0.57 and float(state.turn_rate[0, 0]) > 0
    env.physics.close()


def office() -> RobotEnv:
    """Return an office with a Husky that drives by its wheels."""
    return pedzoo.make_robot_env(
        "goals:map=office.1,people=1", robot="husky", people="orca", num_envs=4,
        physics=f"{HUSKY},drive=wheels", sensors=["goal"], ends_at="none",
    )  # fmt: skip


def driving(env: RobotEnv, action: list[float], steps: int) -> Iterator[tuple[Tensor, Tensor]]:
    """Yield whether the robot of each scene touches a wall (B,), and its distance to one, after decisions."""
    seen = env.reset(seed=0)
    for _ in range(steps):
        seen["robots", "action"] = torch.tensor(action).expand(*env.batch_size, 1, 2)
        seen = env.step(seen)["next"]
        gap, _ = env.bank.closest_wall(env.state.position, env.state.map_id, env.state.pose)
        yield seen["robots", "info", "wall_contact"][:, 0], gap[:, -1]
    env.physics.close()


def test_walls_are_touched_by_the_shape() -> None:
    """A disc of its half width follows the path: a Husky that turns at a wall touches it with its corners."""
    env = pedzoo.make_robot_env(
        "goals:map=apartment.7,people=2", robot="husky:radius=0.35", people="orca", num_envs=8,
        physics=HUSKY, sensors=["goal"], ends_at="none", clearance=0.4,
    )  # fmt: skip
    touched, gap = map(torch.stack, zip(*driving(env, [0.2, 0.8], 15), strict=True))
    assert touched.any() and (touched & (gap >= 0.33)).any()
    assert not (touched & (gap > 0.75)).any()


def test_walls_stop_wheels_and_are_touched() -> None:
    touched, gap = map(torch.stack, zip(*driving(office(), [0.8, 0.8], 24), strict=True))
    assert gap.min() > 0.25
    assert touched.any(0).sum() >= 2


def test_a_mirrored_scene_has_mirrored_ways() -> None:
    """The same places of the plan; left is right, and so are the wheels."""
    env = office()
    env.reset(seed=0)
    state, physics = env.state, env.physics
    mirror = torch.tensor([[0.7, -1.0, 3.0, 2.0]]).expand(4, 4)
    ahead = torch.stack((state.heading.cos(), state.heading.sin()), -1)
    zero = move_to_scene(torch.zeros_like(ahead), mirror)
    other = put(state, move_to_scene(state.position, mirror))
    other = other._replace(pose=mirror, heading=heading_of(move_to_scene(ahead, mirror) - zero))
    command = torch.tensor([0.2, 0.6]).expand(4, 2, 2)
    moving = state.kind == ROBOT
    state = put(state, state.position)
    inputs = MotionInput(command, torch.zeros(2, 4, *moving.shape), moving, moving, 2)
    first = physics.move_owned(state, inputs)
    second = physics.move_owned(other, inputs._replace(command=command.flip(-1)))
    physics.close()
    path = first.path[:, -1].flatten(1, 2)
    torch.testing.assert_close(
        second.path[:, -1].flatten(1, 2), move_to_scene(path, mirror), atol=0.01, rtol=0
    )
    assert (path[:, -1] - state.position[:, -1]).norm(dim=-1).min() > 0.05
    turned = first.heading[:, -1] - state.heading[:, -1]
    back = second.heading[:, -1] - other.heading[:, -1]
    assert (turned > 0.02).all()
    torch.testing.assert_close(turned.sin(), -back.sin(), atol=0.02, rtol=0)
    torch.testing.assert_close(first.turn_rate[:, -1], -second.turn_rate[:, -1], atol=0.05, rtol=0)


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ("urdf=huskey.urdf", r"huskey\.urdf"),
        ("urdf=husky/husky.urdf,drive=legs", "drive legs"),
        ("drive=wheels", "urdf=husky"),
    ],
)
def test_files_and_drives_that_are_none_are_named(settings: str, message: str) -> None:
    with pytest.raises(UserError, match=message):
        make_physics(f"bullet:{settings}", MapBank(), 0.15)


def test_a_body_without_wheels_cannot_drive_by_them() -> None:
    env, state = beside([0.0, 4.0], 0.0, physics="bullet:urdf=cube.urdf,drive=wheels")
    with pytest.raises(UserError, match="no wheels on both sides"):
        driven(env, state, 0.5, 0.5)


# Cameras


def test_depths_are_those_of_a_lidar() -> None:
    """Beams at -20, 0 and 20 degrees."""
    env = pedzoo.make_robot_env(
        "goals:map=apartment.7,people=4",
        robot="unicycle",
        people="go_to_goal",
        num_envs=8,
        physics="bullet",
        sensors=["lidar:beams=3,reach=5,field_of_view=40", "camera:width=161,height=121,reach=5"],
    )
    seen = env.reset(seed=1)["robots", "observation"]
    env.physics.close()
    focal = 80.5 / math.tan(math.radians(35))
    right = round(focal * math.tan(math.radians(20)))
    # just above the horizon, where no floor is seen
    depth = seen["depth"][:, 0, 58, [80 + right, 80, 80 - right]]
    along = torch.tensor([math.cos(math.radians(20)), 1.0, math.cos(math.radians(20))])
    expected = (seen["lidar"][:, 0] * along).clamp_max(5)
    off = (depth - expected).abs()
    assert (off < 0.04).float().mean() > 0.9  # a pixel at an edge may see past it
    assert off[:, 1].max() < 0.04 and (expected < 4.5).sum() > 12


def test_a_mirrored_scene_is_seen_mirrored() -> None:
    env = pedzoo.make_robot_env(
        "goals:map=apartment.7,people=1", people="go_to_goal", sensors=["goal"], num_envs=6
    )
    env.reset(seed=3)
    people = Bodies.of(env.state)._replace(pose=torch.tensor([[0.7, -1.0, 3.0, 2.0]]).expand(6, 4))
    ahead = torch.tensor([0.4, 1.0, -2.0, 3.0, 2.0, -1.0]).unsqueeze(1)
    people = people._replace(position=move_to_scene(people.position, people.pose))
    physics = make_physics("bullet", env.bank, 0.15)
    _, depth = physics.onboard(people, ahead, Lens(101, 101, math.radians(90), 0.5, 5.0))
    angle = ahead + torch.tensor([math.atan(30 / 50.5), 0.0, -math.atan(30 / 50.5)])
    origin = people.position[:, -1:].expand(6, 3, 2)
    rays = physics.rays(people, origin, torch.stack((angle.cos(), angle.sin()), -1), 5.0)
    expected = (rays * (angle - ahead).cos()).clamp_max(5)
    off = (torch.from_numpy(depth[:, 0, 48][:, [20, 50, 80]]) - expected).abs()
    physics.close()
    assert (expected < 4).sum() > 9 and (off[expected < 4] < 0.1).float().mean() > 0.85


def test_cameras_see_people_in_place_and_floor_below_the_horizon() -> None:
    """The robot looks along y; one person is 3 m ahead, another one 2 m to the left of that one."""
    position = torch.tensor([[[0.0, 3.0], [-2.0, 3.0], [0.0, 0.0]]])
    people = Bodies(
        position, torch.ones(1, 3, dtype=torch.bool), torch.tensor([[-1]]), identity_pose(1),
        torch.tensor([[0.2, 0.2, 0.3]]),
    )  # fmt: skip
    physics = make_physics("bullet", MapBank(), 0.15)
    lens = Lens(201, 101, math.radians(90), 0.5, 8.0)
    rgb, depth = (values[0, 0] for values in physics.onboard(people, torch.tensor([[math.pi / 2]]), lens))
    assert depth[50, 100] == pytest.approx(2.8, abs=0.03)
    to_left = 100 - round(100.5 * 2 / 3)
    assert depth[50, to_left] == pytest.approx(2.83, abs=0.07) and depth[50, 200 - to_left] == 8
    first, second = rgb[50, 100].astype(int), rgb[50, to_left].astype(int)
    assert first.argmax() == 0 and second.argmax() == 2  # red and blue
    assert rgb[100, 180].tolist() == list(FLOOR) and rgb[0, 180].tolist() == list(OUTSIDE)
    # 50 rows below the horizon: 0.5 m * 100.5 / 50
    assert depth[100, 180] == pytest.approx(1.005, abs=1e-3)
    gone = people._replace(mask=torch.tensor([[True, True, False]]))
    assert not np.any(physics.onboard(gone, torch.zeros(1, 1), lens)[1])
    physics.close()


def test_other_backends_say_which_one_has_a_camera() -> None:
    env = pedzoo.make_robot_env("circle:people=2", people="go_to_goal", sensors=["camera"])
    with pytest.raises(UserError, match="physics='bullet'"):
        env.reset()
