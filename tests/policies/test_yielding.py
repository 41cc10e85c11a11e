"""People leave a robot its course: the look ahead of the safety layer, and all policies in the encounters."""

import math
from importlib import import_module
from types import ModuleType

import pytest
import torch
from helpers.crowds import steps
from helpers.scenes import scene

from pedzoo.core.batch import PERSON, ROBOT
from pedzoo.core.geometry import identity_pose, move_to_scene, turn_to_scene
from pedzoo.maps.bank import MapBank
from pedzoo.maps.plans import rectangles, room
from pedzoo.maps.walls import LocalWalls
from pedzoo.policies.clearance import ProposedSteps
from pedzoo.policies.controller.controller import Controller
from pedzoo.policies.load import load_policy
from pedzoo.policies.safety_layer import yielding

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
