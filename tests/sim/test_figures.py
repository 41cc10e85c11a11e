"""How people stand in pictures: where they face and step."""

from __future__ import annotations

import importlib.util
import math
import os
from pathlib import Path
from types import SimpleNamespace

import pytest
import torch

from pedzoo.core.batch import PERSON, ROBOT
from pedzoo.sim.physics_parts.bullet import client
from pedzoo.sim.physics_parts.bullet.figure import PARTS, SHIN, STRIDE, THIGH, gait, lofted
from pedzoo.sim.physics_parts.stance import Stance


def test_people_face_where_they_go_and_keep_it_while_they_stand() -> None:
    """One stands for 1 s, walks along y at 1 m/s for 2 s and stands; another one is nowhere at first."""
    y = torch.cat((torch.zeros(10), torch.linspace(0, 2, 21), torch.full((10,), 2.0)))
    way = torch.stack((torch.zeros(41), y), 1)
    late = torch.where(torch.arange(41).unsqueeze(1) < 20, torch.nan, way.flip(1))
    stance = Stance.along(torch.stack((way, late)), torch.tensor([PERSON, ROBOT]))
    assert torch.allclose(stance.heading[:, 0], torch.tensor(math.pi / 2))
    assert torch.allclose(stance.heading[:, 1], torch.tensor(0.0))
    assert torch.allclose(stance.walked[:, 0], y, atol=1e-5)
    assert stance.speed[20, 0] == pytest.approx(1.0) and stance.speed[[0, 40], 0].tolist() == [0, 0]
    assert stance.walked.isfinite().all() and stance.robot[7].tolist() == [False, True]


def test_legs_step_by_the_way_and_one_foot_is_on_the_floor() -> None:
    for part in range(8):
        (left, right), knees, hips = gait(part / 8 * STRIDE, 1.3)
        feet = [
            hips - THIGH * math.cos(hip) - SHIN * math.cos(hip - knee)
            for hip, knee in zip((left, right), knees, strict=True)
        ]
        assert left == -right and min(feet) == pytest.approx(0) and max(feet) < 0.3
        half = gait((part / 8 + 0.5) * STRIDE, 1.3)
        assert half[0] == pytest.approx((right, left)) and half[1] == pytest.approx(knees[::-1], abs=1e-9)
    assert gait(0.3, 0.0) == ((0.0, 0.0), (0.0, 0.0), THIGH + SHIN)


def test_surfaces_are_closed_and_look_outwards() -> None:
    for part in PARTS:
        corners, triangles, normals = lofted(part.rings)
        faces = torch.tensor(triangles).view(-1, 3)
        edges = torch.cat((faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]])).tolist()
        assert sorted(edges) == sorted([end, start] for start, end in edges)  # each once in both directions
        points, outward = torch.tensor(corners), torch.tensor(normals)
        assert (outward.norm(dim=1) - 1).abs().max() < 1e-5
        first, second, third = points[faces].unbind(1)
        volume = (first * torch.linalg.cross(second, third)).sum() / 6
        assert volume > 0


def test_looking_for_a_gpu_runs_no_code_of_the_working_directory(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("pybullet")
    monkeypatch.chdir(tmp_path)
    Path("pybullet.py").write_text("open('it ran', 'w').close()")
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: SimpleNamespace(origin="no plugin"))
    monkeypatch.setattr(Path, "exists", lambda self: True)  # a device
    assert client.egl_plugin.__wrapped__() is None
    assert os.listdir() == ["pybullet.py"]
