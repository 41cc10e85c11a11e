"""RVO2 (through pyrvo) for whole batches of scenes, as the oracle for pedzoo's ORCA."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch
from numpy.typing import NDArray
from pyrvo.pyrvo import RVOSimulator
from torch import Tensor

from pedzoo.maps.segments import edges
from pedzoo.policies.rule_based.orca import OrcaSettings

UNLIMITED = 10_000


class Rvo2:
    """One RVO2 simulator per scene, asked for one step from given states.

    Attributes:
        edges: Segments (S, 18) of the walls, as of `pedzoo.maps.segments.edges`, after RVO2 has split them.
    """

    def __init__(
        self,
        scenes: int,
        agents: int,
        top_speed: float,
        settings: OrcaSettings,
        polygons: Sequence[NDArray[np.float64]] = (),
    ) -> None:
        """Set up the simulators with the same walls in all of them, polygons (V, 2)."""
        most = UNLIMITED if settings.max_neighbors is None else settings.max_neighbors
        values = (settings.dt, settings.neighbor_dist, most, settings.time_horizon)
        self.time_step = settings.dt
        self.simulators = []
        for _ in range(scenes):
            one = RVOSimulator(*values, settings.time_horizon_obst, settings.radius, top_speed)
            for _ in range(agents):
                one.add_agent((0.0, 0.0))
            for polygon in polygons:
                one.add_obstacle([(float(x), float(y)) for x, y in polygon])
            one.process_obstacles()
            self.simulators.append(one)
        self.edges = _edges(self.simulators[0])

    def prepare(self, position: Tensor, velocity: Tensor, preferred: Tensor) -> None:
        """Put every person where they are, all (B, A, 2)."""
        for one, places, velocities in zip(
            self.simulators, position.tolist(), velocity.tolist(), strict=True
        ):
            for agent, (place, current) in enumerate(zip(places, velocities, strict=True)):
                one.set_agent_position(agent, place)
                one.set_agent_velocity(agent, current)
        self.wish(preferred)

    def wish(self, preferred: Tensor) -> None:
        """Tell the velocities (B, A, 2) that every person would like."""
        for one, wishes in zip(self.simulators, preferred.tolist(), strict=True):
            for agent, wish in enumerate(wishes):
                one.set_agent_pref_velocity(agent, wish)

    def step(self) -> None:
        """Let every person choose a velocity and walk."""
        for one in self.simulators:
            one.do_step()

    def velocity(self) -> Tensor:
        """Return the velocities (B, A, 2) that were chosen."""
        return torch.tensor(
            [
                [(v.x, v.y) for v in map(one.get_agent_velocity, range(one.get_num_agents()))]
                for one in self.simulators
            ]
        )


def _edges(simulator: RVOSimulator) -> NDArray[np.float64]:
    """Return RVO2's own segments: it splits some at the lines of others while it builds its search tree."""
    count = range(simulator.get_num_obstacle_vertices())
    corners = [simulator.get_obstacle_vertex(i) for i in count]
    start = np.array([(corner.x, corner.y) for corner in corners]).reshape(-1, 2)
    following = np.array([simulator.get_next_obstacle_vertex(i) for i in count], dtype=int)
    previous = np.array([simulator.get_prev_obstacle_vertex(i) for i in count], dtype=int)
    # where it splits an edge, RVO2 counts the new corner as convex
    return edges(start, -1e-4, following, previous)
