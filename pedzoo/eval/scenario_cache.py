"""A cache of prepared scenarios: planning the paths on a floor plan can take longer than the walks."""

from pedzoo.core.spec import Spec
from pedzoo.sim.make import CLEARANCE, make_scenario, prepare_scenario
from pedzoo.sim.scenario_parts.scenario import PreparedScenario, Scenario

KEPT = 6
"""Scenarios that a process keeps; more than the cases that share a floor plan."""

_kept: dict[tuple[str, str, float], PreparedScenario] = {}


def prepared(name: str | Spec, inputs: str = "", clearance: float = CLEARANCE) -> PreparedScenario:
    """Return the prepared scenario of a name with settings; errors as of `pedzoo.make_env`.

    Its ways keep ``clearance`` metres from walls.

    One that was made before is returned again, and one whose paths were planned for another takes those. It
    is made anew where ``inputs``, the digest of the files that it reads, has changed.
    """
    key = repr(name), inputs, clearance
    result = _kept.pop(key, None)
    if result is None:
        made = make_scenario(name)
        result = _adapted(made, clearance) or prepare_scenario(made, clearance)
    _kept[key] = result  # the latest is the last
    if len(_kept) > KEPT:
        del _kept[next(iter(_kept))]
    return result


def _adapted(made: Scenario, clearance: float) -> PreparedScenario | None:
    """Return the scenario with the floor plans and ways of one that is kept, None where none has them."""
    alike = (kept for kept in _kept.values() if kept.planner.clearance == clearance)
    return next(filter(None, map(made.adapted, alike)), None)
