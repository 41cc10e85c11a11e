"""A model of one's own is tried on one batch before it is trained."""

from pathlib import Path
from textwrap import dedent, indent
from typing import Any

import pytest
import torch
from helpers.batches import make_batch
from torch import nn

from pedzoo.cli.main import main
from pedzoo.core.errors import UserError
from pedzoo.models.base import Forecaster, for_all_samples, true_displacements
from pedzoo.train.module import check_model, is_own


class _Line(Forecaster):
    """The last step times a learned number: all that a model must keep."""

    def __init__(self) -> None:
        super().__init__()
        self.config: dict[str, Any] = {}
        self.factor = nn.Parameter(torch.ones(()))

    def sample(self, batch: Any, samples: int, steps: int, generator: Any = None) -> Any:
        last = batch["agents", "history"].diff(dim=2)[:, :, -1:].expand(-1, -1, steps, -1)
        last = torch.where(batch["agents", "mask"][..., None, None], last, 0.0)
        return for_all_samples(self.factor * last, batch, samples)

    def loss(self, batch: Any, generator: Any = None) -> Any:
        truth = true_displacements(batch)
        error = (self.sample(batch, 1, truth.shape[2])[:, 0] - truth).square().sum(-1)
        return torch.where(batch["agents", "mask"].unsqueeze(-1), error, 0.0).sum()


def changed(name: str, value: Any) -> _Line:
    """Return a model with another method."""
    return type("Mine", (_Line,), {name: value})()


def test_a_sound_model_stays_as_it_is():
    model, batch = _Line(), make_batch((2, 3), goal=False)
    torch.manual_seed(3)
    before = torch.get_rng_state()
    check_model(model, batch, by_loss=True)
    assert torch.equal(torch.get_rng_state(), before)
    assert model.factor.grad is None and is_own(model) and not is_own(Forecaster())


@pytest.mark.parametrize(
    ("name", "value", "message"),
    [
        (
            "sample",
            lambda self, batch: None,
            r"expected Mine.sample\(batch, samples, steps, generator=None\)",
        ),
        (
            "sample",
            lambda self, batch, k, t, g=None: batch["agents", "history"] @ torch.zeros(3, 2),
            r"failed at test_own_model\.py:\d+: RuntimeError: .*; agents: .*history \(2, 4, 8, 2\)",
        ),
        ("sample", Forecaster.sample, r"no Mine.sample\(.*: it returns displacements"),
        (
            "sample",
            lambda self, batch, k, t, g=None: torch.zeros(2, 4, t, 2),
            r"Mine.sample returned \(2, 4, 8, 2\): expected .* here \(2, 2, 4, 8, 2\); .*for_all_samples",
        ),
        (
            "sample",
            lambda self, batch, k, t, g=None: _Line.sample(self, batch, k, t) / 0,
            "Mine.sample returned numbers that are not finite",
        ),
        (
            "sample",
            lambda self, batch, k, t, g=None: batch["agents", "goal"],
            "reads what the batch has not: .*goal.* needs = frozenset",
        ),
        ("loss", lambda self, batch: 0, r"expected Mine.loss\(batch, generator=None\): too many positional"),
        ("loss", lambda self, batch, g=None: self.factor.expand(3), r"loss returned \(3,\): .* add .sum\(\)"),
        ("loss", lambda self, batch, g=None: self.factor / 0, "Mine.loss is inf on the first batch"),
        ("loss", lambda self, batch, g=None: self.factor.detach(), "no gradient of Mine.loss reaches"),
        (
            "loss",
            lambda self, batch, g=None: (self.factor - 1).sqrt(),
            "with respect to factor is not finite",
        ),
        ("parameters", None, ""),
    ],
)
def test_what_a_model_must_keep(name, value, message):
    batch = make_batch((4, 4), goal=False)
    if name == "parameters":
        model, message = _Line(), "_Line has no parameters to train"
        model.factor.requires_grad_(False)
    else:
        model = changed(name, value)
    with pytest.raises(UserError, match=message) as error:
        check_model(model, batch, by_loss=True)
    assert "\n" not in str(error.value)


def test_parameters_that_learn_nothing_are_named(capsys):
    model = _Line()
    model.other = nn.Linear(2, 2)
    check_model(model, make_batch((2, 3), goal=False), by_loss=True)
    assert "note: other.weight, other.bias of _Line get no gradient" in capsys.readouterr().err


FILE = """
    import torch
    from torch import nn
    from pedzoo.models.base import Forecaster


    class Mine(Forecaster):
        needs = frozenset({"goal"})

        def __init__(self):
            super().__init__()
            self.config = {}
            self.factor = nn.Parameter(torch.ones(()))

        def sample(self, batch, samples, steps, generator=None):
            return self.factor * torch.zeros(3)
"""


def test_fit_refuses_it_before_the_first_epoch(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    Path("mine.py").write_text(dedent(FILE))
    plain = "model:\n  class_path: pedzoo.train.module.PlainModule\n"
    plain += indent("init_args: {samples: 1, generator: {class_path: mine.py:Mine}}", "  ")
    Path("mine.yaml").write_text(f"{plain}\ndata: {{fold: embedded}}\ntrainer: {{max_epochs: 1}}\n")
    fit = ["fit", "--config", "mine.yaml", "--trainer.enable_progress_bar=false"]
    assert main([*fit, "--data.goal", "none"]) == 2
    assert "Mine needs them by 'any': set --data.goal window_end" in capsys.readouterr().err
    assert main([*fit, "--data.goal", "destination"]) == 2
    assert "Mine.sample returned (3,): expected displacements" in capsys.readouterr().err
