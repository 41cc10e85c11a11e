"""Scene batches: keys, padding, goals, and augmentation that stays on its floor plan."""

import math
from pathlib import Path
from typing import cast

import numpy as np
import pytest
import torch
from tensordict import TensorDict
from torch import Tensor

from pedzoo.core.types import STEP_SECONDS
from pedzoo.data.datamodule import Loading, TrajectoryDataModule
from pedzoo.data.datasets.eth_ucy import EthUcy
from pedzoo.data.recordings import Recording
from pedzoo.data.scenes import KeptPeople, SceneSet, augmentation
from pedzoo.data.tracks import Tracks
from pedzoo.maps.bank import MapBank
from pedzoo.maps.formats import read_ros
from pedzoo.maps.grid import OCCUPIED, OccupancyGrid

OBS, PRED = 3, 2
PATHS = {  # position at each step, None where not seen
    1: [(0, 0), (0.4, 0), (0.8, 0), (1.2, 0), (1.6, 0), (2.0, 0), (2.0, 4.0)],
    2: [(5, 5), (5, 4), (5, 3), (5, 2), (5, 1), None, None],
    3: [None, None, (9, 0), (9, 1), (9, 3), (9, 4), (9, 5)],
}


def tracks() -> Tracks:
    rows = [(t, who, *xy) for who, path in PATHS.items() for t, xy in enumerate(path) if xy]
    return Tracks.from_table("hand", np.array(rows))


def scene_set(people: KeptPeople = "complete", min_people: int = 1) -> SceneSet:
    return SceneSet([Recording(tracks())], [77], MapBank(), OBS, PRED, people, min_people)


def agents(batch: TensorDict) -> TensorDict:
    return cast("TensorDict", batch["agents"])


def key(batch: TensorDict, name: str) -> Tensor:
    return cast("Tensor", batch["agents", name])


def positions(who: int, start: int, stop: int) -> Tensor:
    return torch.tensor([xy for xy in PATHS[who][start:stop] if xy], dtype=torch.float32)


def test_keys_shapes_and_types():
    """Windows 0, 1 and 2 have people 1 and 2; 1; 1 and 3."""
    batch = scene_set().batch(torch.arange(3), "destination")
    shapes = {name: (tuple(value.shape), value.dtype) for name, value in batch.items(True, True)}
    assert shapes == {
        ("agents", "history"): ((3, 2, OBS, 2), torch.float32),
        ("agents", "valid"): ((3, 2, OBS), torch.bool),
        ("agents", "future"): ((3, 2, PRED, 2), torch.float32),
        ("agents", "future_valid"): ((3, 2, PRED), torch.bool),
        **{("agents", name): ((3, 2, 2), torch.float32) for name in ("velocity", "goal", "desired_velocity")},
        **{
            ("agents", name): ((3, 2, 1), torch.float32)
            for name in ("heading", "radius", "top_speed", "pref_speed")
        },
        **{("agents", name): ((3, 2), torch.int64) for name in ("kind", "group", "id")},
        **{("agents", name): ((3, 2), torch.bool) for name in ("mask", "controlled")},
        "map_id": ((3, 1), torch.int64),
        "scene_pose": ((3, 4), torch.float32),
    }
    assert batch.batch_size == (3,)
    assert agents(batch).batch_size == (3, 2)
    assert batch["map_id"].tolist() == [[77]] * 3
    assert batch["scene_pose"].tolist() == [[0, 1, 0, 0]] * 3
    without = agents(scene_set().batch(torch.arange(3), "none"))
    assert {"goal", "desired_velocity"}.isdisjoint(without.keys())


def test_batches_hold_the_raw_tracks_and_say_what_is_padding():
    batch = scene_set().batch(torch.tensor([2, 1, 0]))
    assert key(batch, "mask").tolist() == [[True, True], [True, False], [True, True]]
    assert key(scene_set().batch(torch.tensor([1])), "mask").shape == (1, 1)  # no wider than it must
    for name in ("valid", "future_valid"):
        assert torch.equal(key(batch, name).all(-1), key(batch, "mask"))
        assert torch.equal(key(batch, name).any(-1), key(batch, "mask"))
    assert torch.isfinite(key(batch, "history")).all()
    for scene, person, who, start in [(0, 0, 1, 2), (0, 1, 3, 2), (1, 0, 1, 1), (2, 0, 1, 0), (2, 1, 2, 0)]:
        assert torch.equal(key(batch, "history")[scene, person], positions(who, start, start + OBS))
        assert torch.equal(
            key(batch, "future")[scene, person], positions(who, start + OBS, start + OBS + PRED)
        )


def test_velocity_and_preferred_speed_by_hand():
    batch = scene_set().batch(torch.tensor([2]))
    assert torch.allclose(key(batch, "velocity"), torch.tensor([[[1.0, 0.0], [0.0, 5.0]]]))
    # person 3 walks 1 and 2 m in two steps of 0.4 s
    assert torch.allclose(key(batch, "pref_speed"), torch.tensor([[[1.0], [3.75]]]))


def test_goals_and_desired_velocities_by_hand():
    scenes = scene_set()
    window_end = scenes.batch(torch.tensor([0]), "window_end")
    assert torch.allclose(key(window_end, "goal"), torch.tensor([[[1.6, 0.0], [5.0, 1.0]]]))
    destination = scenes.batch(torch.tensor([0]), "destination")
    assert torch.allclose(key(destination, "goal"), torch.tensor([[[2.0, 4.0], [5.0, 1.0]]]))
    # person 1 is at (0.8, 0) and walked 1 m/s; (1.2, 4) leads to where they were last seen
    towards = torch.tensor([1.2, 4.0]) / torch.tensor([1.2, 4.0]).norm()
    assert torch.allclose(key(destination, "desired_velocity")[0, 0], towards)
    assert torch.allclose(key(destination, "desired_velocity")[0, 1], torch.tensor([0.0, -2.5]))


@pytest.mark.parametrize("walled", [True, False])
def test_planner_goals_lead_round_walls_as_far_as_people_walk(walled: bool):
    """A wall at x = 5 m, y below 8 m; a person walks towards it, and is last seen outside the plan."""
    cells = np.zeros((100, 100), np.uint8)
    cells[:80, 50] = OCCUPIED * walled
    grid = OccupancyGrid(cells, 0.1)
    rows = [(t, 1, 2 + 0.4 * t, 2.0) for t in range(5)] + [(5, 1, 8.0, 2.0), (6, 1, 11.0, 2.0)]
    hall = Recording(Tracks.from_table("hall", np.array(rows)))
    scenes = SceneSet([hall], [grid.map_id], MapBank([grid]), OBS, PRED, min_people=1)
    batch = scenes.batch(torch.tensor([0]), "planner")
    way = (key(batch, "goal") - key(batch, "history")[:, :, -1])[0, 0]
    desired = key(batch, "desired_velocity")[0, 0]
    assert way.norm().item() == pytest.approx(PRED * STEP_SECONDS, abs=1e-4)  # at 1 m/s
    assert desired.norm().item() == pytest.approx(1, abs=1e-5)
    corner = math.degrees(math.atan2(8.0 - 2.0, 5.0 - 2.8))
    bearing = math.degrees(math.atan2(float(desired[1]), float(desired[0])))
    assert bearing == pytest.approx(corner if walled else 0.0, abs=4)
    assert torch.allclose(way / way.norm(), desired, atol=0.02)
    window_end = scenes.batch(torch.tensor([0]), "window_end")
    assert torch.equal(key(window_end, "pref_speed"), key(batch, "pref_speed"))


def test_random_future_is_later_on_the_same_track_and_seeded():
    scenes = scene_set()

    def draw(seed: int) -> Tensor:
        generator = torch.Generator().manual_seed(seed)
        return key(
            scenes.batch(torch.zeros(400, dtype=torch.long), "random_future", generator=generator), "goal"
        )

    goals = draw(1)
    assert torch.equal(goals, draw(1))
    assert not torch.equal(goals, draw(2))
    for person, who in ((0, 1), (1, 2)):  # everything after the last observed step 2, and nothing else
        later = {tuple(xy) for xy in positions(who, OBS, 7).tolist()}
        assert {tuple(xy) for xy in goals[:, person].tolist()} == later


def test_a_goal_where_the_person_stands_gives_no_direction():
    rows = [(t, who, who, 0.0) for who in (1, 2) for t in range(5)]
    scenes = SceneSet([Recording(Tracks.from_table("still", np.array(rows)))], [-1], MapBank(), OBS, PRED)
    batch = scenes.batch(torch.tensor([0]), "window_end")
    assert torch.equal(key(batch, "desired_velocity"), torch.zeros(1, 2, 2))
    assert torch.equal(key(batch, "pref_speed"), torch.zeros(1, 2, 1))


def test_partly_present_people_are_held_where_they_were_seen():
    """Person 2 leaves after the first predicted step of window 1, and after the observed ones of window 2."""
    scenes = scene_set("present", 2)
    assert scenes.sizes.tolist() == [2, 3, 3]  # person 3 comes at step 2 and counts from step 3 on
    batch = scenes.batch(torch.arange(3), "window_end")
    assert key(batch, "valid")[1].tolist() == [[True] * 3, [True] * 3, [False, True, True]]
    assert key(batch, "future_valid")[1].tolist() == [[True] * 2, [True, False], [True] * 2]
    assert key(batch, "history")[1, 2].tolist() == [[9, 0], [9, 0], [9, 1]]  # before the first sighting
    assert key(batch, "future")[1, 1].tolist() == [[5, 1], [5, 1]]  # after the last one: there
    assert key(batch, "goal")[1, 1].tolist() == [5, 1]
    assert key(batch, "pref_speed")[1, 2].item() == pytest.approx(2.5)  # one known step of 1 m, not two
    assert key(batch, "future_valid")[2, 1].tolist() == [False, False]
    assert key(batch, "goal")[2, 1].tolist() == [5, 1]
    future = scenes.batch(torch.tensor([2]), "random_future", generator=torch.Generator().manual_seed(0))
    assert key(future, "goal")[0, 1].tolist() == [5, 1]  # their track ends here


def test_two_recordings_do_not_mix():
    other = Tracks("other", tracks().frame, tracks().agent, tracks().xy + 100)
    scenes = SceneSet([Recording(tracks()), Recording(other)], [5, -1], MapBank(), OBS, PRED, "present", 1)
    half = len(scenes) // 2
    for goal in ("window_end", "destination"):
        first, second = (scenes.batch(torch.arange(half) + start, goal) for start in (0, half))
        for name in ("history", "future", "goal"):
            assert torch.allclose(key(second, name), key(first, name) + 100)
    assert scenes.map_id.tolist() == [5] * half + [-1] * half


# -- augmentation


def augmented_pair(
    scenes: SceneSet, goal: str = "destination", mirror: bool = True
) -> tuple[TensorDict, TensorDict]:
    chosen = torch.arange(0, len(scenes), max(1, len(scenes) // 40))
    plain = scenes.batch(chosen, goal)  # type: ignore[arg-type]
    generator = torch.Generator().manual_seed(3)
    pose = augmentation(key(plain, "history")[:, 0, -1], True, mirror, generator)
    return plain, scenes.batch(chosen, goal, pose)  # type: ignore[arg-type]


@pytest.mark.parametrize("fold", ["zara1", "eth"])
def test_augmented_people_see_the_same_walls(shared, fold):
    (recording,) = EthUcy(fold, str(shared / "data")).recordings("test")
    assert isinstance(recording.plan, Path)
    bank = MapBank([read_ros(recording.plan)])
    scenes = SceneSet([recording], [bank.id_of(fold)], bank, 8, 8)
    plain, turned = augmented_pair(scenes)
    assert not torch.allclose(key(plain, "history"), key(turned, "history"), atol=0.5)
    for name in ("history", "future", "goal"):
        here, there = (
            bank.signed_distance(key(batch, name), batch["map_id"].squeeze(1), batch["scene_pose"])
            for batch in (plain, turned)
        )
        assert here.std() > 0.1
        assert torch.allclose(here, there, atol=1e-3)
    # real people stand on walls now and then: data are what they are
    assert bank.signed_distance(scenes.xy[None], scenes.map_id[:1], plain["scene_pose"][:1]).min() < 0


def test_augmentation_turns_everything_together():
    plain, turned = augmented_pair(scene_set())
    for name in ("history", "future"):
        here, there = (
            (key(batch, name)[:, :, None] - key(batch, name)[:, None]).norm(dim=-1)
            for batch in (plain, turned)
        )
        assert torch.allclose(here, there, atol=1e-5)
    for name in ("pref_speed", "mask", "valid", "future_valid"):
        assert torch.equal(key(plain, name), key(turned, name))
    # what is derived from positions agrees with the moved positions
    history, goal = key(turned, "history"), key(turned, "goal")
    assert torch.allclose(
        key(turned, "velocity"), (history[..., -1, :] - history[..., -2, :]) / 0.4, atol=1e-5
    )
    towards = torch.nn.functional.normalize(goal - history[..., -1, :], dim=-1)
    assert torch.allclose(key(turned, "desired_velocity"), key(turned, "pref_speed") * towards, atol=1e-5)
    # the first person of each scene is the centre
    assert torch.allclose(history[:, 0, -1], key(plain, "history")[:, 0, -1], atol=1e-5)


def test_mirrored_scenes_turn_the_other_way():
    """Angular velocity flips its sign exactly in scenes with mirror -1."""
    rows = [(t, who, np.cos(0.3 * t + who), np.sin(0.3 * t + who)) for who in (1, 2) for t in range(25)]
    scenes = SceneSet([Recording(Tracks.from_table("left", np.array(rows)))], [-1], MapBank(), OBS, PRED)
    _, turned = augmented_pair(scenes)
    step = key(turned, "history").diff(dim=2)
    turn = step[:, :, 0, 0] * step[:, :, 1, 1] - step[:, :, 0, 1] * step[:, :, 1, 0]
    mirror = turned["scene_pose"][:, 1]
    assert {-1.0, 1.0} == set(mirror.tolist())
    assert torch.equal(turn.sign(), mirror[:, None].expand_as(turn))
    _, rotated = augmented_pair(scenes, mirror=False)
    assert (rotated["scene_pose"][:, 1] == 1).all()


def test_poses_are_drawn_evenly_and_only_as_asked():
    centres = torch.zeros(4000, 2)
    pose = augmentation(centres, True, True, torch.Generator().manual_seed(0))
    assert pose[:, 0].min() >= 0 and pose[:, 0].max() < 2 * torch.pi
    assert abs(pose[:, 0].cos().mean()) < 0.05 and abs(pose[:, 0].sin().mean()) < 0.05
    assert abs(pose[:, 1].mean()) < 0.06
    assert torch.equal(augmentation(centres, False, False), torch.tensor([0.0, 1, 0, 0]).expand(4000, 4))


def test_only_training_batches_are_augmented(shared):
    data = TrajectoryDataModule("zara1", str(shared / "data"), loading=Loading(rotate=True, mirror=True))
    data.setup("fit")
    ids = data.sets["train"].map_id
    assert (ids == -1).any()  # uni_examples
    assert set(ids.tolist()) - {-1} == {data.bank.id_of(name) for name in ("eth", "hotel", "univ", "zara2")}
    plain = torch.tensor([0.0, 1, 0, 0])
    assert not (next(iter(data.train_dataloader()))["scene_pose"] == plain).all()
    assert all((batch["scene_pose"] == plain).all() for batch in data.val_dataloader())
