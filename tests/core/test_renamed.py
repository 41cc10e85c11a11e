"""Old spellings: ``world`` for ``physics``, ``grid`` for ``compiled``; each is told once."""

from __future__ import annotations

import json
from collections.abc import Iterator
from copy import deepcopy
from importlib import import_module
from pathlib import Path
from typing import Any

import pytest
import torch
import yaml

import pedzoo
import pedzoo.cli.parsing
from pedzoo.cli.main import main
from pedzoo.core import renamed
from pedzoo.core.configs import load_config
from pedzoo.core.errors import UserError
from pedzoo.core.paths import find_config, weight_files
from pedzoo.eval.cards import Job, compare, report_of
from pedzoo.eval.comparison import Comparison
from pedzoo.eval.evaluate import Evaluation
from pedzoo.eval.rollout import rollout
from pedzoo.eval.suite import EvaluationOptions
from pedzoo.eval.trained_on import for_fold
from pedzoo.policies.learned.walker import Walker
from pedzoo.policies.load import load_policy
from pedzoo.sim.physics.compiled import Compiled
from pedzoo.train.validation.rollout_validation import ClosedLoopValidation


@pytest.fixture(autouse=True)
def unsaid() -> Iterator[None]:
    renamed.say.cache_clear()
    yield
    renamed.say.cache_clear()


def test_python_takes_the_old_spelling_and_tells_the_new_one_once(capsys: pytest.CaptureFixture[str]) -> None:
    old: dict[str, Any] = {"world": "grid"}
    for _ in range(2):
        env = pedzoo.make_env("door", **old)
        assert type(env.physics) is Compiled
    assert capsys.readouterr().err == "pedzoo: world='grid' is now physics='compiled'\n"
    _, env = rollout("go_to_goal", "circle:people=2", world="grid", episodes=1)
    assert type(env.physics) is Compiled and capsys.readouterr().err == ""
    assert type(pedzoo.make_env("door", physics="grid").physics) is Compiled
    assert capsys.readouterr().err == "pedzoo: physics 'grid' is now 'compiled'\n"
    with pytest.raises(UserError, match="leave out world"):
        pedzoo.make_env("door", physics="torch", **old)


def test_protocols_say_it_anew() -> None:
    old: dict[str, Any] = {"world": "grid"}
    with Comparison(["go_to_goal"], "circle:people=2", episodes=1, **old) as comparison:
        assert comparison.report()["protocol"]["physics"] == "compiled"
    report = pedzoo.evaluate(["go_to_goal"], ["door"], episodes=1, **old)
    assert report["protocol"]["physics"] == "compiled" and "world" not in report["protocol"]
    assert report["rows"][0]["case"] == {"suite": "door", "physics": "compiled"}


@pytest.mark.parametrize("words", [["--world", "grid"], ["--world=grid"]])
def test_commands_take_it(words: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = tmp_path / "out.json"
    walk = ["rollout", "go_to_goal", "--scenario", "circle:people=2", "--episodes", "1"]
    assert main([*walk, *words, "--json", str(file)]) == 0
    assert capsys.readouterr().err == "pedzoo: --world grid is now --physics compiled\n"
    assert json.loads(file.read_text())["protocol"]["physics"] == "compiled"


def test_configs_take_it(capsys: pytest.CaptureFixture[str]) -> None:
    assert ClosedLoopValidation(["door"], world="grid").physics == "compiled"
    assert ClosedLoopValidation(["door"]).physics == "compiled"
    with pytest.raises(UserError, match="did you mean 'bullet'"):
        ClosedLoopValidation(["door"], world="bulet")


def test_cards_are_measured_again_by_it() -> None:
    protocol: dict[str, Any] = {"suites": ["door"], "episodes": 2, "world": "grid"}
    old = report_of("evaluate", Job("bent_line", protocol, [0]))
    new = report_of(
        "evaluate", Job("bent_line", {"suites": ["door"], "episodes": 2, "physics": "compiled"}, [0])
    )
    for report in (old, new):
        assert report["protocol"]["physics"] == "compiled"
    assert old["rows"][0]["metrics"] == new["rows"][0]["metrics"]
    assert "world" not in EvaluationOptions._fields


def test_the_suite_of_encounters_takes_its_old_name(capsys: pytest.CaptureFixture[str]) -> None:
    evaluation = Evaluation(["go_to_goal"], ["cards", "encounters"], EvaluationOptions(episodes=1))
    assert {unit.case.suite for unit in evaluation.units} == {"encounters"}
    assert capsys.readouterr().err == "pedzoo: suite 'cards' is now 'encounters'\n"
    assert renamed.new_keys({"suites": ["door", "cards"]}) == {"suites": ["door", "encounters"]}
    assert not capsys.readouterr().err  # a card's names are mapped silently


def test_a_card_with_the_old_name_of_a_suite_is_compared_by_the_new_one() -> None:
    row = {"metrics": {"success": 1.0}, "ci95": {}, "n": 3}
    before = {"command": "evaluate", "rows": [row | {"table": "cards", "case": {"suite": "cards"}}]}
    now = {"command": "evaluate", "rows": [row | {"table": "encounters", "case": {"suite": "encounters"}}]}
    assert [number.same for number in compare(before, now)] == [True, True]


def test_weights_and_cards_load_with_old_names_of_arguments(capsys: pytest.CaptureFixture[str]) -> None:
    model = pedzoo.load("sgan_goal_map.indoor")
    assert model.walking_extend_goal and model.config["extend_goal"] is True and "pace" not in model.config
    old = {"architecture": "sgan", "init": {"pace": True, "noise_dim": 4}}
    assert renamed.new_init(old)["init"] == {"extend_goal": True, "noise_dim": 4}
    data = renamed.new_init(old | {"protocol": {"fold": "zara1", "people": "complete"}})["protocol"]
    assert data == {"fold": "zara1", "keep_people": "complete"}
    other = {"architecture": "mine.py:Model", "init": {"pace": True}}
    assert renamed.new_init(other) == other  # arguments of another class keep their names
    assert not capsys.readouterr().err


def test_weights_load_by_their_old_names(capsys: pytest.CaptureFixture[str]) -> None:
    old, new = pedzoo.load("sgan_goal_map.zara1_way"), pedzoo.load("sgan_goal_map.controller_open_zara1")
    assert all(torch.equal(value, new.state_dict()[key]) for key, value in old.state_dict().items())
    said = "pedzoo: model 'sgan_goal_map.zara1_way' is now 'sgan_goal_map.controller_open_zara1'\n"
    assert capsys.readouterr().err == said
    assert load_policy("sgan_goal.indoor_b:noise=step").decision_dt == 0.4
    assert for_fold("sgan_goal_map.eth_ucy_way:safety=true", "hotel") == (
        "sgan_goal_map.controller_open_hotel:safety=true"
    )
    assert {*renamed.OLD_WEIGHTS.values()} <= {*weight_files()}


def test_a_policy_takes_the_old_name_of_a_setting(capsys: pytest.CaptureFixture[str]) -> None:
    policy = load_policy("sgan_goal_map.indoor:pace=false")
    assert isinstance(policy, Walker) and not policy.extend_goal
    assert capsys.readouterr().err == "pedzoo: setting pace=false is now extend_goal=false\n"


def test_trainings_take_old_names_of_options(capsys: pytest.CaptureFixture[str]) -> None:
    words = ["--model.init_args.walking.init_args.trait=0.4", "--model.keep", "3", "--data.unroll-apart"]
    assert renamed.new_options(words) == [
        "--model.init_args.walking.init_args.assertiveness=0.4",
        *("--model.max_segments", "3", "--data.imitated.one_recording_per_batch"),
    ]
    message = capsys.readouterr().err.splitlines()
    words = ["--data.people=present", "--model.reward.people", "2", "--model.walking.people", "3"]
    new = ["--data.keep_people=present", "--model.reward.person_cost", "2"]
    assert renamed.new_options(words) == [*new, "--model.walking.person_distance", "3"]
    assert len(message) == 3 and message[1] == "pedzoo: --model.keep is now --model.max_segments"


def test_settings_of_pedzoos_classes_may_be_written_without_their_groups(
    capsys: pytest.CaptureFixture[str],
) -> None:
    words = ["--model.generator.noise-dim=4", "--model.generator.losses.best_k", "2", "--model.steps=3"]
    ppo = {
        "model": "pedzoo.train.rl.ppo.PPOModule",
        "model.generator": "pedzoo.models.architectures.sgan.SGAN",
    }
    assert renamed.new_options(words, ppo) == [
        "--model.generator.architecture.noise_dim=4",
        *("--model.generator.losses.best_k", "2", "--model.collection.steps=3"),
    ]
    said = "pedzoo: --model.generator.noise-dim is now --model.generator.architecture.noise_dim\n"
    assert said in capsys.readouterr().err
    own = {"model": "mine.Module", "model.generator": "mine.Generator"}
    assert renamed.new_options(words, own) == words  # settings of another class keep their names
    settings = {"model": {"init_args": {"generator": {"init_args": {"safety": True}}}}}
    result = renamed.new_config(settings, classes=ppo)["model"]["init_args"]["generator"]["init_args"]
    assert result == {"walking": {"safety": True}}
    assert renamed.new_config(settings, classes=own) == settings


def without_groups(config: dict[str, Any]) -> dict[str, Any]:
    """Return the configuration of a training in the loop as earlier versions wrote it."""
    old = deepcopy(config)
    arguments = old["model"]["init_args"]
    for new, before in (("assertiveness", "trait"), ("person_distance", "people")):
        arguments["walking"][before] = arguments["walking"].pop(new)
    arguments["keep"] = arguments.pop("max_segments")
    generator = arguments["generator"]
    generator["init_args"] = {k: v for group in generator["init_args"].values() for k, v in group.items()}
    generator["init_args"]["pace"] = generator["init_args"].pop("extend_goal")
    imitated = old["data"].pop("imitated")
    old["data"] |= old["data"].pop("loading") | {"unroll_apart": imitated.pop("one_recording_per_batch")}
    old["data"] |= {"unroll": imitated.pop("steps"), "unroll_batch_size": imitated.pop("batch_size")}
    return old


def test_configurations_take_old_names_of_options(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    new = yaml.safe_load(find_config("closed_loop/sgan_goal").read_text())
    old = without_groups(new)
    assert old != new and renamed.new_config(old) == new
    assert not capsys.readouterr().err
    (tmp_path / "old.yaml").write_text(yaml.safe_dump(old, sort_keys=False))
    assert load_config(tmp_path / "old.yaml") == load_config("closed_loop/sgan_goal")
    assert "pedzoo: model.walking.trait is now model.walking.assertiveness\n" in capsys.readouterr().err
    change = "{keep: 9, generator: {init_args: {noise_dim: 4}}}"
    (tmp_path / "mine.yaml").write_text(f"base: old.yaml\nmodel: {{init_args: {change}}}\n")
    result = load_config(tmp_path / "mine.yaml")["model"]["init_args"]
    architecture = result["generator"]["init_args"]["architecture"]
    assert (result["max_segments"], architecture["noise_dim"], architecture["goal_dim"]) == (9, 4, 16)


@pytest.mark.parametrize(
    ("module", "old", "new"),
    [
        ("pedzoo.data.datamodule", "Imitated", "ImitationWindows"),
        ("pedzoo.policies.local_planner", "People", "ObservedPeople"),
        ("pedzoo.policies.local_planner", "Drive", "DriveState"),
        ("pedzoo.sim.replay.script", "Opening", "SceneStarts"),
    ],
)
def test_files_of_others_import_classes_by_their_old_names(
    module: str, old: str, new: str, capsys: pytest.CaptureFixture[str]
) -> None:
    there = import_module(module)
    assert getattr(there, old) is getattr(there, new)
    assert capsys.readouterr().err == f"pedzoo: {module}.{old} is now {new}\n"
    with pytest.raises(AttributeError, match=f"module '{module}' has no attribute 'Other'"):
        there.Other  # noqa: B018
