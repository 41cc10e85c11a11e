"""Finds drop-ins by walking their folder: a new model or dataset is one file, and there is no list to edit.

A file ``constant_velocity.py`` holds a class ``ConstantVelocity`` (the file's name without underscores,
any capitals). Names and one-line descriptions are read without importing anything, so that ``--help``
never waits for torch. People who installed the wheel write ``path/to/file.py:Class`` wherever a name is
accepted, or publish an entry point in the group ``pedzoo.plugins`` named ``<kind>.<name>``.
"""

from __future__ import annotations

import ast
import importlib
import importlib.util
import inspect
import sys
from collections.abc import Callable
from functools import cache
from importlib.metadata import entry_points
from pathlib import Path
from typing import Any
from zlib import crc32

from pedzoo.errors import UserError, unknown


class Registry:
    """The drop-ins of one folder, by file name."""

    def __init__(self, kind: str, package: str) -> None:
        """Serve the files of ``package``; ``kind`` is the word for one of them in messages."""
        self.kind = kind
        self.package = package
        self.folder = Path(__file__).parent.joinpath(*package.split(".")[1:])

    def names(self) -> list[str]:
        """Return all names in alphabetical order, without importing any of them."""
        files = {path.stem for path in self.folder.glob("*.py") if not path.stem.startswith("_")}
        return sorted(files | set(self._plugins()))

    def describe(self, name: str) -> str:
        """Return the first line of the drop-in's docstring, without importing it."""
        path = self.folder / f"{name}.py"
        if not path.is_file():
            return "plugin"
        return (ast.get_docstring(ast.parse(path.read_text())) or "").partition("\n")[0]

    def constant(self, name: str, variable: str) -> Any:
        """Return a literal module-level ``variable`` of a drop-in without importing it, or None."""
        path = self.folder / f"{name}.py"
        body = ast.parse(path.read_text()).body if path.is_file() else []
        for node in body:
            if isinstance(node, ast.Assign) and any(
                isinstance(target, ast.Name) and target.id == variable for target in node.targets
            ):
                return ast.literal_eval(node.value)
        return None

    def get(self, name: str) -> type:
        """Return the class behind a name, a plugin or ``path/to/file.py:Class``.

        Raises:
            UserError: No such name, file or class; the message has the nearest spelling.
        """
        if ".py:" in name:
            return _class_in_file(name)
        if (plugins := self._plugins()).get(name):
            return plugins[name].load()
        if name not in self.names():
            raise unknown(self.kind, name, self.names())
        module = importlib.import_module(f"{self.package}.{name}")
        wanted = name.replace("_", "")
        for attribute, value in vars(module).items():
            if isinstance(value, type) and attribute.lower() == wanted:
                return value
        raise UserError(f"{self.kind} file {name}.py has no class named like it (any capitals): {wanted}")

    def _plugins(self) -> dict[str, Any]:
        prefix = f"{self.kind}."
        return {
            point.name.removeprefix(prefix): point
            for point in _entry_points()
            if point.name.startswith(prefix)
        }


@cache  # reading the metadata of everything installed takes 30 ms
def _entry_points() -> list[Any]:
    return list(entry_points(group="pedzoo.plugins"))


def function_in_file(spec: str) -> Callable[..., Any]:
    """Return the function behind ``path/to/file.py:name``.

    Raises:
        UserError: No such file or function.
    """
    file, _, name = spec.rpartition(":")
    functions = {key: value for key, value in _in_file(file, spec).items() if inspect.isfunction(value)}
    if name not in functions:
        raise unknown(f"function in {file}", name, functions)
    return functions[name]


def _class_in_file(spec: str) -> type:
    file, _, name = spec.rpartition(":")
    classes = {key: value for key, value in _in_file(file, spec).items() if isinstance(value, type)}
    if name not in classes:
        raise unknown(f"class in {file}", name, classes)
    return classes[name]


def _in_file(file: str, spec: str) -> dict[str, Any]:
    """Return all that a file defines; ``spec`` is what errors quote."""
    path = Path(file).expanduser().resolve()
    if not path.is_file():
        raise UserError(f"no file {file!r} (from {spec!r}): expected path/to/file.py:NAME")
    return _executed(path)


@cache
def _executed(path: Path) -> dict[str, Any]:
    module_name = f"pedzoo_user_{path.stem}_{crc32(str(path).encode())}"  # two files may share a name
    module_spec = importlib.util.spec_from_file_location(module_name, path)
    assert module_spec and module_spec.loader
    module = importlib.util.module_from_spec(module_spec)
    sys.modules[module_name] = module
    module_spec.loader.exec_module(module)
    return vars(module)


MODELS = Registry("model", "pedzoo.models.architectures")
DATASETS = Registry("dataset", "pedzoo.data.datasets")
SCENARIOS = Registry("scenario", "pedzoo.sim.scenarios")
POLICIES = Registry("policy", "pedzoo.sim.policies")
SUITES = Registry("suite", "pedzoo.eval.suites")
PHYSICS = Registry("physics", "pedzoo.sim.physics")
BENCHMARKS = Registry("benchmark", "pedzoo.bench.sections")
