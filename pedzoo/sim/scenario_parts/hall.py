"""Scenes in halls whose places and exits are all known ahead."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Sequence
from dataclasses import replace

import torch

from pedzoo.core.errors import UserError
from pedzoo.maps.grid import OccupancyGrid
from pedzoo.maps.plans import Point, Rectangle, rectangles
from pedzoo.sim.scenario_parts.encounter import CELL
from pedzoo.sim.scenario_parts.scenario import PreparedScenario, Scenario


class Hall(Scenario):
    """People on a few floor plans with the same places; subclasses say which, and how people begin."""

    @abstractmethod
    def walls(self) -> Sequence[list[Rectangle]]:
        """Return the walls of every floor plan, whose edges are between cells of 0.05 m."""

    @abstractmethod
    def places(self) -> list[Point]:
        """Return all goals, metres."""

    @property
    def name(self) -> str:
        """The scenario's name in messages and floor plans."""
        return type(self).__module__.rpartition(".")[2]

    def check(self, right: bool, given: str, expected: str) -> None:
        """Raise the error of settings ``given`` that are not as ``expected``."""
        if not right:
            raise UserError(f"{self.name}: {given}: expected {expected}")

    def plans(self) -> list[OccupancyGrid]:
        """Return the floor plans."""
        plans = enumerate(self.walls())
        return [rectangles(walls, CELL, name=f"{self.name}.{number}") for number, walls in plans]

    def prepare(self, clearance: float) -> PreparedScenario:
        """Find the ways to all places; tables: the floor plans (V,) and their goals (V, G)."""
        prepared = super().prepare(clearance)
        map_id = torch.tensor([grid.map_id for grid in prepared.bank.grids])
        points = torch.tensor(self.places(), dtype=torch.float64)
        goals = [prepared.planner.add_goals(row, points) for row in range(len(map_id))]
        return replace(prepared, tables=(map_id, torch.stack(goals)))
