"""Pieces of episodes and what they cost: hand-made ways, real environments, and where gradients go."""

from typing import Any

import pytest
import torch
from tensordict import TensorDict, TensorDictBase
from torch import Tensor

import pedzoo
from pedzoo.core.errors import UserError
from pedzoo.core.geometry import identity_pose
from pedzoo.maps.bank import MapBank
from pedzoo.maps.plans import rectangles, room, wall
from pedzoo.sim.make import make_env
from pedzoo.train.closed_loop.loop_losses import (
    LoopLosses,
    least_gaps,
    lost_seconds,
    wall_distances,
    wrong_side,
)
from pedzoo.train.closed_loop.segments import Course, CourseSampler, Segment, unrolled

TURN = torch.tensor([[0.6, 0.8], [-0.8, 0.6]])
HALL = room((-8.0, -8.0), (8.0, 8.0), 0.1)
NOWHERE = MapBank([])
FIRST = torch.tensor([[[True, False]]])
"""Of two people, the policy moves the first."""


def made(velocity: Tensor, start: Tensor, bank: MapBank | None = None, **more: Any) -> Segment:
    """Return the segment of people who walk with ``velocity`` (T, B, A, 2) from ``start`` (B, A, 2)."""
    moved = 0.4 * velocity.cumsum(0)
    begin = start + torch.cat((torch.zeros_like(moved[:1]), moved[:-1]))
    part = torch.linspace(0, 0.4, 5).view(-1, 1)
    there = torch.ones(velocity.shape[:3], dtype=torch.bool)
    scenes = velocity.shape[1]
    fields = {
        "trace": begin.unsqueeze(-2) + velocity.unsqueeze(-2) * part,
        **dict.fromkeys(("asked", "action", "velocity"), velocity),
        "progress": 0.4 * velocity[..., 0],
        "pref_speed": torch.ones(velocity.shape[:3]),
        "radius": torch.full(velocity.shape[:3], 0.15),
        "goal": begin,
        **dict.fromkeys(("present", "moved"), there),
        **dict.fromkeys(("agent_contact", "wall_contact"), ~there),
        "done": torch.zeros(scenes, dtype=torch.bool),
        "map_id": torch.full((scenes,), bank.grids[0].map_id if bank else -1),
        "pose": identity_pose(scenes),
    }
    return Segment(**fields | more)


def two(distance: float, steps: int = 3) -> Segment:
    """Return two people who walk along x side by side, ``distance`` apart, and a third far away."""
    velocity = torch.tensor([1.0, 0.0]).expand(steps, 1, 3, 2)
    return made(velocity, torch.tensor([[[0.0, 0.0], [0.0, distance], [0.0, 50.0]]]))


def standing_and_walking() -> Segment:
    """Return one who walks at 1 m/s and one who stands 5 m away, for 4 steps."""
    velocity = torch.zeros(4, 1, 2, 2)
    velocity[:, :, 0, 0] = 1.0
    return made(velocity, torch.tensor([[[0.0, 0.0], [0.0, 5.0]]]))


@pytest.mark.parametrize(
    ("speeds", "other", "changes", "expected"),
    [
        # head-on at 2 m/s, 0.2 m beside each other: nearest between two points of the trace
        ((2.0, -2.0), (0.6, 0.2), {}, -0.1),
        # someone of 0.5 m whom nothing moves comes 0.8 m nearer, to 1.2 m between centres
        ((0.0, -2.0), (2.0, 0.0), {"radius": torch.tensor([[[0.15, 0.5]]]), "moved": FIRST}, 0.55),
        # a layer holds two back who ask to walk into each other; whom nothing moves stays
        ((0.0, 0.0), (1.0, 0.0), {}, 0.7),
        ((0.0, 0.0), (1.0, 0.0), {"asked": torch.tensor([[[[1.0, 0.0], [-1.0, 0.0]]]])}, -0.1),
        ((0.0, 0.0), (1.0, 0.0), {"asked": torch.tensor([[[[1.0, 0.0], [-1.0, 0.0]]]]), "moved": FIRST}, 0.3),
    ],
)
def test_gaps_are_between_bodies_along_what_is_asked_for(speeds, other, changes, expected):
    velocity = torch.tensor([[[[speeds[0], 0.0], [speeds[1], 0.0]]]])
    segment = made(velocity, torch.tensor([[[0.0, 0.0], other]]))._replace(**changes)
    assert least_gaps(segment)[0, 0].tolist() == pytest.approx([expected] * 2, abs=1e-4)


def test_those_who_meet_lack_more_than_those_who_walk_together():
    """0.4 m beside each other: towards each other at 1 m/s each, at 0.5 m/s each, and side by side."""
    start, speeds = torch.tensor([[[0.0, 0.0], [0.2, 0.4]]]), [(1.0, -1.0), (0.5, -0.5), (1.0, 1.0)]
    for (mine, theirs), lacking in zip(speeds, (0.3, 0.15, 0.0), strict=True):
        velocity = torch.tensor([[[[mine, 0.0], [theirs, 0.0]]]])
        met, plain = (least_gaps(made(velocity, start), margin) for margin in (0.3, 0.0))
        assert (plain - met)[0, 0].tolist() == pytest.approx([lacking, lacking], abs=1e-3)


def test_no_person_is_near_who_is_alone_or_gone():
    alone = made(torch.ones(2, 1, 1, 2), torch.zeros(1, 1, 2))
    assert bool((least_gaps(alone) > 100).all()) and least_gaps(alone).shape == alone.moved.shape
    segment = two(0.2)
    present = segment.present.clone()
    present[1:, :, 1] = False
    left = least_gaps(segment._replace(present=present))
    assert left[0, 0, 0] == pytest.approx(-0.1, abs=1e-4) and bool((left[1:, 0, 0] > 40).all())


def test_walls_are_felt_along_the_way_that_was_asked_for():
    bank = MapBank([rectangles(HALL + wall((2.0, -8.0), (2.0, 8.0), 0.2), 0.05, name="one wall")])
    segment = made(torch.tensor([[[[2.0, 0.0]]]]), torch.tensor([[[1.0, 0.0]]]), bank)
    distance = wall_distances(segment, bank)[0, 0, 0]
    assert distance.tolist() == pytest.approx([0.7, 0.5, 0.3, 0.1], abs=0.03)


def test_time_is_lost_by_those_who_stand_not_who_walk():
    """The lost time of a person who stands for T steps is 0.4 (1 + ... + T) / T; the mean over two people."""
    segment = standing_and_walking()
    assert float(lost_seconds(segment)) == pytest.approx(1.0 / 2)
    assert float(lost_seconds(segment, torch.tensor([[7.0, 3.0]]))) == pytest.approx(3.0 / 2)
    assert lost_seconds(segment._replace(moved=~segment.moved)).item() == 0.0
    early = two(5.0, steps=4)
    moved = early.moved.clone()
    moved[2:, :, 0] = False  # left after two steps: the rest is to their credit
    moved[:, :, 2] = False  # was never moved by the policy
    # of steps 3 and 4, mean over the segment and two
    assert float(lost_seconds(early._replace(moved=moved))) == pytest.approx((0.4 + 0.8) / 4 / 2)


def test_the_trait_weighs_ones_own_time():
    segment, cost = standing_and_walking(), LoopLosses(assertiveness=0.5, progress=6.0)
    segment = segment._replace(progress=0 * segment.progress)  # both stand
    calm, eager = (cost(segment, NOWHERE, torch.tensor([[[z], [0.0]]]))["progress"] for z in (-1.0, 1.0))
    ratio = (float(eager) - 0.5) / (float(calm) - 0.5)  # the other one's share is 1 / 2
    assert ratio == pytest.approx(torch.tensor(1.0).exp().item(), rel=1e-3)
    never = LoopLosses(assertiveness=0.0, progress=6.0)(segment, NOWHERE, torch.ones(1, 2, 1))
    assert float(never["progress"]) == 1.0


@pytest.mark.parametrize("name", ["person_distance", "walls", "overspeed", "effort", "progress"])
def test_a_term_is_proportional_to_its_weight(name):
    grid = rectangles(HALL + wall((-8.0, -0.3), (8.0, -0.3), 0.2), 0.05, name="beside")
    bank, segment = MapBank([grid]), two(0.25)
    faster = segment._replace(
        asked=1.5 * segment.asked,
        action=1.5 * segment.action,
        map_id=torch.tensor([grid.map_id]),
        progress=0.5 * segment.progress,
    )
    once, twice, never = (LoopLosses(**{name: weight})(faster, bank)[name] for weight in (1.0, 2.0, 0.0))
    assert float(once) > 0 and float(twice) == pytest.approx(2 * float(once)) and float(never) == 0
    with pytest.raises(UserError, match=rf"{name} -1.*at least 0"):
        LoopLosses(**{name: -1})


def test_people_and_corrections_cost_what_they_are_by_hand():
    """Two of three are 0.3 m apart, 0.2 m short of the margin; one of three is held back by 0.5 m/s."""
    segment, short = two(0.3), 10 * 2 / 3 * (0.2 + 0.04)
    for margin in (0.0, 0.3):  # they walk together
        term = LoopLosses(person_distance=10.0, people_margin=0.2, meeting_margin=margin)(segment, NOWHERE)
        assert float(term["person_distance"]) == pytest.approx(short, abs=1e-3)
        assert "safety_correction" not in term
    asked = two(5.0).asked.clone()
    asked[:, :, 0, 0] += 0.5
    result = LoopLosses(safety_correction=3.0)(two(5.0)._replace(asked=asked), NOWHERE)
    assert float(result["safety_correction"]) == pytest.approx(3.0 * 0.5 / 3, abs=1e-3)
    velocity = torch.ones(2, 1, 2, 2).requires_grad_()  # nobody is corrected
    still = made(velocity, torch.tensor([[[0.0, 0.0], [0.0, 5.0]]]))
    LoopLosses(safety_correction=1.0)(still, NOWHERE)["safety_correction"].backward()
    assert velocity.grad is not None and bool(velocity.grad.isfinite().all())


def test_dawdling_does_not_thin_out_what_went_wrong():
    """A contact costs the same whether people leave after it or stand about."""
    segment = two(0.3, steps=4)
    far = segment.trace.clone()
    far[1:, :, 1] += 20.0
    stays = segment._replace(trace=far)
    moved = stays.moved.clone()
    moved[1:] = False
    left = stays._replace(moved=moved, present=moved)
    result = [LoopLosses()(one, NOWHERE)["person_distance"] for one in (stays, left)]
    assert float(result[0]) == pytest.approx(float(result[1]))


def test_people_from_the_front_should_be_on_the_preferred_side():
    """Two meet head-on, each 0.2 m to the other's left: who likes to pass on the left lacks 0.7 m."""
    velocity = torch.tensor([[[[1.0, 0.0], [-1.0, 0.0]]]])
    start = torch.tensor([[[0.0, 0.0], [2.0, 0.2]]])
    segment = made(velocity, start, goal=start + 4 * velocity)
    turned = made(velocity @ TURN, start @ TURN, goal=(start + 4 * velocity) @ TURN)
    for like, lacks in ((9.0, 0.7), (-9.0, 0.3), (0.0, 0.0)):
        for one in (segment, turned):
            result = wrong_side(one, torch.tensor([[like, like]]))
            assert result.flatten().tolist() == pytest.approx([lacks, lacks], abs=1e-4)
    assert not bool(wrong_side(segment._replace(present=FIRST), torch.full((1, 2), 9.0)).any())
    close = made(velocity, 0.3 * start, goal=0.3 * start + 4 * velocity)  # 0.6 m before, 0.06 m beside
    assert wrong_side(close, torch.full((1, 2), 9.0))[0, 0].tolist() == pytest.approx([0.56, 0.56], abs=1e-4)
    behind = segment._replace(goal=start - 4 * velocity)
    assert not bool(wrong_side(behind, torch.ones(1, 2)).any())
    liked = torch.tensor([[[0.0, 9.0], [0.0, 9.0]]])
    term = LoopLosses(passing_side=3.0)(segment, NOWHERE, liked)["passing_side"]
    assert float(term) == pytest.approx(2.1)
    for losses, noise in ((LoopLosses(), liked), (LoopLosses(passing_side=3.0), liked[..., :1])):
        assert "passing_side" not in losses(segment, NOWHERE, noise)


class Straight:
    """Walks as the planner says, times a number that has a gradient."""

    def __init__(self) -> None:
        self.factor = torch.tensor(1.0, requires_grad=True)

    def __call__(self, seen: TensorDictBase) -> TensorDictBase:
        seen["agents", "action"] = self.factor * seen["agents", "desired_velocity"]
        return seen

    def slope(self, ends: Tensor) -> float:
        """Return how much further people are at the end of a segment, metres, if they walk faster."""
        ends.abs().sum().backward()
        assert self.factor.grad is not None
        return float(self.factor.grad)


def test_a_segment_is_what_the_environment_does():
    policy, env = Straight(), make_env("door", 3, seed=4)
    segment = unrolled(env, policy, env.reset(), 5)
    again = make_env("door", 3, seed=4)
    with torch.no_grad():
        seen = again.reset()
        for step in range(5):
            # with gradients torch walks, without them compiled loops
            begin, seen = seen["agents", "history"][:, :, -1], again.step(policy(seen))["next"]
            torch.testing.assert_close(segment.trace[step, :, :, 0], begin, atol=1e-4, rtol=0)
            walked = seen["agents", "info", "trace"]
            torch.testing.assert_close(segment.trace[step, :, :, 1:], walked, atol=1e-4, rtol=0)
            assert torch.equal(segment.agent_contact[step], seen["agents", "info", "agent_contact"].any(-1))
    assert segment.done.tolist() == [False] * 3


def test_gradients_flow_through_all_that_is_seen_until_it_is_cut():
    """Walking faster moves the last position by the whole way, and after the cut by the rest of it."""
    env = make_env("door:offset=0,jitter=0", 2, seed=4)
    for seen, steps in ((env.reset, 2), (env.cut, 1)):
        policy = Straight()
        segment = unrolled(env, policy, seen(), steps)
        end = segment.trace[-1, ..., -1, 0]
        way = float((end - segment.trace[0, ..., 0, 0]).abs().sum().detach())
        slope = policy.slope(end)
        assert abs(slope) == pytest.approx(way, rel=0.02) and (slope < 0 or steps == 1)


def test_scenes_that_are_over_stay_as_they_are():
    env = make_env("circle:people=2", 2, seed=1)
    segment = unrolled(env, Straight(), env.reset(), 60)
    assert bool(segment.done.all()) and len(segment.moved) < 60
    for scene, steps in enumerate(segment.moved.any(2).sum(0).tolist()):
        rest = segment.moved[steps:, scene], segment.progress[steps:, scene]
        assert not any(bool(values.any()) for values in rest)


def test_every_weight_has_a_gradient_through_an_episode():
    model = pedzoo.load("sgan_goal.eth_ucy").train()
    env = make_env("door", 4, seed=0)
    segment = unrolled(env, pedzoo.policy(model), env.reset(), 6)
    torch.stack(list(LoopLosses()(segment, env.bank).values())).sum().backward()
    for name, parameter in model.named_parameters():
        assert parameter.grad is not None and bool(parameter.grad.isfinite().all()), name


COURSES = [Course("door", 3, 1.0), Course("circle:people=3", 2, 3.0)]


def walked(
    courses: CourseSampler, updates: range, per_epoch: int = 4, keep: int = 2, steps: int = 3
) -> list[TensorDict]:
    """Return what is seen at the beginning of each update's segment."""
    result = []
    for update in updates:
        running = courses.at(update, update // per_epoch)
        seen = running.begin(keep)
        result.append(seen.clone())
        running.end(unrolled(running.env, Straight(), seen, steps).done)
    return result


def places(seen: list[TensorDict]) -> list[Tensor]:
    return [one["agents", "history"][:, :, -1] for one in seen]


def test_a_mixture_that_goes_on_equals_an_uninterrupted_one():
    whole = places(walked(CourseSampler(COURSES, 5), range(12)))
    later = places(walked(CourseSampler(COURSES, 5), range(8, 12)))
    assert all(torch.equal(one, other) for one, other in zip(whole[8:], later, strict=True))
    other = places(walked(CourseSampler(COURSES, 6), range(12)))
    same = (one.shape == two.shape and torch.equal(one, two) for one, two in zip(whole, other, strict=True))
    assert not all(same)


def test_courses_have_their_shares_of_the_updates():
    courses = CourseSampler(COURSES, 0)
    doors = sum(courses.at(update, 0).course.scenario == "door" for update in range(400))
    assert 70 < doors < 130


def test_episodes_go_on_until_they_are_over_or_too_old():
    first, second, third, _, fifth = places(
        walked(CourseSampler([Course("door", 2)], 0), range(5), per_epoch=100)
    )
    assert not torch.equal(first, second)  # three steps on
    assert bool(((second - first).norm(dim=-1) < 3 * 0.4 * 1.9).all())
    assert bool(((third - second).norm(dim=-1) > 0).all()) and not torch.equal(third, fifth)
    seen = walked(CourseSampler([Course("door", 2)], 0), range(5), per_epoch=100, steps=1)
    keys = [one["scene_key"][:, 0].tolist() for one in seen]
    assert keys[0] == keys[1] != keys[2] == keys[3] != keys[4]


def test_scenes_that_are_over_are_replaced_and_others_go_on():
    running = CourseSampler([Course("door", 3)], 0).at(0, 0)
    before = running.begin(9)["scene_key"][:, 0].clone()
    running.end(torch.tensor([False, True, False]))
    after = running.begin(9)["scene_key"][:, 0]
    assert (before == after).tolist() == [True, False, True]


@pytest.mark.parametrize("options", [{"scenes": 0}, {"share": 0.0}])
def test_courses_that_give_no_training_are_refused(options):
    with pytest.raises(UserError, match="expected at least 1"):
        Course("door", **options)
    with pytest.raises(UserError, match="no courses"):
        CourseSampler([], 0)
    with pytest.raises(UserError, match="unknown planner 'astr': did you mean 'astar'"):
        CourseSampler([Course("door", planner="astr")], 0)


def test_people_of_a_course_go_the_ways_of_its_planner() -> None:
    ways = []
    for planner in ("astar", "shortest"):
        course = Course("door:offset=0.6,jitter=0,people=1", 1, planner=planner)
        ways.append(CourseSampler([course], 0).at(0, 0).begin(9)["agents", "desired_velocity"])
    assert not torch.allclose(*ways, atol=0.05)


def test_cut_needs_scenes_and_reset_keeps_the_others():
    with pytest.raises(UserError, match=r"reset\(\) first"):
        make_env("door").cut()
    env = make_env("door", 2, seed=0)
    env.step(Straight()(env.reset()))
    cut = env.cut()
    after = env.reset(TensorDict({"_reset": torch.tensor([[True], [False]])}, [2]))
    same = (after["agents", "history"] == cut["agents", "history"]).flatten(1).all(1)
    assert same.tolist() == [False, True]
