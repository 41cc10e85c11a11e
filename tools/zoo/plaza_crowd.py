"""Who is on the plaza of the embedded dataset: parties, ways and the people, one row each."""

from dataclasses import dataclass, field

import numpy as np


@dataclass
class Party:
    """People who walk together, and how long they stand where they stop."""

    wait: float
    abreast: np.ndarray  # unit vector along which they stand side by side
    leave_at: float = -1.0


@dataclass
class Way:
    """The points that one person still has to walk through."""

    points: list[np.ndarray]
    stop: int  # index of the point where they stand a while; -1: none ahead


@dataclass
class Crowd:
    """The people now on the plaza, one row each."""

    agent: np.ndarray = field(default_factory=lambda: np.zeros(0, int))
    party: np.ndarray = field(default_factory=lambda: np.zeros(0, int))
    slot: np.ndarray = field(
        default_factory=lambda: np.zeros(0)
    )  # place to the right of the party's middle, m
    speed: np.ndarray = field(default_factory=lambda: np.zeros(0))
    here: np.ndarray = field(default_factory=lambda: np.zeros((0, 2)))
    velocity: np.ndarray = field(default_factory=lambda: np.zeros((0, 2)))
    course: np.ndarray = field(default_factory=lambda: np.zeros((0, 2)))  # the heading, turned to smoothly
    seen: np.ndarray = field(default_factory=lambda: np.zeros(0, bool))  # they have entered the picture
    wobble: np.ndarray = field(default_factory=lambda: np.zeros((0, 4)))  # side, speed, and what drives them

    def keep(self, rows: np.ndarray) -> None:
        """Drops all other people."""
        for name, value in vars(self).items():
            setattr(self, name, value[rows])

    def add(self, **row: object) -> None:
        """Lets one person in."""
        for name, value in row.items():
            setattr(self, name, np.concatenate([getattr(self, name), np.array([value])]))
