"""A ROS 2 node that moves HuNav's people by any policy of pedzoo: it serves ``compute_agents``.

python people_node.py --ros-args -p policy:=approach_net_goal_map.indoor -p map:=/path/to/map.yaml
"""

from __future__ import annotations

import math
from collections import deque
from copy import deepcopy
from typing import Any

import numpy as np

import pedzoo

ARRIVED, MOVES = 0.3, 0.05
"""Metres at which a controller lets people stand; speed from which on people turn, m/s."""


class HunavPeople:
    """Answers HuNav's requests; it needs no ROS: messages are any objects with their fields."""

    def __init__(self, policy: str, map: str | None = None, dt: float = 0.1) -> None:
        """Take a policy of `pedzoo.load`, a floor plan, and about how many seconds lie between requests."""
        self.policy, self.map, self.dt = pedzoo.load(policy), map, dt
        self.forget()

    def forget(self) -> None:
        """Begin anew with the next request."""
        self.controller: Any = None
        self.goals: dict[int, deque[tuple[float, float]]] = {}
        self.now = 0.0

    def compute(self, agents: Any, robot: Any) -> Any:
        """Return ``hunav_msgs/Agents`` moved by the time since the request before; the first one stays.

        As HuNav's own node does: goals are those of the first message, one after the other, in a circle
        if ``cyclic_goals`` says so, and each counts from ``goal_radius`` + 0.1 m on.
        """
        stamp = agents.header.stamp.sec + 1e-9 * agents.header.stamp.nanosec
        if self.controller is not None and stamp < self.now:
            self.forget()  # the simulator began anew
        updated, first = deepcopy(agents), self.controller is None
        if self.controller is None:
            speeds = {agent.id: agent.desired_velocity or 1.3 for agent in agents.agents}
            self.controller = pedzoo.controller(self.policy, self.map, dt=self.dt, pref_speed=speeds)
        elif stamp == self.now:
            return updated
        people = {agent.id: _xy(agent.position.position) for agent in agents.agents}
        goals = {agent.id: self._goal(agent) for agent in agents.agents}
        velocity = self.controller.step(
            people,
            goals,
            {agent.id: _xy(agent.velocity.linear) for agent in agents.agents},
            others={"robot": _xy(robot.position.position)},
            radius={agent.id: agent.radius for agent in agents.agents if agent.radius > 0}
            | ({"robot": robot.radius} if robot.radius > 0 else {}),
            time=stamp,
        )
        seconds, self.now = (0.0 if first else stamp - self.now), stamp
        for agent in updated.agents:
            _move(agent, velocity[agent.id], seconds)
        return updated

    def _goal(self, agent: Any) -> tuple[float, float] | None:
        left = self.goals.setdefault(agent.id, deque(_xy(goal.position) for goal in agent.goals))
        here = _xy(agent.position.position)
        if left and math.dist(left[0], here) <= max(agent.goal_radius + 0.1, ARRIVED):
            reached = left.popleft()
            if agent.cyclic_goals:
                left.append(reached)
        return left[0] if left else None


def _xy(point: Any) -> tuple[float, float]:
    return float(point.x), float(point.y)


def _move(agent: Any, velocity: np.ndarray, seconds: float) -> None:
    """Let a message say where a person is after so many seconds."""
    vx, vy = map(float, velocity)
    speed = math.hypot(vx, vy)
    yaw = math.atan2(vy, vx) if speed > MOVES else agent.yaw
    turned = math.remainder(yaw - agent.yaw, math.tau)
    agent.angular_vel = turned / seconds if seconds else 0.0
    agent.position.position.x += vx * seconds
    agent.position.position.y += vy * seconds
    turn = agent.position.orientation
    turn.x, turn.y, turn.z, turn.w = 0.0, 0.0, math.sin(yaw / 2), math.cos(yaw / 2)
    agent.yaw, agent.linear_vel = yaw, speed
    agent.velocity.linear.x, agent.velocity.linear.y = vx, vy
    agent.velocity.angular.z = agent.angular_vel


def main() -> None:
    """Serve ``compute_agents`` and ``reset_agents`` until ROS stops."""
    import rclpy  # type: ignore[import-not-found]
    from hunav_msgs.srv import ComputeAgents, ResetAgents  # type: ignore[import-not-found]

    rclpy.init()
    node = rclpy.create_node("pedzoo_people")
    usual = {"policy": "approach_net_goal_map.indoor", "map": "", "dt": 0.1}
    given = {name: node.declare_parameter(name, value).value for name, value in usual.items()}
    people = HunavPeople(given["policy"], given["map"] or None, given["dt"])

    def compute(request: Any, response: Any) -> Any:
        response.updated_agents = people.compute(request.current_agents, request.robot)
        return response

    def reset(request: Any, response: Any) -> Any:
        people.forget()
        response.ok = True
        return response

    node.create_service(ComputeAgents, "compute_agents", compute)
    node.create_service(ResetAgents, "reset_agents", reset)
    rclpy.spin(node)


if __name__ == "__main__":
    main()
