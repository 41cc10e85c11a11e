"""Runs one unit of an evaluation; has its cache key, the file of finished units and progress."""

import ast
import hashlib
import json
import os
import sys
import sysconfig
import time
from collections.abc import Callable
from contextlib import suppress
from functools import cache
from modulefinder import ModuleFinder
from pathlib import Path
from typing import Any, NamedTuple

from pedzoo.core.errors import UserError
from pedzoo.core.machine import versions
from pedzoo.core.paths import sha256_of, write_atomically
from pedzoo.core.registry import ROOT, SUITES, folder_of, names_code
from pedzoo.core.spec import Spec, parse, unquoted
from pedzoo.eval.suite import ShareDone, WorkUnit
from pedzoo.models.zoo.store import find
from pedzoo.policies.crowd_names import parts

Rows = list[dict[str, Any]]

_CODE_FILES = (".py", ".csv", ".yaml", ".png")
_INSTALLED = (Path(sysconfig.get_path(kind)) for kind in ("stdlib", "purelib", "platlib"))
_OF_OTHERS = tuple(path.resolve() for path in (ROOT / "pedzoo", *_INSTALLED))
"""Folders of pedzoo and of installed packages, in which no user code is looked for."""

_IGNORED_PACKAGES = ("cli", "train", "viz", "configs")
"""Packages whose code cannot change a result, so the cache key leaves it out."""


def work(unit: WorkUnit, tell: ShareDone | None = None) -> Rows:
    """Do a unit and return its rows, as they are in JSON; ``tell`` gets the share that is done."""
    wall, cpu = time.perf_counter(), time.process_time()
    case = unit.case
    rows = SUITES.get(case.suite)(case.suite).rows(unit, tell)
    spent = {"wall": time.perf_counter() - wall, "cpu": time.process_time() - cpu}
    where = {"suite": case.suite, "physics": case.physics, **case.case}
    if unit.walks != unit.policy:
        where["weights"] = unit.walks
    for row in rows:
        row["table"], row["case"] = case.table or case.suite, where | row["case"]
        row["seconds"] = {key: round(value, 2) for key, value in spent.items()}
    return json.loads(json.dumps(rows, allow_nan=False))


def digest(unit: WorkUnit) -> str:
    """Return the cache key of a unit: units whose rows may differ have different ones.

    It depends on the unit itself, pedzoo's code, the versions of its dependencies, and the files that the
    unit names. These are weights, or a policy, suite, scenario or physics from a file.
    """
    case, known = unit.case, {**unit._asdict(), "case": unit.case._asdict()}
    walking = []
    for policy in (*parts(unit.walks), *parts(case.people)):
        name, settings = parse(policy)
        entry = find(name)
        own = _file_sum(unquoted(settings["weights"])) if names_code(name) and "weights" in settings else ""
        walking.append(entry.card.sha256 if entry else _file_sum(policy) + own)
    named = case.suite, case.scenario, case.physics, case.robot, *unit.metrics
    return fingerprint(known, [*walking, *map(_file_sum, named)])


def fingerprint(*known: Any) -> str:
    """Return the digest of some work: of all that describes it, pedzoo's code and the versions it uses."""
    used = {name: version for name, version in _versions().items() if name not in ("commit", "pedzoo")}
    return _sum_of([*known, _code_sum(), used])


_versions = cache(versions)


def _sum_of(value: Any) -> str:
    return hashlib.sha256(json.dumps(value, sort_keys=True).encode()).hexdigest()


def _file_sum(what: str | Spec) -> str:
    """Return the digest of the file that a name with settings stands for, and of all user code it imports."""
    name = parse(what).name if isinstance(what, str) else what.name
    path = Path(name.rpartition(":")[0] if names_code(name) else name)
    if not path.is_file() or path.suffix != ".py":
        return sha256_of(path) if path.is_file() else ""
    others = (Path(one).resolve() for one in sys.path)
    own = [str(one) for one in others if not any(one.is_relative_to(folder) for folder in _OF_OTHERS)]
    finder = ModuleFinder([str(path.parent), *own], excludes=["pedzoo"])
    with suppress(SyntaxError, ValueError):  # no Python
        finder.run_script(str(path))
    imported = (getattr(one, "__file__", None) for one in finder.modules.values())
    files = {Path(file).resolve() for file in (path, *imported) if file}
    return _sum_of(sorted((file.name, code_sum(file.read_bytes())) for file in files))


def code_sum(content: bytes) -> str:
    """Return the sha256 of what code does: docstrings, comments and layout do not change it."""
    try:
        tree = ast.parse(content)
    except (SyntaxError, ValueError):
        return hashlib.sha256(content).hexdigest()  # no Python: as it is
    for node in ast.walk(tree):
        if isinstance(body := getattr(node, "body", None), list):  # without docstrings, also of attributes
            texts = [one for one in body if isinstance(one, ast.Expr) and isinstance(one.value, ast.Constant)]
            body[:] = [one for one in body if one not in texts]
    return hashlib.sha256(ast.dump(tree).encode()).hexdigest()


@cache
def _code_sum() -> str:
    """Return the sha256 of what all code does that numbers depend on, and of the embedded recordings."""
    result = hashlib.sha256()
    for base in (Path(__file__).parents[1], folder_of("tools.paper")):  # a checkout's suites and tables
        for path in sorted(base.rglob("*")):
            place = path.relative_to(base)
            if path.suffix in _CODE_FILES and place.parts[0] not in _IGNORED_PACKAGES:
                content = path.read_bytes()
                content = code_sum(content).encode() if path.suffix == ".py" else content
                result.update(f"{place.as_posix()}\0".encode() + content)
    return result.hexdigest()


class Journal:
    """An append-only file with one line of JSON per finished unit.

    Attributes:
        path: The file; None keeps nothing.
        done: Rows of the units that were there when it was opened, by the units' digests.
    """

    def __init__(self, path: Path | None) -> None:
        """Read the file, if there is one; lines that are torn are dropped, and said.

        Raises:
            UserError: It is no such file, or cannot be read or mended.
        """
        self.path = path
        self.done: dict[str, Rows] = {}
        if path is None or not path.exists():
            return
        try:
            content = path.read_bytes()
        except OSError as error:
            raise UserError(f"cannot read {str(path)!r}: {error.strerror}") from error
        lines = content.splitlines(keepends=True)
        whole = [line for line in lines if self._take(line)]
        if not whole and not content.startswith(b'{"unit": "'[: len(content)]):
            raise UserError(
                f"{str(path)!r} holds no finished parts of an evaluation: name another file, or remove it"
            )
        if torn := len(lines) - len(whole):
            parts = f"{torn} finished part{'s' * (torn > 1)}"
            print(f"pedzoo: {path} was cut off in a write: {parts} will be done once more", file=sys.stderr)
            write_atomically(path, b"".join(whole))

    def _take(self, line: bytes) -> bool:
        """Keep the unit of a line, if it was written whole."""
        try:
            entry = json.loads(line) if line.endswith(b"\n") else None
        except (ValueError, RecursionError):
            return False
        match entry:
            case {"unit": str(unit), "rows": [*rows]} if all(isinstance(row, dict) for row in rows):
                self.done[unit] = rows
                return True
        return False

    def add(self, digest: str, rows: Rows) -> None:
        """Append a finished unit; a `UserError` if the file cannot be written."""
        if self.path is None:
            return
        line = json.dumps({"unit": digest, "rows": rows}, allow_nan=False) + "\n"
        try:
            self.path.parent.mkdir(parents=True, exist_ok=True)
            with self.path.open("a") as file:
                file.write(line)
                file.flush()
                os.fsync(file.fileno())
        except OSError as error:
            raise UserError(f"cannot write {str(self.path)!r}: {error.strerror}") from error


class ProgressReport(NamedTuple):
    """How far an evaluation is: ``units`` of ``total`` are finished, a share ``done`` of the expected work.

    ``seconds`` is what the part ``label`` took, None while it is going on; ``left`` what the rest is expected
    to take, None while that is unknown.
    """

    label: str
    done: float
    units: int
    total: int
    seconds: float | None
    left: float | None


Progress = Callable[[ProgressReport], None]
