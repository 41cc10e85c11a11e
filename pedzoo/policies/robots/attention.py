"""A learned robot: attention over the people around it, its way, its body, and a lidar if it has one."""

from __future__ import annotations

from typing import Any, cast

import torch
from tensordict import TensorDictBase
from torch import Tensor, nn
from torch.nn.functional import normalize

from pedzoo.core.bodies import HOLONOMIC, Fleet
from pedzoo.core.errors import UserError
from pedzoo.core.geometry import rotate, unrotate
from pedzoo.policies.robots._base import RobotPolicy, bodies_of

FAR, SOON = 6.0, 4.0
"""Metres and seconds: what is farther away, or later, is all alike."""

TURN_GAIN = 2.5
"""Turning rate of untrained wheels for each radian by which they face away, 1/s; weights rely on it."""

_OWN, _PERSON = 9, 13
"""How many numbers describe a robot and a person."""


class Attention(RobotPolicy):
    """The mean of an action is the one of a robot that goes straight on its way, and what a network adds.

    All numbers are in a frame of the robot: discs that move in any direction look along their way, robots
    on wheels along their heading. So turning the world changes nothing. Untrained it goes straight.

    Attributes:
        sensors: What it needs of `pedzoo.make_robot_env`.
        config: Its arguments.
    """

    def __init__(self, width: int = 64, heads: int = 4, beams: int = 0, reach: float = 5.0) -> None:
        """Create the parameters.

        Args:
            width: Features of a person, and half of those of the hidden layer.
            heads: Of the attention.
            beams: Of the lidar: a multiple of 8; 0 for none.
            reach: Of the lidar, metres.

        Raises:
            UserError: The sizes do not fit each other.
        """
        super().__init__()
        if width < 1 or heads < 1 or width % heads or beams < 0 or beams % 8:
            raise UserError(
                f"attention: width {width}, heads {heads}, beams {beams}: expected a width that is a "
                "multiple of heads, and a multiple of 8 beams"
            )
        self.config = {"width": width, "heads": heads, "beams": beams, "reach": reach}
        self.sensors = ["goal", "odometry", "people"] + [f"lidar:beams={beams},reach={reach}"] * bool(beams)
        self.encoder = Encoder(**self.config)
        self.net = head(self.encoder.features, 2 * width, 2)

    def action(self, scenes: TensorDictBase) -> Tensor:
        """Return the actions (B, R, 2)."""
        bodies = bodies_of(scenes)
        return as_action(self.mean(scenes), frame_of(scenes, bodies), bodies)

    def mean(self, scenes: TensorDictBase) -> Tensor:
        """Return the means (B, R, 2) of decisions as shares of the top speed and of the top turning rate.

        For discs: along their way and to its left. For wheels: ahead, and turning to the left.
        """
        bodies = bodies_of(scenes)
        seen = cast("TensorDictBase", scenes["robots", "observation"])
        needed = {"waypoint", "velocity", "people"} | ({"lidar"} if self.config["beams"] else set())
        if missing := needed - set(seen.keys()):
            raise UserError(
                f"the robot's observation has no {', '.join(sorted(missing))}: attention needs "
                f"sensors={self.sensors}"
            )
        # straight on its way at top speed as if it were alone
        off = torch.atan2(seen["waypoint"][..., 1], seen["waypoint"][..., 0])
        turn = (TURN_GAIN * off / bodies.top_turn).clamp(-1, 1)
        wheels = torch.stack((off.cos().clamp_min(0), turn), dim=-1)
        disc = torch.stack((torch.ones_like(off), torch.zeros_like(off)), dim=-1)
        alone = torch.where((bodies.drive == HOLONOMIC).unsqueeze(-1), disc, wheels)
        return alone + self.net(self.encoder(seen, bodies))


class Encoder(nn.Module):
    """Turns what a robot senses into features, those of all people weighed by attention."""

    def __init__(self, width: int, heads: int, beams: int, reach: float) -> None:
        """Create the parameters; see `Attention`."""
        super().__init__()
        self.beams, self.reach, self.heads = beams, reach, heads
        self.person = nn.Sequential(
            nn.Linear(_OWN + _PERSON, width), nn.ReLU(), nn.Linear(width, width), nn.ReLU()
        )
        self.score = nn.Linear(width, heads)
        self.features = _OWN + width
        if beams:
            self.walls = nn.Sequential(
                nn.Conv1d(1, 8, 5, 2, padding=2, padding_mode="circular"),
                nn.ReLU(),
                nn.Conv1d(8, 16, 3, 2, padding=1, padding_mode="circular"),
                nn.ReLU(),
                nn.Flatten(),
                nn.Linear(4 * beams, width),
                nn.ReLU(),
            )
            self.features += width

    def forward(self, seen: TensorDictBase, bodies: Fleet) -> Tensor:
        """Return the features (B, R, F)."""
        frame = _frame(seen["waypoint"], bodies)
        velocity = unrotate(seen["velocity"], frame)
        way = normalize(unrotate(seen["waypoint"], frame), dim=-1)
        top = bodies.top_speed.unsqueeze(-1)
        turn = seen["turn_rate"] / bodies.top_turn.unsqueeze(-1)
        left = seen["remaining_path"].clamp(0, FAR) / FAR
        near = seen["remaining_path"].clamp(0, 1)
        own = torch.cat((velocity, way, left, near, top, seen["radius"], turn), dim=-1)
        parts = [own, self._people(seen, own, velocity, way * top, frame)]
        if self.beams:
            parts.append(self._lidar(seen["lidar"], frame))
        return torch.cat(parts, dim=-1)

    def _people(
        self, seen: TensorDictBase, own: Tensor, velocity: Tensor, along: Tensor, frame: Tensor
    ) -> Tensor:
        """Return the weighed features (B, R, W) of people; 0 without any."""
        people, mask = cast("Tensor", seen["people"]), cast("Tensor", seen["people_mask"])
        axis = frame.unsqueeze(-2).expand(*mask.shape, 2)
        place, move = unrotate(people[..., :2], axis), unrotate(people[..., 2:4], axis)
        bodies = people[..., 4:] + seen["radius"].unsqueeze(-2)
        distance = torch.linalg.vector_norm(place, dim=-1, keepdim=True)
        gap = (distance - bodies).clamp_max(FAR)
        touch = (-2 * gap.clamp_min(0)).exp()
        message = [place / FAR, place / distance.clamp_min(1e-6), move, gap / FAR, touch, bodies]
        for own_way in (velocity, along):  # when they are nearest if all go on, and how far apart then
            passing = move - own_way.unsqueeze(-2)
            when = -(place * passing).sum(-1, keepdim=True)
            when = (when / passing.square().sum(-1, keepdim=True).clamp_min(1e-6)).clamp(0, SOON)
            apart = torch.linalg.vector_norm(place + passing * when, dim=-1, keepdim=True) - bodies
            message += [when / SOON, apart.clamp(-1, 2)]
        rows = torch.cat((*message, own.unsqueeze(-2).expand(*mask.shape, _OWN)), dim=-1)
        feature = self.person(rows * mask.unsqueeze(-1))
        # one more to attend to, of weight 1 and without features: then no people is no special case
        weight = self.score(feature).clamp(-10, 10).exp() * mask.unsqueeze(-1)
        weight = weight / (1 + weight.sum(-2, keepdim=True))
        return (feature.unflatten(-1, (self.heads, -1)) * weight.unsqueeze(-1)).sum(-3).flatten(-2)

    def _lidar(self, lidar: Tensor, frame: Tensor) -> Tensor:
        """Return features (B, R, W) of walls and bodies all around."""
        turn = torch.atan2(frame[..., 1], frame[..., 0]) / (2 * torch.pi) * self.beams
        beam = torch.arange(self.beams, device=lidar.device) + turn.round().long().unsqueeze(-1)
        turned = lidar.gather(-1, beam % self.beams) / self.reach
        return self.walls(turned.flatten(0, -2).unsqueeze(1)).unflatten(0, lidar.shape[:-1])


def head(features: int, hidden: int, out: int) -> nn.Sequential:
    """Return the layers behind an encoder; at first they say 0."""
    last = nn.Linear(hidden, out)
    nn.init.zeros_(last.weight)
    nn.init.zeros_(last.bias)
    return nn.Sequential(nn.Linear(features, hidden), nn.ReLU(), nn.Linear(hidden, hidden), nn.ReLU(), last)


def as_action(decision: Tensor, frame: Tensor, bodies: Fleet) -> Tensor:
    """Return actions (B, R, 2) of decisions (B, R, 2), see `Attention.mean`, in the frames of `frame_of`."""
    disc = rotate(decision * bodies.top_speed.unsqueeze(-1), frame)
    speed = (decision[..., 0] * bodies.top_speed).maximum(bodies.slowest).minimum(bodies.top_speed)
    turn = (decision[..., 1] * bodies.top_turn).maximum(-bodies.top_turn).minimum(bodies.top_turn)
    return torch.where((bodies.drive == HOLONOMIC).unsqueeze(-1), disc, bodies.from_speed(speed, turn))


def as_decision(action: Tensor, frame: Tensor, bodies: Fleet) -> Tensor:
    """Return the decisions (B, R, 2) of actions (B, R, 2): the inverse of `as_action`."""
    disc = unrotate(action, frame) / bodies.top_speed.unsqueeze(-1)
    speed, turn = bodies.speed_of(action)
    wheels = torch.stack((speed / bodies.top_speed, turn / bodies.top_turn), dim=-1)
    return torch.where((bodies.drive == HOLONOMIC).unsqueeze(-1), disc, wheels)


def frame_of(scenes: TensorDictBase, bodies: Fleet) -> Tensor:
    """Return where the x axes of decisions point (B, R, 2), in the robots' own frames."""
    return _frame(cast("Any", scenes["robots", "observation", "waypoint"]), bodies)


def _frame(waypoint: Tensor, bodies: Fleet) -> Tensor:
    ahead = torch.zeros_like(waypoint)
    ahead[..., 0] = 1.0
    along = torch.where(waypoint.norm(dim=-1, keepdim=True) > 1e-6, normalize(waypoint, dim=-1), ahead)
    return torch.where((bodies.drive == HOLONOMIC).unsqueeze(-1), along, ahead)
