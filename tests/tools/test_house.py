"""The shape of the house: its budget, its floor, imports one way, and what pages say of its files."""

import ast
import re
from collections import Counter, defaultdict
from collections.abc import Iterator
from functools import cache
from graphlib import TopologicalSorter
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PACKAGE = ROOT / "pedzoo"

BUDGET = {"pedzoo": 45_140, "tests": 31_600, "tools": 7_815}
"""Lines at most: the aim is 38,000, 28,000 and 7,000.

Rules of people and what trains them, 2,900 of the package, go when the learned walker takes their place.
"""

LONGEST, TABLES = 400, 600
"""Lines of a file; of one table or one algorithm."""

SLICES, LONELY_FOLDERS = 4, 6
"""Modules under 100 lines with one importer, and folders under 4 files, at most."""


def lines_of(folder: str) -> dict[str, int]:
    """Return the lines of each Python file below a folder, by its path from the root."""
    files = sorted((ROOT / folder).rglob("*.py"))
    return {str(file.relative_to(ROOT)): len(file.read_text().splitlines()) for file in files}


@cache
def imports() -> dict[str, set[str]]:
    """Return which modules of pedzoo each module names, also for types alone and by `import_module`."""
    files = {
        ".".join(file.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__"): file
        for file in PACKAGE.rglob("*.py")
    }

    def module(name: str) -> str | None:
        while name and name not in files:
            name = name.rpartition(".")[0]
        return name or None

    found = defaultdict[str, set[str]](set)
    for name, file in files.items():
        for node in ast.walk(ast.parse(file.read_text())):
            named: list[str] = []
            if isinstance(node, ast.Import):
                named = [alias.name for alias in node.names]
            elif isinstance(node, ast.ImportFrom) and node.module:
                named = [f"{node.module}.{alias.name}" for alias in node.names]
            elif isinstance(node, ast.Call) and ast.unparse(node.func).endswith("import_module"):
                named = [str(one.value) for one in node.args if isinstance(one, ast.Constant)]
            found[name] |= {other for one in named if (other := module(one)) and other != name}
    found.pop("pedzoo", None)  # the lazy front door names everything
    return {name: others - {"pedzoo"} for name, others in found.items()}


@pytest.mark.parametrize("folder", BUDGET)
def test_the_budget_of_lines_is_kept(folder: str) -> None:
    assert sum(lines_of(folder).values()) <= BUDGET[folder]


def test_files_are_as_large_as_an_idea() -> None:
    long = {file: count for file, count in lines_of("pedzoo").items() if count > LONGEST}
    assert {file: count for file, count in long.items() if count > TABLES} == {}
    assert len(long) <= 7


def test_slices_and_small_folders_are_few() -> None:
    importers = Counter(other for others in imports().values() for other in others)
    counts = lines_of("pedzoo")
    slices = [
        file
        for file, count in counts.items()
        if count < 100
        and "/datasets/" not in file
        and importers[".".join(Path(file).with_suffix("").parts)] == 1
    ]
    assert len(slices) <= SLICES, slices
    folders = Counter(str(Path(file).parent) for file in counts if Path(file).stem != "__init__")
    assert len([folder for folder, files in folders.items() if files < 4]) <= LONELY_FOLDERS


def test_imports_have_no_circles() -> None:
    TopologicalSorter(imports()).prepare()  # its error names those of a circle


def named(text: str) -> list[str]:
    """Return the Python files that a text names between backticks."""
    return re.findall(r"`([\w/]+\.py)`", text)


@pytest.mark.parametrize("page", ["CONTRIBUTING.md", "docs/glossary.md"])
def test_pages_name_files_that_exist(page: str) -> None:
    text = re.sub(r"\S*(\bmy_\w+|NAME)\.py", "", (ROOT / page).read_text())
    named_files = [name for name in named(text) if "/" in name]
    assert named_files
    assert [
        name for name in named_files if not any((root / name).is_file() for root in (ROOT, PACKAGE))
    ] == []


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
    own |= {Path(file).stem for file in trees}
    read = {file: set(private_names(tree)) - own for file, tree in trees.items()}
    return {file: names for file, names in read.items() if names}


def test_private_parts_of_libraries_are_in_the_adapters_alone() -> None:
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
