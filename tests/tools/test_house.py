"""`tools/pages/house.py` and the pages for newcomers: they say what the code says."""

from __future__ import annotations

import ast
import inspect
import json
import re
import subprocess
import sys
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import pytest

from pedzoo.policies.load import load_policy
from tools.pages import house

ROOT = Path(__file__).parents[2]
PACKAGE = ROOT / "pedzoo"


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
    result = house.read_house(checkout(tmp_path, sim="import pedzoo.maps.part, pedzoo.core.part"))
    assert list(result["packages"])[:3] == ["core", "maps", "data"]
    assert result["packages"]["sim"] == {"purpose": "About sim.", "files": 2}
    assert result["arrows"] == [["sim", "core"], ["sim", "maps"]]


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


TRACED = """
import sys
from pathlib import Path
import pedzoo
from pedzoo.policies.load import load_policy

package, entered = Path(pedzoo.__file__).parent, []

def note(frame, event, _):
    file = Path(frame.f_code.co_filename)
    if event == "call" and package in file.parents:
        entered.append(str(file.relative_to(package)))

load_policy("orca:radius=0.3")  # imports
sys.setprofile(note)
load_policy("orca:radius=0.3")
sys.setprofile(None)
print(*dict.fromkeys(entered))
"""
"""Prints the files of pedzoo that a policy's string enters, in order."""


def test_a_policy_string_becomes_a_policy_in_the_files_of_the_walk() -> None:
    """At most six of them, in that order, and `load_policy` has at most two returns."""
    walk = walks().partition("### A policy string to velocities")[2].partition("\nThen the call")[0]
    # a process of its own: what other tests have done to this one must not matter
    traced = subprocess.run([sys.executable, "-c", TRACED], capture_output=True, text=True, check=True)
    entered = traced.stdout.split()
    assert entered == list(dict.fromkeys(named(walk))) and len(entered) <= 6
    returns = [
        node for node in ast.walk(ast.parse(inspect.getsource(load_policy))) if isinstance(node, ast.Return)
    ]
    assert len(returns) <= 2


def test_files_and_folders_are_small() -> None:
    files = sorted(PACKAGE.rglob("*.py"))
    assert len(files) > 200
    lines = {str(file.relative_to(PACKAGE)): len(file.read_text().splitlines()) for file in files}
    assert {name: count for name, count in lines.items() if count > 300} == {}
    loose = Counter(str(file.parent.relative_to(PACKAGE)) for file in files if file.name != "__init__.py")
    assert {folder: count for folder, count in loose.items() if count > 15} == {}


TUPLES = {"_replace", "_asdict", "_fields", "_make"}
"""What a `NamedTuple` makes public."""


def private_names(tree: ast.Module) -> Iterator[str]:
    """Yield every private attribute or module that code reads, by dot, import or text."""
    for node in ast.walk(tree):
        names: list[object] = []
        if isinstance(node, ast.Attribute):
            names = [node.attr]
        elif isinstance(node, ast.Import | ast.ImportFrom):
            module = node.module or "" if isinstance(node, ast.ImportFrom) else ""
            names = [part for name in (module, *(a.name for a in node.names)) for part in name.split(".")]
        elif isinstance(node, ast.Call) and ast.unparse(node.func).endswith(("attr", "attrgetter")):
            names = [one.value for one in node.args if isinstance(one, ast.Constant)]
        yield from (str(name) for name in names if re.match(r"_[a-z]", str(name)))


def own_names(tree: ast.Module) -> Iterator[str]:
    """Yield the names that code defines."""
    for node in ast.walk(tree):
        if isinstance(node, ast.FunctionDef | ast.ClassDef):
            yield node.name
        elif isinstance(node, ast.Attribute | ast.Name) and isinstance(node.ctx, ast.Store):
            yield node.attr if isinstance(node, ast.Attribute) else node.id


def foreign(trees: dict[str, ast.Module]) -> dict[str, set[str]]:
    """Return the private names of other libraries that files read: those that none of the files defines."""
    own = {name for tree in trees.values() for name in own_names(tree)} | TUPLES | {"_exit"}  # `os._exit`
    read = {file: set(private_names(tree)) - own for file, tree in trees.items()}
    return {file: names for file, names in read.items() if names}


def test_private_parts_of_other_libraries_are_in_the_adapters_alone() -> None:
    trees = {str(file.relative_to(PACKAGE)): ast.parse(file.read_text()) for file in PACKAGE.rglob("*.py")}
    assert set(foreign(trees)) == {"core/adapters.py"}


def test_the_sweep_finds_private_parts() -> None:
    code = {
        "dot": "trainer.loop._steps",
        "import": "from torch._dynamo.exc import UserError",
        "text": "getattr(action, '_typehint', None)",
        "own": "class A:\n    def _mine(self):\n        return self._mine()._replace(a=1)",
    }
    trees = {name: ast.parse(text) for name, text in code.items()}
    assert foreign(trees) == {"dot": {"_steps"}, "import": {"_dynamo"}, "text": {"_typehint"}}


def test_the_glossary_names_files_and_is_in_order() -> None:
    page = (ROOT / "docs" / "glossary.md").read_text()
    rows = [line.strip("| ").split(" | ") for line in page.splitlines() if line.startswith("| **")]
    words = [row[0].strip("*").casefold() for row in rows]
    assert len(words) > 40 and words == sorted(set(words))
    for row in rows:
        assert len(row) == 4 and named(row[3]), f"{row[0]}: expected word, meaning, unit or shape, files"
    assert [name for name in named(page) if not (ROOT / "pedzoo" / name).is_file()] == []
