"""A look ahead: of the steps that a robot's course leaves room for, the one nearest to what is asked for.

Velocities are sampled. Each is judged by how far it is from what is asked for, and by when it leads to a
contact. See van den Berg, Lin and Manocha, "Reciprocal velocity obstacles for real-time multi-agent
navigation" (ICRA 2008), section V. Here obstacles leave all of the avoidance to people.
"""

import math

import torch
from torch import Tensor

from pedzoo.core.batch import is_person_sized
from pedzoo.core.types import STEP_SECONDS
from pedzoo.maps.walls.local_walls import LocalWalls
from pedzoo.policies.safety_layer.clearance import MARGIN, ProposedSteps

HORIZON = 4.0
"""Seconds within which a contact with a robot counts."""

ROOM = 0.1
"""Metres that are kept beyond a contact with a robot: between two decisions velocities blend."""

WEIGHT = 3.0
"""Metres: a contact after t seconds costs WEIGHT / t in m/s, less the same at the horizon."""

DIRECTIONS, SPEEDS, PLACES = 24, 4, 8
"""Sampled directions, speeds, and places on the way at which walls are asked for."""

_SOONEST = 0.1
"""Seconds: a contact is not sooner than this."""

_LEAST_VIEW = 0.8
"""Seconds within which a contact with a wall counts at least."""


def yielding(steps: ProposedSteps, walls: LocalWalls | None) -> Tensor:
    """Return steps (B, A, 2): those that are asked for, and others where they lead into a robot's course.

    Robots, and bodies of another radius than people's, count if the policy at hand does not move them. They
    are expected to go on as they do. Among people of the usual body nothing changes. The gradient is that of
    what is asked for.
    """
    avoided = steps.present & ~steps.moved & (steps.robot | ~is_person_sized(steps.radius))
    if avoided.device.type == "cpu" and not bool(avoided.any()):
        return steps.step
    with torch.no_grad():
        chosen = _chosen(steps, avoided, walls)
    return steps.step + (chosen - steps.step).detach()


def _chosen(steps: ProposedSteps, avoided: Tensor, walls: LocalWalls | None) -> Tensor:
    away = steps.position.unsqueeze(2) - steps.position.unsqueeze(1)
    velocity = steps.step / STEP_SECONDS
    apart = away.norm(dim=-1)
    least = steps.radius.unsqueeze(2) + steps.radius.unsqueeze(1)
    room = (apart - MARGIN).minimum(least + ROOM).maximum(least + MARGIN)
    others = avoided.unsqueeze(1)
    move = (velocity.unsqueeze(2) - velocity.unsqueeze(1)).unsqueeze(3)
    soon = _contact(away.unsqueeze(3), move, room.unsqueeze(3))[..., 0] < HORIZON
    threatened = (soon & others).any(2) & steps.moved
    # on the CPU few agents are looked at, elsewhere all of them: nothing is read back from there
    scenes, agents = (torch.arange(size, device=threatened.device) for size in threatened.shape)
    which = threatened.flatten().nonzero()[:, 0] if threatened.device.type == "cpu" else slice(None)
    scene = scenes.repeat_interleave(len(agents))[which]
    agent = agents.repeat(len(scenes))[which]
    if not len(scene):
        return steps.step
    asked = velocity[scene, agent]
    samples = _samples(asked, away[scene, agent], steps.longest[scene, agent] / STEP_SECONDS)
    move = samples.unsqueeze(1) - velocity[scene].unsqueeze(2)
    times = _contact(away[scene, agent].unsqueeze(2), move, room[scene, agent].unsqueeze(2))
    times = torch.where(avoided[scene].unsqueeze(2), times, torch.inf).amin(1)
    cost = (samples - asked.unsqueeze(1)).norm(dim=-1) + _cost(times)
    if walls is not None:
        # the way has to be free of walls until the robot is passed
        passed = -(away[scene, agent].unsqueeze(2) * move).sum(-1) / move.square().sum(-1).clamp_min(1e-9)
        passed = torch.where((soon & others)[scene, agent].unsqueeze(2), passed, 0.0).amax(1)
        seen = walls.select(scene)
        place, radius = steps.position[scene, agent], steps.radius[scene, agent]
        cost = cost + _cost(_wall_contact(seen, place, samples, radius, passed.clamp(_LEAST_VIEW, HORIZON)))
    best = samples[torch.arange(len(scene), device=scene.device), cost.argmin(1)]
    chosen = torch.where(threatened[scene, agent].unsqueeze(1), best * STEP_SECONDS, steps.step[scene, agent])
    return steps.step.index_put((scene, agent), chosen)


def _samples(asked: Tensor, away: Tensor, fastest: Tensor) -> Tensor:
    """Return velocities (N, V, 2), m/s: the one asked for, none, and others all around it."""
    # an agent that stands turns away from the others as a whole: its samples turn with the scene
    ahead = torch.where(asked.norm(dim=-1, keepdim=True) > 1e-3, asked, away.sum(1))
    ahead = torch.nn.functional.normalize(ahead, dim=-1)
    angle = torch.arange(DIRECTIONS, device=asked.device) * (2 * math.pi / DIRECTIONS)
    aside = torch.stack((-ahead[:, 1], ahead[:, 0]), -1)
    around = angle.cos().view(-1, 1) * ahead.unsqueeze(1) + angle.sin().view(-1, 1) * aside.unsqueeze(1)
    speed = torch.arange(1, SPEEDS + 1, device=asked.device) / SPEEDS * fastest.unsqueeze(1)
    rest = (around.unsqueeze(2) * speed.view(-1, 1, SPEEDS, 1)).flatten(1, 2)
    return torch.cat((asked.unsqueeze(1), torch.zeros_like(asked).unsqueeze(1), rest), dim=1)


def _contact(away: Tensor, move: Tensor, room: Tensor) -> Tensor:
    """Return after how many seconds (...) a pair that moves straight is nearer than ``room``; inf: never.

    Relative places (..., 2), metres, and velocities (..., 2), m/s.
    """
    closing = -(away * move).sum(-1)
    speed2 = move.square().sum(-1).clamp_min(1e-9)
    beyond = away.square().sum(-1) - room.square()
    root = closing.square() - speed2 * beyond
    time = ((closing - root.clamp_min(0).sqrt()) / speed2).clamp_min(0)
    return torch.where((closing > 0) & (root > 0), time, torch.inf)


def _wall_contact(walls: LocalWalls, place: Tensor, velocity: Tensor, radius: Tensor, view: Tensor) -> Tensor:
    """Return after how many seconds (N, V) people at (N, 2) run into a wall; inf: not in ``view`` (N, V)."""
    when = view.unsqueeze(2) * torch.arange(1, PLACES + 1, device=place.device) / PLACES
    points = place.view(-1, 1, 1, 2) + velocity.unsqueeze(2) * when.unsqueeze(3)
    gap, _ = walls.closest(torch.cat((place.unsqueeze(1), points.flatten(1, 2)), 1))
    least = gap[:, :1].minimum(radius.unsqueeze(1) + MARGIN) - 1e-3
    hit = gap[:, 1:].view(points.shape[:-1]) < least.unsqueeze(2)
    return torch.where(hit, when, torch.inf).amin(2)


def _cost(time: Tensor) -> Tensor:
    return WEIGHT * (1 / time.clamp_min(_SOONEST) - 1 / HORIZON).clamp_min(0)
