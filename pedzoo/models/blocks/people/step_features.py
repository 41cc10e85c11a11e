"""What decides about a person's next step: the way, the hurry, the style and the walls of a scene batch."""

from typing import NamedTuple, Self

import torch
from tensordict import TensorDict
from torch import Tensor
from torch.nn import functional

from pedzoo.core.batch import agents_of, companions_of, goals_of, is_walking
from pedzoo.core.types import STEP_SECONDS
from pedzoo.models.blocks.map_encoders import Viewpoints, rings
from pedzoo.models.blocks.people.crowd import share_seen
from pedzoo.models.blocks.people.style import kinks_of, style_of, unless_even

WALLS, RAYS = (0.4, 0.9), 8
"""Radii of the rings on which walls are asked for, metres, and points of each."""

FAR_WALL = 1.5
"""Metres: farther walls are all alike."""

MEMORY = ("called", "sets_out", "hindered", "pressing")
"""What a policy remembers of people, zero of those who are seen for the first time."""


class Situation(NamedTuple):
    """What decides about the next step of B scenes of A agents."""

    history: Tensor  # positions (B, A, 8, 2), metres
    mask: Tensor  # which agents are there (B, A) bool
    ahead: Tensor  # unit vectors towards the waypoint (B, A, 2)
    pref_speed: Tensor  # the speeds that they like (B, A), m/s
    remaining: Tensor  # what is left of the path (B, A), metres
    late: Tensor  # by how much they are behind a walk at that speed (B, A), seconds
    called: Tensor  # 1 for people who have just got another goal, or are moved from now on, else 0 (B, A)
    sets_out: Tensor  # 1 for people who have stood until a second ago, for want of a goal, else 0 (B, A)
    hindered: Tensor  # 1 for people who stand since they tried to walk in vain, else 0 (B, A)
    pressing: Tensor  # for how many steps, one after the other, they were asked to walk and stood (B, A)
    stood: Tensor  # in which share of the steps that are seen first they stood (B, A)
    style: Tensor  # their styles (B, A, 6)
    crowd_style: Tensor  # the mean over the agents within reach of each (B, A, 6)
    crowd_change: Tensor  # mean second difference of those who walk (B, A, 1), metres; infinite: none does
    radius: Tensor  # radii of their bodies (B, A), metres
    walls: Tensor  # distances to walls around them (B, A, 17), metres; anything where none are seen
    companions: Tensor  # which agents walk in company (B, A, A) bool, see `companions_of`
    moves: Tensor  # which agents the policy moves on (B, A) bool, see `is_walking`

    @classmethod
    def of(cls, batch: TensorDict, walls: bool = True) -> Self:
        """Return the situation of a scene batch, with walls or without.

        ``first_history``, ``elapsed``, ``progress``, ``called``, ``hindered`` and ``pressing`` are a policy's
        memory, see `pedzoo.policies.memory`. Without them people are seen for the first time.
        """
        agents = agents_of(batch)
        there = agents["mask"]

        def present(values: Tensor) -> Tensor:
            return torch.where(there.view(*there.shape, *[1] * (values.dim() - 2)), values, 0.0)

        goal, wanted = goals_of(batch, "this model")
        history = present(agents["history"])
        here = history[:, :, -1]
        towards, ahead = present(goal - here), present(wanted)
        ahead = functional.normalize(torch.where(ahead.any(-1, keepdim=True), ahead, towards), dim=-1)
        pref_speed = torch.where(there, agents["pref_speed"][..., 0], 1.0).clamp_min(0.1)
        remaining = agents.get("remaining_path", None)
        remaining = towards.norm(dim=-1) if remaining is None else remaining[..., 0]
        first = agents.get("first_history", None)
        first = history if first is None else present(first)
        late = nothing = torch.zeros_like(pref_speed)
        if "elapsed" in agents.keys():
            late = present(agents["elapsed"][..., 0] - agents["progress"][..., 0] / pref_speed)
        style = style_of(first)
        stood = (first.diff(dim=2).square().sum(-1) < (0.1 * STEP_SECONDS) ** 2).to(style.dtype).mean(2)
        known = (there & agents["valid"].all(-1)).unsqueeze(-1)
        crowd, _ = _mean_around(here, style, known)
        walks = known & (stood < 0.5).unsqueeze(-1)
        change, walking = _mean_around(here, kinks_of(style).unsqueeze(-1), walks)
        change = torch.where(walking > 0, change, torch.inf)
        around = _walls(batch, here, ahead) if walls else late.unsqueeze(-1)
        remaining = torch.where(there & remaining.isfinite(), remaining, 0.0)
        memory = (agents[key][..., 0].to(late.dtype) if key in agents.keys() else nothing for key in MEMORY)
        manner = stood, style, crowd, change, agents["radius"][..., 0], around
        moves = is_walking(batch) & there
        now = history, there, ahead, pref_speed, remaining, late
        return cls._make((*now, *memory, *manner, companions_of(batch), moves))

    @property
    def usual_style(self) -> Tensor:
        """Styles (B, A, 6) as far as the first steps show them.

        Seven steps say little of one person: the crowd counts twice.
        """
        return unless_even(torch.lerp(self.style, self.crowd_style, 2 / 3), self.crowd_change)

    def after(self, step: Tensor) -> Self:
        """Return the situation after a step (B, A, 2), metres; walls stay as they were seen."""
        position = self.history[:, :, -1] + step
        done = (step * self.ahead).sum(-1)
        target = self.history[:, :, -1] + self.remaining.clamp_min(0.3).unsqueeze(-1) * self.ahead
        return self._replace(
            history=torch.cat((self.history[:, :, 1:], position.unsqueeze(2)), 2),
            ahead=functional.normalize(target - position, dim=-1),
            remaining=(self.remaining - done).clamp_min(0),
            late=self.late + STEP_SECONDS - done / self.pref_speed,
            **dict.fromkeys(MEMORY, torch.zeros_like(self.late)),
        )


def _mean_around(here: Tensor, values: Tensor, known: Tensor) -> tuple[Tensor, Tensor]:
    """Return means (B, A, C) of what is ``known`` (B, A, 1) bool of agents within reach, and their number."""
    share = share_seen(here.unsqueeze(1) - here.unsqueeze(2)).unsqueeze(-1) * known.unsqueeze(1)
    count = share.sum(2)
    return (share * torch.where(known, values, 0.0).unsqueeze(1)).sum(2) / count.clamp_min(1e-6), count


def _walls(batch: TensorDict, position: Tensor, ahead: Tensor) -> Tensor:
    scenes, people = position.shape[:2]
    scene = torch.arange(scenes, device=position.device).repeat_interleave(people)
    at = Viewpoints.of(batch, scene, position.flatten(0, 1), ahead.flatten(0, 1))
    result = at.distances(rings(WALLS, RAYS).to(position))
    return result.clamp(-FAR_WALL, FAR_WALL).view(scenes, people, -1)
