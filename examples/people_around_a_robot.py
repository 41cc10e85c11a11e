"""Learned people around a robot of your own simulator, which here is two lines of Python.

pip install .; python examples/people_around_a_robot.py
"""

from __future__ import annotations

import numpy as np

import pedzoo

DT = 0.1
"""Seconds between two steps of the simulator."""


def main(seconds: float = 12.0) -> float:
    """Drive a robot along the hall of an apartment, and return how near a person came to its edge, metres."""
    controller = pedzoo.controller("approach_net_goal_map.indoor", "apartment.25", dt=DT)
    people = {"anna": np.array([1.0, 5.6]), "ben": np.array([7.5, 5.6]), "eve": np.array([3.0, 8.0])}
    goals = {"anna": (11.5, 3.0), "ben": (0.9, 5.2), "eve": (1.0, 2.0)}
    robot, speed, radius, nearest = np.array([6.5, 5.3]), np.array([-0.5, 0.0]), 0.3, np.inf
    for tick in range(round(seconds / DT)):
        velocity = controller.step(people, goals, others={"robot": robot}, radius={"robot": radius})
        people = {name: place + DT * velocity[name] for name, place in people.items()}
        robot = robot + DT * speed * (robot[0] > 2.0)
        nearest = min(nearest, *(float(np.linalg.norm(place - robot)) - radius for place in people.values()))
        if tick % 20 == 0:
            places = ", ".join(f"{name} ({x:.1f}, {y:.1f})" for name, (x, y) in people.items())
            print(f"{tick * DT:4.1f} s: robot ({robot[0]:.1f}, {robot[1]:.1f}), {places}")
    print(f"the nearest centre of a person was {nearest:.2f} m from the edge of the robot")
    return nearest


if __name__ == "__main__":
    main()
