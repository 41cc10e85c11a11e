"""Social-VRNN: its mixture, divergence and bounds by hand, and what must not matter."""

import math
from typing import Any, cast

import pytest
import torch
from helpers.batches import changed, make_batch, of_people, on_plan, random_weights
from tensordict import TensorDict
from torch import Tensor
from torch.distributions import Categorical, Independent, MixtureSameFamily, Normal

from pedzoo.core import geometry
from pedzoo.core.batch import agents_of
from pedzoo.core.errors import UserError
from pedzoo.metrics.forecast import ForecastScore, negative_log_likelihood
from pedzoo.models.architectures.sgan import SGAN
from pedzoo.models.architectures.social_vrnn import SocialVRNN
from pedzoo.models.base import known_displacements, true_displacements
from pedzoo.models.blocks.mixture import FutureMixture
from pedzoo.sim.make import make_env

SMALL: dict[str, Any] = {
    "embedding_dim": 4,
    "state_dim": 6,
    "others_dim": 5,
    "map": None,
    "latent_dim": 3,
    "hidden_dim": 7,
    "mode_weight": 0.0,
}


def seeded(seed: int = 0) -> torch.Generator:
    return torch.Generator().manual_seed(seed)


def small(**options: Any) -> SocialVRNN:
    """Return a small model in double precision with random weights."""
    return cast("SocialVRNN", random_weights(SocialVRNN.of(**SMALL | options))).double().eval()


def batch_of(sizes: tuple[int, ...] = (3, 1, 4), **options: Any) -> TensorDict:
    return make_batch(sizes, goal=False, dtype=torch.float64, **options)


def without_latents(model: SocialVRNN) -> SocialVRNN:
    """Make a model's latent say nothing."""
    with torch.no_grad():
        cast("Tensor", model.decoder.lstm.weight_ih_l0).zero_()
        model.decoder.start.weight[:, -model.latent_dim :] = 0
    return model


def loss_of(model: SocialVRNN, batch: TensorDict, seed: int = 0) -> float:
    return float(model.loss(batch, seeded(seed)).detach())


def by_hand(mixture: FutureMixture, path: Tensor, known: Tensor) -> float:
    """Return the log density of one person's path (T, 2), with nothing but plain numbers."""
    weights = [math.exp(x) for x in mixture.logits.tolist()]
    density = 0.0
    for m, weight in enumerate(weights):
        share = weight / sum(weights)
        for t in known.nonzero().flatten().tolist():
            for axis in range(2):
                mean, scale = float(mixture.mean[m, t, axis]), float(mixture.scale[m, t, axis])
                off = (float(path[t, axis]) - mean) / scale
                share *= math.exp(-0.5 * off * off) / (scale * math.sqrt(2 * math.pi))
        density += share
    return math.log(density)


def random_mixture(people: int = 4, components: int = 3, steps: int = 5) -> FutureMixture:
    random = seeded(3)
    logits, mean, scale = (
        torch.randn(size, generator=random, dtype=torch.float64)
        for size in ((people, components), (people, components, steps, 2), (people, components, steps, 2))
    )
    return FutureMixture(logits, mean, 0.2 + scale.abs())


def test_mixture_equals_torch_and_leaves_unknown_steps_out():
    mixture = random_mixture()
    path = torch.randn(4, 5, 2, generator=seeded(), dtype=torch.float64)
    everything = torch.ones(4, 5, dtype=torch.bool)
    oracle = MixtureSameFamily(
        Categorical(logits=mixture.logits), Independent(Normal(mixture.mean, mixture.scale), 2)
    )
    torch.testing.assert_close(mixture.log_prob(path, everything), oracle.log_prob(path))
    some = torch.tensor([True, False, True, True, False]).expand(4, 5)
    stored = FutureMixture(mixture.logits, mixture.mean[:, :, some[0]], mixture.scale[:, :, some[0]])
    torch.testing.assert_close(
        mixture.log_prob(path, some), stored.log_prob(path[:, some[0]], some[:, :3] | True)
    )
    assert (mixture.log_prob(path, ~everything).abs() < 1e-12).all()


def test_components_are_chosen_by_their_weights():
    mixture = FutureMixture(
        torch.tensor([0.2, 0.5, 0.3]).log().expand(1000, 3),
        torch.zeros(1000, 3, 1, 2),
        torch.ones(1, 1, 1, 1),
    )
    chosen = mixture.at_quantile((torch.arange(1000) + 0.5) / 1000)
    assert torch.bincount(chosen).tolist() == [200, 500, 300]
    assert mixture.most_likely().eq(1).all()
    assert mixture.at_quantile(torch.ones(1000)).eq(2).all()


@torch.no_grad()
def plain_loss(model: SocialVRNN, batch: TensorDict, eps: Tensor) -> float:
    """Return minus the bound, person by person: KL(N(m, s) || N(n, r)) by its formula, mixtures by hand."""
    seen = model.see(batch)
    truth, known, posterior = model._infer(batch, seen)
    z = posterior.mean + posterior.stddev * eps
    mixture = model.mixture(seen, z.unsqueeze(0), truth.shape[1])
    total = 0.0
    for i in range(len(truth)):
        if not known[i].any():
            continue
        for j in range(model.latent_dim):
            m, s = float(posterior.mean[i, j]), float(posterior.stddev[i, j])
            n, r = float(seen.prior.mean[i, j]), float(seen.prior.stddev[i, j])
            total += math.log(r / s) + (s * s + (m - n) ** 2) / (2 * r * r) - 0.5
        mine = FutureMixture(mixture.logits[0, i], mixture.mean[0, i], mixture.scale[0, i])
        total -= by_hand(mine, truth[i], known[i])
    return total / truth.shape[1]


def test_loss_is_minus_the_evidence_lower_bound():
    model, batch = small(), batch_of(partly=True)
    eps = torch.randn(8, 3, generator=seeded(1), dtype=torch.float64)
    assert loss_of(model, batch, 1) == pytest.approx(plain_loss(model, batch, eps), rel=1e-9)


def test_mode_weight_adds_the_distance_of_the_mode():
    plain, both, batch = small(), small(mode_weight=3.0), batch_of()
    off = both.mode(batch, 8)[:, 0].cumsum(2) - true_displacements(batch).cumsum(2)
    distance = off[agents_of(batch)["mask"]].norm(dim=-1).mean(1).sum()
    added = both.loss(batch, seeded()) - plain.loss(batch, seeded())
    torch.testing.assert_close(added, 3 * distance, rtol=1e-5, atol=0)


@torch.no_grad()
def test_bounds_rise_to_the_likelihood():
    """One sample is the loss's bound on average; more samples give a higher one, up to log p(y | x)."""
    model, draws = small(), 300
    batch = cast("TensorDict", batch_of((1,)).expand(draws).clone())
    elbo = -8 * loss_of(model, batch) / draws
    one, some, most = (float(model.log_likelihood(batch, seeded(1), k).mean()) for k in (1, 10, 100))
    seen = model.see(batch)
    truth, known, _ = model._infer(batch, seen)
    alone = seen._replace(features=seen.features[:1], last=seen.last[:1])
    noise = torch.randn(20_000, 1, 3, generator=seeded()).double()
    z = seen.prior.mean[:1] + seen.prior.stddev[:1] * noise
    nats = model.mixture(alone, z, 8).log_prob(truth[0], known[0])
    exact = float(nats.logsumexp(0).squeeze()) - math.log(20_000)
    assert one == pytest.approx(elbo, abs=0.1 * (exact - elbo))
    assert elbo < some - 0.1 < most - 0.2 < exact
    assert most == pytest.approx(exact, abs=0.25 * (exact - elbo))


def test_without_latents_the_likelihood_is_the_mixtures():
    model, batch = without_latents(small()), batch_of()
    with torch.no_grad():
        for head in (model.prior, model.posterior):
            for parameter in head.parameters():
                parameter.zero_()
    seen = model.see(batch)
    truth, known, _ = model._infer(batch, seen)
    exact = model.mixture(seen, seen.prior.mean.unsqueeze(0), 8).log_prob(truth, known)[0]
    torch.testing.assert_close(model.log_likelihood(batch)[agents_of(batch)["mask"]], exact)
    torch.testing.assert_close(model.loss(batch), -exact.sum() / 8)


def test_samples_are_of_the_mixture():
    """Where the latent says nothing, mean and spread of many samples are the mixture's own."""
    model, batch = without_latents(small()), batch_of((2,))
    with torch.no_grad():
        seen = model.see(batch)
        mixture = model.mixture(seen, seen.prior.mean.unsqueeze(0), 3)
        drawn = model.sample(batch, 20_000, 3, seeded())[0].transpose(0, 1)
    drawn = geometry.unrotate(drawn, seen.heading[:, None, None])
    weight = mixture.logits[0].softmax(-1)[..., None, None]
    mean = (weight * mixture.mean[0]).sum(1)
    variance = (weight * (mixture.scale[0].square() + mixture.mean[0].square())).sum(1) - mean.square()
    torch.testing.assert_close(drawn.mean(1), mean, atol=0.02, rtol=0)
    torch.testing.assert_close(drawn.var(1), variance, atol=0.01, rtol=0.05)


def test_noise_chooses_latent_and_component():
    model, batch = small(), batch_of()
    mask = agents_of(batch)["mask"]
    assert torch.equal(model.next_steps(batch, None, 3, 8), model.mode(batch, 8)[:, 0, :, :3])
    noise = torch.zeros(3, 4, model.noise_dim, dtype=torch.float64)
    seen = model.see(batch)
    mixture = model.mixture(seen, seen.prior.mean.unsqueeze(0), 2)
    for quantile, component in ((-9.0, 0), (9.0, 2)):
        noise[..., -1] = quantile
        walked = model.next_steps(batch, noise, 2, 8)
        expected = geometry.rotate(mixture.mean[0, :, component], seen.heading.unsqueeze(1))
        torch.testing.assert_close(walked[mask], expected)
        assert (walked[~mask] == 0).all()
    noise[..., 0] = 1.0
    assert not torch.allclose(model.next_steps(batch, noise, 2, 8), walked)


def test_what_is_not_known_of_the_future_does_not_matter():
    model, batch = small(mode_weight=2.0), batch_of(partly=True)
    future, known = agents_of(batch)["future"], agents_of(batch)["future_valid"]
    other = changed(batch, future=torch.where(known[..., None], future, future + 3))
    # a person who comes back has a known place, but not a known displacement
    assert (known & ~known_displacements(batch)).any()
    assert loss_of(model, batch) == pytest.approx(loss_of(model, other))
    nats = model.log_likelihood(batch, seeded())
    torch.testing.assert_close(model.log_likelihood(other, seeded()), nats)
    assert float(nats[-1, 1]) == 0  # of whom nothing is known


def test_others_and_map_are_seen_where_asked_for():
    batch = batch_of((3,))
    history = agents_of(batch)["history"].clone()
    history[0, 2] += 1.5
    elsewhere = changed(batch, history=history)
    for dim in (0, 5):
        model = small(others_dim=dim)
        same = torch.equal(model.mode(batch, 8)[0, 0, :2], model.mode(elsewhere, 8)[0, 0, :2])
        assert same == (dim == 0)
    bank, batch = make_env("door").bank, make_batch((3,), goal=False)
    beside_walls = on_plan(batch, bank)
    kinds: tuple[Any, ...] = (None, "patch")
    for kind in kinds:
        model = cast("SocialVRNN", random_weights(SocialVRNN.of(**{**SMALL, "map": kind}))).eval()
        assert model.needs == frozenset(["map"] * (kind is not None))
        assert torch.equal(model.mode(batch, 8), model.mode(beside_walls, 8)) == (kind is None)


def test_untrained_people_walk_on_nearly_as_they_did():
    batch = make_batch((4, 2), goal=False)
    model = SocialVRNN.of(map=None).eval()
    history = of_people(batch, "history")
    off = model.mode(batch, 8)[:, 0][agents_of(batch)["mask"]] - (history[:, -1:] - history[:, -2:-1])
    assert off.abs().max() < 0.1


def test_likelihood_per_step_by_hand():
    """Of 12 and 3 nats over 4 and 2 steps: 15 nats in 6 steps. No other person counts."""
    known = torch.tensor([[[True] * 4, [True, True, False, False], [False] * 4]])
    nats, steps = negative_log_likelihood(torch.tensor([[-12.0, -3.0, -99.0]]), known)
    assert (nats.tolist(), steps.tolist()) == ([15.0], [6])


def test_scores_tell_the_likelihood_of_models_that_have_one():
    batch, model = make_batch((3, 1, 4), goal=False, partly=True), SocialVRNN.of(map=None).eval()
    score = ForecastScore(3)
    score.update(SGAN.of(residual="constant_velocity"), batch)
    assert "nll_nats_per_step" not in score.compute()
    score.reset()
    score.update(model, batch, seeded())
    steps = int((known_displacements(batch) & agents_of(batch)["mask"][..., None]).sum())
    nats = float(model.log_likelihood(batch, seeded()).sum())
    assert score.compute()["nll_nats_per_step"] == pytest.approx(-nats / steps, rel=1e-5)


@pytest.mark.parametrize("options", [{"latent_dim": 0}, {"components": 0}, {"min_scale": 0.0}])
def test_options_out_of_range(options):
    with pytest.raises(UserError, match="expected at least 1, at least 1, and above 0 m"):
        SocialVRNN.of(**options)
