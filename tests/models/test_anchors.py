"""Models with anchors: their origin, what stays the same when a scene is moved, and what is drawn."""

import math
from typing import Any, cast

import pytest
import torch
from helpers.batches import changed, make_batch, random_weights
from tensordict import TensorDict
from torch import Tensor

from pedzoo.core.batch import agents_of
from pedzoo.core.errors import UserError
from pedzoo.core.registry import MODELS
from pedzoo.data.datamodule import TrajectoryDataModule
from pedzoo.models.architectures.anchor_net import AnchorNet
from pedzoo.models.architectures.anchors import Anchors
from pedzoo.models.blocks.anchored import SPEEDS, AnchorForecaster, clustered, reversed_in_time


def made(name: str, **options: Any) -> AnchorForecaster:
    """Return a model whose anchors are of random walks, with weights that move them a little."""
    model = cast("AnchorForecaster", MODELS.get(name).of(**options))  # type: ignore[attr-defined]
    model.prepare([make_batch((9, 12, 7), seed=seed) for seed in range(4)])
    random = torch.Generator().manual_seed(0)
    with torch.no_grad():
        for parameter in model.parameters():
            parameter += 0.05 * torch.randn(parameter.shape, generator=random)
    return model.eval()


def scene(people: int, seed: int = 0) -> TensorDict:
    return make_batch((people,), seed=seed, goal=False)


def test_two_kinds_of_futures_are_two_centroids():
    """Three of four walk on, one in four turns left: the centroids are these futures, right to left."""
    straight = torch.tensor([[1.0, 0.0], [2.0, 0.0]]).expand(30, 2, 2)
    left = torch.tensor([[1.0, 0.5], [1.0, 1.5]]).expand(10, 2, 2)
    result = clustered(torch.cat((left, straight)), 2, seed=0)
    torch.testing.assert_close(result.centroids[0], straight[0], atol=1e-4, rtol=0)
    torch.testing.assert_close(result.centroids[1], left[0], atol=1e-4, rtol=0)
    torch.testing.assert_close(result.centroids[2], (3 * straight[0] + left[0]) / 4, atol=1e-4, rtol=0)
    torch.testing.assert_close(result.logits.exp(), torch.tensor([31 / 42, 11 / 42]))
    assert result.scale.shape == (2, 2, 2) and (result.scale < 1e-3).all()
    few = clustered(torch.ones(3, 4, 2), 20, seed=0)  # fewer futures than centroids are enough
    torch.testing.assert_close(few.centroids, torch.ones(21, 4, 2), atol=1e-3, rtol=0)


def test_anchors_are_of_training_futures_alone():
    """Other validation and test people change nothing; other training people do."""

    def centroids(spoilt: tuple[str, ...]) -> Tensor:
        data = TrajectoryDataModule("embedded")
        data.setup()
        for split in spoilt:
            data.sets[split].xy *= 2.0  # type: ignore[index]
        model = Anchors()
        model.prepare(data.recorded("train"))
        return model.get_buffer("centroids")

    usual = centroids(())
    assert torch.equal(centroids(("val", "test")), usual)
    assert not torch.allclose(centroids(("train",)), usual, atol=1e-2)


@pytest.mark.parametrize("name", ["anchor_mlp", "anchor_net"])
def test_an_untrained_network_is_its_anchors(name):
    batches = [make_batch((9, 12, 7), seed=seed, goal=False) for seed in range(2)]
    network = cast("AnchorForecaster", MODELS.get(name)())
    floor = Anchors()
    for model in (network, floor):
        model.prepare(batches)
        model.prepare([make_batch((9, 12), seed=3)])  # they are taken once
    for batch in batches:
        torch.testing.assert_close(network.candidates(batch, 20, 8), floor.candidates(batch, 20, 8))
        torch.testing.assert_close(network.mode(batch, 8), floor.mode(batch, 8))


def test_far_people_are_not_seen_and_near_ones_are():
    model, batch = made("anchor_net"), scene(2)
    history = agents_of(batch)["history"].clone()
    history[:, 1] += history[:, 0, -1:] - history[:, 1, -1:]
    answers = {}
    for metres in (1.0, 6.0, 60.0):
        place = history.clone()
        place[:, 1, :, 0] += metres
        answers[metres] = model.mode(changed(batch, history=place), 8)[:, :, 0]
    torch.testing.assert_close(answers[6.0], answers[60.0])
    assert not torch.allclose(answers[1.0], answers[60.0], atol=1e-4)


@pytest.mark.parametrize(
    "options",
    [
        {"neighbours": 0},
        {"anchors": False},
        {"map": "rings", "map_dim": 4},
        {"goal": True, "goal_protocol": "window_end"},
        {"goal": True, "goal_protocol": "destination", "map": "patch"},
    ],
)
def test_every_part_can_be_left_out_or_added(options):
    model, batch = AnchorNet.of(**options), make_batch((4, 2))
    model.prepare([batch])
    loss = model.loss(batch, torch.Generator().manual_seed(0))
    loss.backward()
    assert loss.isfinite()
    assert model.candidates(batch, 20, 8).shape == (2, 20, 4, 8, 2)
    with pytest.raises(UserError, match="multiple of 4"):
        AnchorNet.of(width=10)
    with pytest.raises(UserError, match="goal True with goal_protocol none"):
        AnchorNet.of(goal=True)


def test_timed_goal_modes_begin_at_the_line_to_it():
    """Nothing is trained, and all training futures end at the goal: so do all modes."""
    model = AnchorNet.of(goal=True, goal_protocol="window_end")
    batch = make_batch((9, 12, 7))
    model.prepare([batch])
    agents = agents_of(batch)
    ends = model.candidates(batch, 20, 8).sum(3) + agents["history"][:, None, :, -1]
    there = agents["mask"]
    goal = agents["goal"].unsqueeze(1).expand_as(ends)
    torch.testing.assert_close(ends.transpose(1, 2)[there], goal.transpose(1, 2)[there], atol=2e-3, rtol=0)


def test_draws_follow_probabilities_candidates_are_likeliest():
    model, batch = made("anchors"), scene(1)
    seen = model.see(batch)
    mixture = model.mixture(model.write(batch, seen), seen)
    share = mixture.logits.softmax(-1)[0]
    ends = model.candidates(batch, 20, 8)[0, :, 0].sum(1)
    drawn = model.sample(batch, 4000, 8, torch.Generator().manual_seed(0))[0, :, 0].sum(1)
    counts = torch.cdist(drawn, ends).argmin(1).bincount(minlength=20) / 4000
    torch.testing.assert_close(counts, share.sort(descending=True).values, atol=0.03, rtol=0)
    torch.testing.assert_close(model.candidates(batch, 3, 8), model.candidates(batch, 20, 8)[:, :3])
    assert model.candidates(batch, 25, 8).shape[1] == 25


def test_who_would_touch_draws_once_more():
    """Two people side by side touch in fewer samples than two who draw without each other."""
    model = made("anchors")
    history = torch.arange(8.0).view(8, 1) * torch.tensor([0.4, 0.0])
    batch = changed(scene(2), history=torch.stack((history, history + torch.tensor([0.0, 0.35])))[None])
    alone = [changed(scene(1), history=agents_of(batch)["history"][:, i : i + 1]) for i in range(2)]
    random = torch.Generator().manual_seed(0)
    together = model.sample(batch, 2000, 8, random).cumsum(3)
    apart = torch.cat([model.sample(one, 2000, 8, random) for one in alone], 2).cumsum(3)
    start = agents_of(batch)["history"][:, None, :, -1:]

    def touching(path: Tensor) -> float:
        place = path + start
        return float(((place[:, :, 0] - place[:, :, 1]).norm(dim=-1) < 0.3).any(-1).float().mean())

    assert touching(together) < 0.8 * touching(apart)


def test_noise_chooses_the_mode_and_none_the_best_guess():
    model, batch = made("anchor_net"), scene(3)
    assert torch.equal(model.next_steps(batch, None, 2, 8), model.mode(batch, 8)[:, 0, :, :2])
    modes = model.candidates(batch, 20, 8)[0, :, :, :1]
    for value in (-2.0, 0.0, 2.0):
        step = model.next_steps(batch, torch.full((1, 3, 1), value), 1, 8)
        assert (modes - step).norm(dim=-1).amin(0).max() < 1e-5


def test_the_likelihood_of_one_mode_by_hand():
    """A walker on the only anchor, with a standard deviation of 1 + .02 m per step in all 16 numbers."""
    model = Anchors.of(modes=2)
    batch = scene(1)
    with torch.no_grad():
        model.logits.copy_(torch.tensor([0.0, -50.0]).expand_as(model.logits))
        model.log_scale.zero_()
        seen = model.see(batch)
        unit = float(seen.unit)
        path = model.mode(batch, 8)  # the last of the anchors, given to the first
        model.get_buffer("centroids")[:, 0] = model.get_buffer("centroids")[:, -1]
    agents = agents_of(batch)
    exact = changed(batch, future=agents["history"][:, :, -1:] + path[:, 0].cumsum(2))
    expected = -16 * (math.log(unit + 0.02) + 0.5 * math.log(2 * math.pi))
    nats = model.log_likelihood(exact)
    assert nats is not None and float(nats) == pytest.approx(expected, rel=1e-4)
    assert model.log_likelihood(make_batch((2,), steps=12)) is None


def test_a_reversed_scene_runs_backwards():
    batch = make_batch((3, 2))
    agents, back = agents_of(batch), agents_of(reversed_in_time(batch, "window_end"))
    there = agents["mask"]
    whole = torch.cat((agents["history"], agents["future"]), 2)[there]
    turned = torch.cat((back["history"], back["future"]), 2)[there]
    assert torch.equal(turned, whole.flip(1))
    assert torch.equal(back["goal"][there], whole[:, 0])
    twice = agents_of(reversed_in_time(reversed_in_time(batch, "none"), "none"))
    assert torch.equal(twice["history"][there], agents["history"][there])
    assert reversed_in_time(batch, "destination") is batch
    partly = make_batch((3, 2), partly=True)
    gone = ~agents_of(partly)["future_valid"].all(-1)
    assert not (agents_of(reversed_in_time(partly, None))["mask"] & gone).any()


def test_other_step_counts_refused_in_training_else_prolonged():
    model, batch = made("anchor_net"), make_batch((3,), steps=12)
    with pytest.raises(UserError, match="the data predict 12 steps and the model 8"):
        model.loss(batch)
    path = model.mode(batch, 12)
    torch.testing.assert_close(path[..., 8:, :], path[..., 7:8, :].expand_as(path[..., 8:, :]))
    with pytest.raises(UserError, match="at least 1 step and 2 modes"):
        Anchors.of(modes=1)


def test_people_of_any_speed_have_anchors():
    """Standing and running people, and those on the border of two classes of speeds."""
    model = made("anchor_mlp")
    step = torch.tensor([0.0, SPEEDS[0], 0.2, SPEEDS[1], 0.5, SPEEDS[2], 3.0])
    history = step.view(1, -1, 1, 1) * torch.arange(8.0).view(8, 1) * torch.tensor([1.0, 0.0])
    assert model.candidates(changed(scene(7), history=history), 20, 8).isfinite().all()
    assert random_weights(Anchors()).sample(scene(7), 3, 8).isfinite().all()
