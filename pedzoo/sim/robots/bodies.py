"""The table of robots' bodies: every public class here is a robot by its name; `RobotBody` has the units."""

from dataclasses import dataclass

from pedzoo.core.bodies import RobotBody


@dataclass(frozen=True)
class Disc(RobotBody):
    """A disc that moves in any direction at once, as in CrowdNav: 0.3 m, 1 m/s."""


@dataclass(frozen=True)
class Unicycle(RobotBody):
    """A disc that drives along its heading and turns: speed and turning rate are commanded."""

    drive = "unicycle"


@dataclass(frozen=True)
class DiffDrive(RobotBody):
    """A disc on two wheels, whose speeds are commanded."""

    drive = "diff_drive"
    acceleration: float = 1.0
    turn_acceleration: float = 4.0


@dataclass(frozen=True)
class Freight(DiffDrive):
    """Fetch Robotics Freight: a round base for warehouses."""

    source = (
        "fetch_bringup and freight_bringup (Fetch Robotics): 1 m/s, 0.75 m/s^2, track 0.37476 m; 559 mm wide"
    )
    radius: float = 0.28
    top_turn: float = 4.5
    acceleration: float = 0.75
    turn_acceleration: float = 3.0
    track: float = 0.3748


@dataclass(frozen=True)
class Husky(DiffDrive):
    """Clearpath Husky: 0.99 m long, 0.67 m wide."""

    source = (
        "Clearpath's data sheet (1 m/s, 990 x 670 mm) and husky_control/config/control.yaml (accelerations)"
    )
    radius: float = 0.598
    acceleration: float = 3.0
    turn_acceleration: float = 6.0
    track: float = 0.5708


@dataclass(frozen=True)
class Jackal(DiffDrive):
    """Clearpath Jackal: fast, four wheels that slip."""

    source = (
        "jackal_control/config/control.yaml (Clearpath): speeds, accelerations; 508 x 430 mm, 376 mm track"
    )
    radius: float = 0.333
    top_speed: float = 2.0
    top_turn: float = 4.0
    acceleration: float = 20.0
    turn_acceleration: float = 25.0
    track: float = 0.376


@dataclass(frozen=True)
class Turtlebot3(DiffDrive):
    """TurtleBot 3 Burger: slow and small."""

    source = (
        "ROBOTIS e-manual (0.22 m/s, 2.84 rad/s, 138 x 178 mm); accelerations as in Nav2's parameters for it"
    )
    radius: float = 0.113
    top_speed: float = 0.22
    top_turn: float = 2.84
    acceleration: float = 2.5
    turn_acceleration: float = 3.2
    track: float = 0.16


@dataclass(frozen=True)
class Turtlebot4(DiffDrive):
    """TurtleBot 4 on a Create 3 base."""

    source = (
        "iRobot Create 3 documentation: 0.46 m/s, 1.9 rad/s, wheels 0.9 m/s^2 and 0.233 m apart, 342 mm wide"
    )
    radius: float = 0.171
    top_speed: float = 0.46
    top_turn: float = 1.9
    acceleration: float = 0.9
    turn_acceleration: float = 7.725
    track: float = 0.233
