"""Finds drop-ins by walking their folder: a new model or dataset is one file, without a list to edit.

A file ``constant_velocity.py`` holds a class ``ConstantVelocity`` (the file's name without underscores, any
capitals). Where drop-ins are short, all classes of one file may be drop-ins instead, ``BlindCorner`` as
``blind_corner``. Names and one-line descriptions are read without imports, so that ``--help`` never waits for
torch. From an installed wheel, write ``path/to/file.py:Class`` wherever a name is accepted, or publish an
entry point in the group ``pedzoo.plugins`` named ``<kind>.<name>``.
"""

import ast
import importlib
import os
import re
import sys
from collections.abc import Callable
from fnmatch import fnmatch
from functools import cache
from pathlib import Path
from types import FunctionType, ModuleType
from typing import Any
from zlib import crc32

from pedzoo.core.errors import UserError, unknown

_OF_FILES = "pedzoo_user_"
"""The prefix of module names of users' files."""

_PLUGINS = "pedzoo.plugins"

ROOT = Path(__file__).parents[2]
"""The checkout, or where the wheel is installed."""


def names_code(name: str) -> bool:
    """Return whether a name is that of something in a file of code, ``path/to/file.py:NAME``."""
    return ".py:" in name


class Registry:
    """The classes of drop-ins, by the names of their files, or by their own."""

    def __init__(self, kind: str, *packages: str) -> None:
        """Serve what some packages hold.

        Args:
            kind: The word for one of them in messages.
            packages: ``pedzoo.*``, whose files are served, or modules, whose public classes are, but for
                abstract ones and tuples; those of ``tools.*`` are there in a checkout alone.
        """
        self.kind, self.package, self._packages = kind, packages[0], packages

    def names(self) -> list[str]:
        """Return all names in alphabetical order, without importing any of them."""
        return sorted({*self._homes(), *self._plugins()})

    def describe(self, name: str) -> str:
        """Return the first line of the drop-in's docstring, without importing it."""
        node = self._node(name)
        return (ast.get_docstring(node) or "").partition("\n")[0] if node else "plugin"

    def described(self, pattern: str) -> list[dict[str, str]]:
        """Return ``name`` and ``about``, the description, of all whose name matches ``pattern``."""
        names = (name for name in self.names() if fnmatch(name, pattern))
        return [{"name": name, "about": self.describe(name)} for name in names]

    def constant(self, name: str, variable: str) -> Any:
        """Return a literal constant of a drop-in's module or class, without importing it, or None.

        Args:
            name: As of `get`; of a class in a file the file is read.
            variable: The constant's name.

        Raises:
            UserError: It is no literal.
        """
        file, colon, wanted = name.rpartition(".py:")
        if colon:
            path = file_of_code(f"{file}.py")
            node = ast.parse(path.read_text()) if path else None
        else:
            node, wanted = self._node(name), name.replace("_", "")
        body = [*(node.body if node else ())]
        for one in [one for one in body if isinstance(one, ast.ClassDef)]:
            body += one.body if one.name.lower() == wanted.lower() else []
        for one in body:
            if isinstance(one, ast.Assign | ast.AnnAssign) and one.value:
                targets = one.targets if isinstance(one, ast.Assign) else [one.target]
                if variable not in map(ast.unparse, targets):
                    continue
                try:
                    return ast.literal_eval(one.value)
                except ValueError as error:
                    raise UserError(f"{self.kind} {name}: {variable} is no literal: write it out") from error
        return None

    def get(self, name: str, base: type = object) -> type:
        """Return the class behind a name, a plugin or ``path/to/file.py:Class``.

        Raises:
            UserError: No such name, file or class, with the nearest spelling; or no subclass of ``base``.
        """
        if names_code(name) or name.endswith(".py"):
            found = _in_file(name, type)
        elif not (found := self._loaded(name)):
            raise UserError(
                f"{self.kind} file {name}.py has no class named like it (any capitals): "
                f"{name.replace('_', '')}"
            )
        if not issubclass(found, base):
            wanted = f"{base.__module__}.{base.__qualname__}"
            raise UserError(f"{name!r} is no {self.kind}: expected a subclass of {wanted}")
        return found

    def module_of(self, name: str) -> str | None:
        """Return the module that holds a drop-in, without importing it; None for plugins and unknown ones."""
        return self._homes().get(name)

    def _loaded(self, name: str) -> Any:
        """Return what a plugin's or drop-in's name stands for; None where its file does not have it."""
        if (plugins := self._plugins()).get(name):
            return plugins[name].load()
        if (home := self.module_of(name)) is None:
            raise unknown(self.kind, name, self.names())
        return self._find(vars(import_of_checkout(home)), name)

    def _find(self, inside: dict[str, Any], name: str) -> Any:
        wanted = name.replace("_", "")
        classes = (one for one in inside.items() if isinstance(one[1], type))
        return next((value for attribute, value in classes if attribute.lower() == wanted), None)

    def _homes(self) -> dict[str, str]:
        """Return the module of each drop-in by its name."""
        homes: dict[str, str] = {}
        for package in reversed(self._packages):
            files = {path.stem: f"{package}.{path.stem}" for path in folder_of(package).glob("[!_]*.py")}
            homes |= {name: home for name, home in files.items() if home not in self._packages}
            homes |= dict.fromkeys(_public_classes(package), package)
        return homes

    def _node(self, name: str) -> ast.Module | ast.ClassDef | ast.FunctionDef | None:
        """Return the code of a drop-in: its file, or its class in a file of several; None for plugins."""
        if (home := self.module_of(name)) is None:
            return None
        return _public_classes(home)[name] if home in self._packages else _parsed(home)

    def _plugins(self) -> dict[str, Any]:
        points = (point for point in _entry_points() if point.name.startswith(f"{self.kind}."))
        return {point.name.removeprefix(f"{self.kind}."): point for point in points}


class FunctionRegistry(Registry):
    """The functions of a package's files that carry the decorator named like the kind, as ``@metric()``."""

    def names(self) -> list[str]:
        """Return all names: files in alphabetical order, functions as they are written; plugins last."""
        return list(dict.fromkeys((*self._homes(), *self._plugins())))

    def get(self, name: str) -> Callable[..., Any]:
        """Return the function behind a name, a plugin or ``path/to/file.py:function``; errors as there."""
        return function_in_file(name) if names_code(name) or name.endswith(".py") else self._loaded(name)

    def declared(self, name: str) -> list[Any]:
        """Return the literals that the decorator of a function is given; none of plugins."""
        call = _decorated(self.package, self.kind).get(name, (None, None, None))[2]
        return [ast.literal_eval(one) for one in call.args] if call else []

    def _find(self, inside: dict[str, Any], name: str) -> Any:
        return inside[name]

    def _homes(self) -> dict[str, str]:
        return {name: home for name, (home, *_) in _decorated(self.package, self.kind).items()}

    def _node(self, name: str) -> ast.FunctionDef | None:
        return _decorated(self.package, self.kind).get(name, (None, None))[1]


def name_of_class(name: str) -> str:
    """Return the name of a drop-in by that of its class: ``blind_corner`` of ``BlindCorner``."""
    return re.sub(r"(?<=[a-z0-9])(?=[A-Z])", "_", name).lower()


@cache
def _public_classes(module: str) -> dict[str, ast.ClassDef]:
    """Return the public classes that a module defines by their names as drop-ins; none of a package."""
    body = _parsed(module).body if folder_of(module).with_suffix(".py").is_file() else []
    classes = (node for node in body if isinstance(node, ast.ClassDef) and not node.name.startswith("_"))
    interfaces = {"ABC", "NamedTuple"}
    return {
        name_of_class(node.name): node
        for node in classes
        if not interfaces.intersection(ast.unparse(base) for base in node.bases)
    }


@cache
def _decorated(package: str, decorator: str) -> dict[str, tuple[str, ast.FunctionDef, ast.Call]]:
    """Return module, definition and decorator of every function that a decorator declares, by name."""
    return {
        node.name: (f"{package}.{path.stem}", node, call)
        for path in sorted(folder_of(package).glob("[!_]*.py"))
        if f"@{decorator}(" in path.read_text()
        for node in _parsed(f"{package}.{path.stem}").body
        if isinstance(node, ast.FunctionDef)
        for call in node.decorator_list
        if isinstance(call, ast.Call) and ast.unparse(call.func) == decorator
    }


def folder_of(package: str) -> Path:
    """Return where a package of this checkout or wheel lies; ``tools.*`` is nowhere in a wheel."""
    return ROOT.joinpath(*package.split("."))


def import_of_checkout(module: str) -> ModuleType:
    """Import a module of ``pedzoo`` or of ``tools`` beside it; another package's ``tools`` is not taken."""
    if not module.startswith("pedzoo.") and "tools" not in sys.modules:
        sys.path.insert(0, str(ROOT))
    return importlib.import_module(module)


@cache
def _parsed(module: str) -> ast.Module:
    return ast.parse(folder_of(module).with_suffix(".py").read_text())


@cache
def _entry_points() -> list[Any]:
    """Return the plugins; `importlib.metadata` takes 50 ms, and is asked only where a package has some."""
    for folder in dict.fromkeys(path or "." for path in sys.path):
        files = Path(folder).glob("*-info/entry_points.txt")
        readable = (file.read_bytes() for file in files if os.access(file, os.R_OK))
        if os.path.isfile(folder) or any(_PLUGINS.encode() in text for text in readable):
            from importlib.metadata import entry_points

            return list(entry_points(group=_PLUGINS))
    return []


def function_in_file(spec: str) -> Callable[..., Any]:
    """Return the function behind ``path/to/file.py:name``.

    Raises:
        UserError: No such file or function.
    """
    return _in_file(spec, FunctionType)


def import_path(spec: str) -> str:
    """Return the import path of a class behind ``path/to/file.py:Class``; jsonargparse takes no other."""
    cls = _in_file(spec, type)
    return f"{cls.__module__}.{cls.__qualname__}"


def file_path(path: str) -> str:
    """Return ``path/to/file.py:Class`` of an import path that `import_path` gave; others stay."""
    module, _, name = path.rpartition(".")
    return f"{sys.modules[module].__file__}:{name}" if module.startswith(_OF_FILES) else path


def _in_file(spec: str, wanted: type) -> Any:
    """Return what ``path/to/file.py:name`` defines: a class for ``type``, or a function."""
    kind = "class" if wanted is type else "function"
    file, _, name = spec.rpartition(":") if names_code(spec) else (spec, "", "")
    if (path := file_of_code(file)) is None:
        raise UserError(f"no file {file!r:.200} (from {spec!r:.200}): expected path/to/file.py:NAME")
    inside = _executed(path)
    known = {key: value for key, value in inside.items() if isinstance(value, wanted)}
    own = [key for key, value in known.items() if value.__module__ == inside["__name__"] and key[0] != "_"]
    if not name:
        such = " or ".join(f"{file}:{one}" for one in own[:5])
        such = f", such as {such}" if own else f"; it defines no {kind}"
        raise UserError(f"{file!r:.200}: expected {file:.200}:{kind.upper()}{such}")
    if name not in known:
        raise unknown(f"{kind} in {file}", name, own or [*known])
    return known[name]


def file_of_code(path: str | Path) -> Path | None:
    """Return the absolute path of a file, or None; also for names that are too long or have a zero byte."""
    try:
        file = Path(os.path.expanduser(path)).resolve()
        return file if file.is_file() else None
    except (OSError, ValueError, RuntimeError):  # the last: a link to itself
        return None


@cache
def _executed(path: Path) -> dict[str, Any]:
    from importlib.util import module_from_spec, spec_from_file_location

    name = f"{_OF_FILES}{path.stem}_{crc32(str(path).encode())}"  # two files may share a name
    spec = spec_from_file_location(name, path)
    assert spec and spec.loader
    sys.modules[name] = module = module_from_spec(spec)
    spec.loader.exec_module(module)
    return vars(module)


MODELS = Registry("model", "pedzoo.models.architectures")
DATASETS = Registry("dataset", "pedzoo.data.datasets")
SCENARIOS = Registry(
    "scenario", "pedzoo.sim.scenarios", "pedzoo.sim.scenarios.encounters", "pedzoo.sim.scenarios.indoor"
)
POLICIES = Registry("policy", "pedzoo.policies.rule_based")
SUITES = Registry("suite", "pedzoo.eval.suites", "pedzoo.eval.suites.scenes", "tools.paper.suites")
PHYSICS = Registry("physics", "pedzoo.sim.physics")
ROBOTS = Registry("robot", "pedzoo.sim.robots.bodies")
SENSORS = Registry("sensor", "pedzoo.sim.robots.sensors")
ROBOT_REWARDS = Registry("robot reward", "pedzoo.sim.robots.rewards")
ROBOT_POLICIES = Registry("robot policy", "pedzoo.policies.robots", "pedzoo.policies.robots.baselines")
METRICS = FunctionRegistry("metric", "pedzoo.metrics")
COMMANDS = FunctionRegistry("command", "pedzoo.cli.commands")


def datasets_of_folds() -> dict[str, str]:
    """Return the dataset of each fold that is known by its name alone; nothing is imported."""
    return {fold: name for name in DATASETS.names() for fold in DATASETS.constant(name, "FOLDS") or ()}
