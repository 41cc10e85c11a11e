"""Dependencies of the checks: one version of each, every file by its sha256."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path

from pedzoo.core.errors import EXTRAS

ROOT = Path(__file__).parents[2]


def name_of(requirement: str) -> str:
    return re.split(r"[^A-Za-z0-9._-]", requirement)[0].lower().replace("_", "-")


def locked() -> dict[str, tuple[str, int]]:
    """Return the version of each locked package, and how many hashes it has."""
    text = (ROOT / "requirements-ci.txt").read_text().replace("\\\n", " ")
    lines = [line for line in text.splitlines() if line and not line.startswith("#")]
    return {
        name_of(line): (re.split(r"==| ", line)[1], len(re.findall(r"--hash=sha256:[0-9a-f]{64}\b", line)))
        for line in lines
    }


def pinned() -> dict[str, str]:
    lines = (ROOT / "constraints.txt").read_text().splitlines()
    return {name_of(line): line.partition("==")[2] for line in lines if not line.startswith("#")}


def test_every_file_that_the_checks_install_has_a_hash() -> None:
    packages = locked()
    assert len(packages) > 100 and "torch" not in packages
    assert all(hashes > 0 for _, hashes in packages.values())


def test_the_lock_has_the_versions_of_the_constraints() -> None:
    """``tools/lock`` makes them agree. torch has many builds of one version, and no hash."""
    packages, versions = locked(), pinned()
    assert versions.keys() - packages.keys() == {"torch"}
    assert {name: packages[name][0] for name in versions if name != "torch"} == {
        name: version for name, version in versions.items() if name != "torch"
    }


def test_the_lock_has_all_dependencies_of_the_checks() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    extras = project["optional-dependencies"]
    wanted = [*project["dependencies"], *(one for extra in extras.values() for one in extra)]
    assert {name_of(one) for one in wanted} - {"torch", "pedzoo"} <= locked().keys()


def test_the_checks_install_from_the_lock_alone() -> None:
    setup = (ROOT / "tools" / "setup").read_text()
    assert "--no-deps --require-hashes --requirement requirements-ci.txt" in setup


def test_all_is_every_extra() -> None:
    extras = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["optional-dependencies"]
    (every,) = extras["all"]
    assert set(re.split(r"[\[\],]", every)[1:-1]) == set(EXTRAS) == extras.keys() - {"all", "dev"}
    assert extras["dev"][0] == "pedzoo[all]"
