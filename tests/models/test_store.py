"""Models from folders and addresses: found by one call, checked, kept, and refused with the reason."""

import json
import pickle
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
import torch
import yaml
from helpers.batches import make_batch, random_weights
from helpers.model_cards import write_model
from helpers.server import Site, serving
from msgspec.structs import replace
from safetensors.torch import save_file

from pedzoo.core import fetch
from pedzoo.core.errors import UserError
from pedzoo.core.paths import weight_files
from pedzoo.core.registry import MODELS
from pedzoo.models.architectures.sgan import SGAN
from pedzoo.models.base import Forecaster
from pedzoo.models.zoo.card import write_card
from pedzoo.models.zoo.card_page import write_hub
from pedzoo.models.zoo.loading import architecture_of, list_models, load, saved_config
from pedzoo.models.zoo.store import find, no_model, robots, weights_of
from pedzoo.policies.load import load_policy, load_robot_policy

NAME = "sgan_goal.mall"
OPTIONS: dict[str, Any] = {"goal_dim": 4, "goal_protocol": "window_end"}


@pytest.fixture(autouse=True)
def home(tmp_path, monkeypatch):
    """A cache of this test's own, and an empty current folder."""
    monkeypatch.setenv("PEDZOO_HOME", str(tmp_path / "home"))
    (tmp_path / "here").mkdir()
    monkeypatch.chdir(tmp_path / "here")
    for variable in ("PEDZOO_OFFLINE", "PEDZOO_ZOO", "HF_TOKEN"):
        monkeypatch.delenv(variable, raising=False)
    return tmp_path / "home"


@pytest.fixture
def site():
    with serving() as running:
        yield running


@pytest.fixture
def model():
    return random_weights(SGAN.of(**OPTIONS)).eval()


MINE = Path("mine") / NAME
WEIGHTS = MINE / "weights.safetensors"


def obtain(name: str) -> Path:
    """Return the weights of a model's name."""
    if entry := find(name):
        return weights_of(entry)
    raise no_model(name)


def changed(**values: Any) -> None:
    """Change the card in the folder ``mine`` by hand, whether it makes sense or not."""
    path = MINE / "card.yaml"
    path.write_text(yaml.safe_dump(yaml.safe_load(path.read_text()) | values))


def as_they_are() -> dict[str, Any]:
    """Return what a card has to say of the weights in the folder ``mine``."""
    return {"sha256": fetch.sha256_of(WEIGHTS), "size": WEIGHTS.stat().st_size}


def serve(site: Site, folder: Path, below: str) -> None:
    """Put all files of a folder and its folders on a site."""
    for path in filter(Path.is_file, folder.rglob("*")):
        site.put(f"{below}/{path.relative_to(folder).as_posix()}", path.read_bytes())


def same(one: Forecaster, other: Forecaster) -> bool:
    batch, noise = make_batch((3, 2)), torch.Generator()
    return torch.equal(*(m.sample(batch, 2, 8, noise.manual_seed(0)) for m in (one, other)))


def test_a_folder_is_loaded_by_its_path(model, monkeypatch):
    assert write_model(model, Path("mine")).name == NAME and obtain("mine") == WEIGHTS
    Path("mine/config.yaml").write_text("no: card")
    for name in (f"mine/{NAME}", f"./mine/{NAME}/", "mine", "./mine", Path("mine").absolute()):
        assert same(load(name), model)
    write_model(other := random_weights(SGAN.of(**OPTIONS), seed=1).eval(), Path("mine"), "sgan_goal.square")
    assert same(load("mine/sgan_goal.square"), other)
    Path("none").mkdir()
    for name, message in {
        "mine": r"folder 'mine' .*say which: mine/sgan_goal\.mall, mine/sgan_goal\.square",
        "mine/sgan_goal.mal": r"model of 'mine' 'sgan_goal\.mal': did you mean 'sgan_goal\.mall'",
        "none": "unknown model 'none'",
        "./none": "'none' is not that of one model: no card in it",
    }.items():
        with pytest.raises(UserError, match=message):
            load(name)
    write_model(model, Path("sgan"))  # it does not hide the architecture
    with pytest.raises(UserError, match="'sgan' is an architecture"):
        load("sgan")
    assert same(load("./sgan"), model)
    monkeypatch.setenv("PEDZOO_ZOO", " elsewhere, mine ")
    assert same(load(NAME), model) and {NAME, "sgan_goal.square"} <= set(list_models("sgan_goal.*"))
    MINE.rename("walkers.v2")
    assert same(load("./walkers.v2"), model) and same(load("walkers.v2/weights.safetensors"), model)
    Path("walkers.v2").rename("mine/sgan_goal.mal")
    with pytest.raises(UserError, match=r"is of 'sgan_goal\.mall': the folder must have the model's name"):
        load("sgan_goal.mal")


@pytest.mark.parametrize("below", ["me/zoo/resolve/main", f"me/zoo/resolve/main/{NAME}"])
def test_a_repository_of_the_hub_has_a_folder_or_is_one(below, model, site, tmp_path, monkeypatch):
    write_model(model, Path("mine"))
    write_hub(str(MINE), tmp_path / "hub")
    serve(site, tmp_path / "hub", below)
    site.put("me/zoo/resolve/main/README.md", (tmp_path / "hub" / "README.md").read_bytes())
    monkeypatch.setenv("HF_ENDPOINT", site.url)
    assert same(load("hf://me/zoo"), model) and same(load(f"hf://me/zoo/{NAME}"), model)
    if below.endswith(NAME):
        assert same(load(f"{site.url}/me/zoo/resolve/main/{NAME}"), model)
    site.pages.clear()
    assert same(load("hf://me/zoo"), model)
    monkeypatch.delenv("HF_ENDPOINT")
    monkeypatch.setenv("PEDZOO_OFFLINE", "1")
    assert NAME in list_models()


def test_a_model_of_the_web_is_fetched_once_and_found_offline(model, site, monkeypatch):
    write_model(model, Path("mine"))
    serve(site, Path("mine"), "our/zoo")
    address = f"{site.url}/our/zoo/{NAME}"
    assert same(load(address), model)
    asked = [path for path, _ in site.asked]
    assert asked == [f"our/zoo/{NAME}/{file}" for file in ("card.yaml", "weights.safetensors")]
    assert same(load(address), model) and same(load(NAME), model) and NAME in list_models()
    assert load_policy(f"{address}:noise=step").noise == "step"  # pyright: ignore[reportAttributeAccessIssue]
    assert len(site.asked) == 2
    site.pages.clear()
    monkeypatch.setenv("PEDZOO_OFFLINE", "1")
    assert same(load(address), model) and same(load(NAME), model)
    with pytest.raises(UserError, match=r"sgan\.mall/card\.yaml is not there, and PEDZOO_OFFLINE forbids"):
        load(f"{site.url}/our/zoo/sgan.mall")


def test_what_else_lies_in_the_cache_is_no_model(model, site, home):
    write_model(model, Path("mine"))
    site.put(f"{NAME}/card.yaml", (MINE / "card.yaml").read_bytes())
    find(f"{site.url}/{NAME}")
    for junk in ("sgan.a", "hf/sgan.b", "hf/me/sgan.c", "http/sgan.d", "http/host/notes"):
        (home / "models" / junk).mkdir(parents=True)
        (home / "models" / junk / "card.yaml").write_text("x: 1")
    assert {*list_models(), *robots()} == {*weight_files(), NAME}
    with pytest.raises(UserError, match=r"unknown model 'sgan_goal\.mal': did you mean 'sgan_goal\.mall'"):
        obtain("sgan_goal.mal")


def test_damaged_weights_are_fetched_anew_places_told_apart(model, site):
    write_model(model, Path("mine"))
    serve(site, Path("mine"), "a")
    stored = obtain(f"{site.url}/a/{NAME}")
    stored.write_bytes(stored.read_bytes()[:100])
    assert same(load(NAME), model)
    serve(site, Path("mine"), "b")
    obtain(f"{site.url}/b/{NAME}")
    with pytest.raises(UserError, match=f"fetched from 2 places, say which: {site.url}/a/{NAME} or "):
        load(NAME)


def test_models_of_the_hub(model, site, monkeypatch):
    monkeypatch.setenv("HF_ENDPOINT", site.url)
    monkeypatch.setenv("HF_TOKEN", "secret")
    write_model(model, Path("mine"))
    for revision in ("main", "v2"):
        serve(site, Path("mine"), f"me/walkers/resolve/{revision}")
    assert same(load(f"hf://me/walkers/{NAME}"), model)
    assert same(load(f"hf://me/walkers@v2/{NAME}"), model)
    assert {headers.get("Authorization") for _, headers in site.asked} == {"Bearer secret"}
    site.put("me/walkers/resolve/v3/README.md", b"---\nlicense: mit\n---\n# Walkers\n")
    with pytest.raises(UserError, match=r"add /ARCH\.TAG"):
        load("hf://me/walkers@v3")
    readme = f"---\nlicense: mit\nmodel_name: {NAME}\n---\n# Walkers\n"
    site.put("me/walkers/resolve/main/README.md", readme.encode())
    assert same(load("hf://me/walkers"), model)
    for wrong in ("me", "../walkers", "me/walkers@", "me/walkers/a/sgan.b", "me/w/sgan"):
        with pytest.raises(UserError, match=r"expected (hf://OWNER/REPO|ARCHITECTURE)"):
            load(f"hf://{wrong}")


def test_the_token_of_the_hub_is_for_the_hub_alone(model, site, monkeypatch):
    card = write_model(model, Path("mine"))
    with serving() as other:
        monkeypatch.setenv("HF_ENDPOINT", site.url)
        monkeypatch.setenv("HF_TOKEN", "secret")
        write_card(replace(card, url=other.put("w", WEIGHTS.read_bytes())), MINE / "card.yaml")
        serve(site, Path("mine"), "me/walkers/resolve/main")
        assert same(load(f"hf://me/walkers/{NAME}"), model)
        assert len(other.asked) == 1 and "Authorization" not in other.asked[0][1]


def test_weights_at_another_address_than_the_card(model, site):
    card = write_model(model, Path("mine"))
    WEIGHTS.rename("elsewhere")
    with pytest.raises(UserError, match=r"has no weights: its card expects .*weights\.safetensors'"):
        load("mine")
    write_card(replace(card, url=site.put("large", Path("elsewhere").read_bytes())), MINE / "card.yaml")
    assert same(load("mine"), model) and same(load("mine"), model)
    assert len(site.asked) == 1


def test_a_source_of_the_user_is_searched_for_names(model, site, monkeypatch):
    write_model(model, Path("mine"))
    serve(site, Path("mine"), "zoo")
    monkeypatch.setenv("PEDZOO_ZOO", f"{site.url}/zoo/")
    assert same(load(NAME), model)
    with pytest.raises(UserError, match=r"did you mean 'sgan_goal\.mall'.*PEDZOO_ZOO: .*card\.yaml: 404"):
        load("sgan_goal.mal")
    monkeypatch.setenv("PEDZOO_ZOO", "gone,mine")
    with pytest.raises(UserError, match=r"PEDZOO_ZOO: no folder 'gone'$"):
        load("sgan_goal.mal")


def test_who_misspells_is_shown_the_family_and_not_all_there_is():
    known = {"anchor_net_goal": r"known: anchor_net_goal\.eth, .*, anchor_net_goal\.zara2_destination$"}
    known |= {"sgan_gaol.zara1": r"did you mean 'sgan_goal\.zara1'\? known: sgan_goal\.eth"}
    known |= {"orca": r"known: anchor_mlp\.\*, .*, robot_ppo\.\*, sgan\.\*, sgan_goal\.\*, "}
    for name, message in known.items():
        with pytest.raises(UserError, match=message) as caught:
            obtain(name)
        assert "sgan_goal_map.zara1" not in str(caught.value)


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        ("a" * 300, "no model|unknown model"),
        ("x/" + "a" * 300, "no model|unknown model"),
        ("https://[::1/sgan.b", "Invalid IPv6"),
        ("~nobody_here", "unknown model"),
        ("https://host", "HOST/FOLDER"),
        ("https://user:word@host/zoo/sgan.x", "HOST/FOLDER"),
        ("https://host/zoo/sgan.x?token=1", "HOST/FOLDER"),
        ("https://host/zoo/../../sgan.x", "may lead out of"),
    ],
)
def test_names_and_addresses_that_nothing_can_have(name, expected):
    with pytest.raises(UserError, match=expected):
        load(name)


def test_what_is_not_trained_says_nothing_of_its_training():
    assert saved_config("constant_velocity") == {} and saved_config("own.py:Mine") == {}
    assert saved_config("sgan_goal.zara1")["protocol"]["fold"] == "zara1"
    with pytest.raises(UserError, match=r"did you mean 'sgan_goal\.zara1'"):
        saved_config("sgan_gaol.zara1")


def test_tampered_weights_are_refused(model, site, home):
    write_model(model, Path("mine"))
    data = bytearray(WEIGHTS.read_bytes())
    data[-1] ^= 1
    WEIGHTS.write_bytes(data)
    with pytest.raises(UserError, match=r"have sha256 .*, but their card says .*: get both anew"):
        load("mine")
    serve(site, Path("mine"), "zoo")
    with pytest.raises(UserError, match=r"not have the expected content.*if the model has changed there"):
        load(f"{site.url}/zoo/{NAME}")
    assert not list(home.rglob("*.safetensors"))
    changed(sha256="0" * 64)
    with pytest.raises(UserError, match="but their card says 0000"):
        load("mine")


def test_pickle_named_as_weights_is_not_run(model):
    class Trap:
        def __reduce__(self) -> tuple:
            return Path.mkdir, (Path("trapped"),)

    write_model(model, Path("mine"))
    for protocol in (0, 2, 4):
        WEIGHTS.write_bytes(pickle.dumps(Trap(), protocol))
        changed(**as_they_are())
        with pytest.raises(UserError, match="cannot be read"):
            load("mine")
    assert not Path("trapped").exists()


def test_a_card_that_climbs_out_of_its_folder_is_refused(model, site, home):
    write_model(model, Path("mine"))
    WEIGHTS.rename("outside.safetensors")
    for file in ("../outside.safetensors", str(Path("outside.safetensors").absolute())):
        changed(file=file)
        with pytest.raises(UserError, match=r"expected weights\.safetensors, beside the card, and no path"):
            load("mine")
    serve(site, Path("mine"), "zoo")
    with pytest.raises(UserError, match=rf"{site.url}/zoo/{NAME}: model card .*no path"):
        load(f"{site.url}/zoo/{NAME}")
    assert not list(home.rglob("*.yaml"))


def test_cards_that_differ_from_their_weights_are_refused(model):
    config = write_model(model, Path("mine")).config
    other = {"architecture": "bent_line"}
    for values, message in (
        ({"config": config | {"init": {"wings": 2}}}, r"is not that of its weights.* config init"),
        ({"config": config | other, **other}, "they differ in config architecture"),
        ({"config": config, **other}, "'bent_line': its config is of 'sgan'"),
    ):
        changed(**values)
        with pytest.raises(UserError, match=message):
            load("mine")


@pytest.mark.parametrize(
    ("key", "value", "message"),
    [
        ("init", OPTIONS | {"wings": 2}, "'sgan' cannot be built .*'wings'.*another version"),
        ("init", {"encoder_dim": "wide"}, "encoder_dim is 'wide', expected a whole number"),
        ("init", {"encoder_dim": 10**9}, "'sgan' cannot be built with the arguments"),
        ("architecture", "sgam", "unknown model 'sgam': did you mean 'sgan'"),
        ("architecture", "own.py:Mine", "no other file ever makes code run"),
    ],
)
def test_wrong_configs_in_weights_and_card_are_refused(key, value, message, model):
    config = write_model(model, Path("mine")).config | {key: value}
    save_file(model.state_dict(), WEIGHTS, {"config": json.dumps(config)})
    changed(config=config, architecture=config["architecture"], **as_they_are())
    with pytest.raises(UserError, match=message):
        load("mine")


def test_a_page_in_place_of_a_card_is_not_kept(model, site):
    site.put(f"zoo/{NAME}/card.yaml", b"<html>log in, please</html>")
    with pytest.raises(UserError, match="Expected `object`, got `str`"):
        load(f"{site.url}/zoo/{NAME}")
    write_model(model, Path("mine"))
    serve(site, Path("mine"), "zoo")
    site.pages[f"zoo/{NAME}/weights.safetensors"].cuts = [1000]
    assert same(load(f"{site.url}/zoo/{NAME}"), model)


def test_models_are_found_and_cards_shown_without_torch(model):
    write_model(model, Path("mine"))
    code = (
        "import sys; from pedzoo.models.zoo.store import find, names, weights_of;"
        "from pedzoo.models.zoo.card_page import page;"
        "names(); weights_of(find('mine')); page(find('mine').card);"
        "assert not {'torch', 'numpy', 'rich'} & set(sys.modules)"
    )
    subprocess.run([sys.executable, "-c", code], check=True)


def test_every_shipped_card_is_that_of_its_weights():
    batch = make_batch((3, 2))
    for name in weight_files():
        entry = find(name)
        assert entry
        built: Any = (load_robot_policy if name in robots() else load)(name)
        if isinstance(built, Forecaster):
            assert built.sample(batch, 2, 8).isfinite().all() and architecture_of(built) in MODELS.names()
        stored, built = entry.card.config["init"], built.config
        # options that came later are off in older weights, or do what was done before
        neutral = (None, False, 0, 0.0, "relu", "context")
        later = [built[key] for key in built.keys() - stored.keys()]
        assert stored.items() <= built.items() and all(value in neutral for value in later)
        assert entry.card.data["terms"] and entry.card.training["seed"] is not None
