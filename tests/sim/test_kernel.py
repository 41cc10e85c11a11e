"""The kernel is pure: it runs where nothing can be read back to the host."""

from collections.abc import Iterator
from dataclasses import replace

import pytest
import torch

from pedzoo.sim import kernel
from pedzoo.sim.env import PedestrianEnv
from pedzoo.sim.make import make_env
from pedzoo.sim.physics.compiled import Compiled

SCENES = ("door:people=4", "goals:map=apartment.7,people=5,goals=2,pool=6")


class PartByPart(Compiled):
    """Moves bodies by loops, and leaves all else of a decision to the kernel."""

    def decide(self, *given: object) -> None:
        """Return nothing."""


@pytest.fixture(params=SCENES)
def env(request: pytest.FixtureRequest) -> Iterator[PedestrianEnv]:
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
