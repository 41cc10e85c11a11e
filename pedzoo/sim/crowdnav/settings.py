"""The two settings that people compare robots in: CrowdNav's five people, and CrowdNav++'s twenty."""

from __future__ import annotations

import math
from dataclasses import dataclass

from pedzoo.policies.orca.settings import OrcaSettings


@dataclass(frozen=True)
class Setting:
    """A crowd, its rules and its rewards.

    Attributes:
        people: In each case, N.
        circle: Radius of the circle on which people start, metres.
        shift: Least and most shift of their starts along x and along y, metres.
        arena: Half the side of the square where the robot's start and goal are drawn at least ``far``
            apart, metres; None: from (0, -circle) to (0, circle).
        far: See there.
        discomfort_dist: Metres between bodies below which people are disturbed; starts keep them.
        time_limit: Seconds; a case ends `EARLY` before it.
        swept: Whether a collision counts on the way of a step, with the people's velocities of the step
            before, or where a step begins.
        replaced: Whether people who arrive make place for new ones on the circle.
        sensor_range: Metres between bodies up to which the robot sees people; None: all. People whom
            it does not see any more go on as they went, for all that it knows.
        foresight: Steps ahead: a robot in the place of a person at that time intrudes; 0: not looked at.
        visible: Whether people avoid the robot.
        safety_space: Metres by which all radii are longer for the people's ORCA, beside 0.01.
        success_reward: For the goal.
        collision_penalty: For a collision.
        discomfort_factor: Of the time and depth of discomfort, per metre and second.
    """

    people: int = 5
    circle: float = 4.0
    shift: tuple[float, float] = (-0.5, 0.5)
    arena: float | None = None
    far: float = 8.0
    discomfort_dist: float = 0.2
    time_limit: float = 25.0
    swept: bool = True
    replaced: bool = False
    sensor_range: float | None = None
    foresight: int = 0
    visible: bool = False
    safety_space: float = 0.0
    success_reward: float = 1.0
    collision_penalty: float = -0.25
    discomfort_factor: float = 0.5

    @property
    def orca(self) -> OrcaSettings:
        """The parameters of the people's ORCA."""
        return OrcaSettings(
            dt=TIME_STEP, neighbor_dist=10.0, max_neighbors=max(10, self.people), time_horizon=5.0
        )


TIME_STEP = 0.25
"""Seconds of a step."""

EARLY = 1.0
"""Seconds before the limit at which a case counts as timed out."""

RADIUS, SPEED = 0.3, 1.0
"""Metres and m/s of all people, and of the robot."""

MARGIN = 0.01
"""Metres by which ORCA takes all radii longer."""

CROWDNAV = Setting()
"""Chen, Liu, Kreiss and Alahi, "Crowd-Robot Interaction", ICRA 2019: ``crowd_nav/configs/env.config``."""

CROWDNAV_PP = Setting(
    people=20,
    circle=6 * math.sqrt(2),
    shift=(0.0, 2.0),
    arena=6.0,
    discomfort_dist=0.25,
    time_limit=50.0,
    swept=False,
    replaced=True,
    sensor_range=5.0,
    foresight=5,
    safety_space=0.15,
    success_reward=10.0,
    collision_penalty=-20.0,
    discomfort_factor=10.0,
)
"""Liu et al., "Intention Aware Robot Crowd Navigation", ICRA 2023: ``crowd_nav/configs/config.py``, people
whose goals, radii and speeds do not change (``no_rand``)."""
