"""The camera of robots: depths against a lidar, and colours against known places."""

import math

import numpy as np
import pytest
import torch

import pedzoo
from pedzoo.core.errors import UserError
from pedzoo.core.geometry import identity_pose, move_to_scene
from pedzoo.maps.bank import MapBank
from pedzoo.sim.drawing import FLOOR, OUTSIDE, Lens
from pedzoo.sim.make import make_physics
from pedzoo.sim.physics._base import Bodies

pytest.importorskip("pybullet")


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
