"""Pieces of episodes and what they cost: hand-made ways, real environments, and where gradients go."""

from __future__ import annotations

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


def made(velocity: Tensor, start: Tensor, bank: MapBank | None = None, **more: Any) -> Segment:
    """Return the segment of people who walk with ``velocity`` (T, B, A, 2) from ``start`` (B, A, 2)."""
    moved = 0.4 * velocity.cumsum(0)
    begin = start + torch.cat((torch.zeros_like(moved[:1]), moved[:-1]))
    part = torch.linspace(0, 0.4, 5).view(-1, 1)
    there = torch.ones(velocity.shape[:3], dtype=torch.bool)
    scenes = velocity.shape[1]
    fields = {
        "trace": begin.unsqueeze(-2) + velocity.unsqueeze(-2) * part,
        "asked": velocity,
        "action": velocity,
        "velocity": velocity,
        "progress": 0.4 * velocity[..., 0],
        "pref_speed": torch.ones(velocity.shape[:3]),
        "radius": torch.full(velocity.shape[:3], 0.15),
        "goal": begin,
        "present": there,
        "moved": there,
        "agent_contact": ~there,
        "wall_contact": ~there,
        "done": torch.zeros(scenes, dtype=torch.bool),
        "map_id": torch.full((scenes,), bank.grids[0].map_id if bank else -1),
        "pose": identity_pose(scenes),
    }
    return Segment(**fields | more)


def two(distance: float, steps: int = 3) -> Segment:
    """Return two people who walk along x side by side, ``distance`` apart, and a third far away."""
    velocity = torch.tensor([1.0, 0.0]).expand(steps, 1, 3, 2)
    return made(velocity, torch.tensor([[[0.0, 0.0], [0.0, distance], [0.0, 50.0]]]))


def test_people_are_as_near_as_between_two_trace_points() -> None:
    """Two who meet head-on at 2 m/s, 0.2 m beside each other, half way between two points of the trace."""
    velocity = torch.tensor([[[[2.0, 0.0], [-2.0, 0.0]]]])
    result = least_gaps(made(velocity, torch.tensor([[[0.0, 0.0], [0.6, 0.2]]])))
    assert result.shape == (1, 1, 2) and result[0, 0].tolist() == pytest.approx([-0.1, -0.1], abs=1e-4)


def test_gaps_are_between_bodies_of_their_own_sizes_to_the_end_of_a_step() -> None:
    """Someone of 0.5 m whom nothing moves comes 0.8 m nearer in the step, to 1.2 m between centres."""
    velocity = torch.tensor([[[[0.0, 0.0], [-2.0, 0.0]]]])
    segment = made(velocity, torch.tensor([[[0.0, 0.0], [2.0, 0.0]]]), radius=torch.tensor([[[0.15, 0.5]]]))
    segment = segment._replace(moved=torch.tensor([[[True, False]]]), asked=torch.zeros(1, 1, 2, 2))
    assert least_gaps(segment)[0, 0].tolist() == pytest.approx([0.55, 0.55], abs=1e-4)


def test_people_are_as_near_as_they_ask_to_be_and_others_as_they_are() -> None:
    """A layer holds two back who would walk into each other; the one whom nothing moves stays where it is."""
    held = made(torch.zeros(1, 1, 2, 2), torch.tensor([[[0.0, 0.0], [1.0, 0.0]]]))
    asks = torch.tensor([[[[1.0, 0.0], [-1.0, 0.0]]]])
    moved = torch.tensor([[[True, False]]])
    assert least_gaps(held)[0, 0, 0] == pytest.approx(0.7, abs=1e-4)
    assert least_gaps(held._replace(asked=asks))[0, 0, 0] == pytest.approx(-0.1, abs=1e-4)
    assert least_gaps(held._replace(asked=asks, moved=moved))[0, 0, 0] == pytest.approx(0.3, abs=1e-4)


def test_those_who_meet_lack_more_than_those_who_walk_together() -> None:
    """0.4 m beside each other: towards each other at 1 m/s each, at 0.5 m/s each, and side by side."""
    start, speeds = torch.tensor([[[0.0, 0.0], [0.2, 0.4]]]), [(1.0, -1.0), (0.5, -0.5), (1.0, 1.0)]
    for (mine, theirs), lacking in zip(speeds, (0.3, 0.15, 0.0), strict=True):
        velocity = torch.tensor([[[[mine, 0.0], [theirs, 0.0]]]])
        met, plain = (least_gaps(made(velocity, start), margin) for margin in (0.3, 0.0))
        assert (plain - met)[0, 0].tolist() == pytest.approx([lacking, lacking], abs=1e-3)
    term = LoopLosses(person_distance=10.0, people_margin=0.2, meeting_margin=0.3)
    assert float(term(two(0.3), MapBank([]))["person_distance"]) == pytest.approx(
        10 * (0.2 + 0.04) * 2 / 3, abs=1e-3
    )


def test_what_a_safety_layer_changed_costs() -> None:
    """One of three is held back by 0.5 m/s in all steps."""
    segment = two(5.0)
    asked = segment.asked.clone()
    asked[:, :, 0, 0] += 0.5
    result = LoopLosses(safety_correction=3.0)(segment._replace(asked=asked), MapBank([]))[
        "safety_correction"
    ]
    assert float(result) == pytest.approx(3.0 * 0.5 / 3, abs=1e-3)
    assert "safety_correction" not in LoopLosses()(segment, MapBank([]))


def test_no_person_is_near_who_is_alone_or_gone() -> None:
    alone = made(torch.ones(2, 1, 1, 2), torch.zeros(1, 1, 2))
    assert bool((least_gaps(alone) > 100).all()) and least_gaps(alone).shape == alone.moved.shape
    segment = two(0.2)
    present = segment.present.clone()
    present[1:, :, 1] = False
    left = least_gaps(segment._replace(present=present))
    assert left[0, 0, 0] == pytest.approx(-0.1, abs=1e-4) and bool((left[1:, 0, 0] > 40).all())


def test_walls_are_felt_along_the_way_that_was_asked_for() -> None:
    grid = rectangles(HALL + wall((2.0, -8.0), (2.0, 8.0), 0.2), 0.05, name="one wall")
    bank = MapBank([grid])
    segment = made(torch.tensor([[[[2.0, 0.0]]]]), torch.tensor([[[1.0, 0.0]]]), bank)
    distance = wall_distances(segment, bank)[0, 0, 0]
    assert distance.tolist() == pytest.approx([0.7, 0.5, 0.3, 0.1], abs=0.03)


def test_time_is_lost_by_those_who_stand_and_not_by_those_who_walk() -> None:
    """The lost time of a person who stands for T steps is 0.4 (1 + ... + T) / T; the mean over two people."""
    velocity = torch.zeros(4, 1, 2, 2)
    velocity[:, :, 0, 0] = 1.0
    segment = made(velocity, torch.tensor([[[0.0, 0.0], [0.0, 5.0]]]))
    assert float(lost_seconds(segment)) == pytest.approx(1.0 / 2)
    weight = torch.tensor([[7.0, 3.0]])
    assert float(lost_seconds(segment, weight)) == pytest.approx(3.0 / 2)


def test_who_arrived_early_has_the_rest_to_their_credit() -> None:
    segment = two(5.0, steps=4)
    moved = segment.moved.clone()
    moved[2:, :, 0] = False  # left after two steps
    moved[:, :, 2] = False  # was never moved by the policy
    late = lost_seconds(segment._replace(moved=moved))
    assert float(late) == pytest.approx(
        (0.4 + 0.8) / 4 / 2
    )  # of steps 3 and 4, mean over the segment and two


@pytest.mark.parametrize("name", ["person_distance", "walls", "overspeed", "effort", "progress"])
def test_a_weight_of_nothing_takes_its_term_away_and_twice_the_weight_doubles_it(name: str) -> None:
    grid = rectangles(HALL + wall((-8.0, -0.3), (8.0, -0.3), 0.2), 0.05, name="beside")
    bank = MapBank([grid])
    segment = two(0.25)
    faster = segment._replace(
        asked=1.5 * segment.asked,
        action=1.5 * segment.action,
        map_id=torch.tensor([grid.map_id]),
        progress=0.5 * segment.progress,
    )
    once, twice, never = (LoopLosses(**{name: weight})(faster, bank)[name] for weight in (1.0, 2.0, 0.0))
    assert float(once) > 0 and float(twice) == pytest.approx(2 * float(once)) and float(never) == 0


def test_people_cost_what_they_lack_in_distance() -> None:
    """Two of three people are 0.3 m apart, 0.2 m short of the margin: 0.2 + 0.04 each."""
    term = LoopLosses(person_distance=10.0, people_margin=0.2)(two(0.3), MapBank([]))["person_distance"]
    assert float(term) == pytest.approx(10 * 2 / 3 * (0.2 + 0.04), rel=1e-4)


def test_dawdling_does_not_thin_out_what_went_wrong() -> None:
    """A contact costs the same whether people leave after it or stand about."""
    segment = two(0.3, steps=4)
    far = segment.trace.clone()
    far[1:, :, 1] += 20.0
    stays = segment._replace(trace=far)
    moved = stays.moved.clone()
    moved[1:] = False
    left = stays._replace(moved=moved, present=moved)
    result = [LoopLosses()(one, MapBank([]))["person_distance"] for one in (stays, left)]
    assert float(result[0]) == pytest.approx(float(result[1]))


def test_the_trait_weighs_ones_own_time() -> None:
    velocity = torch.zeros(4, 1, 2, 2)
    segment = made(velocity, torch.tensor([[[0.0, 0.0], [0.0, 5.0]]]))
    cost = LoopLosses(assertiveness=0.5, progress=6.0)
    calm, eager = (cost(segment, MapBank([]), torch.tensor([[[z], [0.0]]]))["progress"] for z in (-1.0, 1.0))
    ratio = (float(eager) - 0.5) / (float(calm) - 0.5)  # the other one's share is 1 / 2
    assert ratio == pytest.approx(torch.tensor(1.0).exp().item(), rel=1e-3)
    assert (
        float(
            LoopLosses(assertiveness=0.0, progress=6.0)(segment, MapBank([]), torch.ones(1, 2, 1))["progress"]
        )
        == 1.0
    )


def test_who_comes_from_the_front_should_be_on_the_side_that_one_likes() -> None:
    """Two meet head-on, each 0.2 m to the other's left: who likes to pass on the left lacks 0.7 m."""
    velocity = torch.tensor([[[[1.0, 0.0], [-1.0, 0.0]]]])
    start = torch.tensor([[[0.0, 0.0], [2.0, 0.2]]])
    segment = made(velocity, start)
    segment = segment._replace(goal=start + 4 * velocity)
    for like, lacks in ((9.0, 0.7), (-9.0, 0.3), (0.0, 0.0)):
        result = wrong_side(segment, torch.tensor([[like, like]]))
        assert result[0, 0].tolist() == pytest.approx([lacks, lacks], abs=1e-4)
        turned = made(velocity @ TURN, start @ TURN, goal=(start + 4 * velocity) @ TURN)
        assert wrong_side(turned, torch.tensor([[like, like]])).flatten().tolist() == pytest.approx(
            [lacks, lacks], abs=1e-4
        )
    gone = segment._replace(present=torch.tensor([[[True, False]]]))
    assert not bool(wrong_side(gone, torch.full((1, 2), 9.0)).any())
    close = made(velocity, 0.3 * start, goal=0.3 * start + 4 * velocity)  # 0.6 m before, 0.06 m beside
    assert wrong_side(close, torch.full((1, 2), 9.0))[0, 0].tolist() == pytest.approx([0.56, 0.56], abs=1e-4)
    behind = segment._replace(goal=start - 4 * velocity)
    assert not bool(wrong_side(behind, torch.ones(1, 2)).any())


def test_sides_count_by_their_weight_where_people_have_preferences() -> None:
    velocity = torch.tensor([[[[1.0, 0.0], [-1.0, 0.0]]]])
    start = torch.tensor([[[0.0, 0.0], [2.0, 0.2]]])
    segment = made(velocity, start, goal=start + 4 * velocity)
    liked, bank = torch.tensor([[[0.0, 9.0], [0.0, 9.0]]]), MapBank([])
    assert float(LoopLosses(passing_side=3.0)(segment, bank, liked)["passing_side"]) == pytest.approx(2.1)
    for losses, noise in ((LoopLosses(), liked), (LoopLosses(passing_side=3.0), liked[..., :1])):
        assert "passing_side" not in losses(segment, bank, noise)


def test_losses_are_finite_where_no_one_moves_or_is_corrected() -> None:
    velocity = torch.zeros(2, 1, 2, 2).add(1.0).requires_grad_()
    segment = made(velocity, torch.tensor([[[0.0, 0.0], [0.0, 5.0]]]))
    LoopLosses(safety_correction=1.0)(segment, MapBank([]))["safety_correction"].backward()
    assert velocity.grad is not None and bool(velocity.grad.isfinite().all())
    assert lost_seconds(segment._replace(moved=~segment.moved)).item() == 0.0


def test_a_negative_weight_is_refused() -> None:
    with pytest.raises(UserError, match=r"walls -1.*at least 0"):
        LoopLosses(walls=-1)


class Straight:
    """Walks as the planner says, times a number that has a gradient."""

    def __init__(self) -> None:
        """Begin with 1."""
        self.factor = torch.tensor(1.0, requires_grad=True)

    def __call__(self, seen: TensorDictBase) -> TensorDictBase:
        """Write the action."""
        seen["agents", "action"] = self.factor * seen["agents", "desired_velocity"]
        return seen


def test_a_segment_is_what_the_environment_does() -> None:
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


def test_gradients_flow_through_all_that_is_seen_until_it_is_cut() -> None:
    """Walking faster moves the last position by the whole way, and after the cut by the rest of it."""
    policy, env = Straight(), make_env("door:offset=0,jitter=0", 2, seed=4)
    segment = unrolled(env, policy, env.reset(), 2)
    way = segment.trace[-1, ..., -1, 0] - segment.trace[0, ..., 0, 0]
    segment.trace[-1, ..., -1, 0].abs().sum().backward()
    assert policy.factor.grad is not None
    assert float(policy.factor.grad) == pytest.approx(-float(way.abs().sum().detach()), rel=0.02)
    policy = Straight()
    after = unrolled(env, policy, env.cut(), 1)
    rest = after.trace[0, ..., -1, 0] - after.trace[0, ..., 0, 0]
    after.trace[-1, ..., -1, 0].abs().sum().backward()
    assert policy.factor.grad is not None
    assert abs(float(policy.factor.grad)) == pytest.approx(float(rest.abs().sum().detach()), rel=0.02)


def test_scenes_that_are_over_stay_as_they_are() -> None:
    env = make_env("circle:people=2", 2, seed=1)
    segment = unrolled(env, Straight(), env.reset(), 60)
    assert bool(segment.done.all()) and len(segment.moved) < 60
    ended = segment.moved.any(2).sum(0)
    for scene, steps in enumerate(ended.tolist()):
        assert not bool(segment.moved[steps:, scene].any()) and not bool(
            segment.progress[steps:, scene].any()
        )


def test_every_weight_of_a_network_has_a_gradient_through_an_episode() -> None:
    model = pedzoo.load("sgan_goal_map.eth_ucy").train()
    env = make_env("door", 4, seed=0)
    walker = pedzoo.policy(model)
    segment = unrolled(env, walker, env.reset(), 6)
    torch.stack(list(LoopLosses()(segment, env.bank).values())).sum().backward()
    for name, parameter in model.named_parameters():
        assert parameter.grad is not None and bool(parameter.grad.isfinite().all()), name


COURSES = [Course("door", 3, 1.0), Course("circle:people=3", 2, 3.0)]


def walked(courses: CourseSampler, updates: range, per_epoch: int = 4, keep: int = 2) -> list[Tensor]:
    """Return where people are at the beginning of each update's segment."""
    result = []
    for update in updates:
        running = courses.at(update, update // per_epoch)
        seen = running.begin(keep)
        result.append(seen["agents", "history"][:, :, -1])
        running.end(unrolled(running.env, Straight(), seen, 3).done)
    return result


def test_a_mixture_that_goes_on_does_what_an_uninterrupted_one_would() -> None:
    whole = walked(CourseSampler(COURSES, 5), range(12))
    later = walked(CourseSampler(COURSES, 5), range(8, 12))
    assert all(torch.equal(one, other) for one, other in zip(whole[8:], later, strict=True))
    other = walked(CourseSampler(COURSES, 6), range(12))
    assert any(
        one.shape != two.shape or not torch.equal(one, two) for one, two in zip(whole, other, strict=True)
    )


def test_courses_have_their_shares_of_the_updates() -> None:
    courses = CourseSampler(COURSES, 0)
    doors = sum(courses.at(update, 0).course.scenario == "door" for update in range(400))
    assert 70 < doors < 130


def test_episodes_go_on_until_they_are_over_or_too_old() -> None:
    courses = CourseSampler([Course("door", 2)], 0)
    places = walked(courses, range(5), per_epoch=100, keep=2)
    first, second, third, _, fifth = places
    assert not torch.equal(first, second)  # three steps on
    moved = (second - first).norm(dim=-1)
    assert bool((moved < 3 * 0.4 * 1.9).all())
    assert bool(((third - second).norm(dim=-1) > 0).all()) and not torch.equal(third, fifth)
    keys = []
    courses = CourseSampler([Course("door", 2)], 0)
    for update in range(5):
        running = courses.at(update, 0)
        seen = running.begin(2)
        keys.append(seen["scene_key"][:, 0].tolist())
        running.end(unrolled(running.env, Straight(), seen, 1).done)
    assert keys[0] == keys[1] != keys[2] == keys[3] != keys[4]


def test_scenes_that_are_over_are_replaced_and_others_go_on() -> None:
    running = CourseSampler([Course("door", 3)], 0).at(0, 0)
    before = running.begin(9)["scene_key"][:, 0].clone()
    running.end(torch.tensor([False, True, False]))
    after = running.begin(9)["scene_key"][:, 0]
    assert (before == after).tolist() == [True, False, True]


@pytest.mark.parametrize("options", [{"scenes": 0}, {"share": 0.0}])
def test_courses_that_give_no_training_are_refused(options: dict[str, Any]) -> None:
    with pytest.raises(UserError, match="expected at least 1"):
        Course("door", **options)
    with pytest.raises(UserError, match="no courses"):
        CourseSampler([], 0)


def test_cut_needs_scenes() -> None:
    with pytest.raises(UserError, match=r"reset\(\) first"):
        make_env("door").cut()


def test_reset_after_a_cut_keeps_the_other_scenes() -> None:
    env = make_env("door", 2, seed=0)
    seen = env.reset()
    env.step(Straight()(seen))
    cut = env.cut()
    flags = TensorDict({"_reset": torch.tensor([[True], [False]])}, [2])
    after = env.reset(flags)
    same = (after["agents", "history"] == cut["agents", "history"]).flatten(1).all(1)
    assert same.tolist() == [False, True]
