"""Settings of the social force model."""

import math
from dataclasses import dataclass
from typing import Any, Literal, get_args

from pedzoo.core.errors import UserError, unknown
from pedzoo.core.types import BODY_RADIUS, TRACE_SECONDS

Anisotropy = Literal["view", "smooth", "none"]
"""How the weight of others depends on their direction; see `SocialForceSettings`."""

NEGLIGIBLE = 0.01
"""Acceleration below which a wall is left out, m/s^2; walking people accelerate by 1 or more."""

OF_PRESET: Any = None
"""Default of a setting that has the value of the preset."""


@dataclass(frozen=True)
class SocialForceSettings:
    """Settings of the social force model; the symbols are those of the paper.

    Helbing and Molnar, "Social force model for pedestrian dynamics", Phys. Rev. E 51, 4282 (1995),
    arXiv:cond-mat/9805244. Every default but those of ``behind`` and the last three is the paper's. The
    paper's desired speed (normally distributed, 1.34 and 0.26 m/s) is each person's ``pref_speed`` here. The
    ellipse around a person (eq. 4) lies along their velocity, which others can see; in the paper it lies
    along their desired direction, with the length of their speed.

    Helbing et al. 2005 is Helbing, Buzna, Johansson and Werner, "Self-organized pedestrian crowd dynamics:
    experiments, simulations, and design solutions", Transportation Science 39, 1-24.

    Attributes:
        tau: Relaxation time in which people take up their desired velocity, seconds (tau, eq. 2).
        walls: Whether walls are avoided.
        dt: Seconds between decisions, at most ``tau``; forces are integrated in steps of 0.1 s or less.
        preset: ``1995`` for the paper's parameters, ``indoor`` for doors, see `PRESETS`.
        strength: Of the potential around people, m^2/s^2 (V0, eq. 3).
        sigma: Its range, metres (sigma).
        step_time: How far the potential's ellipses reach ahead of a walking person, seconds (Delta t, eq.
            4).
        wall_strength: Of the potential of walls, m^2/s^2 (U0, eq. 5).
        wall_range: Its range, metres (R).
        anisotropy: Weight of others' forces. ``view``: 1 within ``view_angle`` of the desired direction,
            ``out_of_view`` beyond, by the direction that the force comes from (eq. 8). ``smooth``: lambda +
            (1 - lambda) (1 + cos) / 2, by the angle to the other person (Helbing et al. 2005). ``none``: 1.
            Walls always count in full, as in the paper.
        view_angle: Half of the angle of sight, degrees (phi; the paper gives 2 phi = 200).
        out_of_view: Weight of people out of sight (c).
        behind: Weight of a person straight behind when the weight is ``smooth`` (lambda; 0.75 in Helbing et
            al. 2005).
        top_speed_ratio: Top speed, divided by the preferred one (eq. 11).
        neighbor_dist: Metres between centres beyond which others are ignored. From 5 m away a person who
            approaches at 1.7 m/s accelerates another by less than 0.001 m/s^2, at 2.2 m/s by 0.04 m/s^2.
            People faster than ``neighbor_dist / step_time`` act later than in the paper.
        max_neighbors: Nearest others that act; None: all within ``neighbor_dist``.
        fluctuation: Standard deviation of a random acceleration, drawn for every decision, m/s^2. The paper
            leaves its size open; without it, people who meet exactly head-on never make way.
    """

    tau: float = 0.5
    walls: bool = True
    dt: float = TRACE_SECONDS
    preset: str = "1995"
    strength: float = 2.1
    sigma: float = 0.3
    step_time: float = OF_PRESET
    wall_strength: float = OF_PRESET
    wall_range: float = OF_PRESET
    anisotropy: Anisotropy = "view"
    view_angle: float = 100.0
    out_of_view: float = 0.5
    behind: float = 0.75
    top_speed_ratio: float = 1.3
    neighbor_dist: float = 5.0
    max_neighbors: int | None = None
    fluctuation: float = 0.1

    def __post_init__(self) -> None:
        """Take missing values from the preset, and check all.

        Raises:
            UserError: There is no such preset, or a value is out of its range.
        """
        if self.preset not in PRESETS:
            raise unknown("preset of social_force", self.preset, PRESETS)
        for name, value in PRESETS[self.preset].items():
            if getattr(self, name) is OF_PRESET:
                object.__setattr__(self, name, value)
        for name in ("tau", "sigma", "wall_range", "top_speed_ratio", "neighbor_dist"):
            self._expect(name, "a number above 0", above=0.0)
        for name in ("strength", "step_time", "wall_strength", "fluctuation"):
            self._expect(name, "a number, 0 or more")
        for name in ("out_of_view", "behind"):
            self._expect(name, "a weight from 0 to 1", most=1.0)
        self._expect("view_angle", "degrees from 0 to 180", most=180.0)
        if self.max_neighbors is not None and self.max_neighbors < 0:
            raise UserError(f"social_force: max_neighbors {self.max_neighbors}: expected 0 or more, or none")
        if self.anisotropy not in get_args(Anisotropy):
            raise unknown("anisotropy of social_force", self.anisotropy, get_args(Anisotropy))
        if self.dt > self.tau:
            raise UserError(
                f"social_force: dt {self.dt}: expected at most tau, {self.tau} s: a velocity that is held "
                "for longer than it takes to change it follows no forces"
            )

    def _expect(self, name: str, what: str, most: float = math.inf, above: float | None = None) -> None:
        value = getattr(self, name)
        if not (math.isfinite(value) and 0 <= value <= most) or value == above:
            raise UserError(f"social_force: {name} {value}: expected {what}")

    @property
    def wall_reach(self) -> float:
        """Metres beyond which a wall accelerates a person by less than `NEGLIGIBLE`; 1.70 by default."""
        nearest = self.wall_strength / self.wall_range
        return self.wall_range * math.log(max(nearest / NEGLIGIBLE, 1.0))


PRESETS: dict[str, dict[str, Any]] = {
    "1995": {"step_time": 2.0, "wall_strength": 10.0, "wall_range": 0.2},
    "indoor": {
        # walls of Helbing et al. 2005, fitted to a bottleneck: A exp((r - d) / B) with A = 5 m/s^2, B = 0.1 m
        # and r, a body's radius, as here
        "wall_strength": 5 * 0.1 * math.exp(BODY_RADIUS / 0.1),
        "wall_range": 0.1,
        # one step of 0.65 m at 1.3 m/s, the paper's meaning of Delta t; with its 2 s people in single file
        # push the one in front aside
        "step_time": 0.5,
    },
}
"""Settings of the presets.

In the middle of a door of 0.85 m the two jambs' potential is 2.4 m^2/s^2 with the walls of 1995 and 0.06
with ``indoor``; a person at 1.3 m/s has a kinetic energy of 0.85 m^2/s^2.
"""
