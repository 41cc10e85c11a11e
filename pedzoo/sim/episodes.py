"""How scenes begin: a layout, the warm start, the first goals; episodes are made ahead."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import replace
from typing import Literal, NamedTuple, get_args

import torch
from torch import Tensor

from pedzoo.core.batch import ROBOT
from pedzoo.core.bodies import HOLONOMIC
from pedzoo.core.errors import UserError, unknown
from pedzoo.core.geometry import TURNS_FROM, heading_of, identity_pose
from pedzoo.core.randomness import Draws, signed
from pedzoo.core.types import OBS_LEN, STEP_SECONDS, TRACE_SECONDS
from pedzoo.maps.planning.guidance import Guidance
from pedzoo.policies.rule_based.orca import OrcaSettings, orca_velocity
from pedzoo.sim import kernel
from pedzoo.sim.observation import dense
from pedzoo.sim.physics._base import Physics
from pedzoo.sim.physics.compiled import Compiled
from pedzoo.sim.scenario import MIN_INITIAL_PATH, Layout, PreparedScenario, Rules, deadline, filled, planned
from pedzoo.sim.state import PAST_LEN, TRACE_PER_STEP, State

WarmStart = Literal["orca", "igibson", "static", "recorded"]
"""``igibson``: its own ORCA, 10 times a second and in the physics of the scenes; the others begin alike in
all backends. It sees no walls, keeps 1 m between people, and walks no faster than they like to."""

WALKS = {
    "orca": OrcaSettings(radius=0.2, dt=STEP_SECONDS, max_obstacles=8),
    "igibson": OrcaSettings(preset="igibson", dt=TRACE_SECONDS, walls=False),
}
"""How people walk in a warm start: the same for every row of a table and every policy."""

TRIES = 8
"""Most draws of a goal for a person who begins near one."""

_MADE, _AGENTS_MADE, _DEEPEST = 512, 2560, 128
"""Limits of what is begun together when scenes end one by one: episodes, agents, and episodes of one row."""


class Episodes:
    """Makes the first state of any episode of a scenario, for as many at once as are asked for."""

    def __init__(
        self,
        prepared: PreparedScenario,
        warm_start: WarmStart,
        physics: Physics,
        rules: Rules,
        device: torch.device | str = "cpu",
    ) -> None:
        """Take a prepared scenario, and what says how its scenes begin.

        ``physics`` says how wide bodies are where nothing else does, and moves them in iGibson's warm start.
        Scenes are laid out on the CPU, alike for every ``device``, and then are there.

        Raises:
            UserError: There is no such warm start.
        """
        if warm_start not in get_args(WarmStart):
            raise unknown("warm_start", warm_start, get_args(WarmStart))
        self._prepared, self._warm_start = prepared, warm_start
        self._rules, self._device = rules, torch.device(device)
        alike = Compiled(prepared.bank, physics.body_radius)
        self._physics = physics if warm_start == "igibson" else alike

    @torch.no_grad()
    def begin(self, draws: Draws) -> State:
        """Return the first state of the episodes of ``draws``.

        Raises:
            UserError: The layout is none, or an agent's goal cannot be reached.
        """
        layout, scenario, rules = self._prepared.layout(draws), self._prepared.scenario, self._rules
        self._check(layout)
        begun, past = layout.person is not None, _stood(layout.start)
        if begun or self._warm_start == "recorded":
            if layout.history is None:
                raise UserError(
                    "warm_start recorded: this scenario has no recorded histories; use orca or static"
                )
            past = dense(layout.history)
        state = self._placed(draws.key, layout, past).to(self._device)
        velocity, until, heading = (
            None if value is None else value.to(self._device)
            for value in (layout.velocity, layout.deadline, layout.heading)
        )
        taken = state.controlled
        if not begun and self._warm_start in WALKS:
            state = self._rolled(state, WALKS[self._warm_start])
        guidance = rules.guidance(state)
        for _ in range(0 if begun else TRIES):  # goals that are too near are redrawn
            walks = state.mask & (state.stands <= 0) & (state.goal_id >= 0) & (state.next_goal >= 0)
            near = walks & (guidance.distance < MIN_INITIAL_PATH)
            if not near.any():
                break
            goal = torch.where(near, state.next_goal, state.goal_id)
            state = state._replace(goal_id=goal, goal_index=state.goal_index + near)
            guidance = rules.guidance(state)
        remaining_path = guidance.distance
        if bool(remaining_path.isinf().any()):  # others have squeezed an agent into a corner
            start = state._replace(past=_stood(layout.start).to(state.past))
            remaining_path = remaining_path.minimum(rules.guidance(start).distance)
        cut_off = ((taken | (state.stands > 0)) & remaining_path.isinf()).nonzero()
        if len(cut_off):
            raise self._no_way(state, guidance, *cut_off[0].tolist())
        if begun:  # played-back people may stand where no path leads away
            remaining_path = torch.where(remaining_path.isfinite(), remaining_path, 0.0)
        clock = torch.zeros_like(state.clock)
        waits = state._replace(clock=clock).holds
        stays = waits & state.stands.isinf() & (state.next_goal < 0)
        if until is None:
            until = deadline(clock, remaining_path, state.pref_speed, rules.deadline)
            if rules.deadline is None:
                until = until.clamp_min(scenario.patience)
        # neither a recording nor the warm start says how they came
        placed = rules.script is None if begun else self._warm_start == "static"
        position = state.position
        velocity = filled(velocity, (position - state.past[:, :, -2]) / TRACE_SECONDS)
        goes = filled(heading, heading_of(guidance.goal_point - position))
        faces = heading_of(velocity, goes, TURNS_FROM)
        if heading is not None:
            faces = torch.where(state.drive == HOLONOMIC, faces, heading)
        return state._replace(
            clock=clock,
            velocity=velocity,
            heading=faces,
            goal_point=guidance.goal_point,
            goal_since=torch.full_like(remaining_path, 0.0 if placed else -torch.inf),
            reached=scenario.goals * stays.long(),
            deadline=until.masked_fill(waits, torch.inf),
            overdue=torch.zeros_like(state.overdue),
            remaining_path=remaining_path,
            planned=torch.where(taken, planned(remaining_path), 0.0),
        )

    def _placed(self, key: Tensor, layout: Layout, past: Tensor) -> State:
        """Return agents where they start, before anything has happened."""
        pose = identity_pose(len(key), key.device) if layout.pose is None else layout.pose
        row = self._prepared.planner.map_rows(layout.map_id)
        frame, place = self._prepared.bank.walls_of_scenes(row, pose)
        stands = torch.zeros_like(layout.pref_speed) if layout.stand is None else layout.stand
        given = {name: value for name, value in layout._asdict().items() if name in State._fields}
        given |= {"key": key, "row": row, "wall_frame": frame, "wall_place": place, "pose": pose}
        # where a layout says more, it says how all is after the warm start
        given |= {"velocity": None, "deadline": None, "goal_id": layout.goal}
        given["radius"] = filled(layout.radius, torch.full_like(stands, self._physics.body_radius))
        given["controlled"] = filled(layout.controlled, layout.mask & (stands <= 0))
        given["stands"] = stands if layout.hold is None else stands.maximum(layout.hold)
        given["later_goals"] = self._later_goals(key, layout.goal) if layout.later is None else layout.later
        return State.of(past, **given)

    def _later_goals(self, key: Tensor, first: Tensor) -> Tensor:
        """Return the goals (B, A, G) that follow the ``first`` (B, A), drawn ahead; -1 for none."""
        scenario = self._prepared.scenario
        if not scenario.later:
            return torch.full((*first.shape, 1), -1, device=first.device)
        scenes, agents = first.shape
        slot = torch.arange(agents, device=first.device).repeat(scenes)
        draws, goal, goals = Draws(key.repeat_interleave(agents)), first.flatten(), []
        for number in range(1, scenario.later + 1):
            goal = scenario.next_goal(self._prepared, draws, slot, torch.full_like(slot, number), goal)
            goals.append(goal.view(scenes, agents))
        return torch.where((first >= 0).unsqueeze(2), torch.stack(goals, 2), -1)

    def _rolled(self, state: State, orca: OrcaSettings) -> State:
        """Return the state after 7 steps of 0.4 s with ORCA of people who begin to walk; goals are renewed.

        Robots, agents with wheels and agents that stand or wait where they start stay in place. The time
        of standing starts afterwards.
        """
        ticks = round(orca.dt / TRACE_SECONDS)
        rules = replace(self._rules, ticks=ticks, leave=False, keep_goal=True, script=None, waits=None)
        agents, controlled, stands = state.mask.shape[1], state.controlled, state.stands
        walks = controlled & (stands <= 0) & (state.drive == HOLONOMIC) & (state.kind != ROBOT)
        state = state._replace(controlled=walks, stands=torch.zeros_like(stands))
        map_id, poses = state.map_id.repeat_interleave(agents), state.pose.repeat_interleave(agents, 0)
        guidance = rules.guidance(state)
        # people are on their way already
        velocity = torch.where(walks.unsqueeze(2), guidance.desired_velocity, 0.0)
        state = state._replace(velocity=velocity, goal_point=guidance.goal_point)
        top_speed = state.top_speed.minimum(orca.top_speed_ratio * state.pref_speed)
        radius, near = orca.radii(state.radius, state.kind == ROBOT, state.controlled), None
        for _ in range((OBS_LEN - 1) * TRACE_PER_STEP // ticks):
            if orca.walls:
                reach, place = orca.wall_reach(top_speed, radius).flatten(), state.position.flatten(0, 1)
                near = self._prepared.bank.segments_near(place, map_id, poses, reach, orca.max_obstacles)
            wanted = torch.where(walks.unsqueeze(2), guidance.desired_velocity, 0.0)
            action = orca_velocity(
                state.position, state.velocity, wanted, top_speed, state.mask, orca, near, None, radius
            )
            before = state.position
            state, guidance, _ = kernel.step(state, action, self._physics, rules)
            state = state._replace(velocity=(state.position - before) / orca.dt)
        return state._replace(controlled=controlled, stands=stands)

    def _check(self, layout: Layout) -> None:
        """Check that floor plans and bodies are as the scenario says: sub-steps depend on these."""
        prepared, scenario, bank = self._prepared, self._prepared.scenario, self._prepared.bank
        name = type(scenario).__name__
        if not isinstance(layout, Layout):
            raise UserError(
                f"{name}.layout returned {type(layout).__name__}: expected a pedzoo.sim.scenario.Layout"
            )
        mask = layout.mask
        for field in ("start", "pref_speed"):
            if not getattr(layout, field)[mask].isfinite().all():
                raise UserError(
                    f"{field} of an agent in the layout of {name} is not finite: expected a number"
                )
        known = torch.tensor([-1, *(bank.id_of(plan) for plan in bank.names)], device=layout.map_id.device)
        if (foreign := ~torch.isin(layout.map_id, known)).any():
            plans = ", ".join(f"prepared.bank.id_of({plan!r})" for plan in bank.names[:3])
            raise UserError(
                f"map_id {int(layout.map_id[foreign][0])} in the layout of {name}: expected -1 for open floor"
                + (f", or one of {name}.plans, {plans}" if plans else f": {name}.plans() returns no plans")
            )
        radii, speeds = layout.radius, layout.top_speed
        least = scenario.smallest_radius or self._physics.body_radius
        if radii is not None and (tiny := mask & (radii < least - 1e-6)).any():
            raise UserError(
                f"radius {float(radii[tiny].min()):.3g} m of an agent in {name}: expected at least "
                f"{least:.3g}, or a smaller {name}.smallest_radius"
            )
        most = prepared.fastest_agent
        if speeds is not None and (hasty := mask & (speeds > most + 1e-6)).any():
            raise UserError(
                f"top_speed {float(speeds[hasty].max()):.3g} m/s of an agent in {name}: expected at most "
                f"{most:.3g}, or a larger {name}.fastest_agent"
            )
        wheels = (layout.drive, layout.acceleration, layout.turn_acceleration)
        if not scenario.wheels and any(value is not None for value in wheels):
            raise UserError(f"{name} has agents with wheels or limits: expected {name}.wheels = True")

    def _no_way(self, state: State, guidance: Guidance, scene: int, slot: int) -> UserError:
        here, there = (
            tuple(round(float(value), 2) for value in where[scene, slot])
            for where in (state.position, guidance.goal_point)
        )
        clearance = self._prepared.planner.clearance
        return UserError(
            f"no way from {here} to the goal {there} keeps {clearance} m from walls: passages have to be "
            f"wider than {2 * clearance} m, or the clearance smaller (--clearance, make_env(clearance=))"
        )


def _stood(start: Tensor) -> Tensor:
    """Return the first positions (B, A, 29, 2) of people who have stood still at ``start`` (B, A, 2)."""
    return start.unsqueeze(2).expand(-1, -1, PAST_LEN, -1).clone()


class Scenes(NamedTuple):
    """B scenes, and the planner's answer for them."""

    state: State
    guidance: Guidance

    @classmethod
    def of(cls, fields: Iterable[Tensor]) -> Scenes:
        """Return what has the fields of a state and a guidance, in their order."""
        values, count = tuple(fields), len(State._fields)
        return cls(State(*values[:count]), Guidance(*values[count:]))

    def select(self, index: Tensor) -> Scenes:
        """Return some of the scenes."""
        return self.of(value.index_select(0, index) for value in (*self.state, *self.guidance))


class EpisodeQueue:
    """Begins the episodes of a seed, those of B rows ``stride`` numbers apart.

    A warm start costs as much for one scene as for a hundred. So all rows without an episode get theirs as
    soon as one needs it, and several where rows are few.
    """

    def __init__(
        self,
        episodes: Episodes,
        rules: Rules,
        opened: Callable[[State], State],
        people: int,
        seed: int,
        rows: int,
        first: int,
        stride: int,
    ) -> None:
        """Take what makes first states of A ``people`` in B ``rows``, and ``opened``, which may change them.

        A row's first episode is number ``first`` plus its own.
        """
        self._episodes, self._rules, self._opened = episodes, rules, opened
        self._seed = torch.full((rows,), signed(seed % 2**64))
        self._number, self._stride = first + torch.arange(rows), torch.full((rows,), stride)
        made = min(_MADE, _AGENTS_MADE // people)
        self._depth = min(max(1, made // rows), _DEEPEST)
        self._taken = torch.full((rows,), self._depth)
        self._ahead: tuple[Tensor, ...] = ()
        self._begun = False

    def choose(self, rows: Tensor, seed: Tensor, first: Tensor, stride: int) -> None:
        """Choose other episodes for some rows (N,) long: their seeds and first numbers (N,) long."""
        self._seed, self._number = (
            self._seed.index_copy(0, rows, seed),
            self._number.index_copy(0, rows, first),
        )
        self._stride = self._stride.index_fill(0, rows, stride)
        self._taken = self._taken.index_fill(0, rows, self._depth)

    def begin_all(self) -> Scenes:
        """Return the next episode of every row."""
        rows = torch.arange(len(self._number))
        if not self._begun:
            self._begun = True
            return Scenes.of(self._made(rows, 1))
        place = self._next(rows)
        return Scenes.of(made.index_select(0, place) for made in self._ahead)

    def begin_some(self, scenes: Scenes, ended: Tensor) -> Scenes:
        """Return the scenes, with the next episode in the rows that have ended (B,) bool."""
        index = ended.nonzero().view(-1)
        place, fields = self._next(index.cpu()), (*scenes.state, *scenes.guidance)
        pairs = zip(fields, self._ahead, strict=True)
        return Scenes.of(field.index_copy(0, index, made.index_select(0, place)) for field, made in pairs)

    def _next(self, rows: Tensor) -> Tensor:
        """Return where the next episodes of rows are among those made ahead, which are made if need be."""
        depth = self._depth
        if bool((self._taken[rows] >= depth).any()):
            empty = (self._taken >= depth).nonzero().view(-1)
            made = self._made(empty, depth)
            places = (empty.unsqueeze(1) * depth + torch.arange(depth)).view(-1).to(made[0].device)
            # nothing is written in place: processes to which an environment was sent share its memory
            pairs = zip(self._ahead or made, made, strict=True)
            self._ahead = tuple(old.index_copy(0, places, new) for old, new in pairs)
            self._taken = self._taken.index_fill(0, empty, 0)
        place = rows * depth + self._taken[rows]
        self._taken = self._taken.index_add(0, rows, torch.ones_like(rows))
        return place.to(self._ahead[0].device)

    def _made(self, rows: Tensor, episodes: int) -> tuple[Tensor, ...]:
        """Return all fields of the next ``episodes`` of some rows, those of a row one after the other."""
        number = self._number[rows].unsqueeze(1) + self._stride[rows].unsqueeze(1) * torch.arange(episodes)
        self._number = self._number.index_add(0, rows, episodes * self._stride[rows])
        seed = self._seed[rows].repeat_interleave(episodes)
        state = self._episodes.begin(Draws.for_episodes(seed, number.view(-1)))
        return (*self._opened(state), *self._rules.guidance(state))
