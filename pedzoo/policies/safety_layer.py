"""A net under a learned policy: the least change of all next steps that keeps bodies from touching.

In the spirit of Dalal et al., "Safe exploration in continuous action spaces", 2018: what the network answers
is projected on what can be walked without a contact. The layer looks one step ahead and no farther.

Only robots, which leave all of the avoidance to people, are seen from afar. Of the steps that their course
leaves room for, the one nearest to what is asked for is taken. Velocities are sampled, and each is judged by
how far it is from that, and by when it leads to a contact: van den Berg, Lin and Manocha, "Reciprocal
velocity obstacles for real-time multi-agent navigation" (ICRA 2008), section V. Here obstacles leave all of
the avoidance to people.
"""

import math
from typing import Any, cast

import torch
from tensordict import TensorDictBase
from torch import Tensor

from pedzoo.core import randomness
from pedzoo.core.batch import ROBOT, agents_of, ids_of, is_person_sized, maps_of
from pedzoo.core.machine import compiles
from pedzoo.core.types import STEP_SECONDS
from pedzoo.maps.walls import LocalWalls
from pedzoo.policies.clearance import MARGIN, SHOULDERS, ProposedSteps, kept_clear_in_torch

HORIZON = 4.0  # seconds within which a contact with a robot counts
ROOM = 0.1  # metres that are kept beyond a contact with a robot: between two decisions velocities blend
WEIGHT = 3.0  # metres: a contact after t seconds costs WEIGHT / t in m/s, less the same at the horizon
DIRECTIONS, SPEEDS, PLACES = 24, 4, 8  # that are sampled, and places on the way where walls are asked for
_SOONEST = 0.1  # seconds: a contact is not sooner than this
_LEAST_VIEW = 0.8  # seconds within which a contact with a wall counts at least


def yielding(steps: ProposedSteps, walls: LocalWalls | None) -> Tensor:
    """Return steps (B, A, 2): those that are asked for, and others where they lead into a robot's course.

    Robots, and bodies of another radius than people's, count if the policy at hand does not move them. They
    are expected to go on as they do. Among people of the usual body nothing changes. The gradient is that of
    what is asked for.
    """
    avoided = steps.present & ~steps.moved & (steps.robot | ~is_person_sized(steps.radius))
    if avoided.device.type == "cpu" and not bool(avoided.any()):
        return steps.step
    return steps.step + _change(steps, avoided, walls)


@torch.no_grad()
def _change(steps: ProposedSteps, avoided: Tensor, walls: LocalWalls | None) -> Tensor:
    """Return what turns steps (B, A, 2) off the course of the ``avoided`` (B, A) bool."""
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
        return torch.zeros_like(steps.step)
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
    return steps.step.index_put((scene, agent), chosen) - steps.step


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
    """Return after how many seconds (...) a pair that moves straight is nearer than ``room``; inf: never."""
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


# Metres within the observed steps, 2.8 s, below which a person waits. Two who wait for each other in a narrow
# place turn a shoulder, too, and one of them makes way: otherwise they wait for ever.
WAITED = 0.4


def kept_clear(steps: ProposedSteps, walls: LocalWalls | None = None, shoulders: float = SHOULDERS) -> Tensor:
    """Return steps (B, A, 2), metres, near those that are asked for, without contacts of bodies or walls.

    Two people share a correction, by who goes first: see `precedence`. Agents that the policy does not move
    take no part in it, and robots leave it to people: the other one makes all of it. Agents that touch
    already part, or come no closer. Two who meet exactly head-on keep to the right. Differentiable.

    Walls are those of `MapBank.walls_around`; ``shoulders`` is the room in narrow places, metres: 0 for
    bodies alone.
    """
    numbers = [part for part in steps if part is not None and part.is_floating_point()]
    # top speeds and radii have gradients in torch only
    constants = torch.is_grad_enabled() and (steps.longest.requires_grad or steps.radius.requires_grad)
    if constants or not compiles(*numbers):
        return kept_clear_in_torch(steps, walls, shoulders)
    return _KeptClear.apply(steps.position, steps.step, steps.velocity, steps, walls, shoulders)


class _KeptClear(torch.autograd.Function):
    """Records the corrections of steps if gradients are asked for, and goes back over them."""

    @staticmethod
    def forward(ctx: Any, *given: Any) -> Tensor:
        from pedzoo.policies.clearance_loops import kept  # numba takes a second

        out = torch.empty_like(given[1], memory_format=torch.contiguous_format)
        steps, walls, shoulders = given[3:]
        ctx.stored = kept(steps, walls, shoulders, out, any(ctx.needs_input_grad))
        return out

    @staticmethod
    def backward(ctx: Any, *gradients: Any) -> tuple[Tensor | None, ...]:
        from pedzoo.policies.clearance_loops import slopes_of

        return *slopes_of(ctx.stored, gradients[0]), None, None, None


def safe(batch: TensorDictBase, step: Tensor, shoulders: float = SHOULDERS) -> Tensor:
    """Return the next steps of all agents (B, A, 2), metres, kept clear; see `kept_clear`."""
    agents, bank = agents_of(batch), maps_of(batch)
    moved = agents["mask"] & agents["controlled"]
    there = agents["mask"].unsqueeze(-1)
    history, velocity = cast("Tensor", agents["history"]), cast("Tensor", agents["velocity"])
    here = history[:, :, -1]
    waits, rank = (history - here.unsqueeze(2)).norm(dim=-1).amax(2) < WAITED, ids_of(batch).to(here)
    if waits.device.type != "cpu" or bool(waits.any()):  # else ids do for exact ties
        keys = batch.get("scene_key", None)  # 0 where nothing names the scenes
        keys = torch.zeros_like(batch["map_id"]) if keys is None else keys
        rank = randomness.uniform(randomness.join(keys, "rank", ids_of(batch)))
    steps = ProposedSteps(
        torch.where(there, here, 0.0),
        torch.where(moved.unsqueeze(-1), step, velocity * STEP_SECONDS).where(there, 0.0),
        STEP_SECONDS * cast("Tensor", agents["top_speed"])[..., 0],
        agents["mask"],
        moved,
        waits,
        cast("Tensor", agents["radius"])[..., 0],
        agents["kind"] == ROBOT,
        torch.where(there, velocity, 0.0),
        rank,
    )
    walls = bank.walls_around(batch["map_id"][:, 0], batch["scene_pose"]) if bank.grids else None
    return kept_clear(steps._replace(step=yielding(steps, walls)), walls, shoulders)
