"""The safety layer on blended velocities: true paths, compiled loops against torch, and who goes first."""

from collections.abc import Callable
from typing import Any

import pytest
import torch
from helpers.crowds import around, contacts, crowd, steps
from torch import Tensor

from pedzoo.core.geometry import blended, identity_pose, limit_speed, limited
from pedzoo.core.types import BODY_RADIUS, STEP_SECONDS, TRACE_SECONDS
from pedzoo.eval.rollout import rollout
from pedzoo.maps.bank import MapBank
from pedzoo.maps.plans import rectangles, room, wall
from pedzoo.maps.walls import LocalWalls
from pedzoo.metrics.arrival import deadlock, success
from pedzoo.models.architectures import social_walker
from pedzoo.policies.clearance import (
    BARELY,
    BEYOND,
    LEAST_SHARE,
    MARGIN,
    ProposedSteps,
    kept_clear_in_torch,
    precedence,
)
from pedzoo.policies.load import load_policy
from pedzoo.policies.safety_layer import kept_clear, safe
from pedzoo.sim.make import make_env


def path_of(steps: ProposedSteps, step: Tensor) -> Tensor:
    """Return where the simulation takes people (40, B, A, 2), metres, every 0.01 s."""
    velocity: Any = steps.velocity
    top = steps.longest / STEP_SECONDS
    each = limited(blended(velocity.movedim(-1, 0), limited(step.movedim(-1, 0) / STEP_SECONDS, top), 4), top)
    moved = (0.1 * TRACE_SECONDS * each.repeat_interleave(10, 1)).cumsum(1)
    return steps.position + moved.movedim(0, -1)


def test_a_walk_is_what_the_simulation_makes_of_a_step() -> None:
    """After 0.1, 0.3 and 0.4 s; agents that the policy does not move go straight."""
    asked = crowd(6)
    step = limit_speed(asked.step, asked.longest)
    result = asked.integrate(step).movedim(1, -1)
    assert torch.allclose(asked.position + result, path_of(asked, step)[[9, 29, 39]], atol=1e-5)
    still = asked._replace(moved=torch.zeros_like(asked.moved)).integrate(step).movedim(1, -1)
    assert torch.allclose(still, torch.stack((step / 4, 3 * step / 4, step)))


@pytest.mark.parametrize("people", [2, 6, 20])
def test_on_blended_paths_people_do_not_touch(people: int) -> None:
    """However they come: they stop, where nothing else helps. No other scene of the batch matters."""
    asked = crowd(people)
    result = kept_clear(asked)
    for walk, bound in ((asked.step, 0.15), (result, 2 * BODY_RADIUS - 1e-3)):
        path = path_of(asked, walk)
        apart = torch.cdist(path, path) + 9 * torch.eye(people)
        touching = apart.amin((0, 2, 3)) < bound
        assert bool(touching.any()) == (bound < 0.2)
    assert (result.norm(dim=-1) <= asked.longest + 1e-5).all()
    assert torch.equal(kept_clear(ProposedSteps(*(part[3:4] for part in asked[:9]))), result[3:4])


def test_on_blended_paths_no_person_touches_a_wall() -> None:
    """People who run at a wall and are told to turn along it: the old velocity still leads into it."""
    asked, walls = crowd(1, scenes=512), around(512)
    gap, _ = walls.closest(asked.position)
    free = gap[:, 0] > BODY_RADIUS
    for walk, touches in ((asked.step, True), (kept_clear(asked, walls), False)):
        path = path_of(asked, walk).movedim(0, 1).flatten(1, 2)
        gap, _ = walls.closest(path)
        assert bool((gap[free] < BODY_RADIUS - 2e-3).any()) is touches


@pytest.mark.parametrize("people", [1, 2, 5, 12, 20])
@pytest.mark.parametrize("walled", [False, True])
def test_compiled_loops_say_what_torch_says(people: int, walled: bool) -> None:
    """Crowds of mixed radii with absent and uncontrolled agents and robots, in the open and at a door.

    Gradients too, by places, steps and velocities. Torch is in single precision: it may matter at corners.
    """
    asked, walls = mixed_crowd(people, walled)
    random = torch.Generator().manual_seed(people)
    weight = torch.randn(asked.step.shape, generator=random) * asked.present.unsqueeze(-1)
    result = []
    for answer in (kept_clear, kept_clear_in_torch):
        inputs = [part.clone().requires_grad_() for part in (asked.position, asked.step, asked.velocity)]
        stored = answer(asked._replace(position=inputs[0], step=inputs[1], velocity=inputs[2]), walls)
        result.append((stored.detach(), torch.autograd.grad((stored * weight).sum(), inputs)))
    (compiled, slopes), (in_torch, expected) = result
    alike = ((compiled - in_torch).norm(dim=-1).where(asked.present, 0.0) < 1e-4).all(1)
    assert alike.float().mean() >= (0.95 if walled else 0.99)
    for slope, other in zip(slopes, expected, strict=True):
        close = ((slope - other).abs() < 1e-3 + 1e-3 * other.abs()).flatten(1).all(1)
        assert close[alike].float().mean() >= (0.95 if walled else 0.99)
    assert torch.equal(kept_clear(asked, walls), compiled)


def mixed_crowd(people: int, walled: bool) -> tuple[ProposedSteps, LocalWalls | None]:
    """Return 200 scenes; with walls, only agents outside them are there."""
    asked = crowd(people, scenes=200, mixed=True)
    if not walled:
        return asked, None
    walls = around(200)
    selected = walls.select(torch.arange(200).repeat_interleave(people))
    free = (selected.closest(asked.position.flatten(0, 1))[0] > 0).view(asked.present.shape)
    return asked._replace(present=asked.present & free, moved=asked.moved & free), walls


@pytest.mark.parametrize("answer", [kept_clear, kept_clear_in_torch])
def test_gradients_of_a_person_at_a_wall(answer: Callable[..., Tensor]) -> None:
    """Towards the wall nothing is left of a step; along it all is, and where they stand makes no difference.

    Before the wall, by a step that is cut short, the place counts: nearer by 9 mm, shorter by 8 mm.
    """
    place = torch.tensor([[[-0.15, 1.5]], [[-0.4, 1.5]]], requires_grad=True)
    step = torch.tensor([[[0.1, 0.2]], [[0.3, 0.2]]], requires_grad=True)
    stored = answer(steps(place, step, 1.15), around(2))
    across = torch.autograd.grad(stored[..., 0].sum(), (place, step), retain_graph=True)
    along = torch.autograd.grad(stored[..., 1].sum(), (place, step))
    close: dict[str, Any] = {"atol": 1e-4, "rtol": 0}
    torch.testing.assert_close(across[0], torch.tensor([[[0.0, 0.0]], [[-1 / BEYOND, 0.0]]]), **close)
    torch.testing.assert_close(across[1], torch.zeros(2, 1, 2), **close)
    torch.testing.assert_close(along[0], torch.zeros(2, 1, 2), **close)
    torch.testing.assert_close(along[1], torch.tensor([[[0.0, 1.0]], [[0.0, 1.0]]]), **close)


def test_top_speeds_have_gradients_and_strided_inputs_are_read() -> None:
    """A step that is too long is as long as the top speed allows; torch has gradients of it."""
    asked = crowd(1, scenes=4)
    longest = asked.longest.clone().requires_grad_()
    stored = kept_clear(asked._replace(longest=longest, step=9 * asked.step))
    stored.norm(dim=-1).sum().backward()
    assert longest.grad is not None and torch.allclose(longest.grad, torch.ones(4, 1))
    asked = crowd(5, mixed=True)
    strided: Any = [torch.stack((part, part), -1)[..., 0] for part in asked if part is not None]
    assert torch.equal(kept_clear(ProposedSteps(*strided)), kept_clear(asked))


def test_gradients_through_walks_are_finite() -> None:
    """People who stand, who go on as they go, who touch, and who are at walls."""
    asked = crowd(12, mixed=True)
    velocity: Any = asked.velocity
    velocity[:16] = 0.0
    velocity[16:32] = asked.step[16:32] / STEP_SECONDS
    step = asked.step.clone().requires_grad_()
    kept_clear(asked._replace(step=step), around(64)).square().sum().backward()
    assert step.grad is not None and step.grad.isfinite().all()


def test_the_torch_path_reads_nothing_back_to_the_host() -> None:
    """On the meta device there is nothing to read: every look at a value raises."""
    env = make_env("door:people=4,width=0.8", 3, "torch")
    seen: Any = env.reset(seed=0).select("agents", "maps", "map_id", "scene_pose").to("meta")
    step = torch.zeros(3, 4, 2, device="meta")
    assert safe(seen, step).shape == (3, 4, 2)


NARROW = rectangles(
    [*room((-3.0, -3.0), (3.0, 3.0), 0.1), *wall((0.0, -3.0), (0.0, 3.0), 0.1, doors=[(3.0, 0.5)])], 0.05
)
"""A wall along x = 0 with a door of 0.5 m in its middle."""


def order(place: list[list[float]], step: list[list[float]], waits: bool = False) -> float:
    """Return the precedence of the first of two; the second has the higher rank."""
    at = torch.tensor(place).T.unsqueeze(1)
    wait = torch.full((1, 2, 2), waits)
    rank = torch.tensor([[0.0, 1.0]])
    result = precedence(
        torch.tensor([step]), at.unsqueeze(3) - at.unsqueeze(2), wait, rank, torch.zeros(1, 2, 2)
    )
    assert torch.equal(result, -result.mT)
    return float(result[0, 0, 1])


def test_people_ahead_go_first() -> None:
    """One behind the other; towards one place, the nearer, in proportion up to 0.2 m; head-on one barely."""
    assert order([[0.0, 0.0], [-0.6, 0.1]], [[0.3, 0.0], [0.5, 0.0]]) == 1
    nearer, farther = [[-0.9, 0.0], [0.0, -1.0]], [[0.5, 0.0], [0.0, 0.5]]
    assert order(nearer, farther) == pytest.approx(0.5 * 0.1 / 0.2)
    assert order([[-0.4, 0.0], [0.4, 0.0]], [[0.5, 0.0], [-0.5, 0.0]]) == pytest.approx(-BARELY)


def test_of_two_who_wait_one_goes_first() -> None:
    """Head-on the one with the higher rank; else the one who is ahead, however little."""
    assert order([[-0.4, 0.0], [0.4, 0.0]], [[0.5, 0.0], [-0.5, 0.0]], waits=True) == pytest.approx(-1)
    assert order([[0.0, 0.0], [-0.1, 0.4]], [[0.5, 0.0], [0.5, 0.0]], waits=True) == 1


@pytest.mark.parametrize("answer", [kept_clear, kept_clear_in_torch])
def test_people_behind_make_way(answer: Callable[..., Tensor]) -> None:
    """In the open: of the correction of two, one behind the other, the person behind makes nearly all."""
    result = answer(steps([[0.0, 0.0], [-0.5, 0.0]], [[0.1, 0.0], [0.5, 0.0]], 1.15), None)
    lacks = (2 * BODY_RADIUS + MARGIN - (0.5 - BEYOND * 0.4)) / BEYOND
    assert float(result[0, 0, 0]) == pytest.approx(0.1 + LEAST_SHARE * lacks, abs=5e-3)
    assert float(result[0, 1, 0]) == pytest.approx(0.5 - (1 - LEAST_SHARE) * lacks, abs=5e-3)


@pytest.mark.parametrize(
    ("scenario", "decisions"),
    [
        ("room_exit:people=14,entering=0,width=0.5", 200),
        ("door:people=12,from_right=0,abreast=3,width=0.46,resolution=0.01", 200),
        ("door:people=6,width=0.5,jitter=0,speed_std=0,offset=0", 250),
    ],
)
def test_no_queue_locks(scenario: str, decisions: int) -> None:
    """All get through the narrowest doors, without touching others or walls; also where two groups meet."""
    policy = load_policy("go_to_goal:safety=true")
    assert contacts(policy, scenario, 2, decisions, clearance=0.2) == (0, 0, 0)


@pytest.mark.parametrize("people", ["people=4", "people=4,from_right=1", "people=6,from_right=0"])
def test_no_social_walker_is_held_up_at_a_door_but_by_halts(people: str, monkeypatch) -> None:
    """Those who stand for 5 s do so by themselves: with halts some do, without them none."""
    scenario = f"door:{people},width=[0.7,0.8,0.9,1.0,1.1,1.2],offset=[-0.4,0,0.3,0.6]"
    monkeypatch.setattr(social_walker, "RARE_HALT", 50.0)
    walked, _ = rollout("social_walker.styled", scenario, "compiled", 60, seed=7)
    assert float(deadlock(walked).above.sum()) == 0
    assert torch.equal(success(walked).above, success(walked).below)


@pytest.mark.parametrize("rank", [[0.0, 1.0], [1.0, 0.0]])
def test_two_who_wait_head_on_in_a_narrow_door_pass(rank: list[float]) -> None:
    """One lets the other through, in either order of the two."""
    bank, waits = MapBank([NARROW]), torch.ones(1, 2, dtype=torch.bool)
    walls = bank.walls_around(torch.tensor([bank.grids[0].map_id]), identity_pose(1))
    more = {"waits": waits, "rank": torch.tensor([rank]), "velocity": torch.zeros(1, 2, 2)}
    asked = steps([[-0.4, 0.0], [0.4, 0.0]], [[0.4, 0.0], [-0.4, 0.0]], 1.15, **more)
    move = kept_clear(asked, walls)[0, :, 0]
    first, second = (move[0], -move[1]) if rank[0] else (-move[1], move[0])
    assert first > second + 0.1
