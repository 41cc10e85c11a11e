"""Which parts the social walker has."""

from dataclasses import dataclass


@dataclass(frozen=True)
class WalkerArchitecture:
    """The network's architecture, and which of its parts are used.

    Attributes:
        hidden_dim: Width of the two hidden layers; 0 for none: then all that is learned is a linear function
            of a person's own state, some hundred numbers, which few recordings suffice for.
        near_dim: Width of a neighbour's features.
        walls: Whether it sees the floor plan.
        style: Whether it sees how people walked in their first steps.
        held: Whether velocities can be held.
        halts: Whether people halt now and then, beside what slows them down.
        step_noise: Whether changes of velocity are drawn at every step.
        companions: Whether it sees companions.
        lasting_halts: Whether halts last for some seconds, and begin by braking; else each is one step.
        groups: Whether companions are those of ``agents/group``; else they are guessed from how people walk.
        style_prior: Whether velocities are held as often, and places jitter as much, as in people's first
            steps before training; else people differ in that only as far as the network has learned.
        avoids: Whether people evade others on a collision course before training, too, and set out again
            where somebody stopped them. If they see walls, they turn faster near them.
        follows: Whether people keep a gap to those in front, and change their velocity faster the farther it
            is off what they want.
    """

    hidden_dim: int = 64
    near_dim: int = 32
    walls: bool = True
    style: bool = True
    held: bool = True
    halts: bool = True
    step_noise: bool = True
    companions: bool = True
    lasting_halts: bool = False
    groups: bool = False
    style_prior: bool = False
    avoids: bool = False
    follows: bool = False
