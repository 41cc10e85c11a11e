"""Draw the packages of pedzoo and their imports into ``docs/architecture.png``.

    python tools/pages/house.py            # draws it, and writes what it shows to docs/architecture.json
    python tools/pages/house.py --check    # fails where that file is out of date

Packages, purposes (first lines of the packages' docstrings) and imports are read from the code, the order of
the packages from the layers in ``pyproject.toml``. An arrow that other arrows imply is left out (transitive
reduction). The check does not look at the picture, whose pixels depend on fonts.
"""

from __future__ import annotations

import argparse
import ast
import json
import sys
import tomllib
from collections.abc import Iterator
from io import BytesIO
from pathlib import Path
from textwrap import fill
from typing import Any, NamedTuple

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import FancyArrowPatch, FancyBboxPatch, Polygon

ROOT = Path(__file__).parents[2]
PAGE = ROOT / "docs" / "architecture.json"

FLOORS = (
    ("one base", ("core",)),
    ("three sources", ("maps", "data", "models")),
    ("people walk", ("sim", "policies")),
    ("judge and show", ("metrics", "eval", "viz")),
    ("learn", ("train",)),
    ("commands", ("cli",)),
)
"""Floors of the house from the ground up, and their packages from left to right: arrows are short then."""

COLORS = ("#dfe3e8", "#d5e8d4", "#dae8fc", "#fff2cc", "#f8dcd2", "#e6dcee")

WIDTH, HIGH, LOW, GAP, LEFT = 12.0, 1.3, 0.85, 0.42, 1.75
"""Inches: a floor's width; its height with several rooms, with one; between rooms; the names at the left."""

FOOT, ROOF = 0.95, 0.5
"""Inches: the caption and the roof."""

FEW = 3
"""A picture is still good when a package has so many files more or less, or a fifth."""


class Place(NamedTuple):
    """Where a room is, inches."""

    left: float
    bottom: float
    width: float
    height: float


def main(argv: list[str] | None = None) -> int:
    """Draw or check; returns the exit code."""
    raw = argparse.RawDescriptionHelpFormatter
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=raw)
    parser.add_argument("--check", action="store_true", help="draw nothing; exit code 1 if out of date")
    options = parser.parse_args(argv)
    house = read_house(ROOT)
    if options.check:
        drawn = json.loads(PAGE.read_text()) if PAGE.is_file() else {}
        wrong = differences(drawn, house)
        if wrong:
            print(*wrong, sep="\n")
            print("docs/architecture.png is out of date: run python tools/pages/house.py, and commit docs/")
        return 1 if wrong else 0
    PAGE.parent.mkdir(exist_ok=True)
    PAGE.write_text(json.dumps(house, indent=2) + "\n")
    PAGE.with_suffix(".png").write_bytes(picture(house))
    print(f"{PAGE.with_suffix('.png')}: {len(house['packages'])} packages, {len(house['arrows'])} arrows")
    return 0


def read_house(root: Path) -> dict[str, Any]:
    """Return ``packages`` (name to purpose and files, lowest first) and ``arrows`` (importer, imported).

    Args:
        root: The checkout.

    Raises:
        SystemExit: A package has no layer or no floor, or an import goes up.
    """
    layers = _layers(root)
    placed = {name for _, names in FLOORS for name in names}
    result = {path.parent.name for path in (root / "pedzoo").glob("*/__init__.py")}
    if not result == placed == set(layers):
        odd = (result ^ placed) | (result ^ set(layers))
        raise SystemExit(f"{', '.join(sorted(odd))}: name them in FLOORS and in the layers of pyproject.toml")
    packages, imports = {}, set()
    for name in layers:
        folder = root / "pedzoo" / name
        files = sorted(folder.rglob("*.py"))
        said = ast.get_docstring(ast.parse((folder / "__init__.py").read_text())) or ""
        packages[name] = {"purpose": said.partition("\n")[0], "files": len(files)}
        imports |= {(name, other) for file in files for other in imported(file) & result - {name}}
    for name, other in sorted(imports):
        if layers.index(other) > layers.index(name):
            raise SystemExit(f"pedzoo.{name} imports pedzoo.{other}, which lies above it")
    return {"packages": packages, "arrows": sorted(map(list, reduced(imports)))}


def _layers(root: Path) -> list[str]:
    """Return the packages from the lowest layer to the highest."""
    settings = tomllib.loads((root / "pyproject.toml").read_text())["tool"]["importlinter"]
    contract = next(one for one in settings["contracts"] if one["type"] == "layers")
    return contract["layers"][::-1]


def imported(file: Path) -> set[str]:
    """Return the packages of pedzoo that a file imports when it runs, wherever in it the import stands."""
    result = set()
    for node in _running(ast.parse(file.read_text())):
        parts = []
        if isinstance(node, ast.Import | ast.ImportFrom):
            before = f"{node.module}." if isinstance(node, ast.ImportFrom) else ""
            parts = [f"{before}{alias.name}".split(".") for alias in node.names]
        result |= {part[1] for part in parts if part[0] == "pedzoo" and len(part) > 1}
    return result


def _running(node: ast.AST) -> Iterator[ast.AST]:
    """Yield all nodes below one, without what only type checkers read."""
    for child in ast.iter_child_nodes(node):
        if isinstance(child, ast.If) and ast.unparse(child.test) == "TYPE_CHECKING":
            continue
        yield child
        yield from _running(child)


def reduced(imports: set[tuple[str, str]]) -> set[tuple[str, str]]:
    """Return the imports that others do not imply: the transitive reduction of a graph without circles."""

    def reached(start: str, without: tuple[str, str]) -> set[str]:
        result: set[str] = set()
        left = [start]
        while left:
            here = left.pop()
            more = {b for a, b in imports if a == here and (a, b) != without} - result
            result |= more
            left += more
        return result

    return {one for one in imports if one[1] not in reached(one[0], one)}


def differences(drawn: dict[str, Any], now: dict[str, Any]) -> list[str]:
    """Return what a picture shows that is no longer so, one line each.

    Args:
        drawn: What the picture shows, as of `read_house`; empty where there is none.
        now: What the code says.
    """
    if not drawn:
        return ["there is no docs/architecture.json"]
    old, new = drawn["packages"], now["packages"]
    lines = [] if list(old) == list(new) else [f"packages: drawn {list(old)}, now {list(new)}"]
    for name in (name for name in new if name in old):
        was, said = old[name]["files"], new[name]["files"]
        if abs(said - was) > max(FEW, was // 5):
            lines.append(f"{name}: drawn with {was} files, now {said}")
        if old[name]["purpose"] != new[name]["purpose"]:
            lines.append(f"{name}: drawn as {old[name]['purpose']!r}, now {new[name]['purpose']!r}")
    before, after = ({tuple(one) for one in house["arrows"]} for house in (drawn, now))
    lines += [f"arrow {a} -> {b}: no longer imported" for a, b in sorted(before - after)]
    lines += [f"arrow {a} -> {b}: not drawn" for a, b in sorted(after - before)]
    return lines


def picture(house: dict[str, Any]) -> bytes:
    """Return the house as a PNG."""
    heights = [HIGH if len(names) > 1 else LOW for _, names in FLOORS]
    size = (LEFT + WIDTH + 0.3, FOOT + sum(heights) + GAP * (len(FLOORS) - 1) + ROOF + 0.1)
    figure = Figure(figsize=size)
    axes = figure.add_axes((0, 0, 1, 1))
    axes.set(xlim=(0, size[0]), ylim=(0, size[1]), aspect="equal")
    axes.set_axis_off()
    numbers = {name: number for number, name in enumerate(house["packages"], 1)}
    places: dict[str, Place] = {}
    bottom = FOOT
    for (title, names), height, color in zip(FLOORS, heights, COLORS, strict=True):
        width = (WIDTH - GAP * (len(names) - 1)) / len(names)
        axes.text(LEFT - 0.2, bottom + height / 2, title, ha="right", va="center", fontsize=13, color="0.4")
        for column, name in enumerate(names):
            places[name] = Place(LEFT + column * (width + GAP), bottom, width, height)
            _room(axes, places[name], numbers[name], name, house["packages"][name], color)
        bottom += height + GAP
    _roof(axes, bottom - GAP)
    for importer, used in house["arrows"]:
        _arrow(axes, places[importer], places[used])
    stairs = sorted(numbers[a] for a, b in house["arrows"] if numbers[a] == numbers[b] + 1)
    alone = stairs == list(range(2, len(numbers) + 1)) and len(stairs) == len(house["arrows"])
    left = f"What is left is one stair from {len(numbers)} to 1: a" if alone else "A"
    caption = (
        "An arrow points to what a package imports. Arrows that others imply are left out (transitive "
        f"reduction).\n{left} package may import every package with a smaller number."
    )
    axes.text(LEFT, FOOT / 2 - 0.02, caption, fontsize=11, color="0.35", va="center", linespacing=1.5)
    data = BytesIO()
    figure.savefig(data, format="png", dpi=90, metadata={"Software": None})
    return data.getvalue()


def _room(axes: Axes, place: Place, number: int, name: str, said: dict[str, Any], color: str) -> None:
    """Draw a package: its number, name, files and purpose."""
    left, bottom, width, height = place
    box = FancyBboxPatch((left, bottom), width, height, boxstyle="round,pad=0,rounding_size=0.08")
    box.set(facecolor=color, edgecolor="0.35", linewidth=1.2)
    axes.add_patch(box)
    top = bottom + height
    axes.text(left + 0.16, top - 0.29, f"{number}", fontsize=13, color="0.45", va="center")
    axes.text(left + 0.52, top - 0.29, name, fontsize=18, fontweight="bold", va="center")
    files = f"{said['files']} files"
    axes.text(left + width - 0.16, top - 0.29, files, fontsize=11, color="0.4", va="center", ha="right")
    text = fill(said["purpose"], int(width * 10.4))
    axes.text(left + 0.16, top - 0.52, text, fontsize=11.5, va="top", linespacing=1.3)


def _roof(axes: Axes, low: float) -> None:
    """Draw the roof on the highest floor."""
    middle = LEFT + WIDTH / 2
    roof = Polygon([(LEFT - 0.2, low), (middle, low + ROOF), (LEFT + WIDTH + 0.2, low)], closed=True)
    roof.set(facecolor="0.93", edgecolor="0.35", linewidth=1.2)
    axes.add_patch(roof)
    axes.text(middle, low + 0.17, "pedzoo", fontsize=15, fontweight="bold", ha="center", va="center")


def _arrow(axes: Axes, start: Place, end: Place) -> None:
    """Draw an arrow from a room to the one that it imports, between the sides that face each other."""
    if start.bottom == end.bottom:
        right = end.left > start.left
        y = start.bottom + start.height / 2
        points = ((start.left + start.width * right, y), (end.left + end.width * (not right), y))
    else:
        low, high = max(start.left, end.left), min(start.left + start.width, end.left + end.width)
        middle = (low + high) / 2
        ends = (middle, middle) if low < high else (start.left + start.width / 2, end.left + end.width / 2)
        points = ((ends[0], start.bottom), (ends[1], end.bottom + end.height))
    line = FancyArrowPatch(*points, arrowstyle="-|>", mutation_scale=22, shrinkA=0, shrinkB=0)
    line.set(color="0.15", linewidth=2.2, zorder=5)
    axes.add_patch(line)


if __name__ == "__main__":
    sys.exit(main())
