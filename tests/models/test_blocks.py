"""The fast blocks equal the literal formulas of Social GAN (Gupta et al., CVPR 2018)."""

import math
from collections.abc import Callable, Sequence
from typing import Any, Literal, cast

import numpy as np
import pytest
import torch
from helpers.batches import make_batch, on_plan, random_weights
from torch import Tensor, nn
from torch.nn import functional

from pedzoo.maps.bank import MapBank
from pedzoo.maps.grid import OCCUPIED, OccupancyGrid
from pedzoo.models.architectures.sgan import SGAN, ContextNoise
from pedzoo.models.blocks.mlp import init_like_sgan, mlp
from pedzoo.models.blocks.people import ego_frame, pooling
from pedzoo.models.blocks.people.approach import ApproachPooling
from pedzoo.models.blocks.people.crowd import Crowd, share_seen
from pedzoo.models.blocks.people.pooling import SocialPooling
from pedzoo.models.blocks.recurrent import DisplacementDecoder, DisplacementEncoder
from pedzoo.models.blocks.variety import Discriminator


def crowd_of(sizes: Sequence[int]) -> Crowd:
    """Return the packing of scenes of these sizes."""
    return Crowd.of(torch.arange(max(sizes)) < torch.tensor(sizes).unsqueeze(1))


def plain_lstm(lstm: nn.LSTM, inputs: list[Tensor], hidden: Tensor, cell: Tensor) -> tuple[Tensor, Tensor]:
    """Return hidden and cell state after ``inputs``, gate by gate."""
    w_ih, w_hh, b_ih, b_hh = lstm.parameters()
    for x in inputs:
        gates = x @ w_ih.T + b_ih + hidden @ w_hh.T + b_hh
        i, f, g, o = gates.chunk(4, 1)
        cell = f.sigmoid() * cell + i.sigmoid() * g.tanh()
        hidden = o.sigmoid() * cell.tanh()
    return hidden, cell


def plain_encoder(encoder: DisplacementEncoder, displacements: Tensor) -> Tensor:
    """Return what ``encoder`` should, step by step from a displacement of zero."""
    displacements = functional.pad(displacements, (0, 0, 1, 0))
    zero = displacements.new_zeros(len(displacements), encoder.lstm.hidden_size)
    return plain_lstm(encoder.lstm, [encoder.embedding(d) for d in displacements.unbind(1)], zero, zero)[0]


def plain_decoder(decoder: DisplacementDecoder, hidden: Tensor, first: Tensor, steps: int) -> Tensor:
    """Return what ``decoder`` should, feeding back each displacement."""
    cell, displacement, answer = torch.zeros_like(hidden), first, []
    for _ in range(steps):
        hidden, cell = plain_lstm(decoder.lstm, [decoder.embedding(displacement)], hidden, cell)
        displacement = decoder.output(hidden)
        answer.append(displacement)
    return torch.stack(answer, 1)


def plain_pooling(pool: SocialPooling, hidden: Tensor, position: Tensor, crowd: Crowd) -> Tensor:
    """Return what ``pool`` should, pair by pair."""
    rows = []
    for i, scene in enumerate(crowd.scene):
        others = (crowd.scene == scene).nonzero().flatten()
        seen = [torch.cat([pool.embedding(position[j] - position[i]), hidden[j]]) for j in others]
        rows.append(pool.mlp(torch.stack(seen)).amax(0))
    return torch.stack(rows)


def assert_same(
    fast: Callable[..., Tensor], plain: Callable[..., Tensor], module: nn.Module, inputs: Sequence[Tensor]
) -> None:
    """Check values, and the gradients of inputs and parameters, of two formulations."""
    leaves = [x.requires_grad_() for x in inputs] + list(module.parameters())
    results = []
    for function in (fast, plain):
        value = function(*inputs)
        weight = torch.linspace(-1, 2, value.numel(), dtype=value.dtype).view_as(value)
        results.append((value, torch.autograd.grad((weight * value.square()).sum(), leaves)))
    close = 1e-9 if inputs[0].dtype == torch.float64 else 4e-6
    torch.testing.assert_close(results[0][0], results[1][0], rtol=close, atol=close)
    for got, wanted in zip(results[0][1], results[1][1], strict=True):
        scale = wanted.abs().max().clamp(min=1)
        torch.testing.assert_close(got / scale, wanted / scale, rtol=close, atol=close)


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@pytest.mark.parametrize("people", [1, 5])
def test_encoder_is_the_step_by_step_one(dtype, people):
    encoder = DisplacementEncoder(6, 7).to(dtype)
    displacements = torch.randn(people, 8, 2, dtype=dtype)
    assert_same(encoder, lambda d: plain_encoder(encoder, d), encoder, [displacements])
    with torch.no_grad():
        torch.testing.assert_close(encoder(displacements), plain_encoder(encoder, displacements))


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@pytest.mark.parametrize("people", [1, 5])
@pytest.mark.parametrize("steps", [1, 8])
def test_decoder_is_the_step_by_step_one(dtype, people, steps):
    decoder = DisplacementDecoder(6, 7).to(dtype)
    hidden, first = torch.randn(people, 7, dtype=dtype), torch.randn(people, 2, dtype=dtype)
    assert_same(
        lambda h, d: decoder(h, d, steps),
        lambda h, d: plain_decoder(decoder, h, d, steps),
        decoder,
        [hidden, first],
    )


def test_networks_in_pieces_are_the_whole(monkeypatch):
    encoder, decoder = DisplacementEncoder(6, 7), DisplacementDecoder(6, 7)
    displacements, hidden, first = torch.randn(11, 8, 2), torch.randn(11, 7), torch.randn(11, 2)
    encoded, decoded = encoder(displacements), decoder(hidden, first, 3)
    monkeypatch.setattr("pedzoo.models.blocks.recurrent._CPU_CELLS", 4 * 8 * 7)
    torch.testing.assert_close(encoder(displacements), encoded)
    torch.testing.assert_close(decoder(hidden, first, 3), decoded)


def test_no_people_have_no_future():
    assert DisplacementEncoder(6, 7)(torch.zeros(0, 8, 2)).shape == (0, 7)
    for steps in (1, 3):
        assert DisplacementDecoder(6, 7)(torch.zeros(0, 7), torch.zeros(0, 2), steps).shape == (0, steps, 2)
    crowd = Crowd.of(torch.zeros(2, 3, dtype=torch.bool))
    assert SocialPooling(5)(torch.zeros(0, 5), torch.zeros(0, 2), crowd).shape == (0, 8)


def test_decoder_trains_through_its_own_output():
    """Two calls in a row, as in closed-loop training, equal one plain chain."""
    decoder = DisplacementDecoder(6, 7).double()
    hidden, first = torch.randn(3, 7).double(), torch.randn(3, 2).double()
    assert_same(
        lambda h, d: decoder(h, decoder(h, d, 2)[:, -1], 2),
        lambda h, d: plain_decoder(decoder, h, plain_decoder(decoder, h, d, 2)[:, -1], 2),
        decoder,
        [hidden, first],
    )


SIZES = [(1,), (4,), (3, 3, 3), (2, 5, 1, 5, 3), (1, 1, 9)]


@pytest.mark.parametrize("sizes", SIZES)
@pytest.mark.parametrize(
    ("dtype", "buffer", "at_once"),
    [(torch.float64, 1, 0), (torch.float32, 200, 0), (torch.float64, 2**20, 0), (torch.float32, 200, 2**17)],
)
def test_pooling_is_the_pair_by_pair_one(dtype, sizes, buffer, at_once, monkeypatch):
    monkeypatch.setattr(pooling, "_CPU_FLOATS", buffer)
    monkeypatch.setattr(pooling, "_AT_ONCE", at_once)
    pool = SocialPooling(5, 4, 9, 6).to(dtype)
    init_like_sgan(pool)
    crowd = crowd_of(sizes)
    hidden, position = torch.randn(sum(sizes), 5, dtype=dtype), 3 * torch.randn(sum(sizes), 2, dtype=dtype)
    assert_same(
        lambda h, p: pool(h, p, crowd),
        lambda h, p: plain_pooling(pool, h, p, crowd),
        pool,
        [hidden, position],
    )
    with torch.no_grad():
        torch.testing.assert_close(
            pool(hidden, position, crowd), plain_pooling(pool, hidden, position, crowd)
        )


def test_slot_pooling_leaves_out_absent_and_far_people():
    """As in graphs for other programs; by hand, pair by pair."""
    torch.manual_seed(3)
    absent = torch.tensor([[False, False, True], [False, False, False], [True, False, False]])
    u, v, weight = torch.randn(9, 5), torch.randn(9, 5), torch.randn(4, 5)
    place = torch.randn(9, 2)
    place[4] += 100  # in the second scene, out of everybody's sight
    place[7] += torch.tensor([27.0, 0.0])  # in the third one, it counts less
    result = pooling._max_at_once(u, v, weight, place.view(3, 3, 2), absent)
    for i in (~absent).flatten().nonzero()[:, 0].tolist():
        scene = range(i // 3 * 3, i // 3 * 3 + 3)
        values = [
            weight @ torch.maximum(u[j], v[i]) - (1 / share_seen(place[j] - place[i]) - 1)
            for j in scene
            if not absent.flatten()[j]
        ]
        torch.testing.assert_close(result[i], torch.stack(values).amax(0))


def test_pooling_with_frozen_weights_still_reaches_the_people():
    pool = SocialPooling(5, 4, 9, 6).double().requires_grad_(False)
    crowd = crowd_of((2, 4))
    hidden, position = (torch.randn(6, n).double().requires_grad_() for n in (5, 2))
    got = torch.autograd.grad(pool(hidden, position, crowd).sum(), [hidden, position])
    wanted = torch.autograd.grad(plain_pooling(pool, hidden, position, crowd).sum(), [hidden, position])
    torch.testing.assert_close(got, wanted)


def test_pooling_far_from_the_origin():
    """Map coordinates of a city do not cost digits."""
    pool, crowd = SocialPooling(5), crowd_of((4, 2))
    hidden, position = torch.randn(6, 5), torch.randint(-8, 8, (6, 2)).float()
    torch.testing.assert_close(pool(hidden, position + 2**20, crowd), pool(hidden, position, crowd))


def test_mlp_ends_with_relu_and_draws_only_linear_weights():
    block = nn.ModuleDict({"mlp": mlp(400, 300, 2), "lstm": nn.LSTM(4, 5)})
    before = {name: value.clone() for name, value in block.state_dict().items()}
    init_like_sgan(block)
    changed = {name for name, value in block.state_dict().items() if not torch.equal(value, before[name])}
    assert changed == {"mlp.0.weight", "mlp.2.weight"}
    assert block["mlp"][0].weight.std().item() == pytest.approx(math.sqrt(2 / 400), rel=0.02)  # type: ignore[index]
    assert (block["mlp"](torch.randn(50, 400)) >= 0).all()


# -- the discriminator: the published formula, and the shortcut for several futures of the same people

THREE = (2, 4, 1)
BOTH = pytest.mark.parametrize("kind", ["local", "global"])


def judge_of(kind: Literal["local", "global"]) -> Discriminator:
    """Return a discriminator whose scores are not cut off at zero for most people."""
    torch.manual_seed(0)
    result = Discriminator(kind, 4, 5, 6).double()
    torch.nn.init.constant_(result.classifier.get_submodule("2").get_parameter("bias"), 2.0)
    return result


@BOTH
def test_scores_are_the_plain_ones(kind):
    judge, crowd = judge_of(kind), crowd_of(THREE)
    window, start = torch.randn(7, 16, 2).double(), torch.randn(7, 2).double()
    hidden = plain_encoder(judge.encoder, window)
    if judge.pooling is not None:
        hidden = plain_pooling(judge.pooling, hidden, start, crowd)
    wanted = judge.classifier(hidden)[:, 0]
    assert (wanted > 0).sum() > 4
    torch.testing.assert_close(judge(window, start, crowd), wanted)


@BOTH
def test_futures_of_the_same_people_are_judged_as_whole_windows(kind):
    judge = judge_of(kind)
    both = Crowd.of((torch.arange(4) < torch.tensor(THREE).unsqueeze(1)).repeat(2, 1))
    observed, start = torch.randn(7, 8, 2).double(), torch.randn(7, 2).double()
    futures = torch.randn(2, 7, 8, 2).double().requires_grad_()
    windows = torch.cat([torch.cat((observed, future), 1) for future in futures])
    results = []
    scores = judge.of_futures(observed, futures, start, both), judge(windows, start.repeat(2, 1), both)
    for score in scores:
        assert score.shape == (14,)
        weighted = (torch.linspace(-1, 2, 14).double() * score.square()).sum()
        results.append((score, *torch.autograd.grad(weighted, [futures, *judge.parameters()])))
    torch.testing.assert_close(*results)


# -- what a controller sees and is: closest approaches, the frame of the way, a trait

GOAL: dict[str, Any] = {"goal_dim": 4, "goal_protocol": "window_end", "noise": "agent"}
NEW: dict[str, Any] = {"map": "rings", "map_dim": 5, "approach_dim": 6, "trait_dim": 7}


def transparent() -> ApproachPooling:
    """Return a pooling that answers with the features of the only other person, then with these negated."""
    pool = ApproachPooling(3, 16, hidden_dim=16)
    with torch.no_grad():
        for parameter in pool.parameters():
            parameter.zero_()
        pool.pair.weight.copy_(torch.cat((torch.eye(8), -torch.eye(8))))
        pool.output.weight.copy_(torch.eye(16))
    return pool


def walking(people: int, seed: int = 0) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """Return position, last displacement, heading and state of so many people."""
    random = torch.Generator().manual_seed(seed)
    position, moved, state = (torch.randn(people, n, generator=random) for n in (2, 2, 3))
    return 3 * position, 0.4 * moved, nn.functional.normalize(moved, dim=-1), state


def seen_by_the_first(away: tuple[float, float], velocity: tuple[float, float]) -> list[float]:
    """Return what a person who walks along x at 1 m/s sees of another person."""
    position = torch.tensor([[0.0, 0.0], away])
    moved = 0.4 * torch.tensor([[1.0, 0.0], velocity])
    heading = torch.tensor([[1.0, 0.0], [1.0, 0.0]])
    result = transparent()(position, moved, heading, torch.zeros(2, 3), crowd_of((2,)))
    return (result[0, :8] - result[0, 8:]).tolist()


def test_closest_approaches_by_hand():
    """4 m ahead, 1 m to the left, towards each other at 2 m/s: beside each other, 1 m apart, in 2 s."""
    near = 2 / (2 + math.sqrt(17))
    urgent = near * 2 / (2 + 1) * math.exp(-2 / 2)
    wanted = [near * 4 / 2, near * 1 / 2, near * -2, 0.0, 0.0, near * 1 / 2, near, urgent]
    assert seen_by_the_first((4.0, 1.0), (-1.0, 0.0)) == pytest.approx(wanted, abs=3e-3)
    leaves = seen_by_the_first((-4.0, 0.0), (-1.0, 0.0))  # closest now: nothing is taken off for the time
    assert leaves[4:6] == pytest.approx([2 / 6 * -4 / 2, 0.0], abs=1e-4)
    assert leaves[7] == pytest.approx((2 / 6) ** 2, abs=1e-4)
    far = seen_by_the_first((20.0, 0.0), (-2.0, 0.0))  # at 3 m/s: after 4 s there are 8 m left
    assert far[4] == pytest.approx(2 / 22 * 8 / 2, rel=1e-3)


def test_what_another_does_is_added_to_how_they_move():
    """Features of the state of the person seen, and not of the own one, inside the same layer."""
    pool = transparent()
    with torch.no_grad():
        pool.other.weight[:3] = torch.eye(3)
    position, moved = torch.tensor([[0.0, 0.0], [4.0, 1.0]]), 0.4 * torch.tensor([[1.0, 0.0], [-1.0, 0.0]])
    heading, state = torch.tensor([[1.0, 0.0], [1.0, 0.0]]), torch.tensor([[9.0, 9.0, 9.0], [0.1, 0.2, 5.0]])
    plain = torch.tensor(seen_by_the_first((4.0, 1.0), (-1.0, 0.0)))
    result = pool(position, moved, heading, state, crowd_of((2,)))[0, :8]
    torch.testing.assert_close(result[:3], (plain[:3] + state[1]).clamp_min(0.0))


def test_a_person_alone_sees_no_others():
    result = ApproachPooling(3, 6)(*walking(5), crowd_of((1, 3, 1)))
    assert not result[0].any() and not result[4].any() and bool(result[1:4].any(1).all())


@pytest.mark.parametrize("case", ["same spot", "standing", "both", "side by side"])
def test_gradients_are_finite_wherever_people_are(case):
    pool = ApproachPooling(3, 6)
    position, moved, heading, state = walking(4)
    if case in ("same spot", "both"):
        position = torch.zeros(4, 2)
    if case in ("standing", "both"):
        moved = torch.zeros(4, 2)
    if case == "side by side":
        moved = moved[:1].expand(4, 2).clone()
    leaves = [x.requires_grad_() for x in (position, moved, heading, state)]
    pool(*leaves, crowd_of((4,))).square().sum().backward()
    gradients = [x.grad for x in (*leaves, *pool.parameters()) if x.grad is not None]
    assert len(gradients) == 4 + len(list(pool.parameters()))
    assert all(bool(gradient.isfinite().all()) for gradient in gradients)


def room() -> OccupancyGrid:
    """A square of 6 m with a wall from x = 4 to 5 m and a pillar."""
    cells = np.zeros((60, 60), dtype=np.uint8)
    cells[:, 40:50] = OCCUPIED
    cells[20:25, 10:15] = OCCUPIED
    return OccupancyGrid(cells, 0.1, (1.0, -2.0, 0.3), name="room")


def test_way_frame_hardly_turns_for_stopping_people():
    """A step of 2 cm to the left, to the right or back, with the goal straight ahead."""
    goal = torch.tensor([[4.0, 0.0]]).expand(3, 2)
    moved = torch.zeros(3, 7, 2)
    moved[:, -1] = torch.tensor([[0.0, 0.02], [0.0, -0.02], [-0.02, 0.0]])
    way, heading = ego_frame.way(moved, goal), ego_frame.heading(moved, goal)
    assert torch.allclose(way.norm(dim=-1), torch.ones(3))
    assert bool((way[:, 0] > 0.999).all())
    assert bool((heading[:2, 0] < 0.95).all())
    standing = ego_frame.way(torch.zeros(1, 7, 2), torch.zeros(1, 2))  # nowhere to go: some direction
    assert float(standing.norm()) == pytest.approx(1.0)


def test_a_new_trait_adds_nothing_and_a_trained_one_does():
    trait, context, z = ContextNoise(5, 2, 8), torch.randn(3, 4, 5), torch.randn(3, 4, 2)
    assert torch.equal(trait(context, z), context)
    for parameter in trait.parameters():
        nn.init.normal_(parameter)
    assert not torch.allclose(trait(context, z), trait(context, -z), atol=0.1)


def grown(plain: SGAN) -> SGAN:
    """Return a network with everything new whose other weights are those of a plain one."""
    model, old = SGAN.of(**GOAL, **NEW), plain.state_dict()
    new = model.state_dict()
    for key, value in old.items():
        if key == "to_decoder.0.weight":
            new[key][:, : value.shape[1]] = value
        else:
            new[key] = value
    model.load_state_dict(new)
    return model


def test_new_parts_say_nothing_before_training():
    plain = cast("SGAN", random_weights(SGAN.of(**GOAL)))
    model, batch = grown(plain), on_plan(make_batch((3, 1, 4)), MapBank([room()]))
    noise = torch.randn(3, 4, 8, generator=torch.Generator().manual_seed(0))
    wanted = plain.next_steps(batch, noise, 8, 8)
    result = model.next_steps(batch, noise, 8, 8)
    torch.testing.assert_close(result, wanted, atol=1e-6, rtol=0)
    result.square().sum().backward()
    first = cast("nn.Linear", model.to_decoder[0])
    assert first.weight.grad is not None and bool(first.weight.grad[:, -11:].any(1).any())
    assert model.trait is not None
    last = cast("nn.Linear", model.trait.net[-1])
    assert last.weight.grad is not None and bool(last.weight.grad.any())


@pytest.mark.parametrize("signed", [False, True])
def test_scores_may_be_negative_if_they_are_to(signed: bool) -> None:
    judge, way = Discriminator(hidden_dim=8, mlp_dim=8, signed=signed), torch.randn(200, 10, 2)
    scores = judge(way, way[:, 0], Crowd.of(torch.ones(1, 200, dtype=torch.bool)))
    assert bool((scores < 0).any()) == signed
