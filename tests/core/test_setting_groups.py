"""Settings in groups, and the same settings without."""

from __future__ import annotations

from dataclasses import dataclass

import pytest

from pedzoo.core.errors import UserError
from pedzoo.core.spec import flat, grouped, make_ungrouped, setting_types
from pedzoo.models.architectures.sgan import SGAN
from pedzoo.policies.load import load_policy
from pedzoo.policies.rule_based.orca import Orca
from pedzoo.sim.make import make_scenario
from pedzoo.sim.scenarios.encounters.circle import Circle


@dataclass(frozen=True)
class Size:
    """A group."""

    width: float = 1.0
    height: float = 2.0


class Box:
    """A class whose default differs from its group's."""

    def __init__(self, name: str = "box", size: Size = Size(height=3.0)) -> None:
        """Take them."""
        self.name, self.size = name, size


def test_settings_have_names_with_and_without_their_group() -> None:
    assert setting_types(Box) == {"name": str, "width": float, "height": float}
    assert grouped(Box, {"width": 4.0, "name": "a"}) == {"name": "a", "size": {"width": 4.0}}
    # a name without its group wins
    assert grouped(Box, {"width": 4.0, "size": {"width": 5.0, "height": 6.0}}) == {
        "size": {"width": 4.0, "height": 6.0}
    }


def test_defaults_are_those_of_the_class() -> None:
    assert make_ungrouped(Box, {}).size == Size(1.0, 3.0)
    assert make_ungrouped(Box, {"width": 4.0}).size == Size(4.0, 3.0)
    assert make_ungrouped(Box, {"size": {"height": 1.0}}).size == Size(1.0, 1.0)
    circle = make_scenario("circle:jitter=0")
    assert isinstance(circle, Circle) and (circle.people, circle.aside, circle.jitter) == (4, 1.0, 0.0)


def test_a_preset_has_the_values_that_are_not_given() -> None:
    policy = load_policy("orca:preset=igibson,radius=0.3")
    assert isinstance(policy, Orca)
    result = policy.settings
    assert (result.radius, result.max_neighbors, result.top_speed_ratio) == (0.3, None, 1.0)


def test_a_model_says_its_settings_without_groups() -> None:
    model = SGAN.of(noise_dim=4, best_k=3, safety=True)
    assert model.config == SGAN().config | {"noise_dim": 4, "best_k": 3, "safety": True}
    assert flat(Size(1.0)) == {"width": 1.0, "height": 2.0}
    with pytest.raises(UserError, match="noise_dim 32: expected 1 to 31"):
        SGAN.of(noise_dim=32)
