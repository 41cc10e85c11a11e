"""Every model of the registry, a newcomer's too: shapes, padding, modes, state, arguments."""

from typing import Any, cast

import numpy as np
import pytest
import torch
from helpers.batches import changed, make_batch, on_plan, random_weights
from tensordict import NonTensorData, TensorDict

from pedzoo.core import geometry
from pedzoo.core.batch import agents_of, maps_of
from pedzoo.core.errors import UserError
from pedzoo.core.registry import MODELS
from pedzoo.maps.bank import MapBank
from pedzoo.maps.grid import OCCUPIED, OccupancyGrid
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
def test_samples_and_mode(name, steps):
    model, batch = made(name), make_batch((3, 1, 4))
    there = agents_of(batch)["mask"]
    for answer, samples in ((model.sample(batch, 5, steps), 5), (model.mode(batch, steps), 1)):
        assert answer.shape == (3, samples, 4, steps, 2)
        assert answer.isfinite().all()  # padding is NaN in the batch and zero in the answer
        assert (answer.transpose(1, 2)[~there] == 0).all()
        assert (answer.transpose(1, 2)[there] != 0).any()
    assert torch.equal(model.mode(batch, steps), model.mode(batch, steps))


@EVERY
def test_stochastic_says_whether_samples_differ(name):
    model, batch = made(name), make_batch((3, 2))
    first, second = model.sample(batch, 2, 8, torch.Generator().manual_seed(0)).unbind(1)
    assert torch.equal(first, second) != model.stochastic
    again = model.sample(batch, 2, 8, torch.Generator().manual_seed(0))[:, 0]
    assert torch.equal(first, again)
    if not model.stochastic:
        assert torch.equal(model.mode(batch, 8)[:, 0], first)


@EVERY
def test_predictions_do_not_look_at_the_answer(name):
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
def test_sampling_leaves_the_batch_alone(name):
    model, batch = made(name), make_batch((3, 2), padding=0.0)
    before = batch.clone()
    model.sample(batch, 2, 8)
    assert bool((batch == before).all())  # type: ignore[union-attr]
    assert set(batch.keys(True)) == set(before.keys(True))


@EVERY
def test_built_again_from_its_config_and_state(name):
    model, batch = made(name), make_batch((3, 2))
    other = build(config_of(model))
    assert type(other) is type(model) and other.config == model.config
    other.load_state_dict(model.state_dict())
    seeds = [torch.Generator().manual_seed(1) for _ in range(2)]
    assert torch.equal(other.eval().sample(batch, 2, 8, seeds[0]), model.sample(batch, 2, 8, seeds[1]))


@EVERY
def test_a_goal_is_asked_for_where_it_is_needed(name):
    model, batch = made(name), make_batch((2,), goal=False)
    if "goal" in model.needs:
        with pytest.raises(UserError, match=r"needs a goal.*--data\.goal"):
            model.sample(batch, 1, 8)
    else:
        assert model.sample(batch, 1, 8).isfinite().all()


@EVERY
def test_loss_trains_or_says_that_there_is_nothing_to_train(name):
    model, batch = made(name), make_batch((3, 2))
    if any(True for _ in model.parameters()):
        gradients = torch.autograd.grad(model.loss(batch), list(model.parameters()), allow_unused=True)
        assert any(g is not None and g.abs().max() > 0 for g in gradients)
    else:
        with pytest.raises(UserError, match="nothing to train"):
            model.loss(batch)


GOAL = {"goal_dim": 4, "goal_protocol": "window_end"}
AIMED = {"goal": True, "goal_protocol": "destination"}
VARIANTS: dict[str, tuple[str, dict[str, Any]]] = {
    "sgan": ("sgan", {}),
    "pooling": ("sgan", {"bottleneck_dim": 3}),
    "own": ("sgan", {"frame": "heading", "bottleneck_dim": 3, "activation": "leaky_relu"}),
    "paper": (
        "sgan",
        {
            "frame": "heading",
            "bottleneck_dim": 3,
            "conditions": "decoder",
            "map": "rings",
            "map_dim": 5,
            **GOAL,
        },
    ),
    "heading": ("sgan", {"frame": "heading", "residual": "constant_velocity"}),
    "bent": ("sgan", {"frame": "heading", "residual": "bent_line", "map": "patch", **GOAL}),
    "way": ("sgan", {"frame": "way", "map": "rings", "approach_dim": 6, "trait_dim": 7, **GOAL}),
    "vrnn": ("social_vrnn", {}),
    "blind vrnn": ("social_vrnn", {"map": None, "others_dim": 0}),
    "anchors": ("anchors", {}),
    "anchor_mlp": ("anchor_mlp", {}),
    "anchor_net": ("anchor_net", {"map": "patch", **AIMED}),
    "walker": ("social_walker", {"walls": False}),
    "company": ("social_walker", {"walls": False, "groups": True, "lasting_halts": True}),
    "follower": ("social_walker", {"hidden_dim": 0, "style_prior": True, "avoids": True, "follows": True}),
}
KINDS = pytest.mark.parametrize("kind", VARIANTS)


def walks(kind: str) -> tuple[Forecaster, TensorDict, torch.Tensor]:
    """Return a model that has learned something, scenes beside a wall, and noise for all slots."""
    name, options = VARIANTS[kind]
    torch.manual_seed(0)
    model = cast("Forecaster", MODELS.get(name).of(**options)).eval()  # type: ignore[attr-defined]
    model.prepare([make_batch((9, 12, 7), seed=seed) for seed in range(4)])
    random = torch.Generator().manual_seed(0)
    with torch.no_grad():
        for parameter in model.parameters():
            parameter += 0.1 * torch.randn(parameter.shape, generator=random)
    cells = np.zeros((60, 60), dtype=np.uint8)
    cells[:, 40:44] = OCCUPIED
    bank = MapBank([OccupancyGrid(cells, 0.2, (-6.0, -6.0, 0.3), name="room")])
    batch = on_plan(make_batch((5, 1, 3)), bank)
    if kind == "follower":
        agents_of(batch)["history"] *= 0.12  # close behind each other
    agents_of(batch)["group"] = torch.tensor([[4, -1, 4, 7, 7]]).expand(3, 5).clone()
    return model, batch, torch.randn(3, 5, model.noise_dim, generator=random)


@KINDS
@torch.no_grad()
def test_the_order_of_people_does_not_matter(kind):
    model, batch, noise = walks(kind)
    batch, noise, order = cast("TensorDict", batch[:1]), noise[:1], torch.tensor([3, 0, 4, 1, 2])
    agents = agents_of(batch)
    swapped = changed(batch, **{key: agents[key][:, order] for key in map(str, agents.keys())})
    steps = model.next_steps(batch, noise, 8, 8)
    again = model.next_steps(swapped, noise[:, order], 8, 8)
    torch.testing.assert_close(again, steps[:, order], atol=2e-4, rtol=1e-4)
    assert not torch.allclose(again, steps, atol=1e-2)
    if "group" in agents.keys():  # the names of companies do not matter either
        renamed = changed(batch, group=torch.where(agents["group"] < 0, -1, 9 - agents["group"]))
        assert torch.equal(model.next_steps(renamed, noise, 8, 8), steps)


@KINDS
@torch.no_grad()
def test_padding_and_other_scenes_do_not_matter(kind):
    model, batch, noise = walks(kind)
    steps, modes = model.next_steps(batch, noise, 8, 8), model.mode(batch, 8)[:, 0]
    assert steps.isfinite().all() and not steps[1, 1:].any()
    for scene, people in enumerate((5, 1, 3)):
        part = cast("TensorDict", batch[scene : scene + 1])
        parts: dict[str, Any] = {"agents": agents_of(part)[:, :people]}
        parts |= {"map_id": part["map_id"], "scene_pose": part["scene_pose"]}
        parts["maps"] = NonTensorData(maps_of(batch), batch_size=[1])
        alone = TensorDict(parts, batch_size=1)
        walked = model.next_steps(alone, noise[scene : scene + 1, :people], 8, 8)
        torch.testing.assert_close(walked[0], steps[scene, :people], atol=2e-4, rtol=1e-4)
        torch.testing.assert_close(model.mode(alone, 8)[0, 0], modes[scene, :people], atol=2e-4, rtol=1e-4)


@KINDS
@torch.no_grad()
def test_moving_and_turning_a_scene_moves_and_turns_its_steps(kind):
    """Not those of networks that look at the world, nor their pooling's."""
    model, batch, noise = walks(kind)
    world = kind in ("sgan", "pooling")
    pose = torch.tensor([[0.0 if world else 1.1, 1.0, 3.0, -2.0]]).expand(3, 4)
    agents = agents_of(batch)
    places = {key: geometry.move_to_scene(agents[key], pose) for key in ("history", "future", "goal")}
    vectors = {key: geometry.turn_to_scene(agents[key], pose) for key in ("velocity", "desired_velocity")}
    there = on_plan(changed(batch, **places, **vectors), maps_of(batch), pose=pose)
    steps = geometry.turn_to_scene(model.next_steps(batch, noise, 8, 8), pose)
    # a ten-thousandth of world x is in every person's heading
    torch.testing.assert_close(model.next_steps(there, noise, 8, 8), steps, atol=4e-3, rtol=1e-3)
    nats, again = (model.log_likelihood(one, torch.Generator().manual_seed(0)) for one in (batch, there))
    if nats is not None:
        torch.testing.assert_close(again, nats, atol=0.05, rtol=1e-3)


def test_constant_velocity_by_hand():
    batch = make_batch((2,))
    step = agents_of(batch)["history"][0, 1, 7] - agents_of(batch)["history"][0, 1, 6]
    path = load("constant_velocity").mode(batch, 5)[0, 0, 1]
    assert torch.equal(path, step.expand(5, 2))


@pytest.mark.parametrize("name", ["straight_line", "bent_line"])
def test_lines_end_at_a_timed_goal_and_do_not_overshoot_others(name):
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


def test_bent_line_starts_with_the_last_velocity():
    """The quadratic p8 + k v + (k / T)^2 (g - p8 - T v)."""
    last, goal = torch.tensor([0.3, -0.1]), torch.tensor([2.0, 2.0])
    path = linear_extrapolation.bent_line(last, goal, 4, timed=True)
    by_hand = [k * last + (k / 4) ** 2 * (goal - 4 * last) for k in range(5)]
    torch.testing.assert_close(path, torch.stack(by_hand).diff(dim=0))


def test_a_goal_at_ones_feet_divides_nothing_by_zero():
    nowhere = torch.zeros(3, 2)
    for line in (linear_extrapolation.straight_line, linear_extrapolation.bent_line):
        path = line(torch.tensor([0.4, 0.0]).expand(3, 2), nowhere, 8, timed=False)
        assert path.isfinite().all()
        torch.testing.assert_close(path.sum(-2), nowhere)
