"""The discriminator: the published formula, and the shortcut for several futures of the same people."""

from __future__ import annotations

from typing import Literal

import pytest
import torch
from test_blocks import crowd_of, plain_encoder, plain_pooling

from pedzoo.models.blocks.discriminator import Discriminator
from pedzoo.models.blocks.people.crowd import Crowd

SIZES = (2, 4, 1)
KINDS = pytest.mark.parametrize("kind", ["local", "global"])


def made(kind: Literal["local", "global"]) -> Discriminator:
    """Return a discriminator whose scores are not cut off at zero for most people."""
    torch.manual_seed(0)
    result = Discriminator(kind, 4, 5, 6).double()
    torch.nn.init.constant_(result.classifier.get_submodule("2").get_parameter("bias"), 2.0)
    return result


@KINDS
def test_scores_are_the_plain_ones(kind: Literal["local", "global"]) -> None:
    judge, crowd = made(kind), crowd_of(SIZES)
    window, start = torch.randn(7, 16, 2).double(), torch.randn(7, 2).double()
    hidden = plain_encoder(judge.encoder, window)
    if judge.pooling is not None:
        hidden = plain_pooling(judge.pooling, hidden, start, crowd)
    wanted = judge.classifier(hidden)[:, 0]
    assert (wanted > 0).sum() > 4
    torch.testing.assert_close(judge(window, start, crowd), wanted)


@KINDS
def test_futures_of_the_same_people_are_judged_as_whole_windows(kind: Literal["local", "global"]) -> None:
    judge = made(kind)
    both = Crowd.of((torch.arange(4) < torch.tensor(SIZES).unsqueeze(1)).repeat(2, 1))
    observed, start = torch.randn(7, 8, 2).double(), torch.randn(7, 2).double()
    futures = torch.randn(2, 7, 8, 2).double().requires_grad_()
    windows = torch.cat([torch.cat((observed, future), 1) for future in futures])
    results = []
    for score in (
        judge.of_futures(observed, futures, start, both),
        judge(windows, start.repeat(2, 1), both),
    ):
        assert score.shape == (14,)
        weighted = (torch.linspace(-1, 2, 14).double() * score.square()).sum()
        results.append((score, *torch.autograd.grad(weighted, [futures, *judge.parameters()])))
    for got, wanted in zip(*results, strict=True):
        torch.testing.assert_close(got, wanted)
