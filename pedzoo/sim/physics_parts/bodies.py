"""Where bodies are: what every question to a physics backend begins with."""

from __future__ import annotations

from typing import NamedTuple

from torch import Tensor

from pedzoo.sim.physics_parts.stance import Stance
from pedzoo.sim.state import State


class Bodies(NamedTuple):
    """Where people are in B scenes.

    Attributes:
        position: Scene positions (B, A, 2), metres, of the people who are present by ``mask`` (B, A) bool.
        map_id: Floor plan of each scene (B, 1) long, -1 for none.
        pose: How each scene lies on its floor plan (B, 4).
        radius: Of the bodies (B, A), metres; None for that of the backend.
        stance: How agents stand, for pictures; None where it is not known.
    """

    position: Tensor
    mask: Tensor
    map_id: Tensor
    pose: Tensor
    radius: Tensor | None = None
    stance: Stance | None = None

    @classmethod
    def of(cls, state: State) -> Bodies:
        """Return those of a state."""
        return cls(state.position, state.mask, state.map_id.unsqueeze(1), state.pose, state.radius)

    def scene(self, number: int) -> Bodies:
        """Return those of one scene."""
        own = [None if value is None else value[[number]] for value in self[:5]]
        stance = self.stance and self.stance.scene(number)
        return Bodies(*own, stance)  # type: ignore[arg-type]  # None only where it may be
