"""The camera of robots: depths against a lidar, and colours against known places."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch

import pedzoo
from pedzoo.core.errors import UserError
from pedzoo.core.geometry import identity_pose
from pedzoo.maps.bank import MapBank
from pedzoo.sim.make import make_physics
from pedzoo.sim.physics_parts.base import Bodies
from pedzoo.sim.physics_parts.camera import FLOOR, OUTSIDE, Lens

pytest.importorskip("pybullet")


def test_depths_are_those_of_a_lidar() -> None:
    """Beams at -20, 0 and 20 degrees, in scenes that are turned and mirrored."""
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


def test_people_are_seen_where_they_are_and_the_floor_below_the_horizon() -> None:
    """The robot looks along y; one person is 3 m ahead, another one 2 m to the left of that one."""
    position = torch.tensor([[[0.0, 3.0], [-2.0, 3.0], [0.0, 0.0]]])
    people = Bodies(
        position, torch.ones(1, 3, dtype=torch.bool), torch.tensor([[-1]]), identity_pose(1),
        torch.tensor([[0.2, 0.2, 0.3]]),
    )  # fmt: skip
    physics = make_physics("bullet", MapBank(), 0.15)
    lens = Lens(201, 101, math.radians(90), 0.5, 8.0)
    rgb, depth = (values[0, 0] for values in physics.onboard(people, torch.tensor([[math.pi / 2]]), lens))
    assert depth[50, 100] == pytest.approx(2.8, abs=0.02)
    to_left = 100 - round(100.5 * 2 / 3)
    assert depth[50, to_left] == pytest.approx(2.83, abs=0.05) and depth[50, 200 - to_left] == 8
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
