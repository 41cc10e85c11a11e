"""Scenarios in files: ``mine.yaml`` is the scenario ``custom`` with the settings in it.

Imports nothing heavy.
"""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

from pedzoo.core.errors import UserError, unknown
from pedzoo.core.paths import expanded
from pedzoo.core.size_limits import load_yaml, read_mapping
from pedzoo.core.spec import Spec, SpecText, parse, unquoted

KEYS = ("people", "map", "speed", "speed_std")
"""The settings of `pedzoo.sim.scenarios.custom.Custom`."""

EXPECTED = "people: [{from: [-3, 0], to: [3, 0]}, ...], metres"

_ROS = {"image", "resolution", "origin"}
"""Keys of a floor plan."""


def scenario_spec(scenario: str | Spec) -> Spec | SpecText:
    """Return the name and the settings of a scenario, those of a file where one is named.

    Args:
        scenario: As of `pedzoo.sim.make.make_env`; or ``mine.yaml``, with settings behind it that replace
            the file's (``mine.yaml:speed=1.0``). Its map is looked for beside the file, too.

    Raises:
        UserError: It is no name; the file is missing or no YAML, has an unknown key, or no people.
    """
    if not isinstance(scenario, str | Spec | SpecText):
        raise UserError(f"scenario {scenario!r:.60}: expected its name with settings, such as door:people=4")
    spec = parse(scenario) if isinstance(scenario, str) else scenario
    if not spec.name.endswith((".yaml", ".yml")):
        return spec
    file = expanded(spec.name)
    settings = _read(file)
    for key, value in spec.settings.items():
        settings[key] = load_yaml(unquoted(value)) if isinstance(spec, SpecText) else value
    if wrong := [key for key in settings if key not in KEYS]:
        raise unknown(f"key of scenario {spec.name}", str(wrong[0]), KEYS)
    people = settings.get("people")
    if not isinstance(people, list) or not people or not all(isinstance(one, dict) for one in people):
        given = f"people: {people!r:.60}" if "people" in settings else "no people"
        raise UserError(f"{spec.name}: {given}: expected {EXPECTED}")
    plan = settings.get("map")
    if isinstance(plan, str) and os.path.isfile(file.parent / plan):  # false, too, where a name is too long
        settings["map"] = str(file.parent / plan)
    return Spec("custom", settings)


def _read(file: Path) -> dict[str, Any]:
    """Return the mapping in a file."""
    settings = read_mapping(file, "scenario", EXPECTED)
    if settings.keys() >= _ROS:
        raise UserError(f"{str(file)!r} is a floor plan, no scenario: write goals:map={file}")
    return settings
