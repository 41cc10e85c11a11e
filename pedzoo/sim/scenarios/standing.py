"""A person stands at a narrow door for some seconds while others want to go through."""

from __future__ import annotations

from typing import ClassVar

import torch
from torch import Tensor

from pedzoo.core.errors import UserError, as_integer
from pedzoo.core.randomness import Draws
from pedzoo.sim.scenario_parts.ranges import Drawn, Range
from pedzoo.sim.scenario_parts.scenario import Layout, PreparedScenario
from pedzoo.sim.scenario_parts.variants import Numbers
from pedzoo.sim.scenarios.door import BEFORE, NEAREST, Door

ROOM = 0.2
"""Metres between the person in the door and its sides, at least."""


class Standing(Door):
    """The rooms of `Door`; the last agent stands in its way, others come to it as in `Door`.

    The standing person is neither moved by the policy nor scored before they set out for a goal of their
    own, behind the wall or before it. Their history shows that they stand. If the door is too narrow to pass
    them, others have to wait.
    """

    name: ClassVar[str] = "standing"

    def __init__(
        self,
        width: Numbers = (0.8, 0.9, 1.0, 1.2),
        thickness: Numbers = 0.15,
        offset: Numbers = 0.3,
        jitter: float = 0.1,
        people: int = 2,
        speed: float = 1.3,
        speed_std: float = 0.2,
        speed_ratio: float = 1.0,
        resolution: float = 0.05,
        away: Range = BEFORE,
        sync: float | None = None,
        from_right: int | None = None,
        abreast: int = 1,
        at: Range = (-1.0, 1.0),
        seconds: Range = (2.0, 5.0),
    ) -> None:
        """Set the scene.

        Args:
            width: Of the door, metres; a list: one per scene.
            thickness: Of the wall, metres; a list: one per scene.
            offset: Lateral distance of others' starts and of goals from the door's axis, metres; a list: one
                per scene.
            jitter: Standard deviation of the starts about it, metres.
            people: The standing person, and at least one who comes.
            speed: Mean preferred speed, m/s.
            speed_std: Its standard deviation.
            speed_ratio: Speed of those from the right, divided by that of those from the left.
            resolution: Of the floor plan, metres per cell.
            away: Metres from the middle of the wall at which the first of a side are when the warm start
                ends; ``[least,most]``: each side draws one.
            sync: As of `Door`: by how much the two sides come to the door one after the other, seconds.
            from_right: How many of the others come from the right; None: every other one.
            abreast: How many of a side walk together, 1 to 3.
            at: Metres to the right of the middle of the wall where the person stands, 0 in the door and
                negative on the left; ``[least,most]``: drawn. The distance from the door's axis is drawn,
                too, no nearer to its sides than 0.2 m.
            seconds: How long they stand after the warm start; ``[least,most]``: drawn. They set out with the
                next decision.

        Raises:
            UserError: A setting that gives no scene.
        """
        if (people := as_integer("people", people)) < 2:
            raise UserError(f"standing: people {people}: expected at least 2")
        super().__init__(
            *(width, thickness, offset, jitter, people - 1, speed, speed_std, speed_ratio, resolution),
            *(away, sync, from_right, abreast),
        )
        self.people = people
        self.at = Drawn(self.name, "at", at)
        self.seconds = Drawn(self.name, "seconds", seconds, least=0.1)
        if max(-self.at.least, self.at.most) > self.away.least - NEAREST:
            raise UserError(
                f"standing: at {at}, away {away}: expected to stand at least {NEAREST:g} m nearer to the "
                "wall than others are when the warm start ends"
            )

    def layout(self, prepared: PreparedScenario, draws: Draws) -> Layout:
        """Return the people who come and, as the last, the standing one."""
        coming = super().layout(prepared, draws)
        width = self.variants.of("width", draws)
        beside = (width / 2 - ROOM).clamp_min(0.0) * (2 * draws.uniform("beside") - 1)
        place = torch.stack((self.at.of(draws, 1)[:, 0], beside), dim=-1)
        goals = prepared.tables[1].to(width.device)[self.variants.drawn(draws)]
        goal = goals.gather(1, draws.integers("goal", 2, 1))
        speed = self.speeds(draws)[:, -1:]
        return coming._replace(
            start=torch.cat((coming.start, place.unsqueeze(1)), dim=1),
            mask=torch.ones(len(width), self.people, dtype=torch.bool, device=width.device),
            pref_speed=torch.cat((coming.pref_speed, speed), dim=1),
            goal=torch.cat((coming.goal, goal), dim=1),
            stand=self._stand(draws),
        )

    def _stand(self, draws: Draws) -> Tensor:
        """Return how long people stand (B, A), seconds."""
        seconds = self.seconds.of(draws, 1)
        return torch.cat((seconds.new_zeros(len(seconds), self.people - 1), seconds), dim=1)
