"""The kernel is pure: nothing is read back to the host, and no tensor lies on another device."""

from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any

import pytest
import torch
from helpers.crowds import ROOM, crowd
from helpers.pretend import DEVICE, HostReadError, MixedDevicesError, There, pretended
from helpers.scenes import prepared
from torch import Tensor

from pedzoo.core.geometry import identity_pose
from pedzoo.maps.bank import MapBank
from pedzoo.policies.clearance import ProposedSteps, kept_clear_in_torch
from pedzoo.policies.safety_layer import yielding
from pedzoo.sim import kernel
from pedzoo.sim.env import PedestrianEnv
from pedzoo.sim.make import make_env
from pedzoo.sim.physics.compiled import Compiled
from pedzoo.sim.scenario import rules_of

SCENES = ("door:people=4", "goals:map=apartment.7,people=5,goals=2,pool=6")


class PartByPart(Compiled):
    """Moves bodies by loops, and leaves all else of a decision to the kernel."""

    def decide(self, *given: object) -> None:
        """Return nothing."""


@pytest.fixture(params=SCENES)
def env(request) -> Iterator[PedestrianEnv]:
    yield make_env(request.param, num_envs=3)


@pytest.mark.parametrize("wheels", [False, True])
def test_a_step_reads_nothing_back_to_the_host(env: PedestrianEnv, wheels: bool) -> None:
    """Tensors on ``meta`` have shapes and no values: whatever asks for one raises."""
    action = env.reset()["agents", "desired_velocity"].to("meta").requires_grad_(not wheels)
    rules = replace(env.rules, wheels=wheels)
    after, guidance, events = kernel.step(env.state.to("meta"), action, env.physics, rules)
    for tensor in (*after, *guidance, *events):
        assert tensor.device.type == "meta"
    for mine, theirs in zip(after, env.state, strict=True):
        assert mine.shape == theirs.shape and mine.dtype == theirs.dtype
    if not wheels:
        events.reward.sum().backward()
        assert action.grad is not None and action.grad.shape == action.shape


@pytest.mark.parametrize("leave", [True, False])
def test_compiled_decision_is_that_of_the_kernel(env: PedestrianEnv, leave: bool) -> None:
    """Also with goals reached, agents that set out or leave, deadlines and commands that fail."""
    env.reset()
    state = env.state
    rules = replace(env.rules, leave=leave, keep_goal=not leave)
    waits = torch.zeros_like(state.controlled)
    waits[:, 0] = True
    state = state._replace(
        controlled=state.controlled & ~waits,
        stands=torch.where(waits, 1.9, state.stands),
        deadline=torch.where(torch.arange(state.mask.shape[1]) % 2 == 1, 1.0, state.deadline),
    )
    generator = torch.Generator().manual_seed(0)
    guidance, part_by_part = rules.guidance(state), PartByPart(env.bank)
    reached = 0
    for number in range(40):
        action = guidance.desired_velocity + 0.3 * torch.randn(*state.mask.shape, 2, generator=generator)
        if number == 3:
            action[1, 1] = torch.nan
        mine = kernel.step(state, action, env.physics, rules)
        other = kernel.step(state, action, part_by_part, rules)
        torch.testing.assert_close((mine[0], mine[2]), (other[0], other[2]))
        state, guidance, events = other
        reached = max(reached, int(events.reached.max()))
    assert reached > 0 and state.failed.tolist() == [False, True, False] and state.overdue.any()


def test_strides_of_a_state_do_not_matter() -> None:
    """A state whose agents lie across scenes in memory is walked as one without gaps."""
    env = make_env("circle:people=3", 4, "compiled")
    env.reset()
    state, commands = env.state, 0.5 * torch.ones(*env.state.mask.shape, 2)
    crossed = state._replace(**{
        name: value.transpose(0, 1).contiguous().transpose(0, 1)
        for name, value in state._asdict().items()
        if isinstance(value, torch.Tensor) and value.shape[:2] == state.mask.shape
    })  # fmt: skip
    plain, other = (kernel.step(one, commands, env.physics, env.rules)[0] for one in (state, crossed))
    for name, value in plain._asdict().items():
        if isinstance(value, torch.Tensor):
            assert torch.equal(value, getattr(other, name)), name


# On a pretended device


PLACES = {
    "planner and walls": "goals:map=apartment.7,people=5,goals=2,pool=6",
    "several maps": "door:people=4,width=[0.8,1.2]",
    "no walls": "circle:people=4",
    "people who stand": "standing:people=2",
    "people who wait": "waiting",
    "a queue": "queue",
    "playback": "replay:simulated=one,share=0.1",
}


def values(tensor: Tensor) -> Tensor:
    """Return what a tensor on the device holds."""
    assert isinstance(tensor, There)
    return tensor.here


@pytest.mark.parametrize(("scenes", "wheels"), [*((name, False) for name in PLACES), ("several maps", True)])
def test_steps_on_a_device_are_those_on_the_cpu(scenes: str, wheels: bool, monkeypatch) -> None:
    """Four decisions, some of them into walls and others. After the first one nothing is copied there."""
    env = make_env(prepared(PLACES[scenes]), num_envs=3, physics="torch")
    action = 1.2 * env.reset(seed=0)["agents", "desired_velocity"]
    rules = replace(env.rules, wheels=wheels)
    expected, moved = env.state, 0.0
    monkeypatch.setattr(env.prepared.planner, "compiled", False)
    with pretended():
        state, asked = env.state.to(DEVICE), action.to(DEVICE)
        remote = replace(rules_of(env.prepared, rules.ticks, rules.substeps, DEVICE), wheels=wheels)
        kernel.step(state, asked, env.physics, remote)
    for _ in range(4):
        with pretended(copies=False):
            state, guidance, events = kernel.step(state, asked, env.physics, remote)
            asked = 1.2 * guidance.desired_velocity
        before = expected.position
        expected, guided, seen = kernel.step(expected, action, env.physics, rules)
        action = 1.2 * guided.desired_velocity
        moved += float((expected.position - before).abs().max())
        for mine, other in zip((*state, *events), (*expected, *seen), strict=True):
            torch.testing.assert_close(values(mine), other, atol=1e-4, rtol=1e-4, equal_nan=True)
    assert moved > 0.3


@pytest.mark.parametrize("walled", [False, True])
def test_the_safety_layer_on_a_device(walled: bool) -> None:
    """Its look ahead for robots, too."""
    steps = crowd(6, scenes=20, mixed=True)
    bank = MapBank([ROOM] if walled else [])
    plan, pose = torch.full((20,), ROOM.map_id if walled else -1), identity_pose(20)
    result = []
    for device in (torch.device("cpu"), DEVICE):
        with pretended():
            asked = ProposedSteps(*(part.to(device) for part in steps if part is not None))
            walls = bank.to(device).walls_around(plan.to(device), pose.to(device))
        with pretended(copies=False):
            result.append(kept_clear_in_torch(asked._replace(step=yielding(asked, walls)), walls))
    assert (result[0] - steps.step).abs().max() > 0.1
    torch.testing.assert_close(values(result[1]), result[0], atol=1e-4, rtol=1e-4)


ONES = torch.ones(2)

FAULTS: dict[str, tuple[Callable[[Tensor], object], type[Exception]]] = {
    "bool": (lambda place: bool(place.isfinite().all()), HostReadError),
    "item": (lambda place: place[0, 0, 0].item(), HostReadError),
    "nonzero": (lambda place: (place > 0).nonzero(), HostReadError),
    "a mask": (lambda place: place[place > 0], HostReadError),
    "cpu": (lambda place: place.cpu(), HostReadError),
    "a constant elsewhere": (lambda place: place + ONES, MixedDevicesError),
    "an index elsewhere": (lambda place: place[:, torch.tensor([0, 1])], MixedDevicesError),
    "a new tensor elsewhere": (lambda place: place.minimum(torch.zeros(2)), MixedDevicesError),
    "a copy": (lambda place: place + ONES.to(place), MixedDevicesError),
    "numbers from a list": (lambda place: torch.tensor([1.0, 2.0], device=place.device), MixedDevicesError),
}


@pytest.fixture(scope="module")
def begun() -> tuple[PedestrianEnv, Any, Tensor]:
    """An environment, its state on the device, and an action."""
    env = make_env("door:people=4", num_envs=2, physics="torch")
    action = env.reset(seed=0)["agents", "desired_velocity"]
    with pretended():
        state, asked = env.state.to(DEVICE), action.to(DEVICE)
        kernel.step(state, asked, env.physics, env.rules)
    return env, state, asked


@pytest.mark.parametrize("fault", FAULTS)
def test_a_fault_in_a_step_raises(fault: str, begun: tuple[PedestrianEnv, Any, Tensor]) -> None:
    """What the tests above would say if it were in the step."""
    env, state, asked = begun
    does, error = FAULTS[fault]

    def guidance(state: Any) -> Any:
        does(state.position)
        return env.rules.guidance(state)

    faulty = replace(env.rules, guidance=guidance)
    with pretended(copies=False), pytest.raises(error):
        kernel.step(state, asked, env.physics, faulty)
