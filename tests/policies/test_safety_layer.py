"""The safety layer: who gives way, that contacts are avoided, and how people look ahead for robots."""

import math
from importlib import import_module
from types import ModuleType
from typing import Any

import pytest
import torch
from helpers.crowds import ROOM, around, contacts, steps
from helpers.scenes import scene
from tensordict import TensorDict
from torch import Tensor

from pedzoo.core.batch import PERSON, ROBOT
from pedzoo.core.errors import UserError
from pedzoo.core.geometry import identity_pose, move_to_scene, turn_to_scene
from pedzoo.core.types import BODY_RADIUS, STEP_SECONDS
from pedzoo.maps.bank import MapBank
from pedzoo.maps.plans import rectangles, room
from pedzoo.maps.walls import LocalWalls
from pedzoo.models.base import Forecaster, Walking
from pedzoo.models.zoo.loading import load
from pedzoo.policies.clearance import (
    BEYOND,
    MARGIN,
    SHOULDERS,
    SPREAD,
    ProposedSteps,
    kept_clear_in_torch,
)
from pedzoo.policies.controller.controller import Controller
from pedzoo.policies.load import load_policy
from pedzoo.policies.safety_layer import kept_clear, safe, yielding
from pedzoo.policies.walker import Walker
from pedzoo.sim.make import make_env


def nearest(position: Tensor, step: Tensor) -> float:
    """Return the least distance of any two in the step, of 41 moments."""
    part = torch.linspace(0, 1, 41).view(-1, 1, 1, 1)
    at = position + part * step
    apart = torch.cdist(at.double(), at.double()) + 1e3 * torch.eye(position.shape[1])
    return float(apart.min())


def test_steps_that_touch_no_person_stay_as_they_are() -> None:
    """Two who pass each other 0.33 m beside, which is a margin more than two bodies."""
    asked = steps([[0.0, 0.0], [1.0, 0.33]], [[0.5, 0.0], [-0.5, 0.0]])
    assert torch.equal(kept_clear(asked), asked.step)


@pytest.mark.parametrize("angle", [0.0, 0.3, 2.0])
@pytest.mark.parametrize("compiled", [True, False])
def test_two_who_meet_head_on_share_the_correction(angle: float, compiled: bool) -> None:
    """From 0.6 m apart both keep to the right, as much as the other, and pass."""
    turned = torch.tensor([[math.cos(angle), math.sin(angle)], [-math.sin(angle), math.cos(angle)]])
    asked = steps(
        torch.tensor([[-0.3, 0.0], [0.3, 0.0]]) @ turned, torch.tensor([[0.5, 0.0], [-0.5, 0.0]]) @ turned
    )
    result = (kept_clear if compiled else kept_clear_in_torch)(asked, None)
    first, second = (result[0] @ turned.T).tolist()
    assert first[0] > 0.3 and first[1] < -0.1
    assert second == pytest.approx([-first[0], -first[1]], abs=1e-5)
    assert nearest(asked.position, result) >= 2 * BODY_RADIUS


def test_bodies_that_overlap_part_and_come_no_closer() -> None:
    """Two side by side, 0.1 m apart, who go the same way; then two face to face."""
    walk = torch.tensor([[[0.5, 0.0], [0.5, 0.0]]])
    asked = steps([[0.0, 0.0], [0.0, 0.1]], walk[0], velocity=walk / STEP_SECONDS)
    results = [kept_clear(asked), kept_clear_in_torch(asked, None)]
    torch.testing.assert_close(*results, atol=1e-5, rtol=0)
    assert float(torch.pdist(asked.position[0] + results[0][0])) > 0.29
    apart = kept_clear(steps([[0.0, 0.0], [0.2, 0.0]], [[-0.3, 0.0], [0.3, 0.0]]))[0]
    assert apart[:, 0].tolist() == pytest.approx([-0.3, 0.3])
    closer = steps([[0.0, 0.0], [0.2, 0.0]], [[0.3, 0.0], [-0.3, 0.0]])
    assert nearest(closer.position, kept_clear(closer)) > 0.2 - 2e-3


def test_a_person_who_is_brushed_past_is_given_a_little_room() -> None:
    """What is less, a step aside or one back: 0.29 m beside each other it is 3 cm to the side, shared."""
    asked = steps([[0.0, 0.0], [0.4, 0.29]], [[0.4, 0.0], [-0.4, 0.0]])
    result = kept_clear(asked)
    assert (result - asked.step).norm(dim=-1).max() < 0.035
    assert nearest(asked.position, result) >= 2 * BODY_RADIUS


@pytest.mark.parametrize("moved", [[True, False], [False, True]])
def test_who_the_policy_does_not_move_takes_no_part(moved: list[bool]) -> None:
    """One walks to one who stands: the one who is moved goes aside alone, but not for the absent."""
    asked = steps([[-0.5, 0.0], [0.0, 0.0]], [[0.6, 0.0], [0.0, 0.0]], moved=torch.tensor([moved]))
    result, other = kept_clear(asked)[0], moved.index(False)
    assert torch.equal(result[other], asked.step[0, other])
    assert nearest(asked.position, result[None]) >= 2 * BODY_RADIUS
    if moved[0]:
        assert result[0, 0] > 0.2 and result[0, 1] < 0
    alone = kept_clear(asked._replace(present=torch.tensor([moved])))
    assert torch.equal(alone[0, 1 - other], asked.step[0, 1 - other])


def test_a_wall_stops_who_walks_into_it_and_lets_them_slide() -> None:
    """From 0.35 m before the wall's face, straight on and at 45 degrees."""
    asked = steps([[-0.4, 1.5], [-0.4, -1.5]], [[0.5, 0.0], [0.4, 0.4]])
    result = kept_clear(asked, around(1))[0]
    room_left = (0.35 - BODY_RADIUS - MARGIN) / BEYOND
    assert result[0].tolist() == pytest.approx([room_left, 0.0], abs=5e-3)
    assert result[1].tolist() == pytest.approx([room_left, 0.4], abs=5e-3)


def test_in_a_narrow_place_people_keep_a_shoulders_room() -> None:
    """Who meets 0.1 m beside each other, and who is overtaken: in the door or before it; not in the open."""
    body = 2 * BODY_RADIUS + MARGIN
    places = torch.tensor([[[-0.5, -0.05], [0.5, 0.05]]])
    for ahead, in_the_open in ((-0.4, body), (0.1, None)):
        move = torch.tensor([[[0.6, 0.0], [ahead, 0.0]]])
        for shift, wide in (((0.0, 0.0), SHOULDERS), ((-0.4, 0.0), SHOULDERS), ((1.5, 1.0), in_the_open)):
            place = places + torch.tensor(shift)
            wide = nearest(place, move) if wide is None else wide
            assert nearest(place, kept_clear(steps(place, move), around(1))) == pytest.approx(wide, abs=0.03)


@pytest.mark.parametrize("waits", [(True, True), (True, False), (False, False)])
def test_two_who_wait_in_a_narrow_place_turn_a_shoulder(waits: tuple[bool, bool]) -> None:
    """Both have to wait: who has only just come keeps the room, and so does who meets a person that walks."""
    place, move = torch.tensor([[[-0.4, -0.1], [0.4, 0.1]], [[0.4, 0.0], [-0.4, 0.0]]]).unsqueeze(1)
    result = kept_clear(steps(place, move, waits=torch.tensor([waits])), around(1))
    room = 2 * BODY_RADIUS + MARGIN if all(waits) else SHOULDERS
    assert nearest(place, result) == pytest.approx(room, abs=0.01)


def test_who_hardly_moved_in_the_observed_steps_waits() -> None:
    """Two face to face in a door: after standing there they are let closer than after walking up to it."""
    env = make_env("door:width=0.8,jitter=0,speed_std=0", 1, "compiled")
    seen = env.reset(seed=0)
    agents: Any = seen["agents"]
    place, ahead = torch.tensor([[-0.4, -0.05], [0.4, 0.05]]), torch.tensor([[0.4, 0.0], [-0.4, 0.0]])
    ago = torch.arange(-7.0, 1.0).view(-1, 1)
    for walked, room_left in ((0.0, 2 * BODY_RADIUS + MARGIN + SPREAD), (0.3, SHOULDERS)):
        agents["history"] = (place.unsqueeze(1) + walked * ago * ahead.unsqueeze(1)).unsqueeze(0)
        agents["velocity"] = ahead.unsqueeze(0) / STEP_SECONDS
        result = safe(seen, ahead.unsqueeze(0))
        assert nearest(place.unsqueeze(0), result) == pytest.approx(room_left, abs=0.03)


def test_in_a_room_no_person_touches_walls_or_others() -> None:
    """Random steps of 10 people around a door, places in the free."""
    random = torch.Generator().manual_seed(1)
    place = torch.rand(4000, 2, generator=random) * 3 - 1.5
    gap, _ = around(1).closest(place[None])
    free = place[gap[0] > BODY_RADIUS]
    position = free[: len(free) // 10 * 10].view(-1, 10, 2)
    apart = torch.cdist(position, position) + 9 * torch.eye(10)
    position = position[apart.amin((1, 2)) > 2 * BODY_RADIUS]
    assert len(position) >= 5
    asked = steps(position, 0.4 * torch.randn(position.shape, generator=random))
    walls = around(len(position))
    result = kept_clear(asked, walls)
    path = position.unsqueeze(2) + torch.linspace(0, 1, 21).view(-1, 1) * result.unsqueeze(2)
    gap, _ = walls.select(torch.arange(len(path)).repeat_interleave(10)).closest(path.flatten(0, 1))
    assert gap.min() > BODY_RADIUS - 1e-3 and nearest(position, result) > 2 * BODY_RADIUS - 1e-3


@pytest.mark.parametrize("walled", [False, True])
def test_the_answer_turns_moves_and_renumbers_with_people(walled: bool) -> None:
    """Six people who run into each other, in the open and around a door that turns and moves with them."""
    bank = MapBank([ROOM])
    plan = torch.full((4,), bank.grids[0].map_id)

    def walls(pose: Tensor) -> LocalWalls | None:
        return bank.walls_around(plan, pose) if walled else None

    random = torch.Generator().manual_seed(3)
    asked = steps(0.8 * torch.randn(4, 6, 2, generator=random), 0.4 * torch.randn(4, 6, 2, generator=random))
    result = kept_clear(asked, walls(identity_pose(4)))
    assert (result - asked.step).abs().max() > 0.1
    assert walled != torch.allclose(result, kept_clear(asked), atol=1e-2)
    angle, order = torch.tensor(0.7), torch.randperm(6, generator=random)
    turn = torch.stack((angle.cos(), -angle.sin(), angle.sin(), angle.cos())).view(2, 2)
    moved = steps(asked.position @ turn.T + 5, asked.step @ turn.T)
    turned = kept_clear(moved, walls(torch.tensor([[0.7, 1.0, 5.0, 5.0]]).expand(4, -1)))
    assert torch.allclose(turned, result @ turn.T, atol=1e-4)
    swapped = kept_clear(ProposedSteps(*(values[:, order] for values in asked[:9])), walls(identity_pose(4)))
    assert torch.allclose(swapped, result[:, order], atol=1e-5)


def test_gradients_are_finite_and_those_of_free_steps_are_one() -> None:
    """Of people on top of each other, too."""
    step = torch.tensor([[[0.4, 0.0], [-0.4, 0.0], [0.1, 0.1]]], requires_grad=True)
    asked = steps([[0.0, 0.0], [0.0, 0.0], [5.0, 5.0]], [[0.0, 0.0]] * 3)._replace(step=step)
    kept_clear(asked).sum().backward()
    assert step.grad is not None and step.grad.isfinite().all()
    assert step.grad[0, 2].tolist() == [1.0, 1.0]


def test_going_to_the_goal_with_it_is_a_baseline() -> None:
    """There are no contacts, and it decides when learned models do."""
    stored, free = (load_policy(f"go_to_goal:safety={on}") for on in ("true", "false"))
    result = [contacts(policy, "door:people=4,width=0.8") for policy in (stored, free)]
    assert result[0][:2] == (0, 0) and result[1][0] > 10
    with pytest.raises(UserError, match="leave out dt or safety"):
        load_policy("go_to_goal:safety=true,dt=0.2")


class Dash(Forecaster):
    """Runs straight to its goal, through people and walls."""

    needs = frozenset({"goal"})
    stochastic = False

    def __init__(self, safety: bool) -> None:
        super().__init__()
        self.config, self.walking = {"safety": safety}, Walking(safety)

    def next_steps(self, batch: TensorDict, noise: Tensor | None, steps: int, horizon: int) -> Tensor:
        """Return the straight way at 1.3 m/s."""
        agents: Any = batch["agents"]
        way = agents["goal"] - agents["history"][:, :, -1]
        unit = torch.nn.functional.normalize(way + 0.3 * way.flip(-1), dim=-1)
        return (0.52 * unit).unsqueeze(2).expand(-1, -1, steps, -1)


@pytest.mark.parametrize(
    "scenario", ["door:people=4,width=0.8", "room_exit:people=12,entering=0", "standing"]
)
def test_a_policy_with_it_touches_no_person_and_no_wall(scenario: str) -> None:
    """A policy that does both without."""
    assert sum(contacts(Walker(Dash(False)), scenario)[:2]) > 10
    assert contacts(Walker(Dash(True)), scenario)[:2] == (0, 0)


def test_the_walker_says_what_was_asked_for_and_can_do_without() -> None:
    """As the model says, unless the user says otherwise."""
    env = make_env("door:width=0.8", 4, "compiled")
    seen = env.reset(seed=0)
    for walker, held in ((Walker(Dash(True)), True), (Walker(Dash(True), safety=False), False)):
        assert walker.safety is held
        assert (("agents", "unconstrained_action") in walker(seen.clone()).keys(True)) is held
    assert Walker(load("sgan_goal.zara1")).safety is False


# People leave a robot its course


LONGEST = 1.3 * 1.3 * 0.4
CORRIDOR = rectangles(room((-8.0, -1.2), (8.0, 1.2), 0.2), resolution=0.05)


@pytest.fixture(scope="module")
def tool() -> ModuleType:
    return import_module("tools.pages.robots_respected")


def one_and_a_robot(
    place: tuple[float, float], other: tuple[float, float], drives: float = 0.0
) -> ProposedSteps:
    """Return a person who walks along x at 1.3 m/s, and a robot of 0.5 m on the x axis at ``drives``."""
    robot, radius = torch.tensor([[False, True]]), torch.tensor([[0.15, 0.5]])
    step = torch.tensor([[1.3, 0.0], [drives, 0.0]]) * 0.4
    return steps([place, other], step, LONGEST, radius=radius, robot=robot, moved=~robot)


def crowds(seed: int, robots: bool, scenes: int = 16) -> ProposedSteps:
    """Return dense scenes of six agents, of which some are not moved."""
    random = torch.Generator().manual_seed(seed)
    moved = torch.rand(scenes, 6, generator=random) < 0.6
    robot = torch.zeros_like(moved)
    if robots:
        robot = (torch.rand(scenes, 6, generator=random) < 0.4) & ~moved
    place = 6 * torch.rand(scenes, 6, 2, generator=random)
    step = 0.4 * torch.randn(scenes, 6, 2, generator=random)
    return steps(place, step, LONGEST, radius=torch.where(robot, 0.4, 0.15), robot=robot, moved=moved)


@pytest.mark.parametrize("seed", range(5))
def test_among_people_nothing_changes_not_even_a_bit(seed: int) -> None:
    asked = crowds(seed, robots=False)
    assert torch.equal(yielding(asked, None), asked.step)


@pytest.mark.parametrize("policy", ["social_force:fluctuation=0", "go_to_goal:safety=true"])
def test_a_robot_out_of_sight_changes_nothing(policy: str) -> None:
    asked, result = crowds(1, robots=False), []
    far = torch.tensor([900.0, 900.0]).expand(16, 1, 2)
    place, velocity = torch.cat((asked.position, far), 1), torch.cat((asked.step / 0.4, 0 * far), 1)
    moved = torch.cat((asked.moved, torch.zeros(16, 1, dtype=torch.bool)), 1)
    for kind, radius in ((PERSON, 0.15), (ROBOT, 0.5)):
        kinds, radii = torch.tensor([PERSON] * 6 + [kind]), torch.tensor([0.15] * 6 + [radius])
        batch = scene(place, velocity, velocity, radii, kinds, moved)
        result.append(load_policy(policy)(batch)["agents", "action"][:, :6])
    assert torch.equal(result[0], result[1])


@pytest.mark.parametrize("drives", [0.0, -1.0])
def test_steps_lead_past_the_robot_within_the_longest_step(drives: float) -> None:
    velocity = yielding(one_and_a_robot((-2.5, 0.0), (0.5, 0.1), drives), None)[0, 0] / 0.4
    assert velocity[1] < -0.1 and velocity[0] > 0.5  # to the nearer side, and on
    time = torch.arange(0, 3, 0.02).view(-1, 1)
    person = torch.tensor([-2.5, 0.0]) + time * velocity
    robot = torch.tensor([0.5, 0.1]) + time * torch.tensor([drives, 0.0])
    assert (person - robot).norm(dim=1).min() >= 0.65
    assert velocity.norm() <= 1.69 + 1e-5


@pytest.fixture(scope="module")
def corridor() -> LocalWalls:
    return MapBank([CORRIDOR]).walls_around(torch.tensor([CORRIDOR.map_id]), identity_pose(1))


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_people_pass_on_the_side_that_leaves_room(corridor: LocalWalls, side: float) -> None:
    """The person walks on the side where 0.35 m are left between the robot and the wall."""
    asked = one_and_a_robot((-2.5, 0.45 * side), (0.5, 0.35 * side))
    in_the_open, between_walls = yielding(asked, None)[0, 0, 1], yielding(asked, corridor)[0, 0, 1]
    assert float(in_the_open) * side > 0
    assert float(between_walls) * side < 0


def test_a_person_slows_down_for_what_leaves_no_room(corridor: LocalWalls) -> None:
    wide = one_and_a_robot((-2.0, 0.0), (0.0, 0.0))._replace(radius=torch.tensor([[0.15, 1.1]]))
    assert yielding(wide, corridor)[0, 0].norm() < 0.75 * 0.52


def test_turned_scenes_yield_alike_and_others_keep_steps() -> None:
    asked = crowds(3, robots=True, scenes=200)
    result = yielding(asked, None)
    changed = (result != asked.step).any(-1)
    assert changed.sum() > 10 and not (changed & ~asked.moved).any()
    pose = torch.tensor([[0.9, 1.0, 4.0, -2.0]]).expand(200, 4)
    there, step = move_to_scene(asked.position, pose), turn_to_scene(asked.step, pose)
    turned = yielding(asked._replace(position=there, step=step), None)
    apart = (turned - turn_to_scene(result, pose)).norm(dim=-1)
    assert (apart < 1e-4).float().mean() > 0.98  # equally good samples may be chosen in another order
    order = torch.tensor([3, 0, 5, 1, 4, 2])
    permuted = ProposedSteps(*(part[:, order] for part in asked[:9]))
    torch.testing.assert_close(yielding(permuted, None), result[:, order])


def test_the_gradient_is_that_of_what_is_asked_for() -> None:
    asked = one_and_a_robot((-2.5, 0.0), (0.5, 0.1))
    step = asked.step.clone().requires_grad_()
    yielding(asked._replace(step=step), None)[0, 0].sum().backward()
    assert step.grad is not None and step.grad[0].tolist() == [[1.0, 1.0], [0.0, 0.0]]


@pytest.mark.parametrize(
    ("place", "encounter"),
    [("open", "parked"), ("open", "head-on"), ("open", "crossing"), ("corridor", "head-on")],
)
@pytest.mark.parametrize("policy", ["orca", "social_force:preset=indoor", "approach_net_goal_map.indoor"])
def test_robots_are_respected(tool: ModuleType, policy: str, place: str, encounter: str) -> None:
    """The corridor leaves 0.7 m beside a robot. All offsets: tools/pages/robots_respected.py."""
    for share in (0.0, 0.5):
        run = tool.walked(policy, place, encounter, share * tool.WIDEST[place])
        assert run.nearest >= 0.65 - 1e-3 and run.arrived, share


@pytest.mark.parametrize("encounter", ["overtaken", "overtakes"])
def test_robots_behind_and_slower_ones_are_respected(tool: ModuleType, encounter: str) -> None:
    run = tool.walked("approach_net_goal_map.indoor", "open", encounter, 0.0)
    assert run.nearest >= 0.65 - 1e-3 and run.arrived


def test_a_husky_of_three_discs_is_walked_around() -> None:
    """A parked box of 0.99 x 0.67 m, lengthwise in the way: three discs of 0.37 m."""
    controller = Controller(load_policy("approach_net_goal_map.indoor"), dt=0.1)
    place, nearest = torch.zeros(2, dtype=torch.float64), math.inf
    discs = torch.tensor([[2.7, 0.1], [3.0, 0.1], [3.3, 0.1]], dtype=torch.float64)
    for _ in range(80):
        robot = {"others": {"husky": discs}, "radius": {"husky": 0.37}}
        velocity = controller.step({0: place}, {0: (7.0, 0.0)}, **robot)[0]
        place = place + 0.1 * torch.from_numpy(velocity)
        nearest = min(nearest, float((place - discs).norm(dim=1).min()))
    assert nearest >= 0.52 - 1e-3
    assert float(place[0]) > 6.5
