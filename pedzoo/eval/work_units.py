"""Units of an evaluation: the function that does one in any process, and the digest of a unit."""

import ast
import hashlib
import json
import sys
import sysconfig
import time
from collections.abc import Iterator
from functools import cache
from importlib.util import find_spec
from pathlib import Path
from types import CodeType
from typing import Any

from pedzoo.core.fetch import sha256_of
from pedzoo.core.machine import versions
from pedzoo.core.registry import ROOT, SUITES, folder_of, names_code
from pedzoo.core.spec import Spec, parse, unquoted
from pedzoo.eval.suite import Tell, WorkUnit
from pedzoo.models.zoo.store import find
from pedzoo.policies.crowd_names import parts

_CODE_FILES = (".py", ".csv", ".yaml", ".png")
_OF_OTHERS = tuple(
    path.resolve()
    for path in (
        ROOT / "pedzoo",
        *(Path(sysconfig.get_path(kind)) for kind in ("stdlib", "purelib", "platlib")),
    )
)
"""Folders whose code is no user's: versions stand for it."""

_HAS_DOCSTRING = ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef

_IGNORED_PACKAGES = ("cli", "train", "viz", "configs")
"""Packages whose code changes no number of an evaluation."""


def work(unit: WorkUnit, tell: Tell | None = None) -> list[dict[str, Any]]:
    """Do a unit and return its rows, as they are in JSON; ``tell`` gets the share that is done."""
    wall, cpu = time.perf_counter(), time.process_time()
    rows = SUITES.get(unit.case.suite)(unit.case.suite).rows(unit, tell)
    spent = {"wall": time.perf_counter() - wall, "cpu": time.process_time() - cpu}
    where = {"suite": unit.case.suite, "physics": unit.case.physics, **unit.case.case}
    if unit.walks != unit.policy:
        where["weights"] = unit.walks
    for row in rows:
        row["table"] = unit.case.table or unit.case.suite
        row["case"] = where | row["case"]
        row["seconds"] = {key: round(value, 2) for key, value in spent.items()}
    return json.loads(json.dumps(rows, allow_nan=False))


def digest(unit: WorkUnit) -> str:
    """Return a unit's digest: units whose rows may differ have different ones.

    That is the unit itself, pedzoo's code, the versions of its dependencies, and the files that the unit
    names: weights, or a policy, suite, scenario or physics from a file.
    """
    known = {**unit._asdict(), "case": unit.case._asdict()}
    walking = [_model_sum(policy) for who in (unit.walks, unit.case.people) for policy in parts(who)]
    named = unit.case.suite, unit.case.scenario, unit.case.physics, unit.case.robot, *unit.metrics
    files = [*walking, *map(_file_sum, named)]
    return fingerprint(known, files)


def fingerprint(*known: Any) -> str:
    """Return the digest of some work: of all that describes it, pedzoo's code and the versions it uses."""
    return _sum_of([*known, _code_sum(), _versions()])


def _model_sum(policy: str) -> str:
    """Return the sha256 of the weights or the file that walk, nothing where that is pedzoo's own code."""
    name, settings = parse(policy)
    entry = find(name)
    own = _file_sum(unquoted(settings["weights"])) if names_code(name) and "weights" in settings else ""
    return entry.card.sha256 if entry else _file_sum(policy) + own


def _file_sum(what: str | Spec) -> str:
    """Return the digest of the file that a name with settings stands for, nothing where there is none.

    That of a file of code is its own and that of the user's modules which it imports, and these import.
    """
    name = parse(what).name if isinstance(what, str) else what.name
    path = Path(name.rpartition(":")[0] if names_code(name) else name)
    if not path.is_file() or path.suffix != ".py":
        return sha256_of(path) if path.is_file() else ""
    known: dict[Path, str] = {}
    waiting = [path.resolve()]
    while waiting:
        if (file := waiting.pop()) not in known:
            content = file.read_bytes()
            known[file] = code_sum(content)
            waiting += _imported(file, content)
    return _sum_of(sorted((file.name, digest) for file, digest in known.items()))


def _sum_of(value: Any) -> str:
    return hashlib.sha256(json.dumps(value, sort_keys=True).encode()).hexdigest()


def code_sum(content: bytes) -> str:
    """Return the sha256 of what code does: of docstrings, comments and its form nothing is in it."""
    result = hashlib.sha256()
    try:
        tree = ast.parse(content)
        for node in ast.walk(tree):
            if isinstance(node, _HAS_DOCSTRING) and ast.get_docstring(node, clean=False) is not None:
                node.body[:1] = [] if node.body[1:] else [ast.copy_location(ast.Pass(), node.body[0])]
        waiting: list[Any] = [compile(tree, "", "exec", dont_inherit=True)]
    except (SyntaxError, ValueError):
        return hashlib.sha256(content).hexdigest()
    while waiting:
        code = waiting.pop()
        inner = [one for one in code.co_consts if isinstance(one, CodeType)]
        plain = [_written(one) for one in code.co_consts if not isinstance(one, CodeType)]
        names = code.co_name, code.co_names, code.co_varnames, code.co_freevars, code.co_cellvars
        numbers = code.co_argcount, code.co_posonlyargcount, code.co_kwonlyargcount, code.co_flags
        result.update(repr((names, numbers, plain, len(inner))).encode())
        result.update(code.co_code + code.co_exceptiontable)
        waiting += inner
    return result.hexdigest()


def _written(constant: Any) -> str:
    """Return a constant as text that is the same in every process."""
    if isinstance(constant, tuple | frozenset):
        parts = [_written(one) for one in constant]
        return str(parts if isinstance(constant, tuple) else sorted(parts))
    return repr(constant)


def _imported(file: Path, content: bytes) -> Iterator[Path]:
    """Yield the files of the user's modules that a file imports, anywhere in it."""
    try:
        nodes = [*ast.walk(ast.parse(content))]
    except (SyntaxError, ValueError):
        return
    for node in nodes:
        names: list[str] = []
        if isinstance(node, ast.Import):
            names = [one.name for one in node.names]
        elif isinstance(node, ast.ImportFrom):
            above = "." * node.level
            inner = [f"{node.module}.{one.name}" if node.module else one.name for one in node.names]
            names = [above + one for one in (node.module or "", *inner)]
        elif isinstance(node, ast.Call) and ast.unparse(node.func).endswith(("import_module", "__import__")):
            names = [
                one.value for one in node.args if isinstance(one, ast.Constant) and isinstance(one.value, str)
            ]
        for name in names:
            yield from _files_of(name, file)


def _files_of(name: str, importer: Path) -> Iterator[Path]:
    """Yield the files of a module and of the packages around it, if it is a user's."""
    parts = [part for part in name.split(".") if part]
    dots = len(name) - len(name.lstrip("."))
    places = [importer.parents[dots - 1]] if 0 < dots <= len(importer.parents) else [importer.parent]
    if parts and not dots and parts[0] not in sys.stdlib_module_names:
        try:
            spec = find_spec(parts[0])
        except (ImportError, ValueError, AttributeError):
            spec = None
        where = [*(spec.submodule_search_locations or [])] if spec else []
        places += [Path(one).parent for one in (where or [spec.origin] if spec and spec.origin else where)]
    for place in places:
        for depth in range(len(parts) + 1):
            stem = place.joinpath(*parts[:depth])
            for file in (stem.with_suffix(".py"), stem / "__init__.py") if depth else (stem / "__init__.py",):
                if file.is_file() and not any(file.resolve().is_relative_to(one) for one in _OF_OTHERS):
                    yield file.resolve()


@cache
def _code_sum() -> str:
    """Return the sha256 of what all code does that numbers depend on, and of the embedded recordings.

    Commits of anything else leave it as it is.
    """
    result = hashlib.sha256()
    for base in (Path(__file__).parents[1], folder_of("tools.paper")):  # a checkout's suites and tables
        for path in sorted(base.rglob("*")):
            place = path.relative_to(base)
            if path.suffix in _CODE_FILES and place.parts[0] not in _IGNORED_PACKAGES:
                content = path.read_bytes()
                content = code_sum(content).encode() if path.suffix == ".py" else content
                result.update(f"{place.as_posix()}\0".encode() + content)
    return result.hexdigest()


@cache
def _versions() -> dict[str, str]:
    return {name: result for name, result in versions().items() if name not in ("commit", "pedzoo")}
