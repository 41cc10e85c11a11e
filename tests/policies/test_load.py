"""Loading of models and policies by one function, and what policies may return."""

from collections.abc import Callable
from typing import Any, ClassVar

import pytest
import torch
from tensordict import TensorDictBase

import pedzoo
import pedzoo.sim.gym
from pedzoo.cli.check import check_model
from pedzoo.core.configs import load_config
from pedzoo.core.errors import UserError
from pedzoo.core.paths import config_names
from pedzoo.core.spec import grouped
from pedzoo.models.zoo.loading import saved_config
from pedzoo.policies.load import load_policy, load_robot_policy
from pedzoo.policies.policy import Policy
from pedzoo.policies.teams import Teams


def test_all_public_names_exist_and_are_documented():
    assert pedzoo.__all__ == sorted(pedzoo.__all__)
    assert all(getattr(pedzoo, name).__doc__ for name in pedzoo.__all__)
    assert {"door", "goals"} <= set(pedzoo.list_scenarios()) and pedzoo.list_scenarios("doo*") == ["door"]
    assert {"orca", "approach_net_goal_map.indoor", "bent_line"} <= set(pedzoo.list_policies())
    assert pedzoo.list_policies("orc*") == ["orca"]


@pytest.mark.parametrize(
    ("name", "kind", "seconds"),
    [
        ("orca:radius=0.3", "Orca", 0.1),
        ("constant_velocity", "Walker", 0.4),
        ("sgan_goal.zara1:safety=false", "Walker", 0.4),
        ("orca:share=0.5+go_to_goal", "Teams", 0.1),
    ],
)
def test_every_policy_and_model_steps_people_of_a_simulator(name, kind, seconds):
    loaded = pedzoo.load(name)
    assert loaded.name == name
    assert repr(pedzoo.policy(loaded)) == f"{kind}({name!r}, decides every {seconds:g} s)"
    controller = pedzoo.controller(loaded, dt=seconds)
    velocity = controller.step({"anna": (0.0, 0.0)}, {"anna": (5.0, 0.0)})["anna"]
    assert velocity[0] > 0.5 and abs(velocity[1]) < 0.5
    assert len(repr(controller)) < 150


def test_untrained_models_have_the_architecture_that_is_named():
    trained = pedzoo.load("sgan_goal_map.zara1")
    assert trained.name == trained.card.name == "sgan_goal_map.zara1"
    assert pedzoo.load("bent_line").card is None
    for name in ("sgan_goal_map.zara1", "sgan_goal_map"):
        fresh = pedzoo.load(name, pretrained=False)
        shapes = {key: value.shape for key, value in fresh.state_dict().items()}
        assert shapes == {key: value.shape for key, value in trained.state_dict().items()}
        assert fresh.needs == trained.needs
    assert not torch.equal(next(fresh.parameters()), next(trained.parameters()))
    assert pedzoo.load("sgan", pretrained=False, noise_dim=4).noise_dim == 4


@pytest.mark.parametrize("name", [name for name in config_names() if "/" in name])
def test_configs_in_folders_have_untrained_models(name, tmp_path, monkeypatch):
    for folder in (None, tmp_path):  # a folder of the same name hides none of them
        if folder:
            (folder / name).parent.mkdir()
            monkeypatch.chdir(folder)
        if name.startswith("robot/"):
            with pytest.raises(UserError, match=f"'{name}' trains robots.*pedzoo fit --config {name}"):
                pedzoo.load(name, pretrained=False)
            continue
        model = pedzoo.load(name, pretrained=False)
        generator = load_config(name)["model"]["init_args"]["generator"]
        assert type(model).__name__ == generator["class_path"].rpartition(".")[2] and not model.training
        given = grouped(type(model), model.config)
        for group, settings in generator["init_args"].items():
            assert settings.items() <= given[group].items()


@pytest.mark.parametrize("load", [pedzoo.load, load_policy, load_robot_policy, check_model, saved_config])
@pytest.mark.parametrize(
    ("address", "path"),
    [
        ("file:///zoo/sgan_goal.mall", "/zoo/sgan_goal.mall"),
        ("file:///zoo/a%20b.safetensors", "/zoo/a b.safetensors"),
        ("file:///zoo/best.ckpt", "/zoo/best.ckpt"),
        ("file://localhost/zoo/sgan_goal.mall", "/zoo/sgan_goal.mall"),
    ],
)
def test_addresses_of_files_are_told_to_be_paths(load, address, path):
    for more in ("", ":safety=false") if load in (load_policy, check_model) else ("",):
        with pytest.raises(UserError, match=f"{address}': expected a path .*: {path}$"):
            load(address + more)


@pytest.mark.parametrize(
    ("name", "settings", "message"),
    [
        ("orcaa", {}, "did you mean 'orca'?"),
        ("sgan", {}, "pretrained=False"),
        ("sgan", {"pretrained": False, "nois_dim": 4}, "did you mean 'noise_dim'?"),
        ("sgan", {"pretrained": False, "noise_dim": "x"}, "noise_dim is 'x', expected a whole number"),
        ("orca", {"radius": 0.3}, "orca:KEY=VALUE"),
        ("orca", {"device": "cudda"}, "device 'cudda'"),
    ],
)
def test_mistakes_name_the_cure(name, settings, message):
    with pytest.raises(UserError, match=message.replace("?", r"\?")):
        pedzoo.load(name, **settings)


def test_environments_are_short_and_plots_are_one_call(tmp_path):
    walked = pedzoo.rollout("orca:radius=0.2", "door", physics="compiled", episodes=2)
    assert repr(walked[1]) == "PedestrianEnv(Door, 2 scenes of 2 people, Compiled, decides every 0.1 s)"
    pedzoo.plot(walked, tmp_path / "one.png")
    pedzoo.plot({"mine": walked, "again": walked}, tmp_path / "two.png")
    assert (tmp_path / "two.png").stat().st_size > (tmp_path / "one.png").stat().st_size


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("Other", "is no policy: expected a subclass of pedzoo.policies.policy.Policy, or of"),
        ("Timeless", r"has no decision_dt: call super\(\).__init__\(dt\)"),
    ],
)
def test_classes_that_are_no_whole_policy_are_refused(name: str, message: str, tmp_path) -> None:
    file = tmp_path / "half.py"
    file.write_text(
        "from pedzoo.policies.policy import Policy\n\n\nclass Other:\n    pass\n\n\n"
        "class Timeless(Policy):\n    def __init__(self):\n        pass\n"
    )
    with pytest.raises(UserError, match=message):
        load_policy(f"{file}:{name}")


# What policies return


class Made(Policy):
    """Returns what a function makes of the batch."""

    out_keys: ClassVar[list[Any]] = [("agents", "action")]

    def __init__(self, result: Callable[[TensorDictBase], Any]) -> None:
        super().__init__(0.4)
        self.result = result

    def forward(self, tensordict: TensorDictBase) -> Any:
        return self.result(tensordict)


def wide(width: int = 2) -> Made:
    """Return a policy that walks as the planner says, in double precision and numbers of another width."""

    def write(batch: TensorDictBase) -> TensorDictBase:
        desired = batch["agents", "desired_velocity"]
        batch["agents", "action"] = desired[..., :1].expand(*desired.shape[:2], width).double()
        return batch

    return Made(write)


@pytest.mark.parametrize(
    ("policy", "message"),
    [
        (wide(1), r"action of shape \({scenes}, 1\): expected \({scenes}, 2\)"),
        (wide(3), r"action of shape \({scenes}, 3\): expected \({scenes}, 2\)"),
        (Made(lambda batch: batch), "'Made'.* wrote no velocities: set tensordict"),
        (Made(lambda batch: None), "returned NoneType: write `return tensordict` at its end"),
        (Made(lambda batch: batch["agents", "velocity"]), "returned Tensor: write `return tensordict`"),
    ],
)
def test_policies_that_return_something_else_are_told(policy: Made, message: str) -> None:
    env = pedzoo.make_env("circle:people=3", 2)
    with pytest.raises(UserError, match=message.replace("{scenes}", "2, 3")):
        env.step(policy(env.reset()))
    with pytest.raises(UserError, match=message.replace("{scenes}", "1, 1")):
        pedzoo.controller(policy).step({1: (0, 0)}, {1: (0, -5)})


@pytest.mark.parametrize("scenario", ["door", "circle:people=4"])
def test_double_precision_walks_as_single(scenario: str) -> None:
    env = pedzoo.make_env(scenario, 2)
    for policy in (wide(), Teams([(wide(), 0.5), (pedzoo.load("go_to_goal"), 0.5)])):
        after = env.step(policy(env.reset()))["next"]
        assert after["agents", "history"].dtype == torch.float32
        assert after["agents", "velocity"].norm(dim=-1).max() > 0.1
