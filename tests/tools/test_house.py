"""`tools/pages/house.py` and the pages for newcomers: they say what the code says."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest

from tools.pages import house

ROOT = Path(__file__).parents[2]


def test_the_picture_shows_the_packages_as_they_are() -> None:
    drawn = json.loads((ROOT / "docs" / "architecture.json").read_text())
    assert house.differences(drawn, house.read_house(ROOT)) == []
    assert (ROOT / "docs" / "architecture.png").read_bytes().startswith(b"\x89PNG")


def test_arrows_that_others_imply_are_left_out() -> None:
    diamond = {("d", "b"), ("d", "c"), ("b", "a"), ("c", "a"), ("d", "a")}
    assert house.reduced(diamond) == diamond - {("d", "a")}
    assert house.reduced({("c", "b"), ("b", "a"), ("c", "a")}) == {("c", "b"), ("b", "a")}


def test_imports_are_found_wherever_they_stand(tmp_path: Path) -> None:
    file = tmp_path / "file.py"
    file.write_text(
        "import pedzoo.maps.grid\n"
        "from pedzoo import sim\n"
        "from pedzoo.core.types import OBS_LEN\n"
        "if TYPE_CHECKING:\n    from pedzoo.train import run\n"
        "def late():\n    from pedzoo.data.tracks import Tracks\n"
        "import torch\n"
    )
    assert house.imported(file) == {"maps", "sim", "core", "data"}


def checkout(folder: Path, **packages: str) -> Path:
    """Return a checkout of all floors, whose packages have one more file with the text given for each."""
    names = [name for _, floor in house.FLOORS for name in floor]
    for name in names:
        package = folder / "pedzoo" / name
        package.mkdir(parents=True)
        (package / "__init__.py").write_text(f'"""About {name}."""\n')
        (package / "part.py").write_text(packages.get(name, ""))
    layers = ["cli", "train", "viz", "eval", "metrics", "sim", "policies", "models", "data", "maps", "core"]
    contract = f'[[tool.importlinter.contracts]]\ntype = "layers"\nlayers = {json.dumps(layers)}\n'
    (folder / "pyproject.toml").write_text(contract)
    return folder


def test_a_house_is_read_from_a_checkout(tmp_path: Path) -> None:
    found = house.read_house(checkout(tmp_path, sim="import pedzoo.maps.part, pedzoo.core.part"))
    assert list(found["packages"])[:3] == ["core", "maps", "data"]
    assert found["packages"]["sim"] == {"purpose": "About sim.", "files": 2}
    assert found["arrows"] == [["sim", "core"], ["sim", "maps"]]


def test_imports_that_go_up_and_packages_without_a_floor_are_refused(tmp_path: Path) -> None:
    with pytest.raises(SystemExit, match=r"pedzoo\.maps imports pedzoo\.sim"):
        house.read_house(checkout(tmp_path / "up", maps="from pedzoo.sim import part"))
    more = checkout(tmp_path / "more")
    (more / "pedzoo" / "cellar").mkdir()
    (more / "pedzoo" / "cellar" / "__init__.py").write_text("")
    with pytest.raises(SystemExit, match="cellar"):
        house.read_house(more)


def test_one_more_file_needs_no_new_picture(tmp_path: Path) -> None:
    drawn = house.read_house(checkout(tmp_path))
    now = json.loads(json.dumps(drawn))
    now["packages"]["sim"]["files"] += 3
    assert house.differences(drawn, now) == []
    now["packages"]["sim"]["files"] += 1
    now["packages"]["maps"]["purpose"] = "Something else."
    now["arrows"] = [["sim", "core"]]
    assert house.differences(drawn, now) == [
        "maps: drawn as 'About maps.', now 'Something else.'",
        "sim: drawn with 2 files, now 6",
        "arrow sim -> core: not drawn",
    ]
    assert house.differences({}, now) == ["there is no docs/architecture.json"]


def test_check_says_what_is_out_of_date(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(house, "ROOT", checkout(tmp_path))
    monkeypatch.setattr(house, "PAGE", tmp_path / "docs" / "architecture.json")
    assert house.main(["--check"]) == 1
    assert house.main([]) == 0 and house.main(["--check"]) == 0
    (tmp_path / "pedzoo" / "data" / "part.py").write_text("import pedzoo.maps")
    capsys.readouterr()
    assert house.main(["--check"]) == 1
    assert "arrow data -> maps: not drawn" in capsys.readouterr().out


def named(text: str) -> list[str]:
    """Return the Python files that a text names between backticks."""
    return re.findall(r"`([\w/]+\.py)`", text)


def walks() -> str:
    """Return the part of CONTRIBUTING that names the files of five runs."""
    _, _, rest = (ROOT / "CONTRIBUTING.md").read_text().partition("## A walk for newcomers\n")
    return rest.partition("\n## ")[0]


def test_all_files_of_the_walks_exist() -> None:
    files = named(walks())
    assert len(files) > 100
    assert [name for name in files if not (ROOT / "pedzoo" / name).is_file()] == []


def test_the_glossary_names_files_and_is_in_order() -> None:
    page = (ROOT / "docs" / "glossary.md").read_text()
    rows = [line.strip("| ").split(" | ") for line in page.splitlines() if line.startswith("| **")]
    words = [row[0].strip("*").casefold() for row in rows]
    assert len(words) > 40 and words == sorted(set(words))
    for row in rows:
        assert len(row) == 4 and named(row[3]), f"{row[0]}: expected word, meaning, unit or shape, files"
    assert [name for name in named(page) if not (ROOT / "pedzoo" / name).is_file()] == []


@pytest.mark.parametrize("page", ["glossary", "walks"])
def test_sentences_are_short(page: str) -> None:
    text = walks() if page == "walks" else (ROOT / "docs" / "glossary.md").read_text()
    plain = re.sub(r"`[^`]*`,?", "", text)  # names of files are no words
    sentences = re.split(r"(?<=[.?!])\s+|\n\s*\n|\n(?=[\d|*#-])|\s\|\s", plain)
    assert [one for one in sentences if len(re.findall(r"[^\W_]+", one)) > 25] == []
