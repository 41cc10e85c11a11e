"""Policies for any simulator: positions of people by id in, velocities by id out."""

import warnings
from collections.abc import Hashable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, Protocol, TypeVar, cast

import numpy as np
import torch
from numpy.typing import NDArray
from tensordict import TensorDict, TensorDictBase
from tensordict.nn.probabilistic import InteractionType as ExplorationType
from tensordict.nn.probabilistic import set_interaction_type as set_exploration_type
from torch import Tensor, nn

from pedzoo.core.batch import PERSON, ROBOT, actions_of, scene_batch
from pedzoo.core.errors import UserError
from pedzoo.core.geometry import TURNS_FROM, blended, heading_of, identity_pose, limit_speed
from pedzoo.core.randomness import Draws
from pedzoo.core.types import AHEAD_SECONDS, OBS_LEN, STEP_SECONDS, TOP_SPEED_RATIO, TRACE_SECONDS
from pedzoo.maps.bank import MapBank
from pedzoo.maps.grid import OccupancyGrid, Unknown
from pedzoo.maps.planning.guidance import Guidance
from pedzoo.maps.planning.planner import Planner
from pedzoo.maps.plans import load_plan
from pedzoo.policies.controller.arguments import (
    PREF_SPEED,
    ZERO,
    as_discs,
    as_places,
    as_velocities,
    by_id,
    check_radius_ids,
    of_present,
    origin_of,
)
from pedzoo.policies.controller.ease import CallerClock, eased, expected, setting_out
from pedzoo.policies.controller.roster import OnlineGoals, Roster

Id = TypeVar("Id", bound=Hashable)


class WalkingPolicy(Protocol):
    """Policies of a controller: a `Walker`, or any from `pedzoo.policies.load.load_policy`.

    One that remembers what it has seen has a method ``fresh``, which returns it as before its first scene.
    """

    decision_dt: float

    def __call__(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Write ``agents/action``."""
        ...


class Controller:
    """Moves the people of another simulator: call `step` with the positions of all agents.

    At every call positions are recorded. At the calls nearest to every ``policy.decision_dt`` the policy
    decides, from the same scene batch that the environment makes: the last 8 positions 0.4 s apart, the
    planner's carrot and desired velocity, radii and kinds. Velocities are those of the last ``dt``, at least
    of 0.1 s, by the positions. In between, velocities blend as in the environment: half-way in the first
    0.1 s, and the decision ends where the decided velocity alone would lead. The caller moves people: walls
    do not stop agents here, and positions may differ from where the velocities lead.

    People come and go: a person not named in a call is forgotten, and is new afterwards. For new people the
    policy decides at once, and later together with all others. Their history is a straight walk to here at
    their present velocity: models would take a history on the spot for a standing person. That velocity is
    the one given to `step`, else their preferred speed along the planner's path.

    A goal is reached within 0.3 m of it, once. The person comes to rest on it, or beside a person who stands
    there. With the goal None a person stops at once. Both stand until `step` gets another goal, and the
    others walk around. They brake and set out by at most 2.5 m/s^2: see `pedzoo.policies.controller.ease`.
    Of a goal nearer to a wall than ``clearance`` you are warned once: the person walks to the nearest free
    place, until that and the goal are within 0.3 m, or that is within 0.15 m.

    Other agents (robots, people of another simulator) are moved by the caller alone. All people see them,
    with their histories and radii, as agents of kind `pedzoo.core.batch.ROBOT` that the policy does not
    control.

    Noise is drawn by seed and id alone: a person's does not depend on the other agents. The policy decides in
    torch's inference mode: no gradients, and fewer microseconds.
    """

    def __init__(
        self,
        policy: WalkingPolicy,
        map: OccupancyGrid | str | Path | None = None,
        pref_speed: float | Mapping[Any, float] = PREF_SPEED,
        dt: float = STEP_SECONDS,
        seed: int = 0,
        deterministic: bool = False,
        clearance: float = 0.25,
        unknown: Unknown = "wall",
    ) -> None:
        """Take a policy and the floor plan that people walk on.

        Args:
            policy: Decides. Several controllers may share one: each remembers its own people.
            map: The floor plan, its name (``apartment.7``) or its file; None for open space, where paths are
                straight.
            pref_speed: Preferred speed, m/s: one for all, or by id (1.3 for people not in it). It is read
                when a person comes.
            dt: Seconds between two calls of `step`: exactly, or about, where `step` gets the time.
            seed: Of the noise: that of the environment's first scene of this seed, for ids 0, 1, ...
            deterministic: Without noise.
            clearance: Metres that paths keep from walls.
            unknown: Meaning of unknown cells of the floor plan.

        Raises:
            UserError: There is no such floor plan, or a setting is out of range.
        """
        clock = CallerClock.of(dt, policy.decision_dt)
        if getattr(policy, "execute_steps", 1) != 1:
            raise UserError(
                f"execute_steps {getattr(policy, 'execute_steps', 1)}: a controller decides anew for people "
                "who come and go: expected 1"
            )
        grid, origin = load_plan(map) if isinstance(map, str | Path) else map, ZERO
        if not isinstance(grid, OccupancyGrid | None):
            raise UserError(
                f"map of type {type(map).__name__}: expected the name or file of a floor plan, or "
                "pedzoo.maps.grid.OccupancyGrid(cells, resolution)"
            )
        if grid is not None:
            origin = np.array(grid.origin[:2], dtype=np.float64)
            grid = replace(grid, origin=(0.0, 0.0, grid.origin[2]))
        bank = MapBank([] if grid is None else [grid], unknown)
        self.policy, self.dt = policy, clock.dt
        self.pref_speed, self.deterministic = pref_speed, deterministic
        planner = Planner(bank, clearance, origin=origin)
        if bank.grids:  # at the first step they would come too late
            _ = planner.corners(0).matrix, bank.walls
        self._online_goals = OnlineGoals(planner, origin, set())
        self._warned = False
        # with one call per decision there is nothing to blend
        blends = policy.decision_dt > 1.5 * clock.dt
        self._ticks = max(1, blends * round(policy.decision_dt / TRACE_SECONDS))
        self.reset(seed)

    def __repr__(self) -> str:
        grids = self._online_goals.planner.bank.grids
        floor = grids[0].name if grids else "open space"
        return f"Controller({self.policy!r} on {floor}, {len(self._agents.row)} agents, dt {self.dt:g} s)"

    def reset(self, seed: int = 0) -> None:
        """Forget all agents and start anew with the noise of ``seed``; ways that are known stay known."""
        self.policy = getattr(self.policy, "fresh", lambda: self.policy)()
        self._key = Draws.for_episodes(seed, torch.zeros(1, dtype=torch.long)).key
        self._clock = CallerClock.of(self.dt, self.policy.decision_dt)
        self._agents = Roster.empty(len(self._clock.times), self._ticks)
        self._sized: set[Hashable] = set()

    @torch.inference_mode()  # a sixth less time than `torch.no_grad`
    def step(
        self,
        people: Mapping[Id, Any],
        goals: Mapping[Any, Any] | None = None,
        velocities: Mapping[Any, Any] | None = None,
        *,
        others: Mapping[Any, Any] | None = None,
        radius: Mapping[Any, float] | None = None,
        groups: Mapping[Any, Hashable] | None = None,
        time: float | None = None,
    ) -> dict[Id, NDArray[np.float64]]:
        """Return the velocity (2,) of every person, m/s, at most 1.3 times their preferred speed.

        Coordinates are those of the floor plan, metres: tuples, lists, arrays or tensors. They may be
        anywhere, within 10 km of it, or without one of the first agent. A call that raises changes nothing.

        People may brush walls. Of one who comes deeper in a wall, or farther outside, than their radius you
        are warned, once per controller: their path begins at the nearest free place. Under a safety layer
        nobody gets through a wall, so people outside of it stay there.

        Args:
            people: Where they are now, by id: any hashable values.
            goals: Where they are going, None to stand. Needed when a person is new, and then when the goal
                changes; it counts from the next decision on. Goals of absent people do not matter.
            velocities: How new people and new others are moving, m/s; see the class. Others that are not
                in it begin at rest.
            others: Where agents are that the caller moves, by id: (x, y), or (k, 2) for a body of several
                discs. Each disc has its own history.
            radius: Radii of bodies by id, metres; once given they stay until they change. People have 0.15
                else, others 0.3. All discs of an agent have the same. Absent ids who had one do not matter.
            groups: Which people walk in company, by id: any name, the same for all of a company, or None
                for alone. Once given they stay until they change; people are alone else.
            time: Now, seconds by the caller's clock, at every call or at none. Calls may then come early or
                late. None: calls are ``dt`` apart.

        Raises:
            UserError: A value is not two finite numbers, or an id is in people and in others. A radius is
                not above 0, or of nobody who is or was here. A radius, a speed, a time or a move since the
                last call seems to be in another unit. The time does not go forward. A person has no goal, or
                one in a wall, outside the floor plan or out of reach. The policy's answer is not finite.
        """
        people, others, radius = by_id(people, "people"), by_id(others, "others"), by_id(radius, "radius")
        discs, velocities = as_discs(others), by_id(velocities, "velocities")
        check_radius_ids(radius, people, others, self._sized)
        if both := [one for one in people if one in others]:
            raise UserError(f"{both[0]!r} is in people and in others: expected every id in one of them")
        clock, dropped = self._clock.called(time)
        present = {**people, **discs}
        agents = self._agents.now(present, self.pref_speed).with_radius(radius)
        agents = agents.with_groups(of_present(people, by_id(groups, "groups")))
        online_goals = self._online_goals
        if present and not (self._agents.row or online_goals.planner.bank.grids):
            online_goals = online_goals._replace(origin=origin_of(people or present))
        position = agents.past.new_empty(len(present), 2)
        position[agents.rows(present)] = as_places(present, "position", online_goals.origin).float()
        agents.check_moves(position)
        # on the way since the last call, or at once for a new goal
        agents = before = agents.arrived(agents.past[:, -1], position)
        asked, new = of_present(people, by_id(goals, "goals")), agents.is_new
        comes = bool(new.any())
        if asked or comes:
            online_goals, with_goals = online_goals.with_goals(agents, position, asked, clock.now)
            if with_goals is not agents:
                agents = setting_out(with_goals.arrived(position, position), before, position, self.dt)
        if comes and not self._warned and (misplaced := online_goals.misplaced(agents, position)):
            warnings.warn(misplaced, stacklevel=3)  # beyond the wrapper of torch
            self._warned = True
        past = torch.cat((agents.past[:, dropped:], position.unsqueeze(1)), dim=1)
        trace = torch.where(agents.walks[:, None, None], agents.trace, 0.0)
        trace[before.stands & agents.walks] = torch.nan  # until the next decision: a goal counts from then on
        agents = agents._replace(past=past, trace=trace)
        decides = (new | clock.decides) & agents.walks
        if comes or decides.any():
            guidance = online_goals.guide(agents, position)
            if comes or velocities:
                given = of_present(people, velocities)
                given |= {disc: velocities.get(disc.of, (0.0, 0.0)) for disc in discs}
                rows, known = agents.rows(given), as_velocities(given).float()
                moving = guidance.desired_velocity.index_put((rows,), known)
                agents = agents.begun(position, moving, clock.times, new, rows)
            velocity = clock.velocity(agents.past)
            agents = agents._replace(heading=heading_of(velocity, agents.heading, TURNS_FROM))
            if decides.any():
                batch = self._batch(agents, velocity, guidance, clock)
                agents = self._decided(agents, batch, decides, new | agents.eases)
        wish = (agents.trace * clock.parts(self._ticks).view(-1, 1)).sum(1)
        answer, agents = eased(agents, wish, position, clock, online_goals.planner.bank)
        self._online_goals, self._agents, self._clock = online_goals, agents, clock
        self._sized |= set(radius)
        return {one: answer[agents.row[one]] for one in people}

    def _decided(self, agents: Roster, batch: TensorDict, decides: Tensor, begin: Tensor) -> Roster:
        """Return the roster in which some agents (N,) have a new decision; ``begin``: without blending."""
        before, device = cast("Tensor", batch["agents", "velocity"])[0], agents.past.device
        if isinstance(self.policy, nn.Module):
            device = next(self.policy.parameters(), agents.past).device
        batch = batch if device == agents.past.device else batch.to(device)
        kind = ExplorationType.DETERMINISTIC if self.deterministic else ExplorationType.RANDOM
        with set_exploration_type(kind):
            action = actions_of(self.policy(batch))[0].to(agents.past)
        broken = ~action.isfinite().all(1) & agents.walks
        if broken.any():
            raise UserError(
                f"the policy's velocity is not finite for {agents.names(broken)}: are its weights damaged?"
            )
        top_speed = TOP_SPEED_RATIO * agents.pref_speed
        command = limit_speed(action, top_speed)
        before = torch.where(begin.unsqueeze(1), command, limit_speed(before, top_speed))
        trace = blended(before.T, command.T, self._ticks).permute(2, 1, 0)
        if self._ticks > 1:
            trace = limit_speed(trace, top_speed.unsqueeze(1))
        return agents._replace(trace=torch.where(decides[:, None, None], trace, agents.trace))

    def _batch(self, agents: Roster, velocity: Tensor, guidance: Guidance, clock: CallerClock) -> TensorDict:
        """Return the scene batch (1,) of N agents at ``velocity`` (N, 2), m/s, as the environment does."""
        size = (1, len(agents.row))
        all_known = torch.ones(size, dtype=torch.bool)
        # the caller's way with others is not known: they go on as they do
        other = agents.other.unsqueeze(1)
        ahead = agents.past[:, -1] + AHEAD_SECONDS * velocity
        velocity, top_speed = expected(agents, agents.past[:, -1], velocity, clock)
        return scene_batch(
            maps=self._online_goals.planner.bank,
            map_id=self._online_goals.map_id.view(1, 1),
            pose=identity_pose(1),
            history=clock.history(agents.past).unsqueeze(0),
            valid=all_known.unsqueeze(-1).expand(*size, OBS_LEN),
            mask=all_known,
            velocity=velocity.unsqueeze(0),
            heading=agents.heading.view(*size, 1),
            pref_speed=agents.pref_speed.view(*size, 1),
            top_speed=top_speed.view(*size, 1),
            radius=agents.radius.view(*size, 1),
            kind=torch.where(agents.other, ROBOT, PERSON).unsqueeze(0),
            group=agents.group.unsqueeze(0),
            goal=torch.where(other, ahead, guidance.goal).unsqueeze(0),
            desired_velocity=torch.where(other, velocity, guidance.desired_velocity).unsqueeze(0),
            remaining_path=guidance.distance.view(*size, 1),
            goal_since=agents.goal_since.view(*size, 1),
            controlled=agents.walks.unsqueeze(0),
            id=agents.number.unsqueeze(0),
            key=self._key.unsqueeze(1),
            time=torch.tensor([[clock.now]]),
        )
