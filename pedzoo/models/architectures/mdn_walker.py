"""A walker whose manners are learned: a mixture density network of the next change of velocity.

Every 0.4 s each person either holds the velocity exactly, or changes it by a draw of a mixture of Gaussians
(Bishop, "Mixture density networks", 1994) in the frame of the way. The mixture depends on what a person sees:
the last steps, the way and its end, the speed that they like, the nearest others, the flow and density of the
crowd, their company, and the walls. No rule says how people behave.
"""

import math
from dataclasses import dataclass
from typing import ClassVar, NamedTuple, Self

import torch
from tensordict import TensorDict
from torch import Tensor, nn
from torch.nn import functional

from pedzoo.core.batch import ROBOT, agents_of, companions_of, goals_of
from pedzoo.core.geometry import rotate, unrotate
from pedzoo.core.types import OBS_LEN, STEP_SECONDS, GoalProtocol
from pedzoo.models.base import Forecaster, Random, Walking, known_displacements, true_displacements
from pedzoo.models.blocks.held_mixture import HELD, Change
from pedzoo.models.blocks.map_encoders import Viewpoints, rings
from pedzoo.models.blocks.mlp import mlp
from pedzoo.models.blocks.people.style import STYLE_DIM, style_of
from pedzoo.models.blocks.timed_noise import drawn_walks

WALL_RINGS, WALL_RAYS, FAR_WALL = (0.4, 1.0, 2.0), 12, 2.5
"""Metres at which distances to walls are read, points of each ring, and from where on walls are far."""

SIGHT = 10.0
"""Metres within which others are seen."""

FLOW = 2.0
"""Metres: others count for density and flow by exp(-(distance / FLOW)^2)."""

FINEST, WIDEST = 0.006, 1.5
"""m/s: bounds of the mixture's standard deviations."""


@dataclass(frozen=True)
class Architecture:
    """The network, and what it sees.

    Attributes:
        width: Of both hidden layers.
        near_dim: Width of a neighbour's features.
        neighbours: Nearest others that are seen one by one.
        components: Gaussians of the mixture.
        dropout: Share of hidden numbers left out in training.
        flow: Whether it sees density and flow.
        style: Whether it sees how people walked when they were first seen.
        walls: Whether it sees walls.
        held: Whether velocities can be held exactly.
        temperature: Of the mixture when it walks: 1 as it was learned, below 1 nearer to its peaks.
    """

    width: int = 192
    near_dim: int = 48
    neighbours: int = 12
    components: int = 12
    dropout: float = 0.1
    flow: bool = True
    style: bool = True
    walls: bool = True
    held: bool = True
    temperature: float = 0.7


class View(NamedTuple):
    """What decides about the next step of B scenes of A agents."""

    history: Tensor  # positions (B, A, 8, 2), metres
    style: Tensor  # how they walked when they were first seen (B, A, 6), see `shown_style`
    mask: Tensor  # which agents are there (B, A) bool
    ahead: Tensor  # unit vectors of the ways (B, A, 2)
    goal: Tensor  # short-term goals (B, A, 2), metres
    pref_speed: Tensor  # the speeds that they like (B, A), m/s
    remaining: Tensor  # what is left of the path (B, A), metres
    since: Tensor  # seconds since the goal was given (B, A); infinite for long ago
    radius: Tensor  # of bodies (B, A), metres
    robot: Tensor  # which agents are robots (B, A), 0 or 1
    companions: Tensor  # which agents walk in company (B, A, A) bool
    walls: Tensor  # distances to walls (B, A, W), metres

    @classmethod
    def of(cls, batch: TensorDict, walls: bool) -> Self:
        """Return the view of a scene batch; without ``walls`` W is 1."""
        agents = agents_of(batch)
        mask = agents["mask"]
        there = mask.unsqueeze(-1)
        goal, wanted = (torch.where(there, value, 0.0) for value in goals_of(batch, "this model"))
        history = torch.where(there.unsqueeze(-1), agents["history"], 0.0)
        here, heading = history[:, :, -1], agents["heading"]
        faces = torch.cat((heading.cos(), heading.sin()), -1)
        towards = torch.where(wanted.any(-1, keepdim=True), wanted, goal - here)
        towards = torch.where(towards.any(-1, keepdim=True), towards, faces)
        ahead = functional.normalize(torch.where(there, towards, 0.0), dim=-1)
        pref_speed = torch.where(mask, agents["pref_speed"][..., 0], 1.0).clamp_min(0.1)
        left = agents.get("remaining_path", None)
        left = (goal - here).norm(dim=-1) if left is None else left[..., 0]
        left = torch.where(mask & left.isfinite(), left, 0.0)
        given = agents.get("goal_since", None)
        since = torch.full_like(left, torch.inf) if given is None else batch["time"] - given[..., 0]
        around = _walls(batch, here, ahead) if walls else torch.full_like(left, FAR_WALL).unsqueeze(-1)
        radius, robot = agents["radius"][..., 0], (agents["kind"] == ROBOT).to(left.dtype)
        first = agents.get("first_history", None)
        style = shown_style(history if first is None else torch.where(there.unsqueeze(-1), first, 0.0))
        return cls(
            history,
            style,
            mask,
            ahead,
            goal,
            pref_speed,
            left,
            since,
            radius,
            robot,
            companions_of(batch),
            around,
        )

    def after(self, step: Tensor) -> Self:
        """Return the view after a step (B, A, 2), metres; walls stay as they were seen."""
        place = self.history[:, :, -1] + step
        done = (step * self.ahead).sum(-1)
        target = self.history[:, :, -1] + self.remaining.clamp_min(0.3).unsqueeze(-1) * self.ahead
        return self._replace(
            history=torch.cat((self.history[:, :, 1:], place.unsqueeze(2)), 2),
            ahead=functional.normalize(target - place, dim=-1),
            remaining=(self.remaining - done).clamp_min(0),
            since=self.since + STEP_SECONDS,
        )

    @property
    def velocity(self) -> Tensor:
        """The mean velocity of the last step (B, A, 2), m/s, in the frame of the way."""
        last = self.history[:, :, -1] - self.history[:, :, -2]
        return unrotate(last, self.ahead) / STEP_SECONDS


def shown_style(first: Tensor) -> Tensor:
    """Return the styles (..., 6) of first places (..., T, 2), metres; NaN where these show none.

    Those of a perfectly even walk may be made up: a host knows where people are, not where they were.
    """
    shows = (first.diff(dim=-2).diff(dim=-2).norm(dim=-1) >= HELD * STEP_SECONDS).any(-1, keepdim=True)
    return style_of(first).where(shows, torch.nan)


def _walls(batch: TensorDict, here: Tensor, ahead: Tensor) -> Tensor:
    scenes, people = here.shape[:2]
    scene = torch.arange(scenes, device=here.device).repeat_interleave(people)
    at = Viewpoints.of(batch, scene, here.flatten(0, 1), ahead.flatten(0, 1))
    result = at.distances(rings(WALL_RINGS, WALL_RAYS).to(here))
    return result.clamp(-FAR_WALL, FAR_WALL).view(scenes, people, -1)


class Features(NamedTuple):
    """The numbers that the network sees of N people."""

    own: Tensor  # of the person, the way, the crowd and the walls (N, D); NaN for what is not known
    near: Tensor  # of the nearest others (N, k, 14)
    absent: Tensor  # where there are fewer than k (N, k) bool


NEAR, FLOW_DIM, OWN = 14, 7, 15
"""Numbers of a neighbour, of the crowd's density and flow, and of a person's own state."""


def features(now: View, neighbours: int) -> Features:
    """Return the features (B, A, ...) of all agents."""
    frame, people = now.ahead.unsqueeze(2), now.mask.shape[1]
    past = unrotate(now.history.diff(dim=2), frame) / STEP_SECONDS
    change = past.diff(dim=2)
    size = change.norm(dim=-1)
    kept, usual = (size < HELD).to(size.dtype), (size + HELD).log() / 3
    speed = past[:, :, -1].norm(dim=-1)
    here, velocity = now.history[:, :, -1], now.history[:, :, -1] - now.history[:, :, -2]
    velocity = velocity / STEP_SECONDS
    away, moves = here.unsqueeze(1) - here.unsqueeze(2), velocity.unsqueeze(1) - velocity.unsqueeze(2)
    itself = torch.eye(people, dtype=torch.bool, device=here.device)
    gone = ~now.mask.unsqueeze(1) | itself
    apart = away.norm(dim=-1).masked_fill(gone, torch.inf)

    weight = (-(apart / FLOW).square()).exp()
    flow = unrotate(velocity.unsqueeze(1).expand_as(away), frame)
    along, across = flow.unbind(-1)
    with_me, against = (weight * (sign * along).clamp_min(0) for sign in (1, -1))
    amount = weight.sum(2)
    share = weight / amount.clamp_min(0.1).unsqueeze(2)
    away, moves = unrotate(away, frame), unrotate(moves, frame)
    side = away[..., 1].clamp(-1, 1)
    crowd = torch.stack(
        (
            amount.log1p(),
            with_me.sum(2).log1p(),
            against.sum(2).log1p(),
            (share * along).sum(2),
            (share * across).sum(2),
            (with_me * side).sum(2) / amount.clamp_min(0.1),
            (against * side).sum(2) / amount.clamp_min(0.1),
        ),
        -1,
    )
    shown = now.style.isfinite()
    known = (~gone & shown[..., 0].unsqueeze(1)).to(away.dtype)
    others = known @ now.style.where(shown, 0.0) / known.sum(2, keepdim=True)  # NaN where none is shown
    mate = now.companions.to(away.dtype) * (apart < SIGHT)
    company = mate.sum(2, keepdim=True)
    mates = mate.unsqueeze(3) / company.clamp_min(1).unsqueeze(3)
    place, pace = (mates * away).sum(2), (mates * moves).sum(2)
    goal = unrotate(now.goal - here, now.ahead)
    goal = goal / goal.norm(dim=-1, keepdim=True).clamp_min(4)  # the carrot is some 4 m ahead
    state = (
        now.pref_speed,
        speed,
        speed / now.pref_speed,
        (-now.remaining / 1.5).exp(),
        (now.remaining / 10).clamp_max(1),
        (-now.since.clamp_min(0) / 1.5).exp(),
        now.radius,
        company[..., 0].clamp_max(3),
        place.norm(dim=-1),
    )
    own = torch.cat(
        (
            past.flatten(2),
            5 * change.flatten(2),
            kept,
            usual,
            torch.stack(state, -1),
            goal,
            place,
            pace,
            crowd,
            now.style,
            others,
            now.walls,
        ),
        -1,
    )

    distance, other = apart.topk(min(neighbours, people), 2, largest=False)
    index = other.unsqueeze(-1)
    place, moving = (v.gather(2, index.expand(-1, -1, -1, 2)) for v in (away, moves))
    absent = distance > SIGHT
    distance = distance.masked_fill(absent, SIGHT)
    scene = torch.arange(len(other), device=other.device).view(-1, 1, 1)
    bodies = now.radius[scene, other] + now.radius.unsqueeze(2)
    closing = -(place * moving).sum(-1) / moving.square().sum(-1).clamp_min(0.01)
    soon = closing.clamp(0, 5)
    closest = place + moving * soon.unsqueeze(-1)
    gap = (distance - bodies).clamp_min(-0.2)
    miss = (closest.norm(dim=-1) - bodies).clamp_min(-0.2)
    with_mate = now.companions.gather(2, other).to(place.dtype)
    close = 1 / (gap + 0.6), (-gap / 1.5).exp(), (-soon / 2).exp(), (-miss / 0.5).exp()
    numbers = *close, with_mate, now.robot[scene, other]
    vectors = (place / distance.clamp_min(0.05).unsqueeze(-1), place / 4, moving / 1.5, closest / 2)
    near = torch.cat((*vectors, torch.stack(numbers, -1)), -1).masked_fill(absent.unsqueeze(-1), 0.0)
    if people < neighbours:
        near = functional.pad(near, (0, 0, 0, neighbours - people))
        absent = functional.pad(absent, (0, neighbours - people), value=True)
    return Features(own, near, absent)


class Reader(nn.Module):
    """Reads features of people into hidden numbers (..., width): the body of a walker or a critic."""

    def __init__(self, a: Architecture) -> None:
        """Create the parameters."""
        super().__init__()
        steps, walls = OBS_LEN - 1, (1 + len(WALL_RINGS) * WALL_RAYS) if a.walls else 1
        own = 2 * steps + 4 * (steps - 1) + OWN + FLOW_DIM + 2 * STYLE_DIM + walls
        self.near = mlp(NEAR, a.near_dim, a.near_dim)
        self.query = nn.Linear(own, a.near_dim)
        layers: list[nn.Module] = []
        for wide in (own + 3 * a.near_dim, a.width):
            layers += [nn.Linear(wide, a.width), nn.GELU(), nn.Dropout(a.dropout)]
        self.body = nn.Sequential(*layers)
        self.register_buffer("centre", torch.zeros(own))
        self.register_buffer("spread", torch.ones(own))
        self.style = slice(own - walls - 2 * STYLE_DIM, own - walls)
        """Which of a person's own numbers are styles."""
        flow = slice(self.style.start - FLOW_DIM, self.style.start)
        self.unseen = [part for part, used in ((flow, a.flow), (self.style, a.style)) if not used]

    def forward(self, seen: Features) -> Tensor:
        """Return the hidden numbers."""
        centre, spread = self.get_buffer("centre"), self.get_buffer("spread")
        own = ((seen.own - centre) / spread).clamp(-5, 5).nan_to_num(0.0)
        for part in self.unseen:
            own[..., part] = 0.0
        keys, absent = self.near(seen.near), seen.absent.unsqueeze(-1)
        score = (keys * self.query(own).unsqueeze(-2)).sum(-1, keepdim=True) / keys.shape[-1] ** 0.5
        weight = score.masked_fill(absent, -1e9).softmax(-2).masked_fill(absent, 0.0)
        keys = keys.masked_fill(absent, 0.0)
        pooled = (weight * keys).sum(-2), keys.sum(-2), keys.relu().amax(-2)
        return self.body(torch.cat((own, *pooled), -1))


class MdnWalker(Forecaster):
    """One step at a time, drawn for each person."""

    needs = frozenset({"goal", "map"})
    mode_at_zero: ClassVar[bool] = False
    noise_periods = (STEP_SECONDS,) * 4
    noise_dim = 4
    goal_protocol: GoalProtocol = "destination"
    remembers: ClassVar[bool] = True
    keeps_distance = True

    def __init__(
        self, architecture: Architecture = Architecture(), walking: Walking = Walking(safety=True)
    ) -> None:
        """Create the parameters; the classes of the arguments explain the settings."""
        super().__init__()
        self.built_with(architecture, walking)
        self.architecture = a = architecture
        self.needs = frozenset({"goal", "map"} if a.walls else {"goal"})
        self.reader = Reader(a)
        self.head = nn.Linear(a.width, 1 + 6 * a.components)
        with torch.no_grad():  # untrained it nearly holds; the Gaussians are of many sizes
            self.head.weight.mul_(0.1)
            self.head.bias.zero_()
            self.head.bias[1:].view(a.components, 6)[:, 3:5] = torch.linspace(
                math.log(0.01), math.log(0.4), a.components
            ).unsqueeze(1)

    def change(self, seen: Features) -> Change:
        """Return the distribution of the next change of velocity of people (...,)."""
        out = self.head(self.reader(seen))
        hold, rest = out[..., 0], out[..., 1:].unflatten(-1, (self.architecture.components, 6))
        if not self.architecture.held:
            hold = torch.full_like(hold, -30.0)
        scale = rest[..., 3:5].clamp(math.log(FINEST), math.log(WIDEST)).exp()
        return Change(hold, rest[..., 0], rest[..., 1:3], scale, 0.95 * rest[..., 5].tanh())

    def view(self, batch: TensorDict) -> View:
        """Return what people see in a scene batch."""
        return View.of(batch, self.architecture.walls)

    def features(self, now: View) -> Features:
        """Return the features (B, A, ...) of all agents."""
        return features(now, self.architecture.neighbours)

    def step(self, now: View, noise: Tensor | None) -> Tensor:
        """Return the next steps (B, A, 2), metres, for noise (B, A, 4): the mean ones without."""
        change = self.change(self.features(now)).tempered(self.architecture.temperature)
        drawn = change.average if noise is None else change.at(noise)
        step = rotate(now.velocity + drawn, now.ahead) * STEP_SECONDS
        return torch.where(now.mask.unsqueeze(-1), step, 0.0)

    def next_steps(self, batch: TensorDict, noise: Tensor | None, steps: int, horizon: int) -> Tensor:
        """Return the first steps of one future (B, A, steps, 2)."""
        now, path = self.view(batch), []
        for number in range(steps):
            path.append(self.step(now, noise))
            now = now.after(path[-1]) if number + 1 < steps else now
        return torch.stack(path, 2)

    def mode(self, batch: TensorDict, steps: int) -> Tensor:
        """Return the mean walk (B, 1, A, T, 2)."""
        return self.next_steps(batch, None, steps, steps).unsqueeze(1)

    def sample(self, batch: TensorDict, samples: int, steps: int, generator: Random = None) -> Tensor:
        """Return random futures (B, K, A, T, 2): each sample is one in which all people walk together."""
        now = self.view(batch)
        return drawn_walks(now, self.step, self.noise_periods, samples, steps, generator)

    def log_likelihood(self, batch: TensorDict, generator: Random = None) -> Tensor:
        """Return the log likelihood of the true steps (B, A), nats, all of a person added.

        Others are where they really were.
        """
        now = self.view(batch)
        total = torch.zeros_like(now.pref_speed)
        true, known = true_displacements(batch), known_displacements(batch)
        true = torch.where(known.unsqueeze(-1), true, 0.0)
        for step, seen in zip(true.unbind(2), known.unbind(2), strict=True):
            change = unrotate(step, now.ahead) / STEP_SECONDS - now.velocity
            nats = self.change(self.features(now)).log_prob(change, change.norm(dim=-1) < HELD)
            # of the step, metres, as other forecasters' densities
            nats = torch.where(change.norm(dim=-1) < HELD, nats, nats - 2 * math.log(STEP_SECONDS))
            total = total + torch.where(seen, nats, 0.0)
            now = now.after(step)
        return total

    def loss(self, batch: TensorDict, generator: Random = None) -> Tensor:
        """Return minus the log likelihood, summed over people."""
        return -torch.where(agents_of(batch)["mask"], self.log_likelihood(batch, generator), 0.0).sum()
