"""Learned people around a Husky that drives by its wheels, in a pybullet scene of one's own.

pip install '.[bullet]'; python examples/husky_pybullet.py
"""

from __future__ import annotations

import math

import numpy as np
import pybullet
import pybullet_data

import pedzoo

DT, HZ = 0.1, 240
"""Seconds between two calls of the controller; steps of pybullet in a second."""

WHEELS, SPEED = (2, 3, 4, 5), 0.6 / 0.165
"""Joints of the Husky's wheels, whose radius is 0.165 m; rad/s for 0.6 m/s."""


def main(seconds: float = 12.0) -> float:
    """Drive the Husky towards three people, and return how near one came to its body, metres."""
    client = pybullet.connect(pybullet.DIRECT)  # pybullet.GUI shows it
    pybullet.setAdditionalSearchPath(pybullet_data.getDataPath())
    pybullet.setGravity(0, 0, -9.81)
    pybullet.loadURDF("plane.urdf")
    husky = pybullet.loadURDF("husky/husky.urdf", [-5, 0, 0.13])
    shape = pybullet.createVisualShape(pybullet.GEOM_CAPSULE, radius=0.15, length=1.4)
    people = {one: np.array([5.0, side]) for one, side in enumerate((-1.0, 0.0, 1.0))}
    goals = {one: (-6.0, -place[1]) for one, place in people.items()}
    bodies = {one: pybullet.createMultiBody(0, -1, shape, [*xy, 0.85]) for one, xy in people.items()}
    controller = pedzoo.controller("approach_net_goal_map.indoor", dt=DT)

    nearest = math.inf
    for _ in range(round(seconds / DT)):
        place, turn = pybullet.getBasePositionAndOrientation(husky)
        yaw = pybullet.getEulerFromQuaternion(turn)[2]
        ahead = np.array([math.cos(yaw), math.sin(yaw)])
        discs = [np.array(place[:2]) + along * ahead for along in (-0.3, 0.0, 0.3)]  # 0.99 m x 0.67 m
        velocity = controller.step(people, goals, others={"husky": discs}, radius={"husky": 0.39})
        for one, body in bodies.items():
            people[one] = people[one] + DT * velocity[one]
            pybullet.resetBasePositionAndOrientation(body, [*people[one], 0.85], [0, 0, 0, 1])
            nearest = min(nearest, *(float(np.linalg.norm(people[one] - disc)) - 0.54 for disc in discs))
        for wheel in WHEELS:
            pybullet.setJointMotorControl2(
                husky, wheel, pybullet.VELOCITY_CONTROL, targetVelocity=0.6 / 0.165
            )
        for _ in range(round(DT * HZ)):
            pybullet.stepSimulation()
    pybullet.disconnect(client)
    print(f"the Husky drove {place[0] + 5:.1f} m; the nearest person kept {nearest:.2f} m away")
    return nearest


if __name__ == "__main__":
    main()
