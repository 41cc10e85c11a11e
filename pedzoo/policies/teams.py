"""Mixed crowds: several policies move the agents of a scene, each at its own decision interval."""

import math
from typing import NamedTuple, Self, TypeAlias, cast

import torch
from tensordict import TensorDictBase
from torch import Tensor, nn
from torch.nn import functional

from pedzoo.core import randomness
from pedzoo.core.adapters import copied
from pedzoo.core.batch import PERSON, ROBOT, actions_of, agents_of, ids_of
from pedzoo.core.errors import UserError
from pedzoo.core.geometry import blended, limit_speed
from pedzoo.core.types import TRACE_SECONDS
from pedzoo.policies.memory import AgentMemory
from pedzoo.policies.policy import Policy
from pedzoo.policies.walker import Walker, check_interval

_ROUNDING = 1e-3
"""Seconds: clocks are sums of decisions."""

Crowd: TypeAlias = list[tuple[Policy | Walker, float]]
"""Policies and their shares of the agents."""


class PlannedVelocities(NamedTuple):
    """Velocities that are being walked by A - 1 agents; the last slot is for the team as a whole."""

    begun: Tensor
    """When they were decided (B, A), seconds; inf for never."""
    velocity: Tensor
    """For each of the N decisions of the crowd from then on (B, A, N, 2), m/s."""


class Team(nn.Module):
    """A policy and the agents that it moves: those of a ``kind`` (None for all) with draws in [least, below).

    It decides at ``every`` so many decisions of the crowd.
    """

    def __init__(
        self, policy: Policy | Walker, kind: int | None, least: float, below: float, every: int
    ) -> None:
        """Take the parts."""
        super().__init__()
        self.policy, self.kind, self.least, self.below, self.every = policy, kind, least, below, every
        self._memory = AgentMemory()

    def velocity(self, scenes: TensorDictBase, mine: Tensor, dt: float) -> Tensor:
        """Return the velocities (B, A, 2) of the agents ``mine`` (B, A), m/s; anything for others.

        ``dt``: seconds between two decisions of the crowd.
        """
        if self.every == 1:
            return self._asked(scenes, mine) if bool(mine.any()) else torch.zeros_like(_velocity(scenes))
        # those who leave the team, for another or for good, are forgotten
        person = functional.pad(ids_of(scenes).where(mine, -2), (0, 1), value=-1)
        velocity, now = functional.pad(_velocity(scenes), (0, 0, 0, 1)), cast("Tensor", scenes["time"])
        blank = torch.zeros_like(velocity).unsqueeze(2).expand(-1, -1, self.every, -1)
        never = torch.full_like(now, torch.inf).expand(person.shape)
        begun, planned = self._memory.recall(scenes, person, PlannedVelocities(never, blank))
        since = now - begun[:, -1:]
        turn = (since < _ROUNDING) | (since > (self.every - 0.5) * dt)  # a caller's clock may jitter
        decides = mine & (turn | (now - begun[:, :-1] <= _ROUNDING))
        rows = decides.any(1)
        if bool(rows.any()):
            if bool(rows.all()):
                command = self._asked(scenes, mine)
            else:  # scenes that wait would cost as much
                index = rows.nonzero()[:, 0]
                answer = self._asked(scenes[index], mine[index])
                command = torch.zeros_like(_velocity(scenes), dtype=answer.dtype).index_copy(0, index, answer)
            begun = torch.where(torch.cat((decides, turn & rows.unsqueeze(1)), 1), now, begun)
            fresh = functional.pad(self._blended(scenes, command, dt), (0, 0, 0, 0, 0, 1))
            decides = functional.pad(decides, (0, 1))[..., None, None]
            planned = torch.where(decides, fresh, planned)
        self._memory.keep(PlannedVelocities(begun, planned))
        place = ((now - begun[:, :-1]) / dt).round().clamp(0, self.every - 1).long()
        return planned[:, :-1].gather(2, place[..., None, None].expand(*place.shape, 1, 2))[:, :, 0]

    def _asked(self, scenes: TensorDictBase, mine: Tensor) -> Tensor:
        """Return the policy's answer (B, A, 2): it controls no other team's agents."""
        seen = copied(scenes)
        agents = agents_of(seen)
        agents["controlled"] = mine
        if self.every > 1 and "info" in agents.keys():
            del agents["info"]  # of the crowd's decision, not of the team's
        return actions_of(self.policy(seen))

    def _blended(self, scenes: TensorDictBase, command: Tensor, dt: float) -> Tensor:
        """Return velocities (B, A, N, 2) until the next decision; those of robots (of wheels?) are held."""
        agents = agents_of(scenes)
        person = (agents["kind"] != ROBOT)[..., None, None]
        top_speed = cast("Tensor", agents["top_speed"])[..., 0]
        # what is not finite ends the scene, and is not hidden here
        wanted = torch.where(command.isfinite(), limit_speed(command, top_speed), command)
        points = max(1, round(dt / TRACE_SECONDS))
        smooth = blended(_velocity(scenes).movedim(-1, 0), wanted.movedim(-1, 0), self.every * points)
        smooth = smooth.unflatten(1, (self.every, points)).mean(2).movedim(0, -1).movedim(0, 2)
        return torch.where(person, smooth, command.unsqueeze(2))


class Teams(Policy):
    """A mixed crowd: which policy moves which agents, each policy at its own decision interval.

    An agent's team is drawn by the scene's key and the agent's number. So it is the same in every batch and
    process, and stays for the episode. All teams see all agents. In the batch of a team ``controlled`` are
    its own agents alone. A policy takes on all of the avoidance of agents that it does not move.

    The crowd decides as often as its fastest team. A slower team is asked when its interval has passed. For
    people who are new or just taken over it is asked at once; later they decide with their team. In
    between, velocities blend over steps of 0.1 s.
    """

    def __init__(
        self, people: Policy | Walker | Crowd, robots: Policy | Walker | Crowd | None = None
    ) -> None:
        """Take the policies of people and of robots; `pedzoo.policies.load` makes them from their names.

        Args:
            people: A policy, or a mixed crowd.
            robots: Likewise for agents of the kind ``ROBOT``; None: they are moved as people are.

        Raises:
            UserError: Decision intervals are no multiples of the shortest.
        """
        self._crowds = [
            [] if crowd is None else crowd if isinstance(crowd, list) else [(crowd, 1.0)]
            for crowd in (people, robots)
        ]
        steps = [policy.decision_dt for crowd in self._crowds for policy, _ in crowd]
        super().__init__(min(steps))
        teams, kinds = [], (None,) if robots is None else (PERSON, ROBOT)
        for crowd, kind in zip(self._crowds, kinds, strict=False):
            least = 0.0  # draws of teams lie side by side between 0 and 1
            for number, (policy, share) in enumerate(crowd, start=1):
                below = math.inf if number == len(crowd) else least + share
                every = round(policy.decision_dt / self.decision_dt)
                if abs(every * self.decision_dt - policy.decision_dt) > 1e-6:
                    listed = ", ".join(f"{one:g}" for one in steps)
                    raise UserError(
                        f"teams decide every {listed} s: expected multiples of the shortest, "
                        f"{self.decision_dt:g} s; change the setting dt of one"
                    )
                teams.append(Team(policy, kind, least, below, every))
                least = below
        self.teams = nn.ModuleList(teams)

    def fresh(self) -> Self:
        """Return a crowd of the same policies that has seen no scene yet."""
        people, robots = ([(one.fresh(), share) for one, share in crowd] for crowd in self._crowds)
        result = type(self)(people, robots or None)
        result.name = self.name
        return result

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Write the velocities of all agents."""
        check_interval(tensordict, self.decision_dt, "this crowd")
        teams = cast("list[Team]", list(self.teams))
        if len(teams) == 1:
            return teams[0].policy(tensordict)
        controlled = cast("Tensor", agents_of(tensordict)["controlled"])
        action = torch.zeros_like(_velocity(tensordict))
        for team, theirs in zip(teams, self.assigned(tensordict), strict=True):
            mine = controlled & theirs
            velocity = team.velocity(tensordict, mine, self.decision_dt)
            action = torch.where(mine.unsqueeze(-1), velocity, action)
        tensordict["agents", "action"] = action
        return tensordict

    def assigned(self, scenes: TensorDictBase) -> list[Tensor]:
        """Return which agents are of each team (B, A) bool; every agent is of exactly one."""
        key, kind = cast("Tensor", scenes["scene_key"]), cast("Tensor", agents_of(scenes)["kind"])
        draw = randomness.uniform(randomness.join(key, "team", ids_of(scenes)))
        return [
            (draw >= team.least) & (draw < team.below) & (True if team.kind is None else kind == team.kind)
            for team in cast("list[Team]", list(self.teams))
        ]


def _velocity(scenes: TensorDictBase) -> Tensor:
    return cast("Tensor", agents_of(scenes)["velocity"])
