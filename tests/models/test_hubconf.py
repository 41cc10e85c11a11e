"""torch.hub from a local checkout: no network, the same models as by name."""

from __future__ import annotations

import inspect
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path

import pytest
import torch
from helpers.batches import make_batch

import pedzoo
from pedzoo.core.errors import UserError
from pedzoo.models.base import Forecaster

CHECKOUT = Path(__file__).parents[2]


def test_hub_has_one_entry_per_family_of_weights() -> None:
    spec = spec_from_file_location("hubconf", CHECKOUT / "hubconf.py")
    assert spec is not None and spec.loader is not None
    module = module_from_spec(spec)
    spec.loader.exec_module(module)
    entries = {name: value for name, value in vars(module).items() if callable(value) and name[0] != "_"}
    assert entries.keys() == {name.partition(".")[0] for name in pedzoo.list_models()}
    assert "zara1_destination" in str(inspect.getdoc(entries["sgan_goal"]))


def test_torch_hub_loads_what_pedzoo_loads() -> None:
    model = torch.hub.load(str(CHECKOUT), "sgan_goal", pretrained="zara1", source="local")
    assert isinstance(model, Forecaster) and not model.training
    batch = make_batch((3,))
    assert torch.equal(model.mode(batch, 8), pedzoo.load("sgan_goal.zara1").mode(batch, 8))


def test_unknown_weights_are_named_with_what_there_is() -> None:
    with pytest.raises(UserError, match=r"'sgan_goal\.zara3': did you mean 'sgan_goal\.zara"):
        torch.hub.load(str(CHECKOUT), "sgan_goal", pretrained="zara3", source="local")
    with pytest.raises(RuntimeError, match="Cannot find callable sgan_gaol"):
        torch.hub.load(str(CHECKOUT), "sgan_gaol", source="local")
