"""Arguments of a controller: checked, and turned into arrays. What cannot be raises a `UserError`."""

import numbers
from collections.abc import Hashable, Mapping, Set
from dataclasses import dataclass
from hashlib import blake2b
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from pedzoo.core.errors import UserError, unknown

PREF_SPEED = 1.3
"""Preferred speed of people without a given one, m/s."""

OTHER_RADIUS = 0.3
"""Metres: the radius of other agents for which none is given, about that of a service robot."""

WIDEST, FASTEST, SWIFTEST, JUMP = 10.0, 10.0, 100.0, 1e3
"""Most of radii (m), preferred speeds and given velocities (m/s), and moves between two calls (m)."""

FARTHEST = 1e4
"""Metres from the scene's origin: float32 tells millimetres apart up to here."""

ZERO = np.zeros(2)


@dataclass(frozen=True)
class DiscKey:
    """The disc ``index`` of another agent, ``of`` its id, as the key of a row."""

    of: Hashable
    index: int

    def __repr__(self) -> str:
        """Return its name in messages."""
        return f"{self.of!r}[{self.index}]"


def number_of(one: Hashable) -> int:
    """Return the number by which an agent's noise is drawn, from their id alone, the same in every process.

    An integer is its own number, as people of an environment are numbered. Every other id goes by its
    ``repr``; ids whose ``repr`` holds an address get other noise in the next run.
    """
    if isinstance(one, numbers.Integral):
        return int(one) % 2**63
    return int.from_bytes(blake2b(repr(one).encode(), digest_size=8).digest()) % 2**63


def number(value: Any, what: str, expected: str, one: Hashable | None = None) -> float:
    """Return a value as a number; messages call it ``what`` of agent ``one``, and what was ``expected``."""
    try:
        if not isinstance(value, str):
            return float(value)
    except (TypeError, ValueError):
        pass
    whose = "" if one is None else f" of {one!r}"
    raise UserError(f"{what} {value!r}{whose}: expected {expected}")


def _above_zero(value: Any, what: str, unit: str, one: Hashable, most: float, doubt: str) -> float:
    """Return a value as a number above 0 and at most ``most``; messages about more raise a ``doubt``."""
    expected = f"{unit}, above 0 and at most {most:g}"
    result = number(value, what, expected, one)
    if not 0 < result <= most:
        asks = f": {doubt}" if most < result < np.inf else ""
        raise UserError(f"{what} {value} of {one!r}: expected {expected}{asks}")
    return result


def metres_of(one: Hashable, radius: Any) -> float:
    """Return the radius of an agent's body, metres."""
    far = isinstance(radius, numbers.Real) and float(radius) > 100 * WIDEST
    unit = "millimetres" if far else "centimetres"
    doubt = f"are these {unit}? A larger body is several discs"
    return _above_zero(radius, "radius", "metres", one, WIDEST, doubt)


def speed_of(one: Hashable, pref_speed: float | Mapping[Any, float]) -> float:
    """Return the speed that an agent likes, m/s: `PREF_SPEED` for others."""
    if isinstance(one, DiscKey):
        return PREF_SPEED
    given = pref_speed.get(one, PREF_SPEED) if isinstance(pref_speed, Mapping) else pref_speed
    doubt = "is this in kilometres per hour?"
    return _above_zero(given, "pref_speed", "metres per second", one, FASTEST, doubt)


def by_id(given: Any, what: str) -> Mapping[Any, Any]:
    """Return an argument that has a value for every id, an empty one for None; messages call it ``what``."""
    if not isinstance(given, Mapping | None):
        raise UserError(f"{what} {given!r:.100}: expected a mapping by id, {what}={{'anna': ...}}")
    return given or {}


def of_present(present: Mapping[Any, Any], given: Mapping[Any, Any]) -> dict[Any, Any]:
    """Return the entries of people who are present."""
    return {one: value for one, value in given.items() if one in present}


def check_radius_ids(
    radius: Mapping[Any, Any], people: Mapping[Any, Any], others: Mapping[Any, Any], before: Set[Any]
) -> None:
    """Check that radii are those of people, of other agents, or of ids from ``before`` who have left."""
    for one in radius:
        if not (one in people or one in others or one in before):
            text = all(isinstance(each, str) for each in (one, *people, *others))
            name = str if text else repr
            raise unknown("id in radius", name(one), map(name, (*people, *others)))


def origin_of(places: Mapping[Any, Any]) -> NDArray[np.float64]:
    """Return the origin (2,) of a scene amid most of the places of its agents, by id.

    A scene is walked alike wherever it lies, and whoever is far away from it. What is no place counts as
    zeros: `as_points` refuses it.
    """
    points = [_pair(place) for place in places.values()]
    given = [ZERO if point is None or not np.isfinite(point).all() else point for point in points]
    middle: NDArray[np.float64] = np.sort(given, axis=0)
    return middle[(len(middle) - 1) // 2]


def as_discs(others: Mapping[Any, Any]) -> dict[DiscKey, Any]:
    """Return the discs of other agents, each with its position (2,): given as (2,), or (k, 2) for several."""
    discs: dict[DiscKey, Any] = {}
    for one, value in others.items():
        try:
            points: NDArray[np.float64] = np.atleast_2d(np.array(_plain(value), dtype=np.float64))
        except (TypeError, ValueError):
            points = np.zeros((0, 2))
        if points.ndim != 2 or points.shape[-1] != 2 or not len(points):
            raise UserError(
                f"others: position {value!r} of {one!r}: expected two numbers, (x, y), or a list of such "
                "pairs for several discs"
            )
        discs |= {DiscKey(one, index): point for index, point in enumerate(points)}
    return discs


def as_points(
    given: Mapping[Any, Any], what: str, origin: NDArray[np.float64] = ZERO, farthest: float = FARTHEST
) -> Tensor:
    """Return the values of a dictionary, each two numbers, less an origin (2,), as (n, 2) float64.

    Messages call the values ``what``.
    """
    try:
        points = np.array([_plain(xy) for xy in given.values()], dtype=np.float64).reshape(len(given), 2)
    except (TypeError, ValueError):
        wrong = next((item for item in given.items() if _pair(item[1]) is None), None)
        shown = f"{what} {wrong[1]!r} of {wrong[0]!r}" if wrong else f"{what}s {given!r}"
        raise UserError(f"{shown}: expected two numbers, (x, y)") from None
    if not np.isfinite(points).all():
        one = list(given)[int((~np.isfinite(points).all(1)).argmax())]
        raise UserError(f"{what} {given[one]!r} of {one!r}: expected finite numbers, (x, y)")
    points = points - origin
    if (far := (np.abs(points) > farthest).any(1)).any():
        one = list(given)[int(far.argmax())]
        raise UserError(
            f"{what} {given[one]!r} of {one!r} is more than {FARTHEST:g} m from the scene's origin, the "
            "floor plan's or the first agent's place: are all in one frame, and in metres?"
        )
    return torch.from_numpy(points)


def as_places(given: Mapping[Any, Any], what: str, origin: NDArray[np.float64]) -> Tensor:
    """Return `as_points` in whole micrometres: those of a scene that was moved are the very same.

    Less the origin, the last digits tell how far away a scene is, and where forces balance they decide.
    """
    return as_points(given, what, origin).round(decimals=6)


def as_velocities(given: Mapping[Any, Any]) -> Tensor:
    """Return given velocities, as `as_points` does."""
    result = as_points(given, "velocity", farthest=np.inf)
    if (result.norm(dim=1) > SWIFTEST).any():
        one = list(given)[int(result.norm(dim=1).argmax())]
        raise UserError(
            f"velocity {given[one]!r} of {one!r}: expected metres per second, at most {SWIFTEST:g}: is this "
            "in another unit?"
        )
    return result


def _plain(value: Any) -> Any:
    return value.detach().cpu().numpy() if isinstance(value, Tensor) else value


def _pair(xy: Any) -> NDArray[np.float64] | None:
    """Return two numbers (2,); None for anything else."""
    try:
        pair: NDArray[np.float64] = np.asarray(_plain(xy), dtype=np.float64)
    except (TypeError, ValueError):
        return None
    return pair if pair.shape == (2,) else None
