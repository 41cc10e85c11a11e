"""Imitation: recorded people walk on by a policy, and are compared with how they really did.

Windows are unrolled step by step from where their observed part ends, differentiably and in the open. The
scenario `replay` without walls gives the same observations. B scenes, A people, N steps of 0.4 s.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import NamedTuple, cast

import torch
from tensordict import TensorDict
from torch import Tensor, nn

from pedzoo.core.batch import agents_of, goals_of, maps_of
from pedzoo.core.errors import UserError, at_least_one, unknown
from pedzoo.core.geometry import passes_goal
from pedzoo.core.types import AHEAD_SECONDS, GOAL_RADIUS, STEP_SECONDS
from pedzoo.maps.bank import MapBank
from pedzoo.maps.planning.guidance import Guidance
from pedzoo.metrics.realism.distances import wasserstein
from pedzoo.metrics.realism.features import others_of, step_features
from pedzoo.sim import kernel
from pedzoo.sim.dynamics import STRIDE
from pedzoo.sim.observation import observed, state_of
from pedzoo.sim.physics.torch import Torch
from pedzoo.sim.recorded_people import top_speed_of
from pedzoo.sim.scenario import SLOWEST, Rules
from pedzoo.sim.script import Script
from pedzoo.sim.state import TRACE_PER_STEP, Contacts, MotionInput, State
from pedzoo.train.closed_loop.segments import Policy

Walk = Callable[[TensorDict], Tensor]
"""Returns each person's next displacement (B, A, 2), metres, for an observation."""

_NEAR = 1e-6  # metres within which a person is at a place


class Unrolled(NamedTuple):
    """How the people of recorded windows walk on."""

    xy: Tensor  # positions at the end of each step (B, A, N, 2), metres; the last one where they have left
    # which people a policy moves in the step (B, A, N) bool; the step in which they arrive is the last
    walked: Tensor
    present: Tensor  # which people are present meanwhile (B, A, N) bool: these, and played-back people


def unroll(walk: Walk, batch: TensorDict, steps: int, key: Tensor | None = None) -> Unrolled:
    """Return the result of ``walk`` when all people of recorded windows walk together.

    In every step the goal is the point ``pref_speed`` x 3.2 s ahead on the straight line to the destination.
    ``pref_speed`` is that observed, at least 0.3 m/s; the top speed is that of the scenario ``replay``.
    People leave within 0.3 m of their destination, at the latest when they really left. People who are there
    from the beginning are played back. Gradients flow through all that people see, but not through times of
    leaving.

    Args:
        walk: The policy.
        batch: Recorded windows with the goal protocol ``destination`` and at least ``steps`` of future.
        steps: N.
        key: Keys (B,) long, by which a `pedzoo.policies.walker.Walker` draws noise; 0 to B - 1 if
            None.

    Raises:
        UserError: The windows have no goals.
    """
    agents, maps, there = agents_of(batch), maps_of(batch), _known_to_be_there(batch)
    destination = goals_of(batch, "walking on")[0]
    walks = agents["mask"] & _controlled(agents["history"][:, :, -1], destination)
    scene = torch.arange(len(batch), device=there.device)
    state = state_of(batch, destination, walks, scene if key is None else key)
    liked, slot = state.pref_speed.clamp_min(SLOWEST), state.person
    script = Script.of_windows(state.position, agents["future"], there, state.group)
    here = state.mask & there[..., 0]
    state = state._replace(
        scene=scene,
        pref_speed=liked,
        top_speed=top_speed_of(liked),
        mask=here,
        controlled=walks & here,
        person=script.people_in_slots(scene, 0 * scene),
    )
    rules = Rules(_straight, TRACE_PER_STEP, STRIDE, script=script)
    guidance, physics, result = _straight(state), _OpenFloor(), []
    for _ in range(steps):
        moving, here = state.controlled, state.mask
        seen = state._replace(person=slot.where(here, -1))  # a walker draws noise by the slot
        action = walk(observed(seen, guidance, maps)) / STEP_SECONDS
        state, guidance, _ = kernel.step(state, action, physics, rules)
        result.append((state.position, moving, here))
    return Unrolled(*(torch.stack(values, 2) for values in zip(*result, strict=True)))


def _straight(state: State) -> Guidance:
    """Return goals on the straight line to where people go, and beyond it."""
    position, goal = state.position, state.goal_point
    way = goal - position
    distance = way.square().sum(-1).clamp_min(_NEAR**2).sqrt()
    ahead = way / distance.unsqueeze(-1) * state.pref_speed.unsqueeze(-1)
    carrot = position + ahead * AHEAD_SECONDS
    return Guidance(carrot, ahead, goal, goal, distance, carrot)


def recorded(batch: TensorDict, steps: int) -> Unrolled:
    """Return how they really went on, with ``walked`` as a policy that walks like them would have it."""
    agents, there = agents_of(batch), _known_to_be_there(batch)[..., :steps]
    destination, xy = goals_of(batch, "walking on")[0], agents["future"][:, :, :steps]
    before = torch.cat((agents["history"][:, :, -1:], xy[:, :, :-1]), 2)
    arrives = passes_goal(before, xy, destination.unsqueeze(2))
    had = torch.cat((torch.zeros_like(arrives[..., :1]), arrives[..., :-1]), 2).cummax(2).values
    walked = there & ~had & _controlled(before[:, :, 0], destination).unsqueeze(2)
    return Unrolled(xy, walked, there)


def _known_to_be_there(batch: TensorDict) -> Tensor:
    """Return which people are present from begin to end of each future step (B, A, T) bool."""
    agents = agents_of(batch)
    known: Tensor = agents["future_valid"] & agents["mask"].unsqueeze(2)
    return torch.cummin(known, 2).values


def _controlled(position: Tensor, destination: Tensor) -> Tensor:
    """Return which people are not at their destination already (B, A) bool."""
    return (destination - position).norm(dim=-1) > GOAL_RADIUS


class _OpenFloor(Torch):
    """Moves agents straight, or as they were recorded; differentiable."""

    def __init__(self) -> None:
        super().__init__(MapBank())

    def _touched(self, state: State, path: Tensor, inputs: MotionInput) -> Contacts:
        nothing = torch.zeros_like(path[:, :, :, 0, 0], dtype=torch.bool)
        return Contacts(nothing, nothing)


SPREADS = {
    "speed": 0.52,
    "acceleration": 0.30,
    "heading_rate": 0.39,
    "nearest_distance": 1.52,
    "time_to_collision": 3.25,
    "lateral_deviation": 0.72,
}
"""Standard deviation of each feature in all training windows of ETH/UCY with 20 steps on the true clock;
units as in `pedzoo.metrics.realism.features.FEATURES`. Constants: where all are alone a batch has none.
The distance is Wasserstein-1 in these units, as the suite ``replay`` judges a crowd."""


def features(walk: Unrolled, batch: TensorDict) -> dict[str, Tensor]:
    """Return the values of `step_features`, of all steps in which a person ``walked`` and has the feature.

    Lines begin where the windows' observed part ends. Times to a collision have gradients from 0 to 10 s.
    """
    agents = agents_of(batch)
    begin, end = agents["history"][:, :, -1], goals_of(batch, "walking on")[0]
    # all that is there at once stands together: (B, N, A)
    xy, walked, present = (value.transpose(1, 2) for value in walk)
    velocity = torch.cat((begin.unsqueeze(1), xy), 1).diff(dim=1) / STEP_SECONDS
    earlier = torch.cat((agents["velocity"].unsqueeze(1), velocity[:, :-1]), 1)
    radius = cast("Tensor", agents["radius"])[..., 0].unsqueeze(1).expand(walked.shape)
    scene, step, slot = walked.nonzero().unbind(1)
    place, moving, there, body = (value.flatten(0, 1) for value in (xy, velocity, present, radius))
    moment = scene * xy.shape[1] + step
    around = others_of(place, moving, there, there, body, moment, slot, smooth=True)
    offset, way = xy[walked] - begin[scene, slot], (end - begin)[scene, slot]
    values = step_features(velocity[walked], earlier[walked], around, offset, way)
    return {name: value for name, (value, _) in values.items()}


def tail(first: Tensor, second: Tensor) -> Tensor:
    """Return how far the upper tails of two sets of values (M,) and (L,) differ, as a share of the second's.

    The mean over the quantiles from 90 to 99 %, of values above 0; 0 if a set is empty.
    """
    if not len(first) or not len(second):
        return first.sum() * 0 + second.sum() * 0
    ranks = torch.linspace(0.9, 0.99, 10, dtype=first.dtype, device=first.device)
    made, true = torch.quantile(first, ranks), torch.quantile(second, ranks)
    return ((made - true).abs() / true.clamp_min(1e-3)).mean()


class Imitation(nn.Module):
    """Loss for walking unlike recorded people, each term in a unit of its own.

    All people of recorded windows walk together (see `unroll`). Each person is compared by positions at equal
    times, the crowd by speeds, accelerations, turns and distances between people.
    """

    def __init__(
        self,
        displacement: float = 1.0,
        distribution: float = 1.0,
        features: Mapping[str, float] | None = None,
        tail: float = 0.0,
        samples: int = 1,
        spread: float = 0.5,
    ) -> None:
        """Weigh the terms.

        Args:
            displacement: Weight of the mean distance to the recorded positions, metres.
            distribution: Weight of the distances of distributions, in standard deviations of recorded
                people: the mean over features, like ``realism`` of the suite ``replay``.
            features: Weight of each feature within it, 1 if not named; see `SPREADS`.
            tail: Weight of the difference of the upper tails of acceleration, a share (see `tail`); a mean
                distance hardly sees few large values.
            samples: K walks of every window with noise of their own, at K times the cost.
            spread: Share of the distance between two walks of a person that is taken off the displacement,
                with 2 or more samples. At 0.5 it is the energy score, least for the true distribution
                (Gneiting and Raftery, JASA 2007, eq. 21); without it the loss punishes all noise.

        Raises:
            UserError: There is no such feature, or a setting is out of range.
        """
        super().__init__()
        for name in features or {}:
            if name not in SPREADS:
                raise unknown("feature", name, SPREADS)
        self.features = dict.fromkeys(SPREADS, 1.0) | dict(features or {})
        if min(self.features.values()) < 0 or not any(self.features.values()):
            raise UserError(f"features {features}: expected weights of at least 0, and one above it")
        at_least_one("samples", samples)
        self.displacement, self.distribution = displacement, distribution
        self.tail, self.samples, self.spread = tail, samples, spread

    def walk(self, policy: Policy, batch: TensorDict, random: torch.Generator) -> Unrolled:
        """Return K walks of each of B windows (K x B, A, N, ...), all first walks first.

        Windows have N future steps and the goal protocol ``destination``; ``random`` draws the scenes' keys.
        """
        steps = agents_of(batch)["future"].shape[2]
        many = repeated(batch, self.samples)
        key = torch.randint(2**62, (len(many),), generator=random)

        def displacement(seen: TensorDict) -> Tensor:
            return cast("Tensor", policy(seen)["agents", "action"]) * STEP_SECONDS

        return unroll(displacement, many, steps, key)

    def forward(self, policy: Policy, batch: TensorDict, random: torch.Generator) -> dict[str, Tensor]:
        """Return the ``loss`` and its terms before their weights, scalars; arguments as of `walk`."""
        return self.terms(self.walk(policy, batch, random), batch)

    def terms(self, walk: Unrolled, batch: TensorDict) -> dict[str, Tensor]:
        """Return ``loss`` and its terms before their weights, scalars; terms of weight 0 may be missing.

        ``displacement`` (metres), ``distribution`` and each feature's distance (no unit), ``tail`` (a share),
        of the result of `walk` for ``batch``.
        """
        real = recorded(batch, walk.xy.shape[2])
        result = {"displacement": self._displacement(walk, real)}
        loss = self.displacement * result["displacement"]
        if self.distribution or self.tail:
            made = features(walk, repeated(batch, self.samples))
            with torch.no_grad():
                true = features(real, batch)
            apart = {name: wasserstein(made[name], true[name]) / SPREADS[name] for name in SPREADS}
            weighted = torch.stack([self.features[name] * apart[name] for name in SPREADS])
            result["distribution"] = weighted.sum() / sum(self.features.values())
            loss = loss + self.distribution * result["distribution"]
            result |= apart
            if self.tail:
                result["tail"] = tail(made["acceleration"], true["acceleration"])
                loss = loss + self.tail * result["tail"]
        return {"loss": loss, **result}

    def _displacement(self, walk: Unrolled, real: Unrolled) -> Tensor:
        """Return the mean distance to real positions in steps in which both walk, less that of samples."""
        xy = walk.xy.unflatten(0, (self.samples, -1))
        both = walk.walked.unflatten(0, (self.samples, -1)) & real.walked
        loss = _mean(_distance(xy, real.xy), both)
        if self.samples == 1 or not self.spread:
            return loss
        # neighbours in a ring: as many pairs as samples
        other, together = xy.roll(1, 0), both & both.roll(1, 0)
        return loss - self.spread * _mean(_distance(xy, other), together)


def repeated(batch: TensorDict, times: int) -> TensorDict:
    """Return a batch so many times, one after the other."""
    return batch if times == 1 else cast("TensorDict", TensorDict.cat([batch] * times))


def _distance(first: Tensor, second: Tensor) -> Tensor:
    return (first - second).square().sum(-1).clamp_min(1e-12).sqrt()


def _mean(values: Tensor, where: Tensor) -> Tensor:
    return values[where].sum() / where.sum().clamp_min(1)
