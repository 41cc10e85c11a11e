"""Scenarios are kept within a process: finding the ways on a floor plan can take longer than walking."""

from __future__ import annotations

from pedzoo.sim.make import CLEARANCE, make_scenario
from pedzoo.sim.scenario import Scenario

KEPT = 6
"""Scenarios that a process keeps; more than the cases that share a floor plan."""

_kept: dict[tuple[str, str], Scenario] = {}


def prepared(name: str, inputs: str = "") -> Scenario:
    """Return the prepared scenario of a name with settings.

    One that was made before is returned again, and one whose ways were found for another takes those.

    Args:
        name: The scenario.
        inputs: Digest of the files that it reads: if they have changed, it is made anew.

    Raises:
        UserError: As of `pedzoo.make_env`.
    """
    made = _kept.pop((name, inputs), None)
    if made is None:
        made = make_scenario(name)
        if not any(made.adopt(other) for other in _kept.values()):
            made.ready(CLEARANCE)
    _kept[name, inputs] = made  # the latest is the last
    if len(_kept) > KEPT:
        del _kept[next(iter(_kept))]
    return made
