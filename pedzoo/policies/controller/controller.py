"""Policies for any simulator: positions of people by id in, velocities by id out."""

import warnings
from collections.abc import Hashable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, TypeVar, cast

import numpy as np
import torch
from numpy.typing import NDArray
from tensordict import TensorDict
from tensordict.nn.probabilistic import InteractionType as ExplorationType
from tensordict.nn.probabilistic import set_interaction_type as set_exploration_type
from torch import Tensor

from pedzoo.core.batch import PERSON, ROBOT, actions_of, scene_batch
from pedzoo.core.errors import UserError
from pedzoo.core.geometry import TURNS_FROM, blended, heading_of, identity_pose, limit_speed
from pedzoo.core.randomness import Draws
from pedzoo.core.types import AHEAD_SECONDS, OBS_LEN, STEP_SECONDS, TOP_SPEED_RATIO, TRACE_SECONDS
from pedzoo.maps.bank import MapBank
from pedzoo.maps.grid import OccupancyGrid, Unknown
from pedzoo.maps.planning.guidance import Guidance
from pedzoo.maps.planning.planner import planner_class
from pedzoo.maps.plans import load_plan
from pedzoo.policies.controller.arguments import (
    PREF_SPEED,
    ZERO,
    Array,
    CallerClock,
    as_discs,
    as_places,
    as_points,
    as_velocities,
    by_id,
    check_ids,
    number_of,
    of_present,
    origin_of,
)
from pedzoo.policies.controller.ease import eased, expected
from pedzoo.policies.controller.roster import OnlineGoals, Roster
from pedzoo.policies.policy import NamedPolicy

Id = TypeVar("Id", bound=Hashable)

_SEEN = "heading", "pref_speed", "radius", "group", "goal_since", "number", "other"
"""What policies see of agents as it is."""


class Controller:
    """Moves the people of another simulator: call `step` with the positions of all agents.

    At the calls nearest to every ``policy.decision_dt`` the policy decides, from a scene batch as the
    environment makes it: the last 8 positions 0.4 s apart, the planner's short-term goal and desired
    velocity, radii and kinds. Velocities are those of the last ``dt``, at least of 0.1 s, by the positions.
    In between they blend as in the environment: half-way in the first 0.1 s, and the decision ends where the
    decided velocity alone would lead. The caller moves people: walls do not stop agents here, and positions
    may differ from where the velocities lead.

    People come and go: a person not named in a call is forgotten, and is new afterwards. For new people the
    policy decides at once, and later together with all others. Their history is a straight walk to here, at
    the velocity given to `step`, else at their preferred speed along the planner's path.

    A goal is reached within 0.3 m of it, once. The person comes to rest on it, or beside a person who stands
    there. With the goal None a person stops at once. Both stand until `step` gets another goal, and the
    others walk around. They brake and set out by at most 2.5 m/s^2: see `pedzoo.policies.controller.ease`.
    Of a goal nearer to a wall than ``clearance`` you are warned once: the person walks to the nearest free
    place, until that and the goal are within 0.3 m, or that is within 0.15 m.

    Other agents (robots, people of another simulator) are moved by the caller alone. All people see them,
    with their histories and radii, as agents of kind `pedzoo.core.batch.ROBOT`.

    Noise is drawn by seed and id alone: a person's does not depend on the other agents. The policy decides in
    torch's inference mode, without gradients.
    """

    def __init__(
        self,
        policy: NamedPolicy,
        map: OccupancyGrid | str | Path | None = None,
        pref_speed: float | Mapping[Any, float] = PREF_SPEED,
        dt: float = STEP_SECONDS,
        seed: int = 0,
        deterministic: bool = False,
        clearance: float = 0.25,
        planner: str = "shortest",
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
            planner: ``shortest`` paths, or those of ``astar`` on the grid of open cells.
            unknown: Meaning of unknown cells of the floor plan.

        Raises:
            UserError: There is no such floor plan, or a setting is out of range.
        """
        if not isinstance(policy, NamedPolicy):
            raise UserError(f"policy {policy!r:.60}: expected a subclass of pedzoo.policies.policy.Policy")
        clock = CallerClock.of(dt, policy.decision_dt)
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
        ways = planner_class(planner)(bank, clearance, origin=origin)
        if bank.grids:  # at the first step they would come too late
            _ = ways.corners(0).matrix, bank.walls
        self._online_goals = OnlineGoals(ways, origin, set())
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
        self.policy = self.policy.fresh()
        self._key = Draws.for_episodes(seed, torch.zeros(1, dtype=torch.long)).key
        self._clock = CallerClock.of(self.dt, self.policy.decision_dt)
        self._agents = Roster.empty(len(self._clock.times), self._ticks)
        self._sized: set[Hashable] = set()

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

        Coordinates are those of the floor plan, metres: tuples, lists, arrays or tensors, within 10 km of it,
        or without one of the first agent. A call that raises changes nothing.

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
            UserError: A value is not two finite numbers, or seems to be in another unit. An id is in people
                and in others, or a radius is of nobody who is or was here. The time does not go forward. A
                goal is missing, in a wall, off the plan or out of reach. The policy's answer is not finite.
        """
        people, others, radius = by_id(people, "people"), by_id(others, "others"), by_id(radius, "radius")
        discs, velocities = as_discs(others), by_id(velocities, "velocities")
        check_ids(people, others, radius, self._sized)
        clock, dropped = self._clock.called(time)
        present = {**people, **discs}
        agents, online_goals = self._agents.now(present, self.pref_speed), self._online_goals
        agents.resize(radius)
        state, bank = agents.state, online_goals.planner.bank
        for one, name in of_present(people, by_id(groups, "groups")).items():
            state["group"][agents.row[one]] = -1 if name is None else number_of(name)
        points, position = as_points(present, "position"), np.empty((len(present), 2), np.float32)
        if present and not (self._agents.row or bank.grids):
            online_goals = online_goals._replace(origin=origin_of(points[: len(people) or None]))
        position[agents.rows(present)] = as_places(present, "position", online_goals.origin, points)
        agents.check_moves(position)
        # on the way since the last call, or at once for a new goal
        agents.arrive(agents.past[:, -1], position)
        asked, new, stood = of_present(people, by_id(goals, "goals")), agents.is_new, state["stands"].copy()
        comes = bool(new.any())
        if asked or comes:
            online_goals = online_goals.with_goals(agents, position, asked, clock.now, self.dt)
        if comes and not self._warned and (misplaced := online_goals.misplaced(agents, position)):
            warnings.warn(misplaced, stacklevel=2)
            self._warned = True
        past = np.concatenate((agents.past[:, dropped:], position[:, None]), axis=1)
        agents, walks = agents._replace(past=past), agents.walks
        state["trace"][~walks] = 0.0
        state["trace"][stood & walks] = np.nan  # until the next decision: a goal counts from then on
        decides = (new | clock.decides) & walks
        if comes or decides.any():
            guidance = online_goals.guide(agents, position)
            if comes or velocities:
                given = of_present(people, velocities)
                given |= {disc: velocities.get(disc.of, (0.0, 0.0)) for disc in discs}
                rows, moving = agents.rows(given), guidance.desired_velocity.numpy().copy()
                moving[rows] = as_velocities(given)
                agents.begin(position, moving, clock.times, new, rows)
            velocity, heading = clock.velocity(past), torch.from_numpy(state["heading"])
            state["heading"] = heading_of(torch.from_numpy(velocity), heading, TURNS_FROM).numpy()
            if decides.any():
                with torch.inference_mode():  # a sixth less time than `torch.no_grad`
                    batch = self._batch(agents, velocity, guidance, clock, online_goals)
                    trace = self._trace(agents, batch, new | state["eases"])
                state["trace"][decides] = trace.numpy()[decides]
        wish = (state["trace"] * clock.parts(self._ticks)[:, None]).sum(1)
        answer = eased(state, wish, past, clock, bank)
        self._online_goals, self._agents, self._clock = online_goals, agents, clock
        self._sized |= set(radius)
        return {one: answer[agents.row[one]] for one in people}

    def _trace(self, agents: Roster, batch: TensorDict, begin: Array) -> Tensor:
        """Return the velocities (N, S, 2) of a new decision, m/s; agents who ``begin`` (N,) do not blend."""
        velocity = cast("Tensor", batch["agents", "velocity"])[0]
        device = next(self.policy.parameters(), velocity).device
        batch = batch if device == velocity.device else batch.to(device)
        kind = ExplorationType.DETERMINISTIC if self.deterministic else ExplorationType.RANDOM
        with set_exploration_type(kind):
            action = actions_of(self.policy(batch))[0].to(velocity)
        broken = ~action.isfinite().all(1).numpy() & agents.walks
        if broken.any():
            raise UserError(
                f"the policy's velocity is not finite for {agents.names(broken)}: are its weights damaged?"
            )
        top_speed = TOP_SPEED_RATIO * torch.from_numpy(agents.state["pref_speed"])
        command, before = limit_speed(action, top_speed), limit_speed(velocity, top_speed)
        before = torch.where(torch.from_numpy(begin).unsqueeze(1), command, before)
        trace = blended(before.T, command.T, self._ticks).permute(2, 1, 0)
        return limit_speed(trace, top_speed.unsqueeze(1)) if self._ticks > 1 else trace

    def _batch(
        self, agents: Roster, velocity: Array, guidance: Guidance, clock: CallerClock, goals: OnlineGoals
    ) -> TensorDict:
        """Return the scene batch (1,) of N agents at ``velocity`` (N, 2), m/s, as the environment does."""
        size, position = (1, len(agents.row)), torch.from_numpy(agents.past[:, -1])
        all_known = torch.ones(size, dtype=torch.bool)
        # the caller's way with others is not known: they go on as they do
        ahead = position + AHEAD_SECONDS * torch.from_numpy(velocity)
        moving, top_speed = map(torch.from_numpy, expected(agents.state, agents.past[:, -1], velocity, clock))
        of = {name: torch.from_numpy(agents.state[name].copy()).unsqueeze(0) for name in _SEEN}
        other = of["other"].unsqueeze(-1)
        return scene_batch(
            maps=goals.planner.bank,
            map_id=goals.map_id.view(1, 1),
            pose=identity_pose(1),
            history=torch.from_numpy(clock.history(agents.past)).unsqueeze(0),
            valid=all_known.unsqueeze(-1).expand(*size, OBS_LEN),
            mask=all_known,
            velocity=moving.unsqueeze(0),
            heading=of["heading"].unsqueeze(-1),
            pref_speed=of["pref_speed"].unsqueeze(-1),
            top_speed=top_speed.view(*size, 1),
            radius=of["radius"].unsqueeze(-1),
            kind=torch.where(of["other"], ROBOT, PERSON),
            group=of["group"],
            goal=torch.where(other, ahead, guidance.goal),
            desired_velocity=torch.where(other, moving, guidance.desired_velocity),
            remaining_path=guidance.distance.view(*size, 1),
            goal_since=of["goal_since"].unsqueeze(-1),
            controlled=torch.from_numpy(agents.walks).unsqueeze(0),
            id=of["number"],
            key=self._key.unsqueeze(1),
            time=torch.tensor([[clock.now]]),
        )
