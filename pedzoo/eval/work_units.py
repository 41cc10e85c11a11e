"""Units of an evaluation: the function that does one in any process, and the digest of a unit."""

import hashlib
import json
import time
from functools import cache
from pathlib import Path
from typing import Any

from pedzoo.core.fetch import sha256_of
from pedzoo.core.machine import versions
from pedzoo.core.registry import SUITES, folder_of, names_code
from pedzoo.core.spec import Spec, parse, unquoted
from pedzoo.eval.suite import Tell, WorkUnit
from pedzoo.models.zoo.store import find
from pedzoo.policies.crowd_names import parts

_CODE_FILES = (".py", ".csv", ".yaml", ".png")
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
    parts = [*known, _code_sum(), _versions()]
    return hashlib.sha256(json.dumps(parts, sort_keys=True).encode()).hexdigest()


def _model_sum(policy: str) -> str:
    """Return the sha256 of the weights or the file that walk, nothing where that is pedzoo's own code."""
    name, settings = parse(policy)
    entry = find(name)
    own = _file_sum(unquoted(settings["weights"])) if names_code(name) and "weights" in settings else ""
    return entry.card.sha256 if entry else _file_sum(policy) + own


def _file_sum(what: str | Spec) -> str:
    """Return the sha256 of the file that a name with settings stands for, nothing where there is none."""
    name = parse(what).name if isinstance(what, str) else what.name
    path = Path(name.rpartition(":")[0] if names_code(name) else name)
    return sha256_of(path) if path.is_file() else ""


@cache
def _code_sum() -> str:
    """Return the sha256 of all code that numbers depend on, and of the embedded recordings.

    Commits of anything else leave it as it is.
    """
    result = hashlib.sha256()
    for base in (Path(__file__).parents[1], folder_of("tools.paper")):  # a checkout's suites and tables
        for path in sorted(base.rglob("*")):
            place = path.relative_to(base)
            if path.suffix in _CODE_FILES and place.parts[0] not in _IGNORED_PACKAGES:
                result.update(f"{place.as_posix()}\0".encode() + path.read_bytes())
    return result.hexdigest()


@cache
def _versions() -> dict[str, str]:
    return {name: result for name, result in versions().items() if name not in ("commit", "pedzoo")}
