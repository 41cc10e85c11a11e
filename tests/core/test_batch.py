"""The one scene batch: its defaults, the floor plans that it brings, and who heeds the bodies in it."""

import copy
import math
import pickle
from typing import Any, cast

import pytest
import torch
from helpers.batches import changed, make_batch
from helpers.scenes import Watch, scene
from tensordict import TensorDict
from torch import Tensor
from torchrl.envs.utils import check_env_specs

from pedzoo.core.batch import PERSON, ROBOT, agents_of, companions_of, ids_of, maps_of, scene_batch
from pedzoo.core.errors import UserError
from pedzoo.core.geometry import identity_pose, move_to_scene, turn_to_scene
from pedzoo.data.datamodule import Loading, TrajectoryDataModule
from pedzoo.maps.bank import MapBank
from pedzoo.maps.plans import rectangles, room
from pedzoo.policies.controller.controller import Controller
from pedzoo.policies.load import load_policy
from pedzoo.sim.make import make_env

ROOM = rectangles(room((-6.0, -6.0), (6.0, 6.0), 0.1))
AVOIDING = ("orca:jitter=0", "social_force:fluctuation=0,preset=indoor", "go_to_goal:safety=true")


def test_what_is_left_out_has_its_default() -> None:
    history = torch.zeros(1, 3, 8, 2)
    history[0, 0, -1] = torch.tensor([0.0, 0.4])
    history[0, 1, -1] = torch.tensor([-0.2, 0.0])
    mask = torch.tensor([[True, True, False]])
    batch = scene_batch(
        maps=MapBank(),
        map_id=torch.full((1, 1), -1),
        pose=identity_pose(1),
        history=history,
        valid=torch.ones(1, 3, 8, dtype=torch.bool),
        mask=mask,
        pref_speed=torch.ones(1, 3, 1),
    )
    agents = agents_of(batch)
    torch.testing.assert_close(agents["velocity"][0], torch.tensor([[0.0, 1.0], [-0.5, 0.0], [0.0, 0.0]]))
    assert agents["heading"][0, :, 0].tolist() == pytest.approx([math.pi / 2, math.pi, 0.0])
    assert agents["radius"][..., 0].tolist() == [[pytest.approx(0.15)] * 3]
    assert agents["kind"].tolist() == [[PERSON] * 3]
    assert agents["group"].tolist() == [[-1] * 3] and not companions_of(batch).any()
    assert ids_of(batch).tolist() == [[0, 1, 2]]
    assert torch.equal(agents["controlled"], mask)
    assert {"goal", "desired_velocity", "future", "future_valid"}.isdisjoint(agents.keys())
    assert {"scene_key", "time"}.isdisjoint(batch.keys())
    assert batch.device == agents.device == torch.device("cpu")


def test_all_sources_of_batches_have_the_same_keys() -> None:
    data = TrajectoryDataModule(fold="embedded", goal="destination")
    data.setup("test")
    recorded = next(iter(data.test_dataloader()))
    env = make_env("door:people=2", 2, "compiled")
    check_env_specs(env)
    simulated = env.reset()
    watch = Watch()
    Controller(watch).step({"anna": (0.0, 0.0)}, {"anna": (3.0, 0.0)})
    seen = watch.seen
    own = {"done", "terminated", "truncated", "failed"}
    assert set(simulated.keys()) - own == set(seen[0].keys()) == set(recorded.keys()) | {"scene_key", "time"}
    theirs = set(agents_of(seen[0]).keys()) - {"action"}
    assert set(agents_of(simulated).keys()) - {"info"} == theirs
    theirs -= {"remaining_path", "goal_since"}  # of simulated scenes
    assert set(agents_of(recorded).keys()) - {"future", "future_valid"} == theirs
    for batch in (recorded, simulated, seen[0]):
        kinds = {key: (value.dtype, value.dim()) for key, value in agents_of(batch).items() if key in theirs}
        assert kinds == {
            key: (value.dtype, value.dim()) for key, value in agents_of(seen[0]).items() if key in theirs
        }


def test_companions_are_agents_of_one_company() -> None:
    """Neither the numbers of companies, nor the order of agents, nor padding matter."""
    batch = make_batch((5, 3))
    group = torch.tensor([[4, -1, 4, 7, -1], [2, 2, 0, 2, 2]])  # two of the second scene are padding
    pairs = companions_of(changed(batch, group=group))
    assert pairs.nonzero().tolist() == [[0, 0, 2], [0, 2, 0], [1, 0, 1], [1, 1, 0]]
    assert torch.equal(companions_of(changed(batch, group=torch.where(group < 0, -1, 100 - group))), pairs)
    order = torch.tensor([3, 0, 4, 2, 1])
    moved = changed(batch, group=group[:, order], mask=agents_of(batch)["mask"][:, order])
    assert torch.equal(companions_of(moved), pairs[:, order][:, :, order])


def test_augmented_recordings_face_where_they_go() -> None:
    data = TrajectoryDataModule(fold="embedded", loading=Loading(rotate=True, mirror=True))
    data.setup("fit")
    agents = agents_of(next(iter(data.train_dataloader())))
    walks = agents["mask"] & (cast("Tensor", agents["velocity"]).norm(dim=-1) > 0.1)
    velocity = agents["velocity"][walks]
    facing = torch.atan2(velocity[:, 1], velocity[:, 0])
    torch.testing.assert_close(agents["heading"][walks][:, 0], facing)


def test_bodies_face_where_they_go_and_keep_it_at_rest() -> None:
    env = make_env("door:people=2", 1, "compiled")
    now = env.reset()
    for speed in (1.0, 0.0):
        before = agents_of(now)["heading"]
        turned = torch.tensor([0.0, speed]).expand(1, 2, 2)
        _, now = env.step_and_maybe_reset(now.set(("agents", "action"), turned))
        heading = cast("Tensor", agents_of(now)["heading"])
        assert heading.flatten().tolist() == pytest.approx([math.pi / 2] * 2, abs=1e-3)
        assert speed or torch.equal(heading, before)
    assert agents_of(now)["radius"].unique().tolist() == [pytest.approx(0.15)]


def test_the_floor_plans_stay_with_the_batch() -> None:
    bank = MapBank([ROOM])
    batch = make_batch((2, 3), maps=bank)
    stored: dict[str, Any] = {
        "index": batch[:1],
        "mask": batch[torch.tensor([True, False])],
        "clone": batch.clone(),
        "copy": batch.copy(),
        "to": batch.to("cpu"),
        "stack": torch.stack([batch, batch]),
        "cat": torch.cat([batch, make_batch((2, 3), maps=MapBank([ROOM]))]),
        "lists": torch.stack([batch, batch], 1).flatten(0, 1)[torch.tensor([0, 3])],
        "split": batch.split(1)[0],
        "pickle": pickle.loads(pickle.dumps(batch)),
        "deepcopy": copy.deepcopy(batch),
    }
    for name, result in stored.items():
        assert maps_of(result) is bank, name
    env = make_env("door:people=2", 2, "compiled")
    steps = env.rollout(3, load_policy("go_to_goal"), break_when_any_done=False)
    assert maps_of(steps) is maps_of(cast("TensorDict", steps["next"])) is env.bank


def test_batches_of_two_banks_or_of_none_are_refused() -> None:
    first, second = make_batch((2,), maps=MapBank([ROOM])), make_batch((2,), maps=MapBank())
    for both in (torch.cat([first, second]), torch.stack([first, second])):
        with pytest.raises(UserError, match=r"2 different banks .* and \[no map\]\. Combine scenes of one"):
            maps_of(cast("TensorDict", both))
    assert maps_of(cast("TensorDict", torch.cat([first, second]))[1:]) == MapBank()
    with pytest.raises(UserError, match=r"does not say which floor plans .*scene_batch\(maps=\.\.\.\)"):
        maps_of(first.exclude("maps"))


def test_banks_of_equal_plans_and_walls_are_one() -> None:
    bank = MapBank([ROOM], "wall")
    bank.signed_distance(torch.zeros(1, 1, 2), torch.tensor([ROOM.map_id]), identity_pose(1))
    sent = pickle.dumps(bank)
    assert len(sent) < len(pickle.dumps(ROOM)) + 1000, "distances are made anew, not sent"
    assert pickle.loads(sent) is bank
    assert bank == MapBank([ROOM], "wall") != MapBank([ROOM], "free")
    assert MapBank([], "wall") == MapBank([], "free")
    assert bank.to("cpu") is bank


@pytest.mark.parametrize("policy", AVOIDING[::2])
@pytest.mark.parametrize("kind", [PERSON, ROBOT])
@pytest.mark.parametrize("aside", [0.05, 0.3, 0.6])
def test_a_wide_agent_in_the_way_is_not_touched(policy: str, kind: int, aside: float) -> None:
    """A body of 0.5 m stands in the way: the centres stay 0.65 m apart."""
    walks = load_policy(policy)
    place, velocity = torch.tensor([[-3.0, 0.0], [0.0, aside]]), torch.tensor([[1.3, 0.0], [0.0, 0.0]])
    desired, parts, nearest = velocity.clone(), 8, math.inf
    for _ in range(round(4.0 / walks.decision_dt)):
        desired[0] = 1.3 * torch.nn.functional.normalize(torch.tensor([3.0, 0.0]) - place[0], dim=0)
        seen = scene(
            place, velocity, desired, torch.tensor([0.15, 0.5]), torch.tensor([PERSON, kind]), [[True, False]]
        )
        velocity = torch.stack((walks(seen)["agents", "action"][0, 0], torch.zeros(2)))
        for _ in range(parts):
            place = place + velocity * walks.decision_dt / parts
            nearest = min(nearest, float((place[0] - place[1]).norm()))
    assert nearest >= 0.65 - 1e-3
    assert place[0, 0] > -1.0


def test_a_robot_leaves_the_correction_to_people() -> None:
    walks = load_policy("go_to_goal:safety=true")
    place, velocity = [[-0.4, 0.0], [0.4, 0.0]], [[1.0, 0.0], [-1.0, 0.0]]
    for kind, shares in (((PERSON, PERSON), (True, True)), ((PERSON, ROBOT), (True, False))):
        result = walks(scene(place, velocity, velocity, kind=torch.tensor(kind)))["agents", "action"][0]
        changed = (result - torch.tensor(velocity)).norm(dim=-1) > 1e-3
        assert tuple(changed.tolist()) == shares
    both = walks(scene(place, velocity, velocity, kind=ROBOT))["agents", "action"][0]
    assert both[0].tolist() == pytest.approx((-both[1]).tolist(), abs=1e-5)


def mixed(seed: int = 0) -> dict[str, Tensor]:
    """Return eight scenes of five agents of any kind and size in a room."""
    random = torch.Generator().manual_seed(seed)
    shape = 8, 5
    velocity = 0.8 * torch.randn(*shape, 2, generator=random)
    return {
        "position": 3 * torch.rand(*shape, 2, generator=random) - 5.5,
        "velocity": velocity,
        "desired": velocity + 0.3 * torch.randn(*shape, 2, generator=random),
        "radius": 0.15 + 0.35 * torch.rand(shape, generator=random),
        "kind": (torch.rand(shape, generator=random) < 0.3).long(),
        "controlled": torch.rand(shape, generator=random) < 0.7,
    }


@pytest.mark.parametrize("policy", AVOIDING)
def test_neither_order_nor_pose_matters_for_mixed_bodies(policy: str) -> None:
    walks, parts, bank = load_policy(policy), mixed(), MapBank([ROOM])
    action = walks(scene(**parts, maps=bank))["agents", "action"].clone()
    order = torch.tensor([3, 0, 4, 1, 2])
    permuted = scene(**{key: value[:, order] for key, value in parts.items()}, maps=bank)
    torch.testing.assert_close(walks(permuted)["agents", "action"], action[:, order], atol=1e-4, rtol=0)

    pose = torch.tensor([[0.9, -1.0, 4.0, -2.0]]).expand(8, 4)
    moved = parts | {"position": move_to_scene(parts["position"], pose)}
    moved |= {key: turn_to_scene(parts[key], pose) for key in ("velocity", "desired")}
    turned = scene(**moved, maps=bank)
    turned["scene_pose"] = pose
    result = walks(turned)["agents", "action"]
    apart = (result - turn_to_scene(action, pose)).norm(dim=-1)
    # equally near walls and jammed people may be solved in another order
    assert (apart < 5e-3).float().mean() >= 0.9
