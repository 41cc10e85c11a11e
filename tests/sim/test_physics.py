"""What all backends answer: against formulas, against one another, and when something is wrong."""

import gc
import importlib.util
import math
import os
import pickle
import subprocess
import sys
import weakref
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import torch
from torch import Tensor

from pedzoo.core.errors import UserError
from pedzoo.core.geometry import direction_of, identity_pose, move_to_scene
from pedzoo.core.machine import usual_physics
from pedzoo.eval.suite import EvaluationOptions
from pedzoo.eval.suites.scenes import Door
from pedzoo.maps.bank import MapBank
from pedzoo.maps.grid import OccupancyGrid, boxes
from pedzoo.sim.drawing import (
    FLOOR,
    WALL,
    Camera,
    as_array,
    headings_along,
    moved,
    person_color,
    scene_to_grid,
)
from pedzoo.sim.make import make_env
from pedzoo.sim.physics import _pybullet
from pedzoo.sim.physics._base import Bodies, Physics
from pedzoo.sim.physics.bullet import Bullet
from pedzoo.sim.physics.compiled import Compiled
from pedzoo.sim.physics.torch import Torch
from pedzoo.sim.robots.env import make_robot_env
from pedzoo.train.validation import ClosedLoopValidation

RADIUS, RADII = 0.15, torch.tensor([[0.15, 0.5, 0.25]])

ANSWERS = pytest.mark.parametrize("kind", [Torch, Compiled])
"""Of contacts and rays; those of `Bullet` are those of `Compiled`."""


@pytest.fixture(params=[Torch, Bullet])
def draws(request) -> type[Physics]:
    if request.param is Bullet:
        pytest.importorskip("pybullet")
    return request.param


def hall(name: str = "hall", **options: object) -> OccupancyGrid:
    """6 x 4 m behind 0.2 m walls, a wall with a door 1 m wide at x = 3.2, a pillar of 0.4 m at (1.8, 1.2)."""
    cells = np.zeros((44, 64), dtype=np.uint8)
    cells[:2], cells[-2:], cells[:, :2], cells[:, -2:] = 1, 1, 1, 1
    cells[2:17, 31:33], cells[27:42, 31:33] = 1, 1
    cells[10:14, 16:20] = 1
    return OccupancyGrid(cells, 0.1, name=name, **options)  # type: ignore[arg-type]


def crowd(
    position: Tensor,
    grid: OccupancyGrid | None = None,
    mask: Tensor | None = None,
    pose: Tensor | None = None,
) -> Bodies:
    """People at scene positions (B, A, 2), all scenes on one floor plan."""
    scenes = len(position)
    mask = torch.ones(position.shape[:2], dtype=torch.bool) if mask is None else mask
    map_id = torch.full((scenes, 1), grid.map_id if grid else -1)
    return Bodies(position, mask, map_id, identity_pose(scenes) if pose is None else pose)


def walks(start: Tensor, seed: int, trace: int = 4, steps: int = 4) -> Tensor:
    """Straight paths (B, A, S, M, 2) of 0.4 s at 1.3 m/s in random directions."""
    angle = torch.rand(start.shape[:2], generator=torch.Generator().manual_seed(seed)) * 2 * math.pi
    time = torch.arange(1, trace * steps + 1).view(1, 1, trace, steps, 1) / (trace * steps)
    return start[:, :, None, None] + 1.3 * 0.4 * direction_of(angle)[:, :, None, None] * time


@pytest.mark.parametrize(("scenes", "people"), [(40, 5), (1, 150), (3, 1), (2, 0), (6, 3)])
def test_contacts_are_as_defined(scenes: int, people: int) -> None:
    """Bodies of all widths, also outside the map and on the walls themselves: no shortcut changes any."""
    generator = torch.Generator().manual_seed(0)
    grid = hall(origin=(1.0, -2.0, 0.4))
    bank = MapBank([grid, hall("other")], "wall")
    pose = torch.tensor([[0.3, -1.0, 2.0, 1.0]]).repeat(scenes, 1)
    position = torch.rand(scenes, people, 2, generator=generator) * 8 - 1
    position = move_to_scene(position + torch.tensor([1.0, -2.0]), pose)
    mask = torch.rand(scenes, people, generator=generator) < 0.8
    radius = 0.1 + 0.1 * torch.rand(scenes, people, generator=generator)
    crowded, path = crowd(position, grid, mask, pose)._replace(radius=radius), walks(position, seed=1)
    result = Compiled(bank).contacts(path, crowded)
    apart = (path.unsqueeze(2) - path.unsqueeze(1)).norm(dim=-1)  # (B, A, A, S, M)
    touch = apart < (radius.unsqueeze(2) + radius.unsqueeze(1))[..., None, None]
    both = mask.unsqueeze(1) & mask.unsqueeze(2) & ~torch.eye(people, dtype=torch.bool)
    assert torch.equal(result.agent, (touch.any(-1) & both.unsqueeze(-1)).any(2))
    gap, _ = bank.closest_wall(path, crowded.map_id[:, 0], pose)
    assert torch.equal(result.wall, (gap < radius[..., None, None]).any(-1) & mask.unsqueeze(-1))
    if people > 3:
        assert 0 < result.agent.float().mean() < 0.9 and 0 < result.wall.float().mean() < 0.9


@pytest.mark.parametrize("mirror", [1.0, -1.0])
@pytest.mark.parametrize("yaw", [0.0, 0.7])
def test_the_backends_agree_on_plain_geometry(yaw: float, mirror: float) -> None:
    """Walls are where pybullet has them: of its own boxes, its ray test and its closest points."""
    pytest.importorskip("pybullet")
    grid, generator = hall(origin=(1.0, -2.0, yaw)), torch.Generator().manual_seed(1)
    position = torch.rand(12, 8, 2, generator=generator, dtype=torch.float64) * torch.tensor([6.4, 4.4])
    c, s = math.cos(yaw), math.sin(yaw)
    position = position @ torch.tensor([[c, s], [-s, c]], dtype=torch.float64) + torch.tensor([1.0, -2.0])
    pose = torch.tensor([[2.1, mirror, 3.0, -1.0]] * 11 + [[0.0, 1.0, 0.0, 0.0]])
    mask = torch.rand(12, 8, generator=generator) < 0.9
    people = crowd(move_to_scene(position, pose).float(), grid, mask, pose)
    people.map_id[5] = -1
    bank = MapBank([hall("other"), grid], "wall")
    physics, path = Torch(bank), walks(people.position, 2, trace=2, steps=1)
    direction = direction_of(torch.arange(16) * (2 * math.pi / 16) + 0.03).repeat(8, 1).expand(12, -1, -1)
    origin = people.position.repeat_interleave(16, dim=1)
    alone = people._replace(mask=torch.zeros_like(people.mask))
    ours, touches = physics.rays(alone, origin, direction, 4.0), physics.contacts(path, people).wall
    # a ray that grazes something may just miss it: then it hits at one side of itself and not at the other
    side = 2e-3 * torch.stack((-direction[..., 1], direction[..., 0]), -1)
    left, right = (physics.rays(alone, origin + sign * side, direction, 4.0) for sign in (1, -1))
    grazing = (left - ours).abs().maximum((right - ours).abs()) > 0.02
    assert grazing.float().mean() < 0.15
    gap = bank.closest_wall(path[:, :, :, 0], people.map_id[:, 0], people.pose)[0]
    clear = ((gap - RADIUS).abs() > 1e-4) & people.mask.unsqueeze(-1)
    for scene, scene_pose in enumerate(people.pose):
        plan = bank.grid(people.map_id[scene])
        frame, client = scene_to_grid(scene_pose, plan), _pybullet.connect()
        walls = _pybullet.build_walls(client, boxes(plan, bank.unknown) if plan else np.zeros((0, 4)), 2.5)
        starts, ends = (
            np.pad(moved(frame, as_array(points)), ((0, 0), (0, 1)), constant_values=1.0)
            for points in (origin[scene], origin[scene] + 4.0 * direction[scene])
        )
        free = bank.closest_wall(origin[[scene]], people.map_id[scene], people.pose[[scene]])[0][0] > 0
        theirs = torch.tensor([4.0 * hit[2] for hit in client.rayTestBatch(starts, ends)])
        sure = ~grazing[scene] & free
        torch.testing.assert_close(ours[scene][sure], theirs[sure].to(ours), atol=5e-3, rtol=0)
        height = {"radius": RADIUS, "height": 1.75 - 2 * RADIUS}
        body = client.createMultiBody(0, client.createCollisionShape(client.GEOM_CAPSULE, **height))
        for at in clear[scene].nonzero().tolist():
            place = moved(frame, as_array(path[(scene, *at, 0)]))
            client.resetBasePositionAndOrientation(body, (*place, 0.875), _pybullet.UPRIGHT)
            near = [point[8] for wall in walls for point in client.getClosestPoints(body, wall, RADIUS)]
            assert touches[(scene, *at)] == (min(near, default=1.0) < 0)
        _pybullet.disconnect(client)


@ANSWERS
def test_rays_by_hand(kind: type[Physics]) -> None:
    """The other's body; the wall, past the own body; the first body from outside; a wall; nothing; none."""
    grid, nan = hall(), math.nan
    people = crowd(
        torch.tensor([[[1.0, 3.0], [2.0, 3.0], [1.5, 3.0]]]), grid, torch.tensor([[True, True, False]])
    )
    origin = torch.tensor([[[1.0, 3.0], [1.0, 3.0], [0.5, 3.0], [0.1, 3.0], [1.0, 3.0], [nan, 3.0]]])
    direction = torch.tensor([[[1.0, 0], [-1, 0], [1, 0], [1, 0], [0, -1], [1, 0]]])
    result = kind(MapBank([grid], "wall")).rays(people, origin, direction, reach=2.5)
    assert result[0].tolist() == pytest.approx([0.85, 0.8, 0.35, 0.0, 2.5, 2.5], abs=2e-4)
    # bodies that overlap, and rays from within both
    people = crowd(torch.tensor([[[0.0, 0.0], [0.2, 0.0], [1.0, 0.0]]]))
    origin = torch.tensor([[[0.1, 0.0], [0.0, 0.0], [-0.05, 0.0], [1.0, 0.0]]])
    direction = torch.tensor([[[1.0, 0.0], [1, 0], [1, 0], [-1, 0]]])
    result = kind(MapBank()).rays(people, origin, direction)
    assert result[0].tolist() == pytest.approx([0.75, 0.05, 0.1, 0.65], abs=2e-4)
    # the wide body ahead, that of 0.25 m to the left, a chord of the wide one, out of it, and from below
    people = crowd(torch.tensor([[[0.0, 0.0], [3.0, 0.0], [0.0, 2.0]]]))
    origin = torch.tensor([[[0.0, 0.0], [0.0, 0.0], [1.5, 0.3], [3.3, 0.0], [3.0, -2.0]]])
    direction = torch.tensor([[[1.0, 0.0], [0.0, 1.0], [1.0, 0.0], [1.0, 0.0], [0.0, 1.0]]])
    result = kind(MapBank()).rays(people._replace(radius=RADII), origin, direction, 4.0)
    assert result[0].tolist() == pytest.approx([2.5, 1.75, 1.5 - 0.4, 4.0, 1.5], abs=2e-3)


@ANSWERS
@pytest.mark.parametrize("count", [0, 1])
def test_open_floor_without_people(kind: type[Physics], count: int) -> None:
    people, physics = crowd(torch.zeros(2, count, 2)), kind(MapBank())
    contacts = physics.contacts(torch.zeros(2, count, 4, 1, 2), people)
    assert contacts.agent.shape == contacts.wall.shape == (2, count, 4)
    assert not contacts.agent.any() and not contacts.wall.any()
    assert physics.rays(people, torch.zeros(2, 0, 2), torch.zeros(2, 0, 2)).shape == (2, 0)


@ANSWERS
def test_absent_and_lost_agents_disturb_no_others(kind: type[Physics]) -> None:
    grid, generator = hall(), torch.Generator().manual_seed(5)
    position = torch.rand(3, 6, 2, generator=generator) * torch.tensor([5.0, 3.0]) + 0.5
    mask = torch.rand(3, 6, generator=generator) < 0.7
    broken = position.clone()
    broken[~mask] = 1e6
    broken[1] = math.nan
    broken[~mask][::2] = math.inf
    direction, physics, answers = torch.tensor([1.0, 0.0]).expand(3, 6, 2), kind(MapBank([grid], "wall")), []
    for places in (position, broken):
        people = crowd(places, grid, mask)
        contacts = physics.contacts(places[:, :, None, None].repeat(1, 1, 2, 2, 1), people)
        answers.append((*contacts, physics.rays(people, position, direction)))
    for whole, partly in zip(*answers, strict=True):
        assert torch.equal(whole[[0, 2]], partly[[0, 2]])
    for lost in (torch.tensor([[False], [True], [False]]) & mask, ~mask):
        assert not any(part[lost].any() for part in answers[1][:2])


def test_a_body_without_extent_is_refused() -> None:
    with pytest.raises(UserError, match="body_radius 0"):
        Torch(MapBank(), body_radius=0)


def color_at(picture: np.ndarray, camera: Camera, x: float, y: float) -> np.ndarray:
    height, width, _ = picture.shape
    column, row = moved(camera.to_pixel((width, height)), np.array((x, y)))
    return picture[round(row), round(column)].astype(int)


@pytest.mark.parametrize("pose", [(0.0, 1.0, 0.0, 0.0), (0.4, -1.0, 2.0, 1.0)])
def test_pictures_show_people_and_walls_in_place(draws: type[Physics], pose: tuple[float, ...]) -> None:
    grid = hall(origin=(0.5, 0.5, 0.3))
    poses = torch.tensor([pose])
    hall_to_map = torch.tensor([[math.cos(0.3), math.sin(0.3)], [-math.sin(0.3), math.cos(0.3)]])
    in_hall = torch.tensor([[[1.0, 3.4], [2.6, 1.2], [5.0, 2.0], [1.8, 1.2]]])
    *places, pillar = move_to_scene(in_hall @ hall_to_map + 0.5, poses).unbind(1)
    places = torch.stack(places, 1)
    heading = torch.tensor([[0.5, -2.0, 0.0]])
    people = crowd(places, grid, torch.tensor([[True, True, False]]), poses)._replace(heading=heading)
    camera = Camera().around(places, size=(480, 360), margin=1.5)
    ahead = direction_of(heading[0])
    # shoulders lie across where people face
    left = places[0] + 0.17 * torch.stack((-ahead[:, 1], ahead[:, 0]), 1)
    picture = draws(MapBank([grid], "wall")).image(people, 0, (480, 360), camera)
    assert picture.shape == (360, 480, 3) and picture.dtype == np.uint8
    for place, expected in zip(left.tolist(), (person_color(0), person_color(1), FLOOR), strict=True):
        shade = np.abs(color_at(picture, camera, *place) - expected).max()
        assert shade < (80 if draws is Bullet else 60)
    for head, to in zip(places[0, :2], ahead, strict=False):
        face, hair = (color_at(picture, camera, *(head + step * to).tolist()) for step in (0.08, -0.08))
        assert draws is Bullet or face.sum() > hair.sum() + 100  # Bullet sees heads obliquely
    assert np.abs(color_at(picture, camera, *pillar[0].tolist()) - WALL).max() < 40


@pytest.mark.parametrize("camera", [None, Camera("perspective")])
def test_pictures_of_everything_by_default(draws: type[Physics], camera: Camera | None) -> None:
    grid = hall()
    people, physics = crowd(torch.tensor([[[1.0, 3.0], [5.0, 1.0]]]), grid), draws(MapBank([grid], "wall"))
    for seen in (people, people._replace(map_id=torch.tensor([[-1]]))):
        picture = physics.image(seen, 0, (200, 150), camera)
        for person in (0, 1):
            assert (np.abs(picture.astype(int) - person_color(person)).max(-1) < 60).sum() > 10
    assert physics.image(crowd(torch.zeros(1, 0, 2)), 0, (64, 48)).shape == (48, 64, 3)


def test_a_closed_physics_and_a_lost_client_say_what_to_do() -> None:
    """And clients go with their physics."""
    pytest.importorskip("pybullet")
    people = crowd(torch.zeros(1, 2, 2))

    def opened() -> tuple[Bullet, Any]:
        physics = Bullet(MapBank())
        physics.image(people, 0, (32, 24))
        (looks,) = physics._clients.values()
        assert looks.client.isConnected()
        return physics, looks.client

    physics, client = opened()
    for _ in range(2):
        physics.close()
    assert not client.isConnected()
    with pytest.raises(UserError, match="was closed: make a new one"):
        physics.image(people, 0, (32, 24))
    physics, client = opened()
    client.disconnect()
    with pytest.raises(UserError, match=r"client .* is gone.*make a new Bullet"):
        physics.image(people, 0, (32, 24))
    physics, client = opened()
    gone = weakref.ref(client)
    del physics, client
    gc.collect()
    assert gone() is None


def test_without_pybullet_the_error_says_how_to_get_it(monkeypatch) -> None:
    monkeypatch.setitem(sys.modules, "pybullet", None)
    with pytest.raises(UserError, match=r"pip install .*\[bullet\]'.*3\.11.*physics='compiled'"):
        Bullet(MapBank())


def test_backends_can_be_pickled_before_and_after_use(draws: type[Physics]) -> None:
    grid = hall()
    people, physics = crowd(torch.tensor([[[1.0, 3.0], [5.0, 1.0]]]), grid), draws(MapBank([grid], "wall"))
    for _ in range(2):
        copy = pickle.loads(pickle.dumps(physics))
        assert np.array_equal(physics.image(people, 0, (32, 24)), copy.image(people, 0, (32, 24)))
        copy.close()


def test_pybullet_prints_nothing() -> None:
    """Also where a client is left to the end of the process."""
    pytest.importorskip("pybullet")
    code = (
        "import torch; from pedzoo.maps.bank import MapBank; "
        "from pedzoo.sim.physics._base import Bodies; "
        "from pedzoo.core.geometry import identity_pose; from pedzoo.sim.physics.bullet import Bullet; "
        "mask, map_id = torch.ones(1, 2).bool(), torch.full((1, 1), -1); "
        "people = Bodies(torch.zeros(1, 2, 2), mask, map_id, identity_pose(1)); "
        "Bullet(MapBank()).image(people, 0, (32, 24)); "
        "physics = Bullet(MapBank()); physics.image(people, 0, (32, 24))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert (done.stdout, done.stderr) == ("", "")


def test_people_face_where_they_go_and_keep_it_while_they_stand() -> None:
    """One stands for 1 s, walks along y at 1 m/s for 2 s and stands; another one is nowhere at first."""
    y = torch.cat((torch.zeros(10), torch.linspace(0, 2, 21), torch.full((10,), 2.0)))
    way = torch.stack((torch.zeros(41), y), 1)
    late = torch.where(torch.arange(41).unsqueeze(1) < 20, torch.nan, way.flip(1))
    heading = headings_along(torch.stack((way, late)))
    assert torch.allclose(heading[0], torch.tensor(math.pi / 2))
    assert torch.allclose(heading[1], torch.tensor(0.0))


def test_looking_for_a_gpu_runs_no_code_of_the_working_directory(elsewhere, monkeypatch) -> None:
    pytest.importorskip("pybullet")
    Path("pybullet.py").write_text("open('it ran', 'w').close()")
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: SimpleNamespace(origin="no plugin"))
    monkeypatch.setattr(Path, "exists", lambda self: True)  # a device
    assert _pybullet.egl_plugin.__wrapped__() is None
    assert os.listdir() == ["pybullet.py"]


def test_one_setting_names_the_physics_of_all_environments(monkeypatch) -> None:
    monkeypatch.delenv("PEDZOO_PHYSICS", raising=False)
    usual = usual_physics()
    assert usual == ("bullet" if importlib.util.find_spec("pybullet") else "compiled")
    assert type(make_env("door").physics) is Compiled and ClosedLoopValidation().physics == "compiled"
    monkeypatch.setenv("PEDZOO_PHYSICS", "torch")
    assert usual_physics() == usual_physics(fast=True) == ClosedLoopValidation().physics == "torch"
    assert type(make_env("door").physics) is Torch is type(make_robot_env("door").physics)
    assert type(make_env("door", physics="compiled").physics) is Compiled
    assert [case.physics for case in Door("door").cases(EvaluationOptions())] == ["torch"]
    monkeypatch.setenv("PEDZOO_PHYSICS", "bulet")
    with pytest.raises(UserError, match="unknown physics 'bulet': did you mean 'bullet'"):
        make_env("door")
