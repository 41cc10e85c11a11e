"""A person stands at a narrow door for some seconds while others want to go through."""

from dataclasses import replace

import torch

from pedzoo.core.errors import UserError, as_integer
from pedzoo.core.randomness import Draws
from pedzoo.sim.scenario import Layout, PreparedScenario
from pedzoo.sim.scenarios._base import Numbers, Range, Uniform
from pedzoo.sim.scenarios.door import NEAREST, Door, DoorSettings

ROOM = 0.2
"""Metres between the person in the door and its sides, at least."""


class Standing(Door):
    """The rooms of `Door`; the last agent stands in its way, others come to it as in `Door`.

    The standing person is neither moved by the policy nor scored before they set out for a goal of their
    own, behind the wall or before it. Their history shows that they stand. If the door is too narrow to pass
    them, others have to wait.
    """

    def __init__(
        self,
        width: Numbers = (0.8, 0.9, 1.0, 1.2),
        thickness: Numbers = 0.15,
        offset: Numbers = 0.3,
        common: DoorSettings = DoorSettings(),
        at: Range = (-1.0, 1.0),
        seconds: Range = (2.0, 5.0),
    ) -> None:
        """Set the scene.

        Args:
            width: As of `Door`.
            thickness: As of `Door`.
            offset: As of `Door`.
            common: As of `Door`; the standing person is one of the people.
            at: Metres to the right of the middle of the wall where the person stands, 0 in the door and
                negative on the left; ``[least,most]``: drawn. The distance from the door's axis is drawn,
                too, no nearer to its sides than 0.2 m.
            seconds: How long they stand after the warm start; ``[least,most]``: drawn. They set out with the
                next decision.
        """
        if (people := as_integer("people", common.people)) < 2:
            raise UserError(f"standing: people {people}: expected at least 2")
        super().__init__(width, thickness, offset, replace(common, people=people - 1))
        self.people = people
        self.at = Uniform(self.name, "at", at)
        self.seconds = Uniform(self.name, "seconds", seconds, least=0.1)
        self.check(
            max(-self.at.least, self.at.most) <= self.away.least - NEAREST,
            f"at {at}, away {common.away}",
            f"to stand at least {NEAREST:g} m nearer to the wall than others are when the warm start ends",
        )

    def layout(self, prepared: PreparedScenario, draws: Draws) -> Layout:
        """Return the people who come and, as the last, the standing one."""
        coming, (_, goals) = super().layout(prepared, draws), self.drawn(prepared, draws)
        width, seconds = self.variants.value("width", draws), self.seconds.draw(draws, 1)
        beside = (width / 2 - ROOM).clamp_min(0.0) * (2 * draws.uniform("beside") - 1)
        place = torch.stack((self.at.draw(draws, 1)[:, 0], beside), dim=-1)
        pref_speed = torch.cat((coming.pref_speed, self.speeds(draws)[:, -1:]), 1)
        return coming._replace(
            start=torch.cat((coming.start, place.unsqueeze(1)), 1),
            mask=torch.ones_like(pref_speed, dtype=torch.bool),
            pref_speed=pref_speed,
            goal=torch.cat((coming.goal, goals.gather(1, draws.integers("goal", 2, 1))), 1),
            stand=torch.nn.functional.pad(seconds, (self.people - 1, 0)),
        )
