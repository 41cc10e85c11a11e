"""The walker whose every step is drawn, and its noise."""

import math

import pytest
import torch
from tensordict import TensorDict
from torch import Tensor

from pedzoo.core.batch import agents_of
from pedzoo.core.types import STEP_SECONDS
from pedzoo.models.architectures.social_walker import BRAKING, EVERY_STEP, HALT_PERIOD, JITTER, SocialWalker
from pedzoo.models.blocks.people.evasion import evasion
from pedzoo.models.blocks.people.narrow import confinement, narrowness
from pedzoo.models.blocks.people.nearest import Neighbours, nearest
from pedzoo.models.blocks.people.step_features import Situation
from pedzoo.models.blocks.people.style import USUAL, held_of, jitter_of, kinks_of, style_of, unless_even
from pedzoo.models.blocks.timed_noise import timed_noise
from pedzoo.models.zoo.loading import load
from tests.helpers.batches import changed, make_batch

WIGGLE = 0.0013 * torch.tensor([[1.0, 0.0], [-1.0, 0.0]]).repeat(4, 1)[:7]
"""Changes of steps as small as those of held velocities, and as large as in recordings."""

AGENTS = torch.arange(400).expand(5, -1)
KEYS = torch.arange(5).view(-1, 1)


def noise_at(step: int, *periods: float) -> Tensor:
    return timed_noise(KEYS, AGENTS, torch.full((5, 1), 0.4 * step), periods)


def test_noise_is_normal_at_every_time():
    values = torch.stack([noise_at(step, math.inf, 8.0, 2.0, 0.4) for step in range(0, 60, 7)])
    assert values.mean((0, 1, 2)).abs().max() < 0.1
    torch.testing.assert_close(values.std((1, 2)).mean(0), torch.ones(4), atol=0.05, rtol=0)


def test_noise_changes_as_slowly_as_its_period_says():
    lasts, slow, fast, new = (
        noise_at(4, math.inf, 20.0, 2.0, 0.4) * noise_at(5, math.inf, 20.0, 2.0, 0.4)
    ).mean((0, 1))
    assert float(lasts) == pytest.approx(1.0, abs=0.1)
    assert 0.8 < float(slow) < 1.2 and 0.6 < float(fast) < 0.99
    assert abs(float(new)) < 0.1
    assert torch.equal(noise_at(4, math.inf), noise_at(50, math.inf))


def test_noise_depends_on_scene_and_agent_alone():
    some = timed_noise(KEYS[2:], AGENTS[2:, 7:9], torch.full((3, 1), 1.6), (math.inf, 4.0, 0.4))
    assert torch.equal(some, noise_at(4, math.inf, 4.0, 0.4)[2:, 7:9])


def test_style_of_a_straight_walk_and_of_a_shaky_one():
    line = torch.stack((0.5 * torch.arange(8.0), torch.zeros(8)), -1)
    shaken = line + 0.03 * torch.randn(8, 2, generator=torch.Generator().manual_seed(0))
    calm, shaky = style_of(line), style_of(shaken)
    assert calm[:3].tolist() == pytest.approx([math.log(0.003) + 3.5] * 3, abs=1e-3)
    assert float(calm[3]) == 1.5 and float(shaky[3]) < 0.0
    assert (shaky[:3] > calm[:3] + 1).all()
    assert float(shaky[4]) < 0.0  # what is shaken goes back


def drawn(seed: int = 0, **settings: bool) -> SocialWalker:
    torch.manual_seed(seed)
    model = SocialWalker.of(walls=False, **settings)
    with torch.no_grad():
        model.head.weight.mul_(5.0)
    return model.eval()


GATE, HALT = -6, -3
"""Numbers of the noise."""

NOISE = torch.randn(1, 5, SocialWalker.noise_dim, generator=torch.Generator().manual_seed(1))


@pytest.mark.parametrize("part", ["style", "held", "halts", "step_noise", "companions"])
@torch.no_grad()
def test_every_part_can_be_left_out(part):
    batch = make_batch((5,))
    whole = SocialWalker.of(walls=False)
    without = SocialWalker.of(walls=False, **{part: False})
    without.load_state_dict(whole.state_dict())
    noise = NOISE.clone()
    noise[:, 0, HALT], noise[:, 1, GATE] = -20.0, -20.0
    assert not torch.equal(whole.next_steps(batch, noise, 1, 8), without.next_steps(batch, noise, 1, 8))


@torch.no_grad()
def test_a_held_velocity_goes_on():
    model, batch = drawn(), make_batch((5,))
    noise = NOISE.clone()
    noise[..., GATE] = -20.0  # shut
    noise[..., HALT] = 20.0
    noise[..., -2:] = 0.0
    history = agents_of(batch)["history"]
    step = model.next_steps(batch, noise, 1, 8)[:, :, 0]
    torch.testing.assert_close(step, history[:, :, -1] - history[:, :, -2], atol=1e-4, rtol=0)


@torch.no_grad()
def test_a_halt_is_one_at_once():
    noise = NOISE.clone()
    noise[..., HALT] = -20.0
    assert not drawn().next_steps(make_batch((5,)), noise, 1, 8).any()


def test_noise_of_places_changes_velocities():
    values = torch.stack([noise_at(step, -0.4) for step in range(40)])
    assert float(values.std()) == pytest.approx(1.0, abs=0.02)
    # velocities are sums of such changes, and these do not drift: they are white noise of places
    assert float(values.cumsum(0).cumsum(0).diff(dim=0).std()) < 1.5
    assert float((values[1:] * values[:-1]).mean()) == pytest.approx(-4 / 6, abs=0.05)


def test_jitter_is_that_of_the_smaller_changes():
    """Tracks in straight pieces have kinks and no jitter."""
    bent = torch.stack((0.5 * torch.arange(8.0), 0.5 * (torch.arange(8.0) - 4).clamp_min(0)), -1)
    style = style_of(bent)
    assert float(kinks_of(style)) == pytest.approx(0.5 / 6, abs=1e-5)
    assert float(jitter_of(style)) == pytest.approx(0.0, abs=1e-6)


@torch.no_grad()
def test_velocities_are_held_as_often_as_in_the_first_steps():
    """Before training; one person holds five of six velocities, the other three."""
    model = drawn(style_prior=True, halts=False)
    model.head.weight.zero_()
    step = torch.tensor([[[0.5, 0.5, 0.5, 0.5, 0.6, 0.6, 0.6], [0.5, 0.5, 0.6, 0.6, 0.7, 0.7, 0.8]]])
    steps = torch.stack((step, torch.zeros_like(step)), -1)
    history = torch.nn.functional.pad(steps.cumsum(2), (0, 0, 1, 0)) + torch.tensor([0.0, 9.0])
    batch = changed(make_batch((2,), padding=0.0), history=history, goal=history[:, :, -1] + 50.0)
    along, speed = torch.tensor([1.0, 0.0]).expand(1, 2, 2), steps[:, :, -1, :1] / STEP_SECONDS
    batch = changed(batch, desired_velocity=along, pref_speed=speed)  # they walk as they want
    first = model.sample(batch, 4000, 1, torch.Generator().manual_seed(0))[:, :, :, 0]
    held = ((first - steps[:, None, :, -1]).norm(dim=-1) < 0.003).double().mean((0, 1))
    shares = held_of(style_of(history))[0]
    assert shares.tolist() == pytest.approx([5 / 6, 3 / 6])
    usual = shares / 3 + shares.mean() * 2 / 3  # seven steps say little: the crowd counts twice
    torch.testing.assert_close(held, usual.double(), atol=0.03, rtol=0)


def eastward(steps: Tensor) -> TensorDict:
    """Return people, 42 m apart, who have made steps (1, A, 7, 2) and want to go east at 1.25 m/s."""
    people = steps.shape[1]
    history = torch.nn.functional.pad(steps.cumsum(2), (0, 0, 1, 0))
    history = history + 30 * torch.arange(float(people)).view(1, people, 1, 1)
    along = torch.tensor([1.0, 0.0]).expand(1, people, 2)
    places = {"history": history, "goal": history[:, :, -1] + 50 * along, "desired_velocity": along}
    return changed(make_batch((people,), padding=0.0), **places, pref_speed=torch.full((1, people, 1), 1.25))


def between(model: SocialWalker, now: Situation, walls: float, **noise: float) -> Tensor:
    """Return the velocity (2,) of one person with walls at a distance on all sides."""
    drawn = torch.zeros(1, 1, model.noise_dim)
    for number, value in noise.items():
        drawn[..., {"gate": -EVERY_STEP - JITTER, "halt": -JITTER - 1}[number]] = value
    return model.velocity(now._replace(walls=torch.full((1, 1, 17), walls)), drawn)[0, 0]


@torch.no_grad()
def test_velocities_away_from_the_way_are_hardly_held():
    model = drawn(style_prior=True, halts=False)
    model.head.weight.zero_()
    steps = torch.tensor([[0.5, 0.0], [-0.5, 0.0], [0.0, 0.0]]).view(1, 3, 1, 2).expand(1, 3, 7, 2)
    steps = steps + WIGGLE
    batch = eastward(steps)
    first = model.sample(batch, 2000, 1, torch.Generator().manual_seed(0))[:, :, :, 0]
    held = ((first - steps[:, None, :, -1]).norm(dim=-1) < 0.003).double().mean((0, 1))
    assert held[0] > 0.9 and held[1] < 0.5 and held[2] > 0.9  # along the way, back, standing


def halting(raised: float) -> SocialWalker:
    """Return a walker without any other reason to change speed, that halts more often than usual."""
    model = drawn(lasting_halts=True, step_noise=False, held=False, style=False)
    with torch.no_grad():
        model.head.weight.zero_()
        model.head.bias[7] = 20.0  # at once what they want
        model.head.bias[16] = raised
    return model.eval()


@torch.no_grad()
def test_a_lasting_halt_begins_by_braking():
    model, batch = halting(0.0), make_batch((5,))
    agents = agents_of(batch)
    noise = NOISE.clone()
    noise[..., HALT_PERIOD] = -5.0
    steps = model.next_steps(batch, noise, 8, 8)
    speed = torch.cat((agents["history"].diff(dim=2)[:, :, -1:], steps), 2).norm(dim=-1) / STEP_SECONDS
    torch.testing.assert_close(speed[..., 1:], (speed[..., :-1] - BRAKING).clamp_min(0), atol=2e-4, rtol=0)
    assert (speed[..., 0] > BRAKING).any() and not steps[:, :, -1].any()


@torch.no_grad()
def test_halts_last_some_steps():
    """With this bias people halt in 13 % of the time."""
    model, batch = halting(2.0), make_batch((5,) * 8)
    far = agents_of(batch)["history"][:, :, -1] + 1e3
    batch = changed(batch, goal=far, pref_speed=torch.ones(8, 5, 1))
    speed = model.sample(batch, 1, 200, torch.Generator().manual_seed(0))[:, 0].norm(dim=-1) / STEP_SECONDS
    assert float(speed[..., 10:].diff(dim=-1).min()) > -BRAKING - 1e-3
    stands = (speed < 0.01).flatten(0, 1)
    begins = int((stands[:, 1:] & ~stands[:, :-1]).sum())
    assert begins > 20 and float(stands.sum()) / begins > 5
    assert 0.03 < float(stands.float().mean()) < 0.2


def test_the_gate_of_halts_has_a_gradient_while_people_stand():
    model, noise = halting(0.0), NOISE.clone()
    noise[..., HALT_PERIOD] = -2.5
    model.next_steps(make_batch((5,)), noise, 6, 8).sum().backward()
    assert model.head.bias.grad is not None and model.head.bias.grad.isfinite().all()
    walked = model.next_steps(make_batch((5,)), noise, 1, 8).norm(dim=-1).sum()
    assert torch.autograd.grad(walked, model.head.bias)[0][16]


GROUPS = torch.tensor([[4, -1, 4, 7, 7]])

BEFORE = [
    [0.53688, -0.11801],
    [-0.27999, 0.21999],
    [-0.29748, -0.36616],
    [0.21425, 0.33717],
    [-0.42472, -0.21469],
]
"""Metres: sixth steps of `social_walker.eth_ucy`."""


@torch.no_grad()
def test_companions_are_those_of_the_groups():
    """People one after the other, 1 m apart: the companion of the last is the first, 8 m ahead."""
    model = drawn(groups=True, step_noise=False, held=False, halts=False)
    model.head.weight.zero_()
    model.head.bias[2], model.head.bias[10] = -20.0, 3.0
    x = torch.arange(9.0).view(1, 9, 1, 1) + 0.4 * torch.arange(8.0).view(1, 1, 8, 1)
    history = torch.cat((x, torch.zeros_like(x)), 3)
    ways = {"history": history, "goal": history[:, :, -1] + torch.tensor([20.0, 0.0])}
    batch = changed(make_batch((9,)), **ways, pref_speed=torch.ones(1, 9, 1))
    company = torch.full((1, 9), -1)
    company[0, 0] = company[0, -1] = 3

    def walked(batch: TensorDict, model: SocialWalker = model) -> Tensor:
        return model.sample(batch, 1, 6, torch.Generator().manual_seed(0))[0, 0].sum(1)[:, 0]

    alone, together = (walked(changed(batch, group=group)) for group in (torch.full((1, 9), -1), company))
    assert together[0] > alone[0] + 0.3 and together[-1] < alone[-1] - 0.3
    assert torch.equal(together[1:-1], alone[1:-1])
    del batch["agents", "group"]
    assert torch.equal(walked(batch), alone)
    guessing = drawn(step_noise=False, held=False, halts=False)
    guessing.load_state_dict(model.state_dict())
    assert not torch.equal(walked(batch, guessing)[1:-1], alone[1:-1])


@torch.no_grad()
def test_weights_from_before_walk_as_before():
    """Steps of published weights that were made before there were lasting halts and groups."""
    model = load("social_walker.eth_ucy")
    batch = changed(make_batch((5,)), group=GROUPS)
    noise = torch.linspace(-1, 1, 5 * SocialWalker.noise_dim).view(1, 5, -1)
    steps = model.next_steps(batch, noise, 6, 8)
    assert {name: tuple(value.shape) for name, value in model.state_dict().items()} == {
        name: tuple(value.shape)
        for name, value in SocialWalker.of(lasting_halts=True, groups=True).state_dict().items()
    }
    torch.testing.assert_close(steps[0, :, -1], torch.tensor(BEFORE), atol=1e-4, rtol=0)


def met(x: float, y: float, vx: float, vy: float) -> Neighbours:
    """Return what a person at the origin who walks along x at 1 m/s sees of another one."""
    back = STEP_SECONDS * torch.arange(-7.0, 1.0).unsqueeze(1)
    history = torch.stack(
        (back * torch.tensor([1.0, 0.0]), torch.tensor([x, y]) + back * torch.tensor([vx, vy]))
    )
    shape = torch.ones(1, 2)
    return nearest(
        history.unsqueeze(0), shape.bool(), 0.15 * shape, torch.tensor([[[1.0, 0.0], [-1.0, 0.0]]])
    )


def test_people_evade_others_who_will_come_close():
    right = torch.tensor([[-1.0, -1.0]])
    evading, urgent = evasion(met(4.0, 0.3, -1.0, 0.0), right)  # in 2 s, 0.3 m beside
    assert evading[0, 0].tolist() == pytest.approx([0.0, -math.exp(-1.6)], abs=1e-4)
    assert float(urgent[0, 0]) == pytest.approx(math.exp(-1.6), abs=1e-4)
    meets, _ = evasion(met(4.0, 0.0, -1.0, 0.0), right)  # each takes the other to be on its right
    torch.testing.assert_close(meets[0], torch.tensor([[0.0, math.exp(-1)]] * 2), atol=1e-2, rtol=0)
    behind, _ = evasion(met(-2.0, 0.0, 0.5, 0.0), right)  # gets left behind
    beside, _ = evasion(met(0.0, 0.7, 1.0, 0.0), right)  # walks beside
    assert not behind.any() and not beside.any()


@torch.no_grad()
def test_people_who_evade_pass_each_other():
    apart = {}
    for avoids in (True, False):
        model = SocialWalker.of(hidden_dim=0, avoids=avoids, halts=False, step_noise=False).eval()
        batch = make_batch((2,), padding=0.0)
        back = 0.5 * torch.arange(-7.0, 1.0)
        history = torch.zeros(1, 2, 8, 2)
        history[0, 0, :, 0], history[0, 1, :, 0] = back, 6.0 - back
        ways = torch.tensor([[[1.0, 0.0], [-1.0, 0.0]]])
        seen = changed(batch, history=history, goal=20 * ways, desired_velocity=1.25 * ways)
        noise = torch.zeros(1, 2, model.noise_dim)
        noise[..., 1] = 1.0
        path = history[:, :, -1:] + model.next_steps(seen, noise, 12, 12).cumsum(2)
        apart[avoids] = float((path[:, 0] - path[:, 1]).norm(dim=-1).min())
    assert apart[True] > 0.4 > apart[False] + 0.2


def test_places_are_narrow_by_the_nearest_wall():
    walls = torch.tensor([[[1.5, 0.3], [0.175, 1.0], [0.05, 0.4], [-0.2, 1.5]]])
    assert narrowness(walls)[0].tolist() == pytest.approx([0.0, 0.5, 1.0, 1.0], abs=1e-6)


def test_places_are_confined_by_walls_on_both_sides():
    """Rays are every 45 degrees from straight ahead to the left, on two rings, after the place itself."""
    places = {"left": [3, 11], "right": [7], "both": [2, 14], "ahead": [1], "here": [0], "behind": [13]}
    walls = torch.full((1, len(places), 17), 1.5)
    for number, rays in enumerate(places.values()):
        walls[0, number, rays] = 0.05
    confined = dict(zip(places, confinement(walls)[0].tolist(), strict=True))
    one_side = ("left", "right")
    assert confined == {key: pytest.approx(float(key not in one_side)) for key in places}
    assert (confinement(walls) <= narrowness(walls)).all()


@torch.no_grad()
def test_people_between_walls_neither_stop_nor_drift():
    """They walk across their way, and a halt and a held velocity are drawn; in a doorway neither happens."""
    model = SocialWalker.of(hidden_dim=0, style_prior=True, avoids=True).eval()
    steps = torch.tensor([0.1, 0.4]).expand(1, 1, 7, 2)
    now = Situation.of(eastward(steps), walls=False)
    for noise in ({"gate": -3.0}, {"halt": -4.0}):
        outside, inside = (STEP_SECONDS * between(model, now, walls, **noise) for walls in (1.5, 0.05))
        same_way = torch.nn.functional.cosine_similarity(outside, steps[0, 0, -1], dim=0)
        assert float(outside.norm()) < 1e-3 or float(same_way) > 0.99
        assert float(inside[0]) > 0.25 > abs(float(inside[1]))


@torch.no_grad()
def test_people_in_narrow_places_turn_to_their_way_at_once():
    """They walk across it; where their velocity changes, most of it is along the way near walls."""
    model = SocialWalker.of(hidden_dim=0, style_prior=True, avoids=True, halts=False).eval()
    now = Situation.of(eastward(torch.tensor([0.0, 0.5]).expand(1, 1, 7, 2)), walls=False)
    inside, outside = (float(between(model, now, walls, gate=5.0)[0]) / 1.25 for walls in (0.0, 1.5))
    assert inside > 0.8 and outside < 0.3


def test_people_evener_than_recorded_have_the_usual_style():
    """What stands says nothing of that; styles of a scene with one shaky walk stay to the bit."""
    line = 0.5 * torch.arange(8.0).view(8, 1) * torch.tensor([1.0, 0.0])
    shaky = line + 0.02 * torch.randn(8, 2)
    usual = torch.tensor(USUAL)
    for other, same in ((line, False), (torch.zeros(8, 2), False), (shaky, True)):
        history = torch.stack((line, other + torch.tensor([0.0, 5.0]))).unsqueeze(0)
        now = Situation.of(changed(make_batch((2,), padding=0.0), history=history), walls=False)
        expected = now.style if same else usual.expand_as(now.style)
        assert torch.equal(unless_even(now.style, now.crowd_change), expected)
        assert same or torch.equal(now.usual_style, expected)
    stand = torch.zeros(1, 2, 8, 2) + torch.tensor([0.0, 5.0])
    now = Situation.of(changed(make_batch((2,), padding=0.0), history=stand), walls=False)
    assert torch.equal(unless_even(now.style, now.crowd_change), now.style)
    assert float(held_of(usual)) == pytest.approx(0.1)
    assert float(kinks_of(usual)) == pytest.approx(0.01, abs=1e-4)
    assert float(jitter_of(usual)) == pytest.approx(5e-4, abs=1e-5)


def share_who_set_out(model: SocialWalker, back: Tensor, **situation: float) -> float:
    """Return the share of 100 people with other noise who set out; they stand, and began as `back` says."""
    batch = changed(make_batch((1,), padding=0.0), history=torch.zeros(1, 1, 8, 2))
    agents_of(batch)["first_history"] = back
    wall = situation.pop("wall", 1.5)
    now = Situation.of(batch, walls=False)._replace(
        walls=torch.full((1, 1, 17), wall), **{key: torch.full((1, 1), v) for key, v in situation.items()}
    )
    noise = torch.zeros(100, 1, model.noise_dim)
    noise[:, 0, -EVERY_STEP - JITTER] = torch.linspace(-2, 2, 100)
    many = Situation(*(value.expand(100, *value.shape[1:]) for value in now))
    return float((model.velocity(many, noise).norm(dim=-1) > 0.1).float().mean())


@torch.no_grad()
def test_people_who_stand_set_out_again():
    """They have walked straight until then, and would hold their last velocity: none.

    Near a wall they set out after a while, where others stopped them at once, and at last anywhere. People
    who stood when they were seen first do not, nor do those of models that do not evade.
    """
    model = SocialWalker.of(hidden_dim=0, style_prior=True, avoids=True, halts=False).eval()
    walked = 0.5 * torch.arange(-7.0, 1.0).view(1, 1, 8, 1) * torch.tensor([1.0, 0.0])
    walked = walked + torch.nn.functional.pad(WIGGLE.cumsum(0), (0, 0, 1, 0))
    stood = torch.zeros(1, 1, 8, 2)
    assert share_who_set_out(model, walked, late=4.0) < 0.02
    assert share_who_set_out(model, walked, late=4.0, wall=0.0) > 0.3
    assert share_who_set_out(model, walked, late=0.0, hindered=1.0) == 1
    assert share_who_set_out(model, walked, late=60.0) == 1
    assert share_who_set_out(model, stood, late=60.0) < 0.02
    others = SocialWalker.of(hidden_dim=0, style_prior=True, halts=False).eval()
    assert share_who_set_out(others, walked, late=60.0, hindered=1.0) < 0.02
