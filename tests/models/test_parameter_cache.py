"""What is kept between calls never shows: answers are those of the parameters as they are."""

from __future__ import annotations

import copy
import pickle
from collections.abc import Callable
from contextlib import AbstractContextManager
from typing import Any, cast

import pytest
import torch
from helpers.batches import make_batch, random_weights
from torch import Tensor, nn

from pedzoo.models.architectures.sgan import SGAN
from pedzoo.models.blocks.parameter_cache import ParameterCache

OPTIONS: dict[str, Any] = {"bottleneck_dim": 3, "best_k": 2}
MODES = pytest.mark.parametrize("mode", [torch.no_grad, torch.inference_mode])


def made(seed: int = 0, **options: Any) -> SGAN:
    """Return a model with random weights."""
    torch.manual_seed(seed)
    return cast("SGAN", random_weights(SGAN.of(**OPTIONS | options), seed)).double()


def answers(model: SGAN) -> list[Tensor]:
    """Return futures of one step and of several, of scenes of one size and of two."""
    dtype = next(model.parameters()).dtype
    return [
        model.sample(make_batch(sizes, dtype=dtype), 2, steps, torch.Generator().manual_seed(0)).detach()
        for sizes in ((4,), (3, 2))
        for steps in (1, 3)
    ]


def edit(model: SGAN) -> None:
    cast("Tensor", model.decoder.lstm.bias_hh_l0).add_(0.5)


def step(model: SGAN) -> None:
    optimizer = torch.optim.Adam(model.parameters(), 0.1)
    with torch.enable_grad():
        model.loss(make_batch((3, 2), dtype=torch.float64)).backward()
    optimizer.step()


def assign(model: SGAN) -> None:
    model.load_state_dict(made(7).state_dict(), assign=True)


def replace_layer(model: SGAN) -> None:
    model.to_decoder[2] = nn.Linear(64, 24).double()


def replace_part(model: SGAN) -> None:
    model.decoder = made(7).decoder


def replace_parameter(model: SGAN) -> None:
    model.encoder.embedding.bias = nn.Parameter(torch.full((16,), 0.3, dtype=torch.float64))


def replace_data_twice(model: SGAN) -> None:
    """The second memory may well have the address of the first."""
    for _ in range(2):
        for parameter in model.parameters():
            parameter.data = parameter.data * 1.1


CHANGES: list[Callable[[SGAN], Any]] = [
    step,
    assign,
    replace_layer,
    replace_part,
    replace_parameter,
    replace_data_twice,
    lambda model: model.load_state_dict(made(7).state_dict()),
    lambda model: model.float(),
    edit,
    lambda model: nn.utils.vector_to_parameters(
        1.1 * nn.utils.parameters_to_vector(model.parameters()), model.parameters()
    ),
]


@MODES
@pytest.mark.parametrize("change", CHANGES)
def test_every_change_of_parameters_is_seen(
    change: Callable[[SGAN], object], mode: Callable[[], AbstractContextManager]
) -> None:
    model = made()
    with mode():
        before = answers(model)
        assert all(map(torch.equal, answers(model), before))
    with torch.no_grad():
        change(model)
    with mode():
        after = answers(model)
    wanted = answers(model)  # with gradients, nothing is kept
    close = 1e-9 if wanted[0].dtype == torch.float64 else 1e-4
    for got, want, old in zip(after, wanted, before, strict=True):
        torch.testing.assert_close(got, want, rtol=close, atol=close)
        if want.dtype == old.dtype:
            assert (got - old).abs().max() > 1e-4


def test_change_within_inference_mode_is_seen() -> None:
    model = made()
    with torch.inference_mode():
        before = answers(model)
        model.encoder.embedding.weight.mul_(1.5)
        after = answers(model)
    for got, want, old in zip(after, answers(model), before, strict=True):
        torch.testing.assert_close(got, want, rtol=1e-9, atol=1e-9)
        assert (got - old).abs().max() > 1e-4


@pytest.mark.parametrize("copied", [copy.deepcopy, lambda model: pickle.loads(pickle.dumps(model))])
def test_copies_are_on_their_own(copied: Callable[[SGAN], SGAN]) -> None:
    model = made()
    with torch.no_grad():
        before = answers(model)
        other = copied(model)
        assert other._parameter_cache._cached is None
        for parameter in other.parameters():
            parameter.mul_(1.2)
        after = answers(other)
        assert all(map(torch.equal, answers(model), before))
    for got, want in zip(after, answers(other), strict=True):
        torch.testing.assert_close(got, want, rtol=1e-9, atol=1e-9)


def test_parameters_of_inference_mode_are_never_kept() -> None:
    with torch.inference_mode():
        model = made()
        before = answers(model)
        model.encoder.embedding.weight.mul_(1.5)
        assert not any(map(torch.equal, answers(model), before))
        assert model._parameter_cache._cached is None


def test_gradients_flow_after_answers_without_them() -> None:
    model = made()
    for mode in (torch.no_grad, torch.inference_mode):
        with mode():
            answers(model)
        loss = model.loss(make_batch((3, 2), dtype=torch.float64))
        gradients = torch.autograd.grad(loss, list(model.parameters()))
        assert all(gradient.isfinite().all() for gradient in gradients)


def test_automatic_precision_does_not_stay() -> None:
    model, fresh = made(), made()
    with torch.no_grad():
        with torch.autocast("cpu", dtype=torch.bfloat16):
            model._parameter_cache(model)
        for got, want in zip(answers(model), answers(fresh), strict=True):
            assert torch.equal(got, want)


def test_functional_calls_do_not_leave_their_parameters() -> None:
    model, other, batch = made(), made(7), make_batch((3,), dtype=torch.float64)
    with torch.no_grad():
        before, wanted = model.mode(batch, 1), other.mode(batch, 1)
        with torch.nn.utils.stateless._reparametrize_module(model, dict(other.named_parameters())):
            torch.testing.assert_close(model.mode(batch, 1), wanted)
        assert torch.equal(model.mode(batch, 1), before)


def test_a_value_is_made_once() -> None:
    calls = []
    stored, module = ParameterCache(lambda m: calls.append(m) or len(calls), 0), nn.Linear(2, 2)
    assert stored(module) == 0
    with torch.no_grad():
        assert [stored(module), stored(module)] == [1, 1]
        module.bias.add_(1)
        assert [stored(module), stored(module)] == [2, 2]
        assert stored(nn.Linear(2, 2)) == 3
