"""A controller that is stochastic at every step: velocities are held for a while and then changed.

SGAN+goal+map draws a person's noise once, so its people walk in smooth lines that no recorded person walks
in. Here every step is drawn: a gate decides whether the velocity is held, and a change of velocity is drawn
if it is not. How far and how often depends on the style of a person's first steps, on the neighbours, the
companions, the walls and on how late the person is. It is trained on whole walks in the loop.
"""

import math
from dataclasses import dataclass
from typing import ClassVar

import torch
from tensordict import TensorDict
from torch import Tensor, nn
from torch.nn import functional

from pedzoo.core.geometry import rotate, smooth_norm, unrotate
from pedzoo.core.types import OBS_LEN, STEP_SECONDS, GoalProtocol
from pedzoo.models.base import Forecaster, Random, Walking, known_displacements, true_displacements
from pedzoo.models.blocks.mlp import mlp
from pedzoo.models.blocks.people.evasion import evasion
from pedzoo.models.blocks.people.following import held_back
from pedzoo.models.blocks.people.narrow import confinement, narrowness
from pedzoo.models.blocks.people.nearest import FEATURES, nearest
from pedzoo.models.blocks.people.setting_out import AT_ONCE, setting_out
from pedzoo.models.blocks.people.step_features import RAYS, WALLS, Situation
from pedzoo.models.blocks.people.style import STYLE_DIM, held_of, jitter_of, kink_of_change, kinks_of
from pedzoo.models.blocks.timed_noise import drawn_walks

LASTING, SMOOTH, EVERY_STEP, JITTER = 3, (24.0, 8.0, 4.0, 2.0), 4, 2
"""Noise: numbers that last, periods of those that change smoothly (s), and numbers drawn at every step."""

OWN, OUTPUTS, AVOIDING = 6, 17, 2
"""Numbers of a person's own state, those that steer a person, and more that steer how others are avoided."""

ASTRAY, LOOKING_UP = 0.3, 3.0
"""Velocities farther off what people want than a share of their speed open the gate by so much more.

People who follow others change them faster, too.
"""

GATE_NOISE, USUAL_GATE, RARE_HALT = 1.7, 2.0, 4.0
"""Spread of the chance by which velocities are held, in units of the gate. Before training they change in 9
of 10 steps, but for what first steps show; and by another gate 1 % of the steps of people who walk is a halt.
"""

HALT_PERIOD = LASTING + SMOOTH.index(8.0)
"""Number of the noise that begins and ends lasting halts: before training one lasts for some 5 s."""

CARE, LOOKS_UP, WALKS_ON = 0.8, 4.0, 4.0
"""Between walls: the share of drawn changes that people do without, and what opens the gates of changes and
of going on. In a doorway people go where they want, and do not stop by themselves.
"""

CALM = 0.95
"""Of drawn changes: before training they are a third of those seen; ways and neighbours make the rest."""

BRAKING = 0.35  # m/s: how much slower people who halt get in a step


@dataclass(frozen=True)
class Architecture:
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


class SocialWalker(Forecaster):
    """One step at a time, in the frame of each person's way."""

    needs = frozenset({"goal"})
    remembers: ClassVar[bool] = True
    mode_at_zero: ClassVar[bool] = True
    noise_periods = (math.inf,) * LASTING + SMOOTH + (STEP_SECONDS,) * EVERY_STEP + (-STEP_SECONDS,) * JITTER
    noise_dim = len(noise_periods)
    goal_protocol: GoalProtocol = "destination"

    def __init__(
        self, architecture: Architecture = Architecture(), walking: Walking = Walking(safety=True)
    ) -> None:
        """Create the parameters; the classes of the arguments explain the settings."""
        super().__init__()
        self.built_with(architecture, walking)
        self.architecture = a = architecture
        self.keeps_distance = a.follows
        self.sees_walls = a.walls and (a.hidden_dim > 0 or a.avoids)
        self.needs = frozenset({"goal", "map"} if self.sees_walls else {"goal"})
        if a.hidden_dim:
            self.near = mlp(FEATURES, a.near_dim, a.near_dim)
            seen = 2 * (OBS_LEN - 1) + OWN + 2 * STYLE_DIM + self.noise_dim + 2 * a.near_dim + 5
            self.body = mlp(seen + (1 + RAYS * len(WALLS)) * a.walls, a.hidden_dim, a.hidden_dim)
        self.head = nn.Linear(a.hidden_dim or OWN, OUTPUTS + AVOIDING * a.avoids)
        self.patience = nn.Parameter(torch.tensor([1.1, 1.5, 0.3]))  # usual, of those who stood, by chance
        with torch.no_grad():  # the untrained network walks to the waypoint
            self.head.weight.mul_(0.2 if a.hidden_dim else 0.0)
            self.head.bias.zero_()

    def velocities(self, now: Situation, noise: Tensor) -> tuple[Tensor, Tensor]:
        """Return velocities until the next decision (B, A, 2), m/s, and wished ones, for noise (B, A, Z)."""
        a, z = self.architecture, noise
        frame = now.ahead.unsqueeze(2)
        past = unrotate(now.history.diff(dim=2), frame) / STEP_SECONDS
        known = now.companions if a.groups else None
        others = nearest(now.history, now.mask, now.radius, now.ahead, known)
        company = others.company * float(a.companions)
        share = company.clamp_max(1) if a.groups else company  # known companions: their mean, not their sum
        with_me = others.place * share, others.velocity * share
        style, crowd = now.style * float(a.style), now.crowd_style.expand_as(now.style) * float(a.style)
        stands = (past[:, :, -1].square().sum(-1) < 0.01).to(past.dtype)
        arriving = (-(now.remaining / 1.2).square()).exp()
        left = (-now.remaining / 1.5).exp(), (now.remaining / 10).clamp_max(1)
        own = torch.stack((now.pref_speed, *left, (now.late / 4).tanh(), stands, now.stood), -1)
        if a.hidden_dim:
            pooled = self.near(others.features) * others.share.unsqueeze(-1)
            seen = [past.flatten(2), own, style, crowd, z, pooled.sum(2), pooled.amax(2), *with_me, company]
            if a.walls:
                seen.append(now.walls)
            out = self.head(self.body(torch.cat(seen, -1)))
        else:
            out = self.head(own)

        # where they want to go: to the waypoint at their speed, and with their companions
        close = arriving.unsqueeze(-1)
        speed = now.pref_speed * (0.5 * out[..., 0].tanh()).exp()
        turn = 0.8 * out[..., 1].tanh() * (1 - 0.9 * arriving)
        want = torch.stack((speed * turn.cos(), speed * turn.sin()), -1)
        together = (out[..., 2:3] - 1).sigmoid() * company.clamp_max(1)
        want = torch.lerp(want, past[:, :, -1] + with_me[1], together)
        if a.avoids:
            evading, urgent = evasion(others, z[..., 1])
            want = want + out[..., 17:18].exp() * evading * (1 - close)  # m/s
        # how fast they change to it, from a mean of the last steps that takes jitter out
        recent = (out[..., 3:7] + out.new_tensor([2.0, 0.0, 0.0, 0.0])).softmax(-1)
        base = (recent.unsqueeze(-1) * past.flip(2)[:, :, :4]).sum(2)
        rate = (out[..., 7:8] - 1).sigmoid()
        rate = rate + (1 - rate) * 0.8 * close
        nowhere = torch.zeros_like(stands)
        narrow = narrowness(now.walls) if self.sees_walls else nowhere
        confined = confinement(now.walls) if self.sees_walls and a.avoids else nowhere
        off = (smooth_norm(past[:, :, -1] - want) / now.pref_speed - ASTRAY).clamp_min(0)
        if a.follows:
            rate = rate + (1 - rate) * 0.8 * off.clamp_max(1).unsqueeze(-1)
        if a.avoids:
            rate = rate + (1 - rate) * out[..., 18:19].sigmoid() * urgent
            rate = rate + (1 - rate) * torch.maximum(0.8 * narrow, confined).unsqueeze(-1)
        push = 0.8 * (out[..., 8:10] / 2).tanh() * (1 - 0.7 * close)
        closer = 0.3 * out[..., 10:11].tanh() * with_me[0]
        change = base - past[:, :, -1] + rate * (want - base) + push + closer

        step = z[..., -EVERY_STEP - JITTER : -JITTER]
        usual = now.usual_style * float(a.style) if a.style_prior else style
        kink, calm = (kink_of_change(usual), CALM) if a.style_prior else (kinks_of(style), 0.0)
        kinks, jitter = (size.unsqueeze(-1) / STEP_SECONDS for size in (kink, jitter_of(usual)))
        moves = change
        result = past[:, :, -1]
        if a.step_noise:
            kinks = (1 - CARE * confined.unsqueeze(-1)) * (kinks + 0.03)
            moves = change + kinks * functional.softplus(out[..., 11:13] - calm) * step[..., 1:3]
            result = result + jitter * functional.softplus(out[..., 13:15] - 0.5) * z[..., -JITTER:]
        if a.held:
            log_patience = self.patience[0] + self.patience[1] * now.stood + self.patience[2] * z[..., 0]
            too_late = now.late - log_patience.exp()
            late = 2 * (2 * too_late).sigmoid()
            again = stands * setting_out(now, too_late, a.avoids)
            often: Tensor | float = USUAL_GATE
            if a.style_prior:
                changed = 1 - held_of(usual).clamp(0.03, 0.97)
                often = GATE_NOISE * torch.special.ndtri(changed) + LOOKING_UP * off * (1 - stands)
            if a.avoids:
                stopped = narrow * stands * (1 - now.stood)
                often = often + stopped * (USUAL_GATE - often) + LOOKS_UP * confined * (1 - stands)
            gate = ((out[..., 15] + often + GATE_NOISE * step[..., 0] + late + again) / 0.2).sigmoid()
            # held velocities are exactly those of before; the gradient is that of the soft gate
            moves = _hard(gate).unsqueeze(-1) * moves
        result = result + moves
        if a.halts:
            drawn = z[..., HALT_PERIOD] if a.lasting_halts else step[..., 3]
            going = RARE_HALT + WALKS_ON * confined - out[..., 16] + 1.7 * drawn + AT_ONCE * now.sets_out
            goes = _hard((going / 0.4).sigmoid()).unsqueeze(-1)
            if a.lasting_halts:  # they brake first
                speed = smooth_norm(past[:, :, -1]).unsqueeze(-1)
                slower = past[:, :, -1] * (1 - BRAKING / speed.clamp_min(BRAKING))
                result = torch.lerp(slower, result, goes)
            else:
                result = goes * result
        wish = rotate(result, now.ahead)
        return held_back(wish, now, others, narrow, confined, z[..., 2]) if a.follows else wish, wish

    def velocity(self, now: Situation, noise: Tensor) -> Tensor:
        """Return velocities until the next decision (B, A, 2), m/s, for noise (B, A, Z)."""
        return self.velocities(now, noise)[0]

    def _begun(self, batch: TensorDict, noise: Tensor | None) -> tuple[Situation, Tensor]:
        """Return the situation of a scene batch, and the noise (B, A, Z): zeros for none."""
        now = Situation.of(batch, self.sees_walls)
        return now, now.history.new_zeros(*now.mask.shape, self.noise_dim) if noise is None else noise

    def step_and_wish(self, batch: TensorDict, noise: Tensor | None) -> tuple[Tensor, Tensor]:
        """Return the next steps (B, A, 2), metres, and those that people wish for."""
        now, noise = self._begun(batch, noise)
        there = now.mask.unsqueeze(-1)
        step, wish = (torch.where(there, v * STEP_SECONDS, 0.0) for v in self.velocities(now, noise))
        return step, wish

    def next_steps(self, batch: TensorDict, noise: Tensor | None, steps: int, horizon: int) -> Tensor:
        """Return the first steps of one future (B, A, steps, 2); others go on as they do."""
        now, noise = self._begun(batch, noise)
        there = now.mask.unsqueeze(-1)
        path = []
        for _ in range(steps):
            step = torch.where(there, self.velocity(now, noise) * STEP_SECONDS, 0.0)
            path.append(step)
            now = now.after(step) if len(path) < steps else now
        return torch.stack(path, 2)

    def sample(self, batch: TensorDict, samples: int, steps: int, generator: Random = None) -> Tensor:
        """Return random futures (B, K, A, T, 2): each sample is one in which all people walk together."""
        now = Situation.of(batch, self.sees_walls)
        return drawn_walks(
            now,
            lambda seen, noise: self.velocity(seen, noise) * STEP_SECONDS,
            self.noise_periods,
            samples,
            steps,
            generator,
        )

    def loss(self, batch: TensorDict, generator: Random = None) -> Tensor:
        """Return the energy score of two forecasts at every step, metres, summed over people.

        Its minimum is the true distribution (Gneiting and Raftery, JASA 2007, eq. 21).
        """
        true = true_displacements(batch).cumsum(2)
        path = self.sample(batch, 2, true.shape[2], generator).cumsum(3)
        apart = [path[:, 0] - true, path[:, 1] - true, path[:, 0] - path[:, 1]]
        first, second, between = ((one.square().sum(-1) + 1e-10).sqrt() for one in apart)
        known = known_displacements(batch).cummin(2).values
        return ((first + second - between) / 2).where(known, 0.0).sum() / true.shape[2]

    def mode(self, batch: TensorDict, steps: int) -> Tensor:
        """Return the future (B, 1, A, T, 2) without noise."""
        return self.next_steps(batch, None, steps, steps).unsqueeze(1)


def _hard(gate: Tensor) -> Tensor:
    """Return 0 or 1 for a gate in between, with its gradient."""
    return (gate > 0.5).to(gate.dtype) + gate - gate.detach()
