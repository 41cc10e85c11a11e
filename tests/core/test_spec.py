"""Names with settings, also in groups, and config files: what they mean and inherit, and mistakes."""

import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest
import yaml

from pedzoo.core.configs import load_config, merged
from pedzoo.core.errors import UserError
from pedzoo.core.paths import config_names
from pedzoo.core.registry import POLICIES, SCENARIOS
from pedzoo.core.spec import (
    Spec,
    SpecText,
    build,
    build_ungrouped,
    flattened,
    grouped,
    make,
    parse,
    setting_types,
    split,
    with_settings,
)
from pedzoo.core.untrusted import load_yaml, read_mapping
from pedzoo.models.architectures.sgan import SGAN
from pedzoo.policies.load import load_policy
from pedzoo.policies.policy import Policy
from pedzoo.policies.rule_based.orca import Orca
from pedzoo.sim.scenario import Scenario

pytestmark = pytest.mark.usefixtures("elsewhere")


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


def test_what_a_name_may_not_be_is_told(tmp_path) -> None:
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


# Config files


def write(name: str, **settings: Any) -> str:
    Path(name).parent.mkdir(parents=True, exist_ok=True)
    Path(name).write_text(yaml.safe_dump(settings, sort_keys=False))
    return name


def test_a_config_takes_its_base_beside_it_or_a_shipped_one() -> None:
    write("a.yaml", data={"fold": "zara1", "files": ["x", "y"]}, trainer={"max_epochs": 3})
    write("b.yaml", base="a.yaml", data={"fold": "eth", "files": ["z"]}, monitor="val/fde")
    write("c.yaml", base="b.yaml", trainer={"max_epochs": None}, data={"goal": "none"})
    assert load_config("c.yaml") == {
        "data": {"fold": "eth", "files": ["z"], "goal": "none"},
        "trainer": {"max_epochs": None},
        "monitor": "val/fde",
    }
    assert load_config("a.yaml")["data"]["fold"] == "zara1"
    write("mine/first.yaml", data={"fold": "eth"})
    assert load_config(write("mine/second.yaml", base="first.yaml")) == {"data": {"fold": "eth"}}
    result = load_config(write("third.yaml", base="sgan_goal", data={"fold": "mall"}))
    assert result["data"].pop("fold") == "mall"
    shipped = load_config("sgan_goal")
    del shipped["data"]["fold"]
    assert result == shipped


def test_another_class_takes_none_of_the_arguments_of_the_base() -> None:
    base = {"class_path": "A", "init_args": {"x": 1, "y": {"class_path": "C", "init_args": {"p": 1}}}}
    other = {"class_path": "B", "init_args": {"z": 2}}
    assert merged(base, other) == other
    same = {"class_path": "A", "init_args": {"y": {"class_path": "D"}}}
    assert merged(base, same) == {"class_path": "A", "init_args": {"x": 1, "y": {"class_path": "D"}}}
    inner = merged(base, {"init_args": {"y": {"init_args": {"q": 2}}}})["init_args"]["y"]
    assert inner == {"class_path": "C", "init_args": {"p": 1, "q": 2}}
    assert base["init_args"]["y"] == {"class_path": "C", "init_args": {"p": 1}}


def test_scenarios_may_be_mappings() -> None:
    door = {"scenario": "door", "width": [0.9, 1.0], "people": 3, "jitter": 0, "together": True}
    plans = {"scenario": "goals:people=2", "map": ["a.1", "b,c.yaml"], "seed": None}
    circle, walk = {"scenario": "circle", "planner": "astar"}, {"scenario": "door:people=2"}
    courses = [door | {"scenes": 6, "share": 0.5}, circle, walk]
    walked = {"scenarios": [door, plans, "hallway", {"scenario": "circle"}]}
    result = load_config(write("mine.yaml", rollout=walked, model={"init_args": {"courses": courses}}))
    text = "door:width=[0.9,1.0],people=3,jitter=0,together=true"
    goals = "goals:people=2,map=[a.1,'b,c.yaml'],seed=null"
    assert result["rollout"]["scenarios"] == [text, goals, "hallway", "circle"]
    assert result["model"]["init_args"]["courses"] == [
        {"scenario": text, "scenes": 6, "share": 0.5},
        circle,
        walk,
    ]
    assert load_config(write("none.yaml", rollout={"scenarios": None})) == {"rollout": {"scenarios": None}}


def test_what_is_spelled_out_is_read_again() -> None:
    settings = {"map": "/a,b/plan.yaml", "share": 0.05, "walls": False}
    written = parse(with_settings("goals", settings))
    assert written.name == "goals"
    assert written.settings == {"map": "'/a,b/plan.yaml'", "share": "0.05", "walls": "false"}
    assert with_settings("door", {}) == "door"


@pytest.mark.parametrize("name", config_names())
def test_shipped_configs_are_whole(name: str) -> None:
    result = load_config(name)
    robot = name.startswith("robot/")  # it learns in an environment, and from no recordings
    wanted = {"model", "trainer"} if robot else {"model", "data", "trainer", "rollout"}
    assert "base" not in result and wanted <= result.keys()
    assert robot or all(isinstance(one, str) for one in result["rollout"]["scenarios"] or [])


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("base: sgan_gaol", r"config 'own\.yaml': unknown config 'sgan_gaol': did you mean 'sgan_goal'"),
        ("base: own.yaml", r"its own base: own -> own"),
        ("base: other.yaml", r"'own\.yaml' is its own base: own -> other -> own"),
        ("base: [sgan]", "expected the name of one config as base, not"),
        ("rollout: {scenarios: [{width: 1}]}", r"expected its name, as in \{scenario: door"),
        ("rollout: {scenarios: [{scenario: door, x: {y: 1}}]}", "door:x: expected a number"),
        ("model: [", r"config '.*own\.yaml' is no YAML"),
        ("- a\n- b", r"own\.yaml': expected a mapping"),
        ("words", r"own\.yaml': expected a mapping"),
        ("a: &a [*a]", "a value is inside itself"),
        ("a: " + "[" * 1000 + "]" * 1000, "at most 20 levels|maximum nesting depth"),
        ("monitor: 2026-11-99", "day is out of range"),
        ("seed_everything: " + "1" * 5000, "has 5,000 digits, at most 300"),
        ("1: 2", "1 stands in the place of an option's name"),
        ("model: {2026-01-01: 2}", "stands in the place of an option's name"),
        ("[1, 2]: 2", "cannot be read"),
        ("<<: 3", "cannot be read"),
        ("monitor: caf\u00e9".encode("latin-1"), "save it as UTF-8"),
        ("base: sgan".encode("utf-16"), "save it as UTF-8"),
    ],
)
def test_mistakes_in_configs_are_one_line(text: str | bytes, message: str) -> None:
    write("other.yaml", base="own.yaml")
    Path("own.yaml").write_bytes(text if isinstance(text, bytes) else text.encode())
    with pytest.raises(UserError, match=message) as caught:
        load_config("own.yaml")
    assert "\n" not in str(caught.value)


def test_yaml_has_so_many_values_that_a_second_reads_them(tmp_path) -> None:
    path = tmp_path / "many.yaml"
    path.write_text("people:\n" + "- {from: [-1, 0], to: [1, 0]}\n" * 150_000)
    began = time.process_time()
    with pytest.raises(UserError, match="it has 100,001 values or more, at most 100,000 are read"):
        load_config(path)
    assert time.process_time() - began < 2


def test_references_are_for_people_and_not_for_bombs(tmp_path) -> None:
    path = tmp_path / "own.yaml"
    path.write_text("a: &size 3\nb: *size\nc: {<<: &more {d: 1}}\ne: *more")
    assert load_config(path) == {"a": 3, "b": 3, "c": {"d": 1}, "e": {"d": 1}}
    lines = ["a0: &a0 [x, x, x, x, x, x, x, x, x]"]
    lines += [f"a{n}: &a{n} [{', '.join([f'*a{n - 1}'] * 9)}]" for n in range(1, 9)]
    path.write_text("\n".join(lines))
    with pytest.raises(UserError, match="490,329,055 values, at most 100,000 are read: write fewer"):
        load_config(path)


def _merges(levels: int, width: int) -> str:
    lines = ["a0: &a0 {a: 1, b: 2, c: 3, d: 4, e: 5, f: 6, g: 7, h: 8, i: 9}"]
    lines += [f"a{n}: &a{n} {{<<: [{', '.join([f'*a{n - 1}'] * width)}]}}" for n in range(1, levels + 1)]
    return "\n".join(lines)


BOMBS = {
    "merges": _merges(9, 9),
    "wide merges": _merges(2, 300),
    "merge keys": f"a0: &a {{{', '.join(f'k{n}: 1' for n in range(1000))}}}\nb: {{{'<<: *a, ' * 200}}}",
    "merges of merges": _merges(6, 9).replace("<<: [", "<<: [{<<: [").replace("]}", "]}]}"),
    "references": "\n".join(
        ["a0: &a0 [x, x]", *(f"a{n}: &a{n} [*a{n - 1}, *a{n - 1}]" for n in range(1, 60))]
    ),
    "a merge in itself": "a: &a {<<: *a}",
    "levels": "a: " + "[" * 100_000,
    "levels of mappings": "a: " + "{a: " * 60 + "}" * 60,
}


@pytest.mark.parametrize("bomb", BOMBS)
@pytest.mark.parametrize("inside", ["file", "text"])
def test_yaml_is_counted_before_it_is_loaded(bomb: str, inside: str, tmp_path) -> None:
    """Also that in texts, which the command line reads as YAML where no text is expected."""
    path, said = tmp_path / "own.yaml", "at most 100,000 are|inside itself|at most 20 levels|maximum nesting"
    text = BOMBS[bomb] if inside == "file" else yaml.safe_dump({"data": {"files": BOMBS[bomb]}})
    path.write_text(text)
    began, settings = time.process_time(), {"people": BOMBS[bomb]}
    reads = [lambda: load_config(path)]
    if inside == "file":
        reads += [lambda: read_mapping(path, "scenario", "people")]
    else:
        reads += [lambda: build(SCENARIOS, Spec("door", settings), Scenario)]
        reads += [lambda: make(SCENARIOS.get("door"), "scenario", SpecText("door", settings))]
    for read in reads:
        with pytest.raises(UserError, match=said):
            read()
    assert time.process_time() - began < 1


def test_what_is_merged_and_is_no_bomb_is_read(tmp_path) -> None:
    path = tmp_path / "own.yaml"
    path.write_text(_merges(3, 9) + "\nb: {<<: [{a: 5}, *a1], b: 7}\nc: {<<: *a0, a: 8}\nd:\n")
    result = load_config(path)
    usual = dict(zip("abcdefghi", range(1, 10), strict=True))
    assert result["a3"] == usual and result["b"] == usual | {"a": 5, "b": 7} and result["d"] is None
    assert result["c"] == usual | {"a": 8} and load_yaml("") is None
    for text in ("59:" * 999 + "59.5", "0x" + "f" * 5000, "a: 2001-99-14t21:59:43"):
        with pytest.raises(UserError, match=r"cannot be read|digits"):
            load_yaml(text)
