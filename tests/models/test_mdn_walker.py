"""The mixture density walker: its distribution, what it draws, and what it sees."""

import math
from typing import cast

import pytest
import torch
from tensordict import TensorDict
from torch import Tensor

from pedzoo.core import geometry
from pedzoo.core.batch import agents_of, scene_batch
from pedzoo.core.types import STEP_SECONDS
from pedzoo.maps.bank import MapBank
from pedzoo.maps.plans import rectangles
from pedzoo.models.architectures.mdn_walker import Architecture, Change, MdnWalker, shown_style
from tests.helpers.batches import changed, make_batch


def distribution(hold: float = -1.0) -> Change:
    random = torch.Generator().manual_seed(1)
    mean = torch.randn(1, 3, 2, generator=random) * 0.3
    scale = 0.1 + 0.2 * torch.rand(1, 3, 2, generator=random)
    return Change(
        torch.tensor([hold]), torch.tensor([[0.0, 1.0, -1.0]]), mean, scale, torch.tensor([[0.0, 0.6, -0.8]])
    )


def walker(**more: object) -> MdnWalker:
    """Return a walker whose parameters are random."""
    torch.manual_seed(0)
    model = MdnWalker(Architecture(width=16, near_dim=8, components=3, **more)).eval()  # type: ignore[arg-type]
    with torch.no_grad():
        for parameter in model.parameters():
            parameter.add_(0.1 * torch.randn(parameter.shape))
    return model


@pytest.mark.parametrize("temperature", [1.0, 0.5])
def test_chances_of_holding_and_changing_add_up_to_one(temperature: float):
    change = distribution().tempered(temperature)
    edge = torch.linspace(-3, 3, 601)
    grid = torch.stack(torch.meshgrid(edge, edge, indexing="xy"), -1).flatten(0, 1)
    density = change.log_prob(grid, torch.zeros(len(grid), dtype=torch.bool)).exp()
    holds = change.log_prob(torch.zeros(1, 2), torch.ones(1, dtype=torch.bool)).exp()
    assert float(holds) == pytest.approx(1 / (1 + math.e), abs=1e-6)
    assert float(density.sum() * 0.01**2 + holds) == pytest.approx(1.0, abs=1e-3)


def test_log_likelihood_of_one_gaussian_by_hand():
    change = Change(
        torch.tensor(0.0),
        torch.zeros(1),
        torch.tensor([[0.1, -0.2]]),
        torch.tensor([[0.2, 0.5]]),
        torch.zeros(1),
    )
    got = change.log_prob(torch.tensor([0.3, 0.3]), torch.tensor(False))
    want = math.log(0.5) - 0.5 * (1 + 1) - math.log(2 * math.pi * 0.2 * 0.5)
    assert float(got) == pytest.approx(want, abs=1e-5)


def test_draws_follow_the_density():
    change = distribution()
    noise = torch.randn(200_000, 4, generator=torch.Generator().manual_seed(0))
    many = Change(*(value.expand(len(noise), *value.shape[1:]) for value in change))
    drawn = many.at(noise)
    held = (drawn == 0).all(-1)
    assert float(held.float().mean()) == pytest.approx(1 / (1 + math.e), abs=0.005)
    torch.testing.assert_close(drawn.mean(0), change.average[0], atol=0.003, rtol=0)
    weight = change.logits.softmax(-1)[0]
    second = (weight.unsqueeze(1) * (change.scale.square() + change.mean.square())[0]).sum(0)
    torch.testing.assert_close(drawn[~held].square().mean(0), second, atol=0.003, rtol=0)


def test_a_held_velocity_is_exactly_that_of_before():
    model, batch = walker(), make_batch([4])
    with torch.no_grad():
        model.head.bias[0] = 50.0
    steps = model.next_steps(batch, torch.randn(1, 4, 4), 3, 8)
    history = agents_of(batch)["history"]
    torch.testing.assert_close(steps, (history[:, :, -1:] - history[:, :, -2:-1]).expand(-1, -1, 3, -1))


def moved(batch: TensorDict, angle: float) -> TensorDict:
    """Return the batch, turned about the origin; headings follow from histories."""
    turn = torch.tensor([math.cos(angle), math.sin(angle)])
    agents = agents_of(batch)
    rotated = {
        key: geometry.rotate(agents[key], turn.expand_as(agents[key]))
        for key in ("history", "goal", "desired_velocity", "velocity")
    }
    return changed(batch, **rotated, heading=agents["heading"] + angle)


def test_turning_the_scene_turns_the_steps():
    model, batch, noise = walker(), make_batch([5]), torch.randn(1, 5, 4)
    straight, turned = (model.next_steps(b, noise, 2, 8) for b in (batch, moved(batch, 0.7)))
    turn = torch.tensor([math.cos(0.7), math.sin(0.7)]).expand_as(straight)
    torch.testing.assert_close(geometry.rotate(straight, turn), turned, atol=1e-4, rtol=0)


def test_order_and_padding_do_not_matter():
    model, batch, noise = walker(), make_batch([5, 3]), torch.randn(2, 5, 4)
    steps = model.next_steps(batch, noise, 1, 8)
    order = torch.tensor([3, 1, 4, 0, 2])
    other = cast("TensorDict", batch[:1].clone())
    for key, value in list(agents_of(other).items()):
        if isinstance(value, Tensor):
            other["agents", key] = value[:, order]
    torch.testing.assert_close(
        model.next_steps(other, noise[:1, order], 1, 8), steps[:1, order], atol=1e-5, rtol=0
    )
    alone = make_batch([5, 3])[1:]
    few = scene_of(alone, 3)
    torch.testing.assert_close(model.next_steps(few, noise[1:, :3], 1, 8), steps[1:, :3], atol=1e-5, rtol=0)
    assert (steps[1, 3:] == 0).all()


def scene_of(batch: TensorDict, people: int) -> TensorDict:
    """Return a batch without its last slots."""
    agents = agents_of(batch)
    kept = {
        key: agents[key][:, :people]
        for key in ("history", "valid", "mask", "pref_speed", "goal", "desired_velocity")
    }
    return scene_batch(maps=MapBank(), map_id=batch["map_id"], pose=batch["scene_pose"], **kept)


def test_sees_others_walls_and_how_the_crowd_walked():
    model = walker()
    plan = rectangles([(0.5, -3.0, 0.6, 3.0)], around=(-5, -5, 5, 5), name="wall")
    bank = MapBank([plan])
    batch = make_batch([3], maps=bank)
    noise = torch.randn(1, 3, 4)
    steps = model.next_steps(batch, noise, 1, 8)
    walled = batch.clone()
    walled["map_id"] = torch.tensor([[bank.id_of("wall")]])
    apart = changed(batch, mask=torch.tensor([[True, False, True]]))
    first = agents_of(batch)["history"] + 0.1 * torch.randn(1, 3, 8, 2)
    for other in (walled, apart, changed(batch, first_history=first)):
        assert ((model.next_steps(other, noise, 1, 8) - steps)[:, 0].abs() > 1e-5).any()


@pytest.mark.parametrize("part", ["flow", "style", "walls"])
def test_what_is_switched_off_is_not_seen(part: str):
    model = walker(**{part: False})
    batch, noise = make_batch([1]), torch.randn(1, 1, 4)
    steps = model.next_steps(batch, noise, 1, 8)
    first = agents_of(batch)["history"] + 0.1 * torch.randn(1, 1, 8, 2)
    other = changed(batch, first_history=first)
    assert torch.equal(model.next_steps(other, noise, 1, 8), steps) == (part == "style")
    assert ("map" in model.needs) == (part != "walls")


def test_an_even_walk_shows_no_style():
    """A host's people begin with a straight walk that was made up: it counts as a style that is not known."""
    line = torch.stack((0.5 * torch.arange(8.0), torch.zeros(8)), -1)
    shaken = line + 0.01 * torch.randn(8, 2)
    assert shown_style(line).isnan().all() and shown_style(shaken).isfinite().all()
    model, batch = walker(), make_batch([3])
    even = changed(batch, first_history=torch.stack((line, line, line)).unsqueeze(0))
    assert model.features(model.view(even)).own.isnan().sum(-1).tolist() == [[12, 12, 12]]
    assert model.next_steps(even, torch.randn(1, 3, 4), 2, 8).isfinite().all()
    mixed = changed(batch, first_history=torch.stack((line, shaken, line)).unsqueeze(0))
    own = model.features(model.view(mixed)).own[..., model.reader.style]
    # the second one's is the mean of the others for the first and the third
    torch.testing.assert_close(own[0, 0, 6:], shown_style(shaken))
    assert own[0, 1, 6:].isnan().all() and own[0, 1, :6].isfinite().all()


def test_without_hold_nothing_is_held():
    change = walker(held=False)
    noise = torch.randn(1, 4, 4)
    noise[..., 0] = -5.0  # would hold nearly always
    batch = make_batch([4])
    history = agents_of(batch)["history"]
    last = history[:, :, -1] - history[:, :, -2]
    assert ((change.next_steps(batch, noise, 1, 8)[:, :, 0] - last).norm(dim=-1) > 1e-4).all()


def test_likelihood_is_that_of_every_known_step():
    model, batch = walker(), make_batch([3], steps=2)
    now = model.view(batch)
    agents = agents_of(batch)
    place = torch.cat((agents["history"][:, :, -1:], agents["future"]), 2).diff(dim=2)
    total = torch.zeros(1, 3)
    for step in place.unbind(2):
        change = geometry.unrotate(step, now.ahead) / STEP_SECONDS - now.velocity
        nats = model.change(model.features(now)).log_prob(change, torch.zeros(1, 3, dtype=torch.bool))
        total = total + nats - 2 * math.log(STEP_SECONDS)
        now = now.after(step)
    torch.testing.assert_close(model.log_likelihood(batch), total)
    unknown = agents["future_valid"].clone()
    unknown[0, 1] = False
    assert float(model.log_likelihood(changed(batch, future_valid=unknown)).detach()[0, 1]) == 0.0
