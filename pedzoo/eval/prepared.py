"""Scenarios are kept within a process: finding the ways on a floor plan can take longer than walking."""

from __future__ import annotations

from pedzoo.core.spec import Spec
from pedzoo.sim.make import CLEARANCE, make_scenario
from pedzoo.sim.scenario_parts.scenario import Scenario

KEPT = 6
"""Scenarios that a process keeps; more than the cases that share a floor plan."""

_kept: dict[tuple[str, str], Scenario] = {}


def prepared(name: str | Spec, inputs: str = "") -> Scenario:
    """Return the prepared scenario of a name with settings.

    One that was made before is returned again, and one whose ways were found for another takes those.

    Args:
        name: The scenario: a text, or its name and values.
        inputs: Digest of the files that it reads: if they have changed, it is made anew.

    Raises:
        UserError: As of `pedzoo.make_env`.
    """
    key = repr(name), inputs
    made = _kept.pop(key, None)
    if made is None:
        made = make_scenario(name)
        if not any(made.adopt(other) for other in _kept.values()):
            made.ready(CLEARANCE)
    _kept[key] = made  # the latest is the last
    if len(_kept) > KEPT:
        del _kept[next(iter(_kept))]
    return made
