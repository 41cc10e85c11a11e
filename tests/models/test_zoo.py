"""Models by name and file: what is saved comes back bit by bit, and what is damaged is refused in words."""

import hashlib
import inspect
import json
import os
import pickle
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
from typing import Any

import pytest
import torch
from helpers.batches import make_batch, random_weights
from helpers.model_cards import write_model
from safetensors.torch import save_file

import pedzoo
from pedzoo.core.errors import UserError
from pedzoo.models.architectures.sgan import SGAN
from pedzoo.models.base import Forecaster
from pedzoo.models.zoo import loading as zoo
from pedzoo.models.zoo import store
from pedzoo.models.zoo.card import read_config
from pedzoo.models.zoo.loading import list_models, load, save_weights, saved_config
from pedzoo.policies.load import load_policy, load_robot_policy
from pedzoo.policies.walker import Walker

OPTIONS: dict[str, Any] = {
    "bottleneck_dim": 8,
    "goal_dim": 4,
    "goal_protocol": "destination",
    "frame": "heading",
}

OWN_MODEL = """
import torch
from torch import nn
from pedzoo.models.base import Forecaster, arguments

class Drifting(Forecaster):
    stochastic = False

    def __init__(self, speed: float = 0.25):
        super().__init__()
        self.config = arguments(locals())
        self.speed = nn.Parameter(torch.tensor(speed))

    def sample(self, batch, samples, steps, generator=None):
        mask = batch["agents", "mask"]
        path = torch.zeros(len(mask), samples, mask.shape[1], steps, 2)
        return path + self.speed * mask[:, None, :, None, None]

class Forgetful(Forecaster):
    pass

class Needy(Forecaster):
    def __init__(self, size):
        super().__init__()

class Table:
    pass
"""


@pytest.fixture
def model():
    return random_weights(SGAN.of(**OPTIONS)).eval()


@pytest.fixture
def checkpoints(tmp_path, monkeypatch):
    """An empty folder in the place of the shipped one."""
    folder = tmp_path / "checkpoints"
    folder.mkdir()
    monkeypatch.setattr(store, "shipped", lambda name: tmp_path / name)
    monkeypatch.setenv("PEDZOO_HOME", str(tmp_path / "home"))
    return folder


@pytest.fixture
def own(tmp_path):
    """A user's file with models of their own."""
    path = tmp_path / "own.py"
    path.write_text(OWN_MODEL)
    return path


def answers(model: Forecaster) -> torch.Tensor:
    return model.sample(make_batch((3, 2)), 4, 8, torch.Generator().manual_seed(0))


def test_saved_and_loaded_is_the_same_model(model, tmp_path):
    path, second = tmp_path / "new" / "folder" / "mine.safetensors", tmp_path / "b.safetensors"
    digest = save_weights(model, path, training={"seed": 1}, protocol={"fold": "zara1"})
    again = load(path)
    assert torch.equal(answers(again), answers(model)) and not again.training
    assert again.config == model.config and again.goal_protocol == "destination"
    assert digest == hashlib.sha256(path.read_bytes()).hexdigest()
    config = read_config(path)
    assert config["protocol"] == {"fold": "zara1"} and config["architecture"] == "sgan"
    save_weights(again, second, protocol={"fold": "zara1"}, training={"seed": 1})
    assert path.read_bytes() == second.read_bytes()


@pytest.mark.parametrize("keep", [0, 5, 200, -1])
def test_truncated_files_are_refused_and_absent_ones_named(model, tmp_path, keep):
    save_weights(model, tmp_path / "cut.safetensors")
    torch.save({"pedzoo": {}, "state_dict": {"generator.x": torch.zeros(500)}}, tmp_path / "cut.ckpt")
    for path in (tmp_path / "cut.safetensors", tmp_path / "cut.ckpt"):
        path.write_bytes(path.read_bytes()[:keep])
        with pytest.raises(UserError, match=rf"cut\{path.suffix}' cannot be read .*cut off"):
            load(str(path))
        with pytest.raises(UserError, match=rf"no .* at .*none\{path.suffix}"):
            load(path.with_stem("none"))


def test_weights_of_others_are_refused(model, tmp_path):
    path = tmp_path / "other.safetensors"
    save_file(model.state_dict(), path)
    with pytest.raises(UserError, match="no pedzoo config"):
        load(str(path))
    unknown = '{"architecture": "sgan", "init": {}, "hook": "x"}'
    for damaged in ("{", "[]", "{}", '{"architecture": "sgan", "init": 3}', unknown):
        save_file(model.state_dict(), path, {"config": damaged})
        with pytest.raises(UserError, match="config that cannot be read"):
            load(str(path))


def test_weights_of_another_architecture_are_refused(model, tmp_path):
    path = tmp_path / "other.safetensors"

    def written(**changed: Any) -> str:
        config = {"architecture": "sgan", "init": OPTIONS} | changed
        save_file(model.state_dict(), path, {"config": json.dumps(config)})
        return str(path)

    assert torch.equal(answers(load(written())), answers(model))
    with pytest.raises(
        UserError, match=r"other\.safetensors' holds weights of another architecture than 'sgan'"
    ):
        load(written(init={**OPTIONS, "encoder_dim": 48}))
    with pytest.raises(UserError, match=r"another architecture.*pooling"):
        load(written(init={**OPTIONS, "bottleneck_dim": 0}))
    with pytest.raises(UserError, match="another architecture"):
        load(written(architecture="constant_velocity", init={}))


def test_checkpoints_of_others_are_refused_and_not_run(tmp_path):
    path = tmp_path / "other.ckpt"
    for content in ({"state_dict": {}}, [1, 2], torch.zeros(3)):
        torch.save(content, path)
        with pytest.raises(UserError, match="not written by pedzoo"):
            load(str(path))

    class Trap:
        def __reduce__(self) -> tuple:
            return os.mkdir, (str(tmp_path / "trapped"),)

    torch.save({"pedzoo": Trap()}, path)
    with pytest.raises(UserError, match=r"other\.ckpt' cannot be read"):
        load(str(path))
    noise = bytes(torch.randint(256, (400,), generator=torch.Generator().manual_seed(0)).tolist())
    for garbage in (pickle.dumps(Trap(), 2), noise, b"PK\x03\x04" + noise, b"version https://git-lfs"):
        path.write_bytes(garbage)
        with pytest.raises(UserError, match=r"other\.ckpt' cannot be read"):
            load(str(path))
    assert not (tmp_path / "trapped").exists()


def test_shipped_weights_are_listed_loaded_by_name_and_checked(model, checkpoints):
    assert list_models() == []
    with pytest.raises(UserError, match="'sgan' is an architecture; name its weights: none yet"):
        load("sgan")
    for name in ("sgan_goal.zara1", "sgan.zara1"):
        write_model(model, checkpoints, name)
    assert list_models() == ["sgan.zara1", "sgan_goal.zara1"] and list_models("sgan.*") == ["sgan.zara1"]
    assert torch.equal(answers(pedzoo.load("sgan_goal.zara1")), answers(model))
    with pytest.raises(UserError, match=r"name its weights: sgan\.zara1"):
        load("sgan")
    with pytest.raises(UserError, match=r"unknown model 'sgan_goal\.zara2': did you mean 'sgan_goal\.zara1'"):
        load("sgan_goal.zara2")
    with pytest.raises(UserError, match=r"did you mean 'constant_velocity'.* known: .*sgan_goal\.\*"):
        load("constant_speed_velocity")
    save_weights(random_weights(model, seed=1), checkpoints / "sgan.zara1" / "weights.safetensors")
    with pytest.raises(
        UserError, match=r"sgan\.zara1/weights\.safetensors' have sha256 .* card says .*reinstall"
    ):
        load("sgan.zara1")
    (checkpoints / "sgan.zara1" / "card.yaml").unlink()
    with pytest.raises(UserError, match=r"unknown model 'sgan\.zara1': did you mean 'sgan_goal\.zara1'"):
        load("sgan.zara1")


def test_own_models_take_their_settings_behind_the_name(own):
    name = f"{own}:Drifting"
    assert [pedzoo.load(text).speed.item() for text in (name, f"{name}:speed=0.5")] == [0.25, 0.5]
    walker = pedzoo.load(f"{name}:speed=0.5,safety=false")
    assert isinstance(walker, Walker) and walker.model.get_parameter("speed").item() == 0.5
    with pytest.raises(UserError, match=r"setting of .*own\.py:Drifting 'sped': did you mean 'speed'"):
        pedzoo.load(f"{name}:sped=0.5")


def test_own_models_are_found_saved_and_loaded(own, tmp_path):
    model = load(f"{own}:Drifting")
    assert model.sample(make_batch((2,)), 3, 8).unique().tolist() == [0.25]
    random_weights(model)
    save_weights(model, tmp_path / "mine.safetensors")
    again = load(f"{own}:Drifting:weights={tmp_path / 'mine.safetensors'}")
    assert torch.equal(answers(again), answers(model))
    for name, message in {
        "Forgetful": "cannot be saved: keep its arguments",
        "Needy": "missing a required argument: 'size'",
        "Table": "is no model: expected a subclass",
        "Drifter": "did you mean 'Drifting'",
    }.items():
        with pytest.raises(UserError, match=message):
            save_weights(load(f"{own}:{name}"), tmp_path / "x.safetensors")
    with pytest.raises(UserError, match="no file"):
        load(f"{tmp_path / 'none.py'}:Drifting")


def written_twice(model: Forecaster, folder: Path) -> list[str]:
    """Write a model as a checkpoint of fit and as weights; return both files."""
    state = {f"generator.{key}": value for key, value in model.state_dict().items()}
    torch.save({"pedzoo": zoo.config_of(model), "state_dict": state}, folder / "a.ckpt")
    save_weights(model, folder / "a.safetensors")
    return [str(folder / "a.ckpt"), str(folder / "a.safetensors")]


def test_weights_never_make_a_file_of_code_run(own, tmp_path):
    files = written_twice(load(f"{own}:Drifting"), tmp_path)
    own.write_text("raise SystemExit('this must not run')")
    for file in files:
        for action in (load, load_policy, load_robot_policy):
            with pytest.raises(UserError, match=f"no other file ever makes code run.*weights=.*{file}"):
                action(file)


def test_who_names_the_class_gets_weights_of_it(own, model, tmp_path):
    drifting = random_weights(load(f"{own}:Drifting"))
    for file in written_twice(drifting, tmp_path):
        spec = f"{own}:Drifting:weights={file}"
        assert torch.equal(answers(load(spec)), answers(drifting))
        walker = load_policy(f"{spec},noise=step")
        assert isinstance(walker, Walker) and torch.equal(answers(walker.model), answers(drifting))
        assert saved_config(spec)["init"] == drifting.config
    save_weights(model, tmp_path / "sgan.safetensors")
    with pytest.raises(UserError, match="holds weights of 'sgan', not of "):
        load(f"{own}:Drifting:weights={tmp_path / 'sgan.safetensors'}")
    with pytest.raises(UserError, match=r"unknown setting of .*'weight': did you mean 'weights'"):
        load(f"{own}:Drifting:weight=a.ckpt")


def test_half_precision_is_read_as_float32(tmp_path):
    model = random_weights(SGAN.of(bottleneck_dim=8)).eval()
    for half in (False, True):
        save_weights(model, tmp_path / f"{half}.safetensors", half)
    assert (tmp_path / "True.safetensors").stat().st_size < 0.7 * (
        tmp_path / "False.safetensors"
    ).stat().st_size
    loaded = load(tmp_path / "True.safetensors").state_dict()
    for key, value in model.state_dict().items():
        assert loaded[key].dtype == torch.float32
        assert torch.allclose(loaded[key], value, rtol=1e-3, atol=1e-6)


# -- torch.hub from a local checkout: no network, the same models as by name

CHECKOUT = Path(__file__).parents[2]


def test_hub_has_one_entry_per_family_of_weights():
    spec = spec_from_file_location("hubconf", CHECKOUT / "hubconf.py")
    assert spec is not None and spec.loader is not None
    module = module_from_spec(spec)
    spec.loader.exec_module(module)
    entries = {name: value for name, value in vars(module).items() if callable(value) and name[0] != "_"}
    assert entries.keys() == {name.partition(".")[0] for name in pedzoo.list_models()}
    assert "zara1_destination" in str(inspect.getdoc(entries["anchor_net_goal"]))


def test_torch_hub_loads_what_pedzoo_loads():
    model = torch.hub.load(str(CHECKOUT), "sgan_goal", pretrained="zara1", source="local")
    assert isinstance(model, Forecaster) and not model.training
    batch = make_batch((3,))
    assert torch.equal(model.mode(batch, 8), pedzoo.load("sgan_goal.zara1").mode(batch, 8))


def test_unknown_weights_are_named_with_what_there_is():
    with pytest.raises(UserError, match=r"'sgan_goal\.zara3': did you mean 'sgan_goal\.zara"):
        torch.hub.load(str(CHECKOUT), "sgan_goal", pretrained="zara3", source="local")
    with pytest.raises(RuntimeError, match="Cannot find callable sgan_gaol"):
        torch.hub.load(str(CHECKOUT), "sgan_gaol", source="local")
