"""Scenes of any scenario in which robots take the places of its last people, and the robots' view of them."""

import inspect
import math
from collections.abc import Sequence
from copy import copy
from dataclasses import replace
from typing import Any, NamedTuple

import torch
from torch import Tensor

from pedzoo.core.batch import ROBOT
from pedzoo.core.bodies import HOLONOMIC, Fleet, RobotBody
from pedzoo.core.errors import UserError, as_integer
from pedzoo.core.geometry import direction_of, identity_pose, rotate, unrotate
from pedzoo.core.randomness import Draws
from pedzoo.core.registry import SCENARIOS
from pedzoo.core.spec import Spec, build, groups_by_setting, setting_groups, setting_types
from pedzoo.core.types import BODY_RADIUS, TOP_SPEED_RATIO
from pedzoo.core.untrusted import load_yaml
from pedzoo.maps.grid import OccupancyGrid
from pedzoo.maps.planning.guidance import Guidance
from pedzoo.maps.planning.planner import Planner
from pedzoo.sim.make import scenario_spec
from pedzoo.sim.physics._base import Bodies, Physics
from pedzoo.sim.scenario import WARM_SECONDS, Layout, PreparedScenario, Scenario, filled
from pedzoo.sim.state import State


class RobotView(NamedTuple):
    """B scenes of A agents, the last R of which are ``robots``: what sensors and rewards look at.

    ``guidance`` is what the planner says to all agents; ``physics`` casts rays, and takes pictures.
    """

    state: State
    guidance: Guidance
    physics: Physics
    robots: int

    def robot(self, values: Tensor) -> Tensor:
        """Return the values (B, R, ...) of robots among those of all agents (B, A, ...)."""
        return values[:, -self.robots :]

    @property
    def position(self) -> Tensor:
        """Positions of robots (B, R, 2), metres."""
        return self.robot(self.state.position)

    @property
    def heading(self) -> Tensor:
        """Headings of robots (B, R), radians."""
        return self.robot(self.state.heading)

    def own(self, vectors: Tensor) -> Tensor:
        """Return vectors (B, R, ..., 2) of the world in the robots' frames: x ahead, y to the left."""
        return unrotate(vectors, _aligned(direction_of(self.heading), vectors))

    def world(self, vectors: Tensor) -> Tensor:
        """Return vectors (B, R, ..., 2) of the robots' frames in the world's: the inverse of `own`."""
        return rotate(vectors, _aligned(direction_of(self.heading), vectors))

    def own_places(self, points: Tensor) -> Tensor:
        """Return points (B, R, ..., 2) of the world in the robots' frames, from their positions, metres."""
        return self.own(points - _aligned(self.position, points))

    def rays(self, direction: Tensor, reach: float, people: bool = True) -> Tensor:
        """Return how far rays from the robots' centres go (B, R, N), metres, at most ``reach``.

        ``direction`` (B, R, N, 2): unit vectors of the world. Without ``people`` walls alone are in the way.
        """
        bodies = Bodies.of(self.state)
        if not people:
            bodies = bodies._replace(mask=torch.zeros_like(bodies.mask))
        # a ray that begins inside a body does not see it: so a robot does not see itself
        origin = self.position.unsqueeze(2).expand_as(direction).flatten(1, 2)
        return self.physics.rays(bodies, origin, direction.flatten(1, 2), reach).view(direction.shape[:3])


def _aligned(value: Tensor, like: Tensor) -> Tensor:
    """Return (B, R, 2) with as many dimensions as ``like`` (B, R, ..., 2)."""
    return value.view(*value.shape[:2], *[1] * (like.dim() - 3), 2)


class RobotScenes(Scenario):
    """A scenario of N people and R robots: the scenario of N + R people, whose last R are robots.

    So a robot starts where a person would, and goes where a person would go. Without robots
    (``present=False``) the same people are in the same scenes: robots are taken out after the warm start, so
    that all people are where they are beside the robots.

    Attributes:
        robots: R.
        bodies: Of the robots.
        robot_goals: Goals that each robot has to reach.
        body_radius: Of people where the scenario says nothing else, metres.
    """

    def __init__(
        self,
        inner: Scenario,
        bodies: Sequence[RobotBody],
        robot_goals: int = 1,
        present: bool = True,
        body_radius: float = BODY_RADIUS,
    ) -> None:
        """Take the scenario of N + R people; `with_robots` makes it."""
        robot_goals = as_integer("robot_goals", robot_goals)
        if not bodies or robot_goals < 1:
            raise UserError(f"{len(bodies)} robots, robot_goals {robot_goals}: expected at least 1 of each")
        self.inner, self.bodies, self.robots = inner, list(bodies), len(bodies)
        self.fleet, self.robot_goals, self.present = Fleet.of(self.bodies), robot_goals, present
        self.body_radius = body_radius
        # robots wait like the people whose places they take
        for name in "people speed speed_std goals later finished unknown waits pauses gate".split():
            setattr(self, name, getattr(inner, name))
        self.wheels = inner.wheels or any(
            body.drive != "holonomic" or math.isfinite(body.acceleration) for body in bodies
        )
        self.smallest_radius = min(inner.smallest_radius or body_radius, *(body.radius for body in bodies))

    def without_robots(self, prepared: PreparedScenario) -> PreparedScenario:
        """Return the same ``prepared`` scenes, in which the robots are missing."""
        scenes = copy(self)
        scenes.present = False
        return replace(prepared, scenario=scenes)

    @property
    def fastest(self) -> float:
        """The largest preferred speed of any agent, m/s."""
        return max(self.inner.fastest, *(body.top_speed for body in self.bodies))

    @property
    def fastest_agent(self) -> float:
        """The largest top speed of any agent, m/s."""
        return max(self.inner.fastest_agent, *(body.top_speed for body in self.bodies))

    def plans(self) -> list[OccupancyGrid]:
        """See `Scenario.plans`."""
        return self.inner.plans()

    def prepare(self, clearance: float, planner: str = Planner.name) -> PreparedScenario:
        """Return the scenes with the ways of people and robots, ``clearance`` metres from walls."""
        inner = self.inner.prepare(clearance, planner)
        return replace(inner, scenario=self, tables=inner)

    def next_goal(
        self, prepared: PreparedScenario, draws: Draws, agent: Tensor, number: Tensor, last: Tensor
    ) -> Tensor:
        """Return the next goals of agents; robots have as many as they have to reach."""
        goal = self.inner.next_goal(prepared.tables, draws, agent, number, last)
        finished = (agent >= prepared.people - self.robots) & (number >= self.robot_goals)
        return torch.where(finished, -1, goal)

    def layout(self, prepared: PreparedScenario, draws: Draws) -> Layout:
        """Return people as the scenario has them, and robots in the last places."""
        layout, fleet = prepared.tables.layout(draws), self.fleet.to(draws.key.device)
        people, played = prepared.people - self.robots, prepared.script is not None
        start = self._in_time(prepared, layout)
        layout = layout._replace(
            start=start,
            # a scene of fewer people leaves out the last ones, which are robots here
            mask=layout.mask if people == 0 or played else layout.mask.roll(-self.robots, 1),
            top_speed=filled(layout.top_speed, TOP_SPEED_RATIO * layout.pref_speed),
        )
        usual = {"radius": self.body_radius, "kind": 0, "drive": HOLONOMIC, "track": 1}  # of people
        robots = {"mask": True, "kind": ROBOT, "radius": fleet.radius}
        robots |= dict.fromkeys(("pref_speed", "top_speed"), fleet.top_speed)
        if self.wheels:
            wheels = ("drive", "acceleration", "turn_acceleration", "track")
            robots |= {name: getattr(fleet, name) for name in wheels}
        if layout.group is not None and not played:
            robots["group"] = -1
        for name, theirs in robots.items():
            values = getattr(layout, name)
            if values is None:
                like = layout.goal if name in ("kind", "drive") else layout.pref_speed
                values = torch.full_like(like, usual.get(name, math.inf))
            theirs = torch.as_tensor(theirs, device=values.device).to(values).expand(len(values), self.robots)
            layout = layout._replace(**{name: torch.cat((values[:, :people], theirs), 1)})
        if layout.history is not None and not played:  # robots stand in the warm start
            standing = start.unsqueeze(2).expand_as(layout.history)
            layout = layout._replace(history=torch.cat((layout.history[:, :people], standing[:, people:]), 1))
        return layout

    def _in_time(self, prepared: PreparedScenario, layout: Layout) -> Tensor:
        """Return starts (B, A, 2): robots, which stand in the warm start, are in time to meet people."""
        if self.inner.meet is None:
            return layout.start
        planner, people = prepared.planner, prepared.people - self.robots
        # a person walks for the warm start, and then `meet` seconds to where people meet
        pace, own = layout.pref_speed, self.fleet.top_speed.to(layout.pref_speed)
        pace = torch.cat((pace[:, :people], own.expand(len(pace), -1)), 1)
        ahead = layout.pref_speed + (layout.pref_speed - pace) * self.inner.meet / WARM_SECONDS
        pose = identity_pose(len(pace), pace.device) if layout.pose is None else layout.pose
        row, goal = planner.map_rows(layout.map_id), torch.where(layout.mask, layout.goal, -1)
        carrot = planner.guidance(
            layout.start, goal, row, pose, ahead.clamp_min(0.01), WARM_SECONDS, prepared.fastest
        ).carrot
        return torch.cat((layout.start[:, :people], carrot[:, people:].to(layout.start)), 1)


def with_robots(
    scenario: str | Spec, bodies: Sequence[RobotBody], robot_goals: int = 1, **options: Any
) -> RobotScenes:
    """Return the scenes of a scenario, by its name with settings, with robots beside its people.

    ``goals:map=plan.yaml,people=6`` has six people, and the robots. In ``replay:simulated=one`` a robot takes
    the place of one recorded person, and others are played back; with ``simulated=around`` the people's
    policy moves them. ``robot_goals`` and ``options`` are arguments of `RobotScenes`.

    Raises:
        UserError: An unknown name or setting, or a scenario without places for so many robots.
    """
    spec = scenario_spec(scenario)
    cls, robots = SCENARIOS.get(spec.name, Scenario), len(bodies)
    places = cls.place_of_robot
    settings = {key: values[0] for key, values in places.items()} | dict(spec.settings)
    if places:
        if robots > 1 or any(str(settings[key]).lower() not in values for key, values in places.items()):
            given = ", ".join(f"{key}={settings[key]}" for key in places)
            expected = ", ".join(f"{key}={' or '.join(values)}" for key, values in places.items())
            raise UserError(
                f"{spec.name} with {robots} robots, {given}: expected one robot in the place of one person, "
                f"{expected}"
            )
    elif "people" not in setting_types(cls):
        raise UserError(
            f"{spec.name}: robots take the places of people, and this scenario has no setting people: "
            "expected goals, door, hallway, circle or another one that has"
        )
    else:
        home = groups_by_setting(cls).get("people")
        group = setting_groups(cls)[home] if home else None
        people = group.people if group else inspect.signature(cls).parameters["people"].default
        people = settings.get("people", people if isinstance(spec, Spec) else str(people))
        number = load_yaml(people) if isinstance(people, str) else people
        several = number if isinstance(number, list) else [number]  # or the least and the largest
        if all(isinstance(one, int) for one in several):  # of people written one by one the last are robots
            more = [one + robots for one in several]
            more = more if isinstance(number, list) else more[0]
            people = str(more) if isinstance(people, str) else more
        settings["people"] = people
    inner = build(SCENARIOS, spec._replace(settings=settings), Scenario)
    if inner.people < robots:
        raise UserError(
            f"{inner.people} people and {robots} robots: robots take the places of the last people of "
            f"{spec.name}: expected at least as many people"
        )
    return RobotScenes(inner, bodies, robot_goals, **options)
