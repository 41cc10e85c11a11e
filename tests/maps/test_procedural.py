"""Floor plans from seeds: sound, passable, the same everywhere, and usable by name."""

import json
import os
import subprocess
import sys
from functools import cache

import cv2
import numpy as np
import pytest
from scipy.ndimage import distance_transform_edt, find_objects, label

import pedzoo
from pedzoo.cli.main import main
from pedzoo.core.errors import UserError
from pedzoo.data.datamodule import TrajectoryDataModule
from pedzoo.eval.comparison import row
from pedzoo.eval.rollout import rollout
from pedzoo.maps.formats import read_plan, write_ros
from pedzoo.maps.grid import FREE, OCCUPIED, OccupancyGrid
from pedzoo.maps.planning.graph import OpenGraph
from pedzoo.maps.plans import flat, load_plan
from pedzoo.maps.procedural import KINDS, FloorPlan, generate, is_connected
from pedzoo.maps.shapes import UNIT, Rect

SEEDS = {"apartment": range(20), "office": range(10)}
EVERY_KIND = pytest.mark.parametrize("kind", KINDS)

DIGESTS = {
    "apartment": "a63138d75e59d692 23460fff0e122549 92fd2eb1156a3d96 5a29fe2c347d98a3".split(),
    "office": "1b2f362d936332bd d324f7cb732a97d1 571e6c5424d047db 2b2b84a5f48aedff".split(),
}
"""The first 16 digits for seeds 0, 1, 7 and 29: plans of old seeds must never change."""


@cache
def plans(kind: str) -> list[FloorPlan]:
    return [generate(kind, seed) for seed in SEEDS[kind]]


def cells_of(plan: FloorPlan, rect: Rect) -> np.ndarray:
    return plan.grid.cells[rect.y0 : rect.y1, rect.x0 : rect.x1]


@EVERY_KIND
def test_all_free_space_is_one_for_the_planner(kind: str) -> None:
    for plan in plans(kind):
        # between centres of cells; the nearest wall begins half a cell before its centre
        is_open = np.asarray(distance_transform_edt(plan.grid.cells == FREE)) >= 0.25 / 0.05 + 0.5
        assert label(is_open)[1] == 1  # type: ignore[index]
        for x0, y0, x1, y1 in (*(r.box for r in plan.rooms), *(door.opening for door in plan.doors)):
            assert is_open[y0:y1, x0:x1].any()
        if plan.seed % 9 == 0:
            graph = OpenGraph(plan.grid, "wall", 0.25)
            assert (graph.open == is_open).all()  # no pocket was left out
            assert graph.component.max() == 0


def test_what_is_not_connected_is_seen() -> None:
    cells = np.full((40, 40), OCCUPIED, dtype=np.uint8)
    cells[2:38, 2:18] = cells[2:38, 20:38] = FREE
    assert not is_connected(OccupancyGrid(cells, 0.05), 0.25)
    cells[10:20, 18:20] = FREE  # 0.5 m wide: no centre of a cell is 0.25 m from both sides
    assert not is_connected(OccupancyGrid(cells, 0.05), 0.25)
    cells[10:21, 18:20] = FREE
    assert is_connected(OccupancyGrid(cells, 0.05), 0.25)
    assert not is_connected(OccupancyGrid(np.full_like(cells, OCCUPIED), 0.05), 0.25)


def test_doors_measured_on_the_grid() -> None:
    widths = []
    for kind, seed in (*(("apartment", seed) for seed in range(20)), ("office", 0), ("office", 1)):
        bare = generate(kind, seed, furnished=0.0)
        openings = bare.grid.cells == FREE
        for room in bare.rooms:
            for x0, y0, x1, y1 in room.parts:
                openings[y0:y1, x0:x1] = False
        # whatever is free and in no room leads through a wall
        result, count = label(openings)  # type: ignore[misc]
        assert count == len(bare.doors)
        for place in find_objects(result):
            assert openings[place].all()
            thickness, width = sorted(openings[place].shape)
            assert thickness * UNIT == pytest.approx(0.1)
            widths.append(width * UNIT)
    assert 0.7 - 1e-9 <= min(widths) < 0.75 and 1.4 < max(widths) <= 1.5 + 1e-9
    assert len({round(width, 2) for width in widths}) > 10


@EVERY_KIND
def test_furniture_doors_and_walls(kind: str) -> None:
    """Nothing stands before a door; doors lead to every room, some ways in loops; walls have a thickness."""
    loops, thick = 0, set()
    for plan in plans(kind):
        for door in plan.doors:
            assert (cells_of(plan, door.ahead(18)) == FREE).all()  # 0.9 m on both sides
        for piece in plan.pieces:
            assert (cells_of(plan, piece.rect) == OCCUPIED).all()
            assert any(part.holds(piece.rect) for room in plan.rooms for part in room.parts)
        reached, grew = {0}, True
        while grew:
            beside = {i for door in plan.doors if reached & set(door.rooms) for i in door.rooms}
            grew = not beside <= reached
            reached |= beside
        assert len(reached) == len(plan.rooms)
        loops += len(plan.doors) - len(plan.rooms) + 1
        free = np.argwhere(plan.grid.cells == FREE)
        low, high = free.min(axis=0), plan.grid.cells.shape - free.max(axis=0) - 1
        assert low[0] == low[1] == high[0] == high[1]
        thick.add(int(low[0]))
    assert loops > len(plans(kind)) / 4
    assert thick == {2, 3, 4}
    assert plans(kind)[0].grid.origin == (0.0, 0.0, 0.0)


def test_apartments_are_apartments() -> None:
    counts = set()
    for plan in plans("apartment"):
        hall, *rooms = plan.rooms
        assert hall.use == "hall" and all(1.2 <= part.short * UNIT <= 1.7 + 1e-9 for part in hall.parts)
        counts.add(len(rooms))
        assert all(8 <= side <= 14 for side in plan.size)
        assert all(room.box.short * UNIT >= 2.0 - 1e-9 for room in rooms)
        uses = [room.use for room in rooms]
        assert {"living", "kitchen", "bathroom"} <= set(uses)
    assert counts == {4, 5, 6, 7}


def test_offices_are_offices() -> None:
    for plan in plans("office"):
        corridor, *rooms = plan.rooms
        assert corridor.use == "corridor"
        assert all(1.2 <= part.short * UNIT <= 2.4 + 1e-9 for part in corridor.parts)
        width, height = plan.size
        assert 20 <= width <= 40 and 12 <= height <= 25
        assert len(rooms) >= 5 and all(room.box.short * UNIT >= 2.0 for room in rooms)
        assert any(room.use == "open_plan" for room in rooms)


@EVERY_KIND
def test_seeds_differ_and_one_seed_is_one_plan_in_every_process(kind: str) -> None:
    digests = [plan.grid.digest for plan in plans(kind)]
    assert len(set(digests)) == len(digests)
    assert [*(digests[seed][:16] for seed in (0, 1, 7)), generate(kind, 29).grid.digest[:16]] == DIGESTS[kind]
    code = f"from pedzoo.maps.procedural import generate\nprint(generate({kind!r}, 5).grid.digest)"
    other = subprocess.check_output([sys.executable, "-c", code], env=os.environ | {"PYTHONHASHSEED": "7"})
    assert other.decode().strip() == digests[5]


@EVERY_KIND
def test_furniture_and_resolution_leave_the_rooms_as_they_are(kind: str) -> None:
    full = plans(kind)[3]
    bare, some = generate(kind, 3, furnished=0.0), generate(kind, 3, furnished=0.4)
    assert bare.rooms == some.rooms == full.rooms and bare.doors == full.doors
    assert 0 == len(bare.pieces) < len(some.pieces) < len(full.pieces)
    assert bare.facts()["free_m2"] > some.facts()["free_m2"] > full.facts()["free_m2"]
    assert ((full.grid.cells == OCCUPIED) | (bare.grid.cells == FREE)).all()
    assert (bare.grid.name, full.grid.name) == (f"{kind}.3.bare", f"{kind}.3")
    fine = generate(kind, 3, resolution=0.025)
    assert (fine.grid.cells == np.kron(full.grid.cells, np.ones((2, 2)))).all()
    assert fine.size == full.size and is_connected(fine.grid, 0.25)


def test_a_grid_that_is_too_fine_for_a_plan_is_refused() -> None:
    # two of its 1 cm cells keep 0.25 m from what is all around them
    with pytest.raises(UserError, match=r"apartment.105: at resolution 0.01 some cells are cut off"):
        generate("apartment", 105, resolution=0.01)


SIZES = {"apartment": [(7, 7), (16, 7.5), (16, 16)], "office": [(12, 12), (12, 30), (45, 41)]}


@EVERY_KIND
@pytest.mark.parametrize("width", [0.7, 1.5])
def test_sizes_and_narrow_and_wide_doors(kind: str, width: float) -> None:
    for size in SIZES[kind]:
        plan = generate(kind, 1, size=size, doors=(width, width))
        assert plan.size == pytest.approx(size)
        assert {round(door.width, 6) for door in plan.doors} == {width}
        assert is_connected(plan.grid, 0.25)


@pytest.mark.parametrize(
    ("kind", "options", "message"),
    [
        ("apartmnt", {}, "unknown kind of floor plan 'apartmnt': did you mean 'apartment'"),
        ("office", {"seed": -1}, "seed -1: expected a whole number"),
        ("office", {"seed": 1.5}, "seed 1.5: expected a whole number"),
        ("apartment", {"size": (6, 9)}, r"size \(6, 9\): expected width and height from 7 to 16 m"),
        ("office", {"size": (20,)}, "expected width and height from 12 to 60"),
        ("office", {"furnished": 1.5}, r"furnished 1.5: expected 0 \(bare\) to 1"),
        ("office", {"furnished": float("nan")}, "furnished nan"),
        ("office", {"doors": (0.6, 1.0)}, r"doors \(0.6, 1.0\): expected .* from 0.7 to 1.5 m"),
        ("office", {"doors": (1.0, 0.8)}, "doors"),
        ("office", {"resolution": 0.1}, "resolution 0.1: expected 0.05 m per cell or a whole part"),
        ("office", {"resolution": 0.02}, "such as 0.025 or 0.01"),
        ("office", {"resolution": 0.0}, "resolution 0.0"),
    ],
)
def test_bad_settings_are_named(kind: str, options: dict, message: str) -> None:
    with pytest.raises(UserError, match=message):
        generate(kind, **{"seed": 0, **options})


def test_plans_by_name_and_file(tmp_path) -> None:
    assert load_plan("flat").digest == flat().digest
    assert load_plan("apartment.5").digest == plans("apartment")[5].grid.digest
    bare = load_plan("office.2.bare")
    assert bare.digest == generate("office", 2, furnished=0.0).grid.digest != load_plan("office.2").digest
    for plan in (plans("apartment")[0], plans("office")[0]):
        file = tmp_path / f"{plan.grid.name}.yaml"
        write_ros(plan.grid, file)
        again = load_plan(file)
        assert (again.digest, again.name) == (plan.grid.digest, plan.grid.name)
        assert load_plan(str(file)).map_id == plan.grid.map_id


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("apartmnt.3", "unknown floor plan 'apartmnt.3': did you mean 'apartment.3'.*office.SEED.* ROS map"),
        ("ofice.12.bare", "did you mean 'office.12.bare'"),
        ("office", r"did you mean 'office.7'"),
        ("flatt", "did you mean 'flat'"),
        ("castle", "unknown floor plan 'castle': known: flat, apartment.SEED, office.SEED"),
        ("plans/office", "expected a ROS map yaml or an image"),
        ("office.7.yaml", "no map file 'office.7.yaml'"),
    ],
)
def test_unknown_names_are_helped(name: str, message: str) -> None:
    with pytest.raises(UserError, match=message):
        load_plan(name)


def test_a_controller_and_a_datamodule_take_a_name(tmp_path) -> None:
    graph = OpenGraph(plans("apartment")[3].grid, "wall", 0.25)
    start, goal = graph.xy[0], graph.xy[-1]
    controller = pedzoo.controller("constant_velocity", "apartment.3")
    velocity = controller.step({"anna": start}, {"anna": goal})["anna"]
    assert np.linalg.norm(velocity) == pytest.approx(1.3, abs=1e-3)

    rows = [f"{frame},{agent},{frame / 4},{agent}" for frame in range(80) for agent in (1, 2)]
    (tmp_path / "a.csv").write_text("\n".join(["frame,agent,x,y", *rows]))
    file = str(tmp_path / "a.csv")
    data = TrajectoryDataModule(files=[file], dt=0.4, split="0.5,0.25,0.25", map="apartment.3")
    data.setup("fit")
    assert data.bank.names == ("apartment.3",)


@pytest.mark.parametrize(
    ("scenario", "scenes"),
    [
        ("goals:map=[apartment.3,apartment.4],people=3,pool=8", 8),
        ("goals:map=office.3,people=6,pool=4", 2),
    ],
)
def test_people_find_their_ways(scenario: str, scenes: int) -> None:
    result, _ = rollout("go_to_goal", scenario, "compiled", scenes)
    assert row("go_to_goal", result)["metrics"]["success"] > 0.95


def test_the_command_writes_what_it_says(refused, tmp_path, capsys) -> None:
    out, table, picture = tmp_path / "maps", tmp_path / "plans.json", tmp_path / "sheet.png"
    words = ["plans", "apartment", "office", "--count", "2", "--seed", "4", "--out", str(out)]
    assert main([*words, "--json", str(table), "--sheet", str(picture)]) == 0
    names = [f"{kind}.{seed}" for kind in ("apartment", "office") for seed in (4, 5)]
    assert sorted(file.name for file in out.iterdir()) == sorted(
        f"{n}{e}" for n in names for e in (".png", ".yaml")
    )
    printed = capsys.readouterr().out
    report = json.loads(table.read_text())
    assert report["command"] == "plans" and report["seeds"] == [4, 5]
    assert [entry["name"] for entry in report["rows"]] == names
    for entry in report["rows"]:
        grid = read_plan(entry["file"])
        assert grid.digest == entry["digest"] == load_plan(entry["name"]).digest
        facts = entry["metrics"]
        size = f"{facts['width_m']:.2f} x {facts['height_m']:.2f} m"
        assert f"{entry['file']}  {size}, {facts['rooms']} rooms, {facts['doors']} doors" in printed
        height, width = grid.cells.shape
        assert (facts["width_m"], facts["height_m"]) == pytest.approx((width * 0.05, height * 0.05))
        assert facts["free_m2"] == pytest.approx((grid.cells == FREE).sum() * 0.05**2, abs=0.01)
    image = cv2.imread(str(picture))
    assert image is not None and image.shape[1] == 1600

    assert f"{out / 'apartment.4.yaml'} exists: give another --out" in refused(*words)
    assert main([*words, "--overwrite", "--doors", "0.8,0.9", "--size", "15,14"]) == 0
    assert read_plan(out / "office.4.yaml").cells.shape == (280, 300)
    assert "doors of 0.80 to 0.90 m" in capsys.readouterr().out
    assert main(["plans", "office", "--count", "1", "--furnished", "0", "--out", str(out)]) == 0
    assert read_plan(out / "office.0.bare.yaml").digest == load_plan("office.0.bare").digest
