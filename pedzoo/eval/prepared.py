"""Scenarios are kept within a process: finding the ways on a floor plan can take longer than walking."""

from pedzoo.core.spec import Spec
from pedzoo.sim.make import make_scenario, prepare_scenario
from pedzoo.sim.scenario_parts.scenario import PreparedScenario

KEPT = 6
"""Scenarios that a process keeps; more than the cases that share a floor plan."""

_kept: dict[tuple[str, str], PreparedScenario] = {}


def prepared(name: str | Spec, inputs: str = "") -> PreparedScenario:
    """Return the prepared scenario of a name with settings; errors as of `pedzoo.make_env`.

    One that was made before is returned again, and one whose paths were planned for another takes those. It
    is made anew where ``inputs``, the digest of the files that it reads, has changed.
    """
    key = repr(name), inputs
    result = _kept.pop(key, None)
    if result is None:
        made = make_scenario(name)
        result = next(filter(None, map(made.adapted, _kept.values())), None) or prepare_scenario(made)
    _kept[key] = result  # the latest is the last
    if len(_kept) > KEPT:
        del _kept[next(iter(_kept))]
    return result
