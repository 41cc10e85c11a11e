"""Every model of the registry, a newcomer's too: shapes, padding, modes, state, arguments."""

from __future__ import annotations

from typing import cast

import pytest
import torch
from helpers.batches import changed, make_batch, random_weights

from pedzoo.core.batch import agents_of, goals_of
from pedzoo.core.errors import UserError
from pedzoo.core.registry import MODELS
from pedzoo.models.base import Forecaster
from pedzoo.models.blocks.people import linear_extrapolation
from pedzoo.models.zoo.loading import build, config_of, load


def made(name: str) -> Forecaster:
    """Return a model of default arguments, bound, with random weights."""
    model = random_weights(cast("Forecaster", MODELS.get(name)()))
    return model.eval()


EVERY = pytest.mark.parametrize("name", MODELS.names())


@EVERY
@pytest.mark.parametrize("steps", [1, 12])
def test_samples_and_mode(name: str, steps: int) -> None:
    model, batch = made(name), make_batch((3, 1, 4))
    there = agents_of(batch)["mask"]
    for answer, samples in ((model.sample(batch, 5, steps), 5), (model.mode(batch, steps), 1)):
        assert answer.shape == (3, samples, 4, steps, 2)
        assert answer.isfinite().all()  # padding is NaN in the batch and zero in the answer
        assert (answer.transpose(1, 2)[~there] == 0).all()
        assert (answer.transpose(1, 2)[there] != 0).any()
    assert torch.equal(model.mode(batch, steps), model.mode(batch, steps))


@EVERY
def test_stochastic_says_whether_samples_differ(name: str) -> None:
    model, batch = made(name), make_batch((3, 2))
    first, second = model.sample(batch, 2, 8, torch.Generator().manual_seed(0)).unbind(1)
    assert torch.equal(first, second) != model.stochastic
    again = model.sample(batch, 2, 8, torch.Generator().manual_seed(0))[:, 0]
    assert torch.equal(first, again)
    if not model.stochastic:
        assert torch.equal(model.mode(batch, 8)[:, 0], first)


@EVERY
def test_predictions_do_not_look_at_the_answer(name: str) -> None:
    """Without the truth `mode`, `sample` and `next_steps` answer the same."""
    model, batch = made(name), make_batch((3, 2), padding=0.0)
    blind = batch.clone()
    for key in ("future", "future_valid"):
        del blind["agents", key]
    noise = torch.zeros(2, 3, model.noise_dim)
    for seen, unseen in (
        (model.mode(batch, 8), model.mode(blind, 8)),
        (model.next_steps(batch, noise, 1, 8), model.next_steps(blind, noise, 1, 8)),
        tuple(model.sample(b, 2, 8, torch.Generator().manual_seed(0)) for b in (batch, blind)),
    ):
        assert torch.equal(seen, unseen)


@EVERY
def test_sampling_leaves_the_batch_alone(name: str) -> None:
    model, batch = made(name), make_batch((3, 2), padding=0.0)
    before = batch.clone()
    model.sample(batch, 2, 8)
    assert bool((batch == before).all())  # type: ignore[union-attr]
    assert set(batch.keys(True)) == set(before.keys(True))


@EVERY
def test_built_again_from_its_config_and_state(name: str) -> None:
    model, batch = made(name), make_batch((3, 2))
    other = build(config_of(model))
    assert type(other) is type(model) and other.config == model.config
    other.load_state_dict(model.state_dict())
    seeds = [torch.Generator().manual_seed(1) for _ in range(2)]
    assert torch.equal(other.eval().sample(batch, 2, 8, seeds[0]), model.sample(batch, 2, 8, seeds[1]))


@EVERY
def test_a_goal_is_asked_for_where_it_is_needed(name: str) -> None:
    model, batch = made(name), make_batch((2,), goal=False)
    if "goal" in model.needs:
        with pytest.raises(UserError, match="needs a goal"):
            model.sample(batch, 1, 8)
    else:
        assert model.sample(batch, 1, 8).isfinite().all()


@EVERY
def test_loss_trains_or_says_that_there_is_nothing_to_train(name: str) -> None:
    model, batch = made(name), make_batch((3, 2))
    if any(True for _ in model.parameters()):
        gradients = torch.autograd.grad(model.loss(batch), list(model.parameters()), allow_unused=True)
        assert any(g is not None and g.abs().max() > 0 for g in gradients)
    else:
        with pytest.raises(UserError, match="nothing to train"):
            model.loss(batch)


def test_constant_velocity_by_hand() -> None:
    batch = make_batch((2,))
    step = agents_of(batch)["history"][0, 1, 7] - agents_of(batch)["history"][0, 1, 6]
    path = load("constant_velocity").mode(batch, 5)[0, 0, 1]
    assert torch.equal(path, step.expand(5, 2))


@pytest.mark.parametrize("name", ["straight_line", "bent_line"])
def test_lines_end_at_a_timed_goal_and_do_not_overshoot_others(name: str) -> None:
    batch = make_batch((4,))
    agents = agents_of(batch)
    here = agents["history"][:, :, -1]
    speed = torch.linalg.vector_norm(here - agents["history"][:, :, -2], dim=-1)
    direction = torch.nn.functional.normalize(agents["goal"] - here, dim=-1)
    near, far = here + 0.3 * direction, here + 100 * direction
    for goal in (near, far):
        moved = load(name, "window_end").mode(changed(batch, goal=goal), 8).sum(-2)[:, 0]
        torch.testing.assert_close(here + moved, goal)
    walked = load(name, "destination").mode(changed(batch, goal=near), 8).sum(-2)[:, 0]
    torch.testing.assert_close(here + walked, near)
    walked = load(name, "destination").mode(changed(batch, goal=far), 8).sum(-2)[:, 0]
    torch.testing.assert_close(walked, 8 * speed.unsqueeze(-1) * direction)


def test_bent_line_starts_with_the_last_velocity() -> None:
    """The quadratic p8 + k v + (k / T)^2 (g - p8 - T v)."""
    last, goal = torch.tensor([0.3, -0.1]), torch.tensor([2.0, 2.0])
    path = linear_extrapolation.bent_line(last, goal, 4, timed=True)
    by_hand = [k * last + (k / 4) ** 2 * (goal - 4 * last) for k in range(5)]
    torch.testing.assert_close(path, torch.stack(by_hand).diff(dim=0))


def test_a_goal_at_ones_feet_divides_nothing_by_zero() -> None:
    nowhere = torch.zeros(3, 2)
    for line in (linear_extrapolation.straight_line, linear_extrapolation.bent_line):
        path = line(torch.tensor([0.4, 0.0]).expand(3, 2), nowhere, 8, timed=False)
        assert path.isfinite().all()
        torch.testing.assert_close(path.sum(-2), nowhere)


def test_message_of_a_missing_goal_names_the_model() -> None:
    with pytest.raises(UserError, match="BentLine needs a goal"):
        goals_of(make_batch((2,), goal=False), "BentLine")
