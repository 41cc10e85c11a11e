"""Names with settings, also in groups: what they mean, and what a misspelling is told."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

from pedzoo.core.errors import UserError
from pedzoo.core.registry import POLICIES, SCENARIOS
from pedzoo.core.spec import Spec, build, build_ungrouped, flattened, grouped, parse, setting_types, split
from pedzoo.models.architectures.sgan import SGAN
from pedzoo.policies.load import load_policy
from pedzoo.policies.policy import Policy
from pedzoo.policies.rule_based.orca import Orca
from pedzoo.sim.scenario import Scenario


def test_parts() -> None:
    assert parse("door") == ("door", {})
    assert parse("goals:map=[a.yaml,b.yaml],people=5") == ("goals", {"map": "[a.yaml,b.yaml]", "people": "5"})
    assert parse("my/file.py:Mine") == ("my/file.py:Mine", {})
    assert parse("my/file.py:Mine:a=1") == ("my/file.py:Mine", {"a": "1"})
    assert parse("runs/best.ckpt:noise=step") == ("runs/best.ckpt", {"noise": "step"})
    for address in ("hf://me/zoo@v1/sgan.mall", "http://localhost:8000/zoo/sgan.mall", "https://a.b/sgan.x"):
        assert parse(address) == (address, {})
        assert parse(f"{address}:noise=step,a=x/y") == (address, {"noise": "step", "a": "x/y"})


@pytest.mark.parametrize(
    ("text", "path"),
    [
        ("'/a,b/plan.yaml'", "/a,b/plan.yaml"),
        ('"/o\'brien,b"', "/o'brien,b"),
        ("/o'brien/it's", "/o'brien/it's"),
        ("'[a'", "[a"),
        ("'a+b: c'", "a+b: c"),
        ("'3'", "3"),
    ],
)
def test_quotes_hold_what_would_split_a_text(text: str, path: str) -> None:
    one = build(SCENARIOS, f"goals:map={text},people=3", Scenario)
    assert (one.files, one.people) == ([path], 3)
    assert split(f"goals:map={text}+orca", "+") == [f"goals:map={text}", "orca"]
    several = build(SCENARIOS, f"goals:people=3,map=[{text},flat]", Scenario)
    assert several.files == [path, "flat"]


@pytest.mark.parametrize("text", ["radius=0.3,walls=false,preset=igibson", "preset='igibson',radius='0.3'"])
def test_values_have_their_types(text: str) -> None:
    """A preset has the values that are not given."""
    policy = build(POLICIES, f"orca:{text}", Policy)
    assert isinstance(policy, Orca)
    result = policy.settings
    assert (result.radius, result.max_neighbors, result.top_speed_ratio) == (0.3, None, 1.0)
    scenario = build(SCENARIOS, "goals:people=[2,5],goals=2", Scenario)
    assert (scenario.fewest, scenario.people, scenario.goals) == (2, 5, 2)


@pytest.mark.parametrize(
    "path", ["a,b/plan.yaml", "a:b", "[a].yaml", "a=b,people=9", "{a: b}", "null", "a: b # c", "'a'"]
)
def test_typed_values_hold_any_text(path: str) -> None:
    one = build(SCENARIOS, Spec("goals", {"map": path, "people": (2, 5), "speed": 1}), Scenario)
    assert (one.files, one.fewest, one.people, one.speed) == ([path], 2, 5, 1.0)
    several = build(SCENARIOS, Spec("goals", {"map": [path, "flat"]}), Scenario)
    assert several.files == [path, "flat"]


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"pool": "many"}, "goals:pool='many': expected int"),
        ({"pool": 2.5}, "goals:pool=2.5: expected int"),
        ({"map": 3}, r"goals:map=3: expected str \| list\[str\]"),
        ({"poll": 3}, "did you mean 'pool'"),
    ],
)
def test_typed_values_are_checked(settings: dict[str, Any], message: str) -> None:
    with pytest.raises(UserError, match=message):
        build(SCENARIOS, Spec("goals", settings), Scenario)


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("orca:radus=0.3", "did you mean 'radius'"),
        ("orca:radius=wide", "orca:radius=wide: expected"),
        ("orca:preset=gibson", "orca:preset=gibson: expected Literal"),
        ("orca:radius", "'radius' is no setting: expected orca:key=value"),
        ("orca:radius=1,radius=2", "'radius' is given twice"),
        ("a.py:A:map=/x,y/plan.yaml", "a value with commas needs quotes: map='/x,y/plan.yaml'$"),
        ("a.py:A:map='/x,y", "needs quotes: map='/x,y'$"),
        ("a.py:A:map=/it's,y", 'needs quotes: map="/it\'s,y"$'),
        ("orca:radius=-1", "radius -1.0: expected a number above 0"),
        ("orka", "did you mean 'orca'"),
        ("constant_velocity:noise=always", "expected Optional\\[Literal"),
        ("constant_velocity:speed=3", "unknown setting of walker constant_velocity 'speed'"),
    ],
)
def test_mistakes(name: str, message: str) -> None:
    with pytest.raises(UserError, match=message.replace("(", r"\(")):
        load_policy(name)


def test_what_a_name_may_not_be_is_told(tmp_path: Path) -> None:
    with pytest.raises(UserError, match=r"files=a.csv: expected list.*; write a list of one as \[a.csv\]$"):
        build(SCENARIOS, "replay:files=a.csv,dt=0.1", Scenario)
    (tmp_path / "mine.py").write_text("class Mine:\n    pass\n")
    with pytest.raises(UserError, match="is no scenario"):
        build(SCENARIOS, f"{tmp_path}/mine.py:Mine", Scenario)


@dataclass(frozen=True)
class Size:
    """A group."""

    width: float = 1.0
    height: float = 2.0


class Box:
    """A class whose default differs from its group's."""

    def __init__(self, name: str = "box", size: Size = Size(height=3.0)) -> None:
        self.name, self.size = name, size


def test_settings_of_groups_have_names_and_defaults_of_the_class() -> None:
    assert setting_types(Box) == {"name": str, "width": float, "height": float}
    assert grouped(Box, {"width": 4.0, "name": "a"}) == {"name": "a", "size": {"width": 4.0}}
    # a name without its group wins
    assert grouped(Box, {"width": 4.0, "size": {"width": 5.0, "height": 6.0}}) == {
        "size": {"width": 4.0, "height": 6.0}
    }
    assert build_ungrouped(Box, {}).size == Size(1.0, 3.0)
    assert build_ungrouped(Box, {"width": 4.0}).size == Size(4.0, 3.0)
    assert build_ungrouped(Box, {"size": {"height": 1.0}}).size == Size(1.0, 1.0)
    circle: Any = build(SCENARIOS, "circle:jitter=0", Scenario)
    assert (circle.people, circle.aside, circle.jitter) == (4, 1.0, 0.0)
    model = SGAN.of(noise_dim=4, best_k=3, safety=True)
    assert model.config == SGAN().config | {"noise_dim": 4, "best_k": 3, "safety": True}
    assert flattened(Size(1.0)) == {"width": 1.0, "height": 2.0}
    with pytest.raises(UserError, match="noise_dim 32: expected 1 to 31"):
        SGAN.of(noise_dim=32)
