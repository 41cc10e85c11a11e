"""SGAN and its variants: the published formulas, computed the plain way, and what must not matter."""

import math
from typing import Any, cast

import pytest
import torch
from helpers.batches import changed, make_batch, of_people, random_weights
from tensordict import TensorDict
from test_blocks import plain_decoder, plain_encoder, plain_pooling
from torch import Tensor

from pedzoo.core.batch import agents_of
from pedzoo.core.configs import load_config
from pedzoo.core.errors import UserError
from pedzoo.core.spec import build_ungrouped
from pedzoo.data.datamodule import Loading, TrajectoryDataModule
from pedzoo.models.architectures.sgan import SGAN
from pedzoo.models.blocks.people import linear_extrapolation
from pedzoo.models.blocks.people.crowd import Crowd
from pedzoo.models.blocks.people.pooling import SocialPooling

SMALL: dict[str, Any] = {
    "embedding_dim": 5,
    "encoder_dim": 6,
    "decoder_dim": 9,
    "mlp_dim": 7,
    "noise_dim": 3,
    "best_k": 4,
}
GOAL: dict[str, Any] = {"goal_dim": 4, "goal_protocol": "window_end"}
VARIANTS = ["sgan_nopool", "sgan", "sgan_goal", "sgan_goal_map"]


def seeded(seed: int = 0) -> torch.Generator:
    return torch.Generator().manual_seed(seed)


def small(**options: Any) -> SGAN:
    """Return a small SGAN in double precision with random weights."""
    return cast("SGAN", random_weights(SGAN.of(**SMALL | options))).double()


def plain_path(model: SGAN, batch: TensorDict, scene: int, z: Tensor) -> Tensor:
    """Return displacements (n, T, 2) of one scene for noise ``z`` (n, noise_dim), step by step."""
    agents = agents_of(batch)
    there = agents["mask"][scene]
    history, steps = agents["history"][scene, there], agents["future"].shape[2]
    here, last = history[:, -1], history[:, -1] - history[:, -2]
    observed = torch.stack([history[:, step] - history[:, step - 1] for step in range(1, 8)], 1)
    features = [plain_encoder(model.encoder, observed)]
    if isinstance(model.pooling, SocialPooling):
        one = Crowd.of(torch.ones(1, len(here), dtype=torch.bool))
        features.append(plain_pooling(model.pooling, features[0], here, one))
    if model.goal is not None:
        goal, wanted = agents["goal"][scene, there], agents["desired_velocity"][scene, there]
        features.append(model.goal(torch.cat((goal - here, wanted), 1)))
    hidden = torch.cat((model.to_decoder(torch.cat(features, 1)), z), 1)
    if model.residual == "none":
        return plain_decoder(model.decoder, hidden, last, steps)
    path = plain_decoder(model.decoder, hidden, torch.zeros_like(last), steps)
    if model.residual == "constant_velocity":
        return path + last.unsqueeze(1)
    return path + linear_extrapolation.bent_line(last, agents["goal"][scene, there] - here, steps, timed=True)


def plain_error(
    model: SGAN, batch: TensorDict, scene: int, path: Tensor, other: Tensor | None = None
) -> Tensor:
    """Return the mean error of a scene, or distance to another path, over the steps that are known."""
    agents = agents_of(batch)
    there = agents["mask"][scene]
    before, after = agents["history"][scene, there], agents["future"][scene, there]
    known = agents["future_valid"][scene, there]
    total, count = path.new_zeros(()), 0
    for person in range(len(before)):
        for step in range(after.shape[1]):
            if not known[person, step]:
                continue
            if model.losses.error == "distance":
                reached = before[person, -1] + path[person, : step + 1].sum(0)
                wanted = after[person, step]
                if other is not None:
                    wanted = before[person, -1] + other[person, : step + 1].sum(0)
                total = total + ((reached - wanted).square().sum() + 1e-8).sqrt()
                count += 1
            elif step == 0 or known[person, step - 1]:
                start = after[person, step - 1] if step else before[person, -1]
                wanted = after[person, step] - start if other is None else other[person, step]
                total = total + (path[person, step] - wanted).square().sum()
                count += 1
    return total / max(count, 1)


def plain_noise(model: SGAN, batch: TensorDict, seed: int) -> Tensor:
    """Return the noise (at least 2, P, noise_dim) of the loss: one row per scene, or per person."""
    mask = agents_of(batch)["mask"]
    rows = len(mask) if model.noise == "scene" else int(mask.sum())
    z = torch.randn(
        max(model.losses.best_k, 2), rows, model.noise_dim, generator=seeded(seed), dtype=torch.float64
    )
    return z[:, mask.nonzero()[:, 0]] if model.noise == "scene" else z


def plain_loss(model: SGAN, batch: TensorDict, seed: int) -> Tensor:
    """Return the sum over scenes of the best of all samples' errors and of the other terms.

    Every sample with its gradient.
    """
    mask = agents_of(batch)["mask"]
    z, scene_of = plain_noise(model, batch, seed), mask.nonzero()[:, 0]
    loss = torch.zeros((), dtype=torch.float64)
    for scene in range(len(mask)):
        paths = [plain_path(model, batch, scene, sample[scene_of == scene]) for sample in z]
        errors = [plain_error(model, batch, scene, path) for path in paths]
        loss = loss + model.losses.variety_weight * torch.stack(errors[-model.losses.best_k :]).min()
        if model.losses.energy_weight:
            spread = plain_error(model, batch, scene, paths[-1], paths[-2])
            loss = loss + model.losses.energy_weight * (errors[-1] + errors[-2] - spread) / 2
        if model.losses.mode_weight:
            zero = torch.zeros_like(z[0, scene_of == scene])
            error = plain_error(model, batch, scene, plain_path(model, batch, scene, zero))
            loss = loss + model.losses.mode_weight * error
    return loss


@pytest.mark.parametrize(
    "options",
    [
        {},
        {"noise": "agent"},
        {"bottleneck_dim": 3},
        {"bottleneck_dim": 3, "error": "distance", **GOAL},
        {"residual": "bent_line", "error": "distance", "mode_weight": 0.7, "variety_weight": 1.3, **GOAL},
        {"residual": "constant_velocity", "mode_weight": 0.5, "best_k": 1},
        {"variety_weight": 0.0, "mode_weight": 1.0},
        {"energy_weight": 0.6, "error": "distance", "mode_weight": 1.0},
        {"energy_weight": 1.0, "error": "distance", "variety_weight": 0.0, "best_k": 1, "noise": "agent"},
        {"energy_weight": 0.5, "error": "distance", "variety_weight": 2.0, "mode_weight": 0.3, "best_k": 2},
    ],
    ids=str,
)
@pytest.mark.parametrize("partly", [False, True])
def test_loss_and_gradient_are_those_of_all_samples(options, partly):
    model = small(**options)
    batch = make_batch((2, 4, 3), partly=partly, dtype=torch.float64)
    values, gradients = [], []
    for loss in (model.loss(batch, seeded(5)), plain_loss(model, batch, 5)):
        values.append(loss)
        gradients.append(torch.autograd.grad(loss, list(model.parameters()), allow_unused=True))
    torch.testing.assert_close(*values, rtol=1e-9, atol=1e-9)
    for (name, _), got, wanted in zip(model.named_parameters(), *gradients, strict=True):
        assert got is not None and wanted is not None, name
        torch.testing.assert_close(got, wanted, rtol=1e-7, atol=1e-9, msg=lambda m, name=name: f"{name}: {m}")


def test_the_winner_is_chosen_for_a_scene_together():
    """The loss would be smaller if each person chose their own sample; the test above uses such batches."""
    model, batch = small(best_k=6).requires_grad_(False), make_batch((3, 4), dtype=torch.float64)
    z, scene_of = plain_noise(model, batch, 5), agents_of(batch)["mask"].nonzero()[:, 0]
    apart = 0.0
    for scene, people in enumerate((3, 4)):
        for person in range(people):
            mask = torch.zeros_like(agents_of(batch)["mask"])
            mask[scene, person] = True
            alone = changed(batch, future_valid=agents_of(batch)["future_valid"] & mask[..., None])
            paths = [plain_path(model, batch, scene, z[k, scene_of == scene]) for k in range(6)]
            apart += min(float(plain_error(model, alone, scene, path)) for path in paths) / people
    assert apart < float(model.loss(batch, seeded(5))) - 1e-4


@pytest.mark.parametrize("residual", ["none", "constant_velocity", "bent_line"])
@pytest.mark.parametrize("steps", [1, 8, 12])
def test_samples_are_the_plain_ones(residual, steps):
    model = small(bottleneck_dim=3, residual=residual, **GOAL)
    batch = make_batch((2, 4, 1), dtype=torch.float64, steps=steps)
    z = plain_noise(model, batch, 3)
    sampled = model.sample(batch, model.losses.best_k, steps, seeded(3))
    mask = agents_of(batch)["mask"]
    assert sampled.shape == (3, model.losses.best_k, 4, steps, 2)
    assert (sampled.transpose(1, 2)[~mask] == 0).all()
    for scene in range(3):
        for k in range(model.losses.best_k):
            wanted = plain_path(model, batch, scene, z[k, mask.nonzero()[:, 0] == scene])
            torch.testing.assert_close(sampled[scene, k, mask[scene]], wanted)
    torch.testing.assert_close(
        model.mode(batch, steps)[1, 0], plain_path(model, batch, 1, torch.zeros(4, 3).double())
    )


def test_noise_is_shared_by_a_scene_or_drawn_for_all_people():
    batch = make_batch((3, 2), dtype=torch.float64)
    for noise in ("scene", "agent"):
        model = small(noise=noise)
        z = model.draw(model.encode(batch, 8), 6, seeded())
        assert z.shape == (6, 5, 3)
        shared = (z[:, 0] == z[:, 1]).all() and (z[:, 1] == z[:, 2]).all() and (z[:, 3] == z[:, 4]).all()
        assert bool(shared) == (noise == "scene")
        assert not torch.isclose(z[:, 2], z[:, 3]).any()
        assert len(z[:, 0].unique()) == 18


def of_kind(options: dict[str, Any]) -> SGAN:
    """Return a model in single precision."""
    return cast("SGAN", random_weights(SGAN.of(**SMALL | options)))


def test_people_who_stand_have_a_heading():
    model = of_kind({"frame": "heading", **GOAL})
    batch = make_batch((2, 2))
    still = agents_of(batch)["history"][:, :, -1:].expand(-1, -1, 8, -1)
    for goal in (agents_of(batch)["goal"], still[:, :, -1]):
        standing = changed(batch, history=still, goal=goal)
        sampled = model.sample(standing, 2, 8, seeded())
        assert sampled.isfinite().all() and sampled.abs().max() > 0
        gradients = torch.autograd.grad(model.loss(standing), list(model.parameters()))
        assert all(gradient.isfinite().all() for gradient in gradients)


@pytest.mark.parametrize("frame", ["world", "heading"])
@pytest.mark.parametrize("protocol", ["window_end", "destination"])
def test_untrained_residual_is_the_line_itself(frame, protocol):
    batch = make_batch((3, 2), padding=0.0)
    agents = agents_of(batch)
    last = agents["history"][:, :, -1] - agents["history"][:, :, -2]
    for residual in ("constant_velocity", "bent_line"):
        model = SGAN.of(frame=frame, residual=residual, goal_dim=4, goal_protocol=protocol, bottleneck_dim=8)  # type: ignore[arg-type]
        for steps in (1, 8, 12):
            to_goal = agents["goal"] - agents["history"][:, :, -1]
            wanted = linear_extrapolation.constant_velocity(last, steps)
            if residual == "bent_line":
                wanted = linear_extrapolation.bent_line(last, to_goal, steps, timed=protocol == "window_end")
            for path in (model.mode(batch, steps)[:, 0], model.sample(batch, 2, steps)[:, 1]):
                assert torch.equal(path[agents["mask"]], wanted[agents["mask"]])
            if residual == "bent_line" and protocol == "window_end":
                end = model.mode(batch, steps).sum(-2)[:, 0]
                torch.testing.assert_close(end[agents["mask"]], to_goal[agents["mask"]])


def test_unknown_steps_change_nothing():
    batch = make_batch((2, 3), partly=True)
    agents = agents_of(batch)
    unknown = (~agents["future_valid"] & agents["mask"][..., None]).unsqueeze(-1)
    assert unknown.sum() == 14
    elsewhere = changed(batch, future=torch.where(unknown, agents["future"] + 3.0, agents["future"]))
    for error in ("squared_displacement", "distance"):
        model = cast("SGAN", random_weights(SGAN.of(error=error, mode_weight=1.0)))  # type: ignore[arg-type]
        losses = [model.loss(data, seeded()) for data in (batch, elsewhere)]
        assert losses[0].isfinite() and torch.equal(losses[0], losses[1])
        without_future = changed(batch, future_valid=torch.zeros_like(agents["future_valid"]))
        assert model.loss(without_future, seeded()).item() == 0.0


def test_a_scene_without_anybody_is_answered():
    batch = make_batch((2, 3))
    empty = changed(batch, mask=torch.zeros_like(agents_of(batch)["mask"]))
    model = of_kind({"bottleneck_dim": 3, "map": "patch", "frame": "heading", **GOAL})
    assert torch.equal(model.sample(empty, 2, 8), torch.zeros(2, 2, 3, 8, 2))
    assert model.loss(empty).item() == 0.0


def test_a_map_model_reads_the_bank_of_its_batch():
    model, batch = SGAN.of(map="patch"), make_batch((2, 2))
    with pytest.raises(UserError, match="does not say which floor plans"):
        model.sample(batch.exclude("maps"), 1, 8)
    data = TrajectoryDataModule()
    data.setup("test")
    batch.set_non_tensor("maps", data.bank)
    assert model.sample(batch, 1, 8).isfinite().all()  # -1 is no map, which every bank knows
    batch["map_id"] = torch.full((2, 1), data.bank.id_of(data.bank.names[0]) + 1)
    with pytest.raises(UserError, match="is not of this bank"):
        model.sample(batch, 1, 8)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"noise_dim": 32}, "noise_dim 32: expected 1 to 31"),
        ({"noise_dim": 0}, "noise_dim 0"),
        ({"best_k": 0}, "best_k 0"),
        ({"residual": "bent_line"}, "set goal_dim"),
        ({"frame": "way"}, "set goal_dim, or frame heading"),
        ({"energy_weight": 1.0}, "rewards the mean alone"),
    ],
)
def test_options_that_do_not_go_together_are_refused(options, message):
    with pytest.raises(UserError, match=message):
        SGAN.of(**options)


@pytest.fixture(scope="module")
def training_batches():
    """Two dozen embedded scenes without and with a goal."""
    result = {}
    for goal in ("none", "window_end"):
        data = TrajectoryDataModule(goal=goal, loading=Loading(batch_size=24))
        data.setup("fit")
        result[goal] = next(iter(data.train_dataloader()))
    return result


@pytest.mark.parametrize("name", VARIANTS)
def test_shipped_variants_learn(name, training_batches, request):
    if name.endswith("map"):
        request.getfixturevalue("alexnet")
    options = load_config(name)["model"]["init_args"]["generator"]["init_args"]
    model = build_ungrouped(SGAN, options)
    batch = training_batches[model.goal_protocol]
    optimizer = torch.optim.Adam(model.parameters())
    losses = []
    for step in range(30):
        optimizer.param_groups[0]["lr"] = 1e-3 * min(1.0, (step + 1) / 20)
        loss = model.loss(batch, seeded())
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        losses.append(float(loss.detach()))
    assert all(math.isfinite(loss) for loss in losses)
    assert losses[-1] < 0.97 * losses[0], losses
    untouched = [key for key, value in model.named_parameters() if value.grad is None]
    assert not untouched
    assert (("map" in model.needs) == ("map" in name)) and (("goal" in model.needs) == ("goal" in name))
    assert not any("features." in key or "offsets" in key for key in model.state_dict())
    assert of_people(batch, "history").shape[0] == int(agents_of(batch)["mask"].sum())
