"""Inputs and outputs of a robot's local planner. B robots, N people around each (padded)."""

from collections.abc import Callable
from typing import NamedTuple, Protocol, cast

from torch import Tensor

from pedzoo.core.errors import UserError
from pedzoo.core.registry import ROBOT_POLICIES
from pedzoo.core.spec import make, parse


class Robot(NamedTuple):
    """One robot in each scene.

    Attributes:
        position: Centre (B, 2), metres.
        velocity: Current velocity (B, 2), m/s.
        goal: Where it shall go (B, 2), metres.
        radius: Of its disc (B,), metres.
        v_pref: The speed it likes, which is its top speed (B,), m/s.
    """

    position: Tensor
    velocity: Tensor
    goal: Tensor
    radius: Tensor
    v_pref: Tensor


class DriveState(NamedTuple):
    """How B differential drives move.

    Attributes:
        heading: Where they face (B,), radians from the x axis.
        speed: Forwards (B,), m/s.
        turn_rate: To the left (B,), rad/s.
    """

    heading: Tensor
    speed: Tensor
    turn_rate: Tensor


class ObservedPeople(NamedTuple):
    """The people that the robot knows of.

    Attributes:
        position: Centres (B, N, 2), metres; any numbers where there is no person.
        velocity: Velocities (B, N, 2), m/s; likewise.
        radius: Of their discs (B, N), metres; likewise.
        mask: Which of them are there (B, N) bool.
    """

    position: Tensor
    velocity: Tensor
    radius: Tensor
    mask: Tensor


Clearance = Callable[[Tensor], Tensor]
"""Distances (B, M) of points (B, M, 2) from the nearest walls, metres."""


class LocalPlanner(Protocol):
    """Anything that gives robots velocities; one object serves the same B scenes from their start.

    A class takes its settings as arguments, and ``time_step`` if it wants it: the seconds for which its
    velocities are held. A policy with memory starts with an empty one. Scenes that have ended stay in the
    batch, and their velocities are ignored.

    One that avoids walls takes them as a third argument, ``walls: Clearance | None``. One for wheels has a
    method ``command`` beside, see `pedzoo.policies.robots.dwa.Dwa.command`.
    """

    def __call__(self, robot: Robot, people: ObservedPeople) -> Tensor:
        """Return the next velocities (B, 2), m/s; longer ones than ``v_pref`` are shortened to it."""
        ...


def load_local_planner(name: str, time_step: float) -> LocalPlanner:
    """Return a new local planner of a robot that decides every ``time_step`` seconds.

    The name may have settings, ``crowdnav_orca:safety_space=0.15``, or be ``path/to/file.py:Class``.

    Raises:
        UserError: Unknown name, setting or file, or a class whose objects cannot be called.
    """
    spec = parse(name)
    policy = make(ROBOT_POLICIES.get(spec.name), ROBOT_POLICIES.kind, spec, time_step=time_step)
    if not callable(policy):
        raise UserError(f"{name!r}: expected a class with __call__(robot, people) -> velocities (B, 2)")
    return cast("LocalPlanner", policy)
