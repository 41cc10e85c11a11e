"""The walker whose every step is drawn, and its noise."""

from __future__ import annotations

import math

import pytest
import torch
from torch import Tensor

from pedzoo.core.batch import agents_of
from pedzoo.core.geometry import rotate
from pedzoo.models.architectures.social_walker import SocialWalker
from pedzoo.models.blocks.people.style import jitter_of, kinks_of, style_of
from pedzoo.models.blocks.timed_noise import timed_noise
from tests.helpers.batches import changed, make_batch

AGENTS = torch.arange(400).expand(5, -1)
KEYS = torch.arange(5).view(-1, 1)


def noise_at(step: int, *periods: float) -> Tensor:
    return timed_noise(KEYS, AGENTS, torch.full((5, 1), 0.4 * step), periods)


def test_noise_is_normal_at_every_time() -> None:
    values = torch.stack([noise_at(step, math.inf, 8.0, 2.0, 0.4) for step in range(0, 60, 7)])
    assert values.mean((0, 1, 2)).abs().max() < 0.1
    torch.testing.assert_close(values.std((1, 2)).mean(0), torch.ones(4), atol=0.05, rtol=0)


def test_noise_changes_as_slowly_as_its_period_says() -> None:
    lasts, slow, fast, new = (
        noise_at(4, math.inf, 20.0, 2.0, 0.4) * noise_at(5, math.inf, 20.0, 2.0, 0.4)
    ).mean((0, 1))
    assert float(lasts) == pytest.approx(1.0, abs=0.1)
    assert 0.8 < float(slow) < 1.2 and 0.6 < float(fast) < 0.99
    assert abs(float(new)) < 0.1
    assert torch.equal(noise_at(4, math.inf), noise_at(50, math.inf))


def test_noise_depends_on_scene_and_agent_alone() -> None:
    some = timed_noise(KEYS[2:], AGENTS[2:, 7:9], torch.full((3, 1), 1.6), (math.inf, 4.0, 0.4))
    assert torch.equal(some, noise_at(4, math.inf, 4.0, 0.4)[2:, 7:9])


def test_style_of_a_straight_walk_and_of_a_shaky_one() -> None:
    line = torch.stack((0.5 * torch.arange(8.0), torch.zeros(8)), -1)
    shaken = line + 0.03 * torch.randn(8, 2, generator=torch.Generator().manual_seed(0))
    calm, shaky = style_of(line), style_of(shaken)
    assert calm[:3].tolist() == pytest.approx([math.log(0.003) + 3.5] * 3, abs=1e-3)
    assert float(calm[3]) == 1.5 and float(shaky[3]) < 0.0
    assert (shaky[:3] > calm[:3] + 1).all()
    assert float(shaky[4]) < 0.0  # what is shaken goes back


def drawn(seed: int = 0) -> SocialWalker:
    torch.manual_seed(seed)
    model = SocialWalker.of(walls=False)
    with torch.no_grad():
        model.head.weight.mul_(5.0)
    return model.eval()


GATE, HALT = -6, -3
"""Numbers of the noise."""

NOISE = torch.randn(1, 5, SocialWalker.noise_dim, generator=torch.Generator().manual_seed(1))


@torch.no_grad()
def test_turning_and_moving_a_scene_turns_its_steps() -> None:
    model, batch = drawn(), make_batch((5,), padding=0.0)
    turn, shift = torch.tensor([math.cos(1.1), math.sin(1.1)]), torch.tensor([3.0, -2.0])
    agents = agents_of(batch)
    places = {key: rotate(agents[key], turn) + shift for key in ("history", "goal")}
    wanted = rotate(agents["desired_velocity"], turn)
    there = model.next_steps(changed(batch, **places, desired_velocity=wanted), NOISE, 3, 8)
    torch.testing.assert_close(
        there, rotate(model.next_steps(batch, NOISE, 3, 8), turn), atol=1e-4, rtol=1e-3
    )


@torch.no_grad()
def test_the_order_of_people_does_not_matter() -> None:
    model, batch, order = drawn(), make_batch((5,)), torch.tensor([3, 0, 4, 1, 2])
    agents = agents_of(batch)
    swapped = changed(batch, **{key: agents[key][:, order] for key in map(str, agents.keys())})
    steps = model.next_steps(swapped, NOISE[:, order], 2, 8)
    torch.testing.assert_close(steps, model.next_steps(batch, NOISE, 2, 8)[:, order], atol=1e-5, rtol=1e-4)


@torch.no_grad()
def test_padding_does_not_matter() -> None:
    model, alone, padded = drawn(), make_batch((3,), seed=2), make_batch((3, 5), seed=2)
    agents, wide = agents_of(alone), agents_of(padded)
    same = changed(
        padded,
        **{
            key: torch.cat((torch.cat((agents[key], wide[key][:1, 3:]), 1), wide[key][1:]))
            for key in map(str, wide.keys())
        },
    )
    one = model.next_steps(alone, NOISE[:, :3], 2, 8)
    both = model.next_steps(same, NOISE.repeat(2, 1, 1), 2, 8)
    torch.testing.assert_close(both[:1, :3], one, atol=1e-5, rtol=1e-4)
    assert not both[0, 3:].any()


@pytest.mark.parametrize("part", ["style", "held", "halts", "step_noise", "companions"])
@torch.no_grad()
def test_every_part_can_be_left_out(part: str) -> None:
    batch = make_batch((5,))
    torch.manual_seed(0)
    whole = SocialWalker.of(walls=False)
    without = SocialWalker.of(walls=False, **{part: False})
    without.load_state_dict(whole.state_dict())
    noise = NOISE.clone()
    noise[:, 0, HALT], noise[:, 1, GATE] = -20.0, -20.0
    assert not torch.equal(whole.next_steps(batch, noise, 1, 8), without.next_steps(batch, noise, 1, 8))


@torch.no_grad()
def test_a_held_velocity_goes_on() -> None:
    model, batch = drawn(), make_batch((5,))
    noise = NOISE.clone()
    noise[..., GATE] = -20.0  # shut
    noise[..., HALT] = 20.0
    noise[..., -2:] = 0.0
    history = agents_of(batch)["history"]
    step = model.next_steps(batch, noise, 1, 8)[:, :, 0]
    torch.testing.assert_close(step, history[:, :, -1] - history[:, :, -2], atol=1e-4, rtol=0)


@torch.no_grad()
def test_a_halt_is_one_at_once() -> None:
    noise = NOISE.clone()
    noise[..., HALT] = -20.0
    assert not drawn().next_steps(make_batch((5,)), noise, 1, 8).any()


def test_noise_of_places_changes_velocities() -> None:
    values = torch.stack([noise_at(step, -0.4) for step in range(40)])
    assert float(values.std()) == pytest.approx(1.0, abs=0.02)
    # velocities are sums of such changes, and these do not drift: they are white noise of places
    assert float(values.cumsum(0).cumsum(0).diff(dim=0).std()) < 1.5
    assert float((values[1:] * values[:-1]).mean()) == pytest.approx(-4 / 6, abs=0.05)


def test_jitter_is_that_of_the_smaller_changes() -> None:
    """Tracks in straight pieces have kinks and no jitter."""
    bent = torch.stack((0.5 * torch.arange(8.0), 0.5 * (torch.arange(8.0) - 4).clamp_min(0)), -1)
    style = style_of(bent)
    assert float(kinks_of(style)) == pytest.approx(0.5 / 6, abs=1e-5)
    assert float(jitter_of(style)) == pytest.approx(0.0, abs=1e-6)
