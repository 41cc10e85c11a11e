"""Environments with robots by name."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from pedzoo.core.bodies import RobotBody
from pedzoo.core.errors import known_arguments
from pedzoo.core.registry import ROBOTS, SENSORS
from pedzoo.core.spec import Spec, build
from pedzoo.core.types import BODY_RADIUS
from pedzoo.policies.learned.walker import Walker
from pedzoo.policies.load import crowd_of
from pedzoo.policies.policy import Policy
from pedzoo.policies.teams import Crowd
from pedzoo.sim.env import PedestrianEnv
from pedzoo.sim.make import CLEARANCE, make_physics
from pedzoo.sim.robot_parts.env import RobotEnv
from pedzoo.sim.robot_parts.reward import WeightedSum
from pedzoo.sim.robot_parts.scenes import with_robots
from pedzoo.sim.robot_parts.sensor import Sensor
from pedzoo.sim.scenario_parts.scenario import PreparedScenario

SENSES = ("goal", "odometry", "people")
"""Sensors where nothing else is said."""

GAP = 0.1
"""Metres that ways keep from walls beyond the radius of the widest robot, at least."""


@known_arguments(PedestrianEnv.__init__, RobotEnv.__init__)
def make_robot_env(
    scenario: str | Spec | PreparedScenario,
    robot: str | Spec | RobotBody | Sequence[str | RobotBody] = "disc",
    people: str | Policy | Walker | Crowd = "orca",
    num_envs: int = 1,
    sensors: str | Sensor | Sequence[str | Sensor] = SENSES,
    reward: Mapping[str, float] | WeightedSum | None = None,
    physics: str = "compiled",
    clearance: float | None = None,
    robot_goals: int = 1,
    present: bool = True,
    **settings: Any,
) -> RobotEnv:
    """Return an environment in which a policy moves robots among people who are walked inside.

    Args:
        scenario: Its name with settings, ``goals:map=plan.yaml,people=6``: so many people beside the robots.
            Or prepared scenes with robots, which environments may share: ``robot``, ``robot_goals``,
            ``present`` and ``clearance`` are theirs then.
        robot: Its name with settings, ``diff_drive:radius=0.35``, ``file.py:Class``, or a body; a list for
            several robots.
        people: The policy of the people, or its name, a mixed crowd, see
            `pedzoo.policies.load.load_policy`.
        num_envs: B, scenes that are run at once.
        sensors: Names with settings, ``lidar:beams=64``, ``file.py:Class``, or sensors: one, or a list.
        reward: Weights of terms by name, ``{"progress": 1, "collision": 5}``; None for
            `pedzoo.sim.robot_parts.reward.USUAL`.
        physics: As in `pedzoo.make_env`.
        clearance: Metres that planned ways keep from walls; None: 0.25, or more for wide robots.
        robot_goals: Goals that each robot has to reach.
        present: Without it the robots are missing: the same people, in the same scenes.
        settings: More of `RobotEnv` and `PedestrianEnv`: ``seed``, ``decision_dt``, ``ends_at``,
            ``time_limit``, ``device``, ...

    Raises:
        UserError: An unknown name or setting, or a scene that cannot be.
    """
    body_radius = settings.setdefault("body_radius", BODY_RADIUS)
    if isinstance(scenario, PreparedScenario):
        prepared = scenario
    else:
        given = [robot] if isinstance(robot, str | Spec | RobotBody) else list(robot)
        bodies = [one if isinstance(one, RobotBody) else build(ROBOTS, one, RobotBody) for one in given]
        made = with_robots(scenario, bodies, robot_goals, present, body_radius)
        prepared = made.prepare(clearance_of(bodies) if clearance is None else clearance)
    senses = [sensors] if isinstance(sensors, str | Sensor) else sensors
    return RobotEnv(
        prepared,
        make_physics(physics, prepared.bank, body_radius),
        crowd_of(people) if isinstance(people, str) else people,
        [one if isinstance(one, Sensor) else build(SENSORS, one, Sensor) for one in senses],
        reward if isinstance(reward, WeightedSum) else WeightedSum(reward),
        num_envs,
        **settings,
    )


def clearance_of(bodies: Sequence[RobotBody]) -> float:
    """Return the metres that planned ways keep from walls, so that all robots fit."""
    return max(CLEARANCE, *(body.radius + GAP for body in bodies))
