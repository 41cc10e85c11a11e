"""Recorded people, simulated from their real entry to their real exit among played-back people."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import ClassVar, get_args

import numpy as np
import torch
from torch import Tensor

from pedzoo.core.errors import UserError, unknown
from pedzoo.core.geometry import passes_goal
from pedzoo.core.randomness import Draws
from pedzoo.core.types import GOAL_RADIUS, STEP_SECONDS
from pedzoo.data.recordings import OpenFold, OwnFiles, Scene, find_fold, grids_of, open_fold
from pedzoo.maps.bank import MapBank
from pedzoo.maps.grid import OccupancyGrid, Unknown
from pedzoo.maps.planning.guidance import Guidance
from pedzoo.maps.planning.planner import Planner, planner_class
from pedzoo.sim import kernel
from pedzoo.sim.dynamics import substeps
from pedzoo.sim.episodes import Episodes
from pedzoo.sim.physics.compiled import Compiled
from pedzoo.sim.recorded_people import RecordedPeople, SpeedOf, people_of, top_speed_of
from pedzoo.sim.rollout import Rollout, joined, rollout_of
from pedzoo.sim.scenario import Layout, PreparedScenario, Rules, Scenario, rules_of
from pedzoo.sim.script import Script, Simulated
from pedzoo.sim.state import TRACE_PER_STEP, State

CELL = 0.1
"""Metres: cells on which ways are planned."""

_AT_ONCE = 64
"""Scenes: as many of the recorded crowd as are walked together."""


class Replay(Scenario):
    """All people of a recording, on the true clock: played back for 8 steps, then moved by the policy.

    People leave within 0.3 m of where they really left the scene, and are taken out after twice the time
    that they really took. They are never put back on their track in between. Tracks of at most 8 steps, and
    people at their exit already, are only played back and do not react. Exits too near to walls move to the
    nearest walkable place, by 0.5 m at most. Unknown cells are free, and preferred speeds are those observed
    in the first 8 steps. Of the recording ahead a policy knows these, the exit, and the velocity of others'
    first step.

    A recording is cut where no person is left (in a recording of sparse crowds), so that its parts run side
    by side: part i of R is scene i, i + R, ... of every seed; only the policy's noise differs. With
    ``simulated=one`` each person has a scene of their own in which all others are played back; with
    ``simulated=around`` the policy moves them from the moment at which it would have taken them over.
    """

    unknown: Unknown = "free"
    place_of_robot: ClassVar[Mapping[str, tuple[str, ...]]] = {
        "simulated": ("one", "around"),
        "stops": ("false",),
    }

    def __init__(
        self,
        fold: str = "embedded",
        root: str | None = None,
        files: list[str] | None = None,
        dt: float | None = None,
        map: str | None = None,
        homography: str | None = None,
        simulated: Simulated = "all",
        share: float = 1.0,
        speed: SpeedOf = "observed",
        stops: bool = False,
    ) -> None:
        """Set the recordings that `prepare` will read.

        Args:
            fold: Test recordings of eth, hotel, univ, zara1, zara2, ``embedded``, or ``file.py:Class:fold``.
            root: Folder of the recordings; by default PEDZOO_DATA, or that of `pedzoo download`.
            files: Your own recordings instead of a fold.
            dt: Seconds between consecutive frame numbers of ``files``; None where these say it.
            map: The floor plan of ``files``; without one there are no walls.
            homography: Text file of a 3x3 matrix from the positions in ``files`` to world metres.
            simulated: ``all``; ``one`` person per scene among all others as they were recorded; or
                ``around``: scenes as of ``one``, in which the policy moves the others, so that they react.
            share: Only people who come in this first share of the time are simulated, others are played
                back: a tenth gives a quick look.
            speed: The speed that people like: ``observed`` in their first 8 steps; ``estimated`` from those
                of them in which no person is near, for recordings of queues; or that of the whole ``track``,
                which uses the future. At least 0.3 m/s.
            stops: People have the places where they stood for 2 s or more as goals before their exit, and
                stay there as long as they did. That uses the future, as exits do.
        """
        super().__init__(people=1)
        for name, given, known in (("simulated", simulated, Simulated), ("speed", speed, SpeedOf)):
            if given not in get_args(known):
                raise unknown(name, given, get_args(known))
        if not 0 < share <= 1:
            raise UserError(f"replay: share {share}: expected a part of the time, above 0 and at most 1")
        if not files and (dt or map or homography):
            raise UserError(f"replay: dt, map and homography are of files; the fold {fold!r} has its own")
        named = find_fold(fold)
        self.name = "files" if files else named.name if named else fold
        self.simulated: Simulated = simulated
        self.waits = stops
        self._options = {"share": share, "speed": speed, "stops": stops}
        self._source: OpenFold | OwnFiles = (
            OwnFiles(files, dt, "0,0,1", map, homography) if files else open_fold(fold, root, "true")
        )
        self._data = (fold, root, files, dt, map, homography, self._options)

    def plans(self) -> list[OccupancyGrid]:
        """Return the floor plans of the recordings."""
        return [scene.grid for scene in self._scenes() if scene.grid is not None]

    def _scenes(self) -> list[Scene]:
        """Return the recordings with their floor plans, every file of which is read once."""
        recordings = self._source.recordings("test")
        read = grids_of(recordings)
        return [Scene.of(one.tracks, read[one.plan] if one.plan else None) for one in recordings]

    def prepare(self, clearance: float, planner: str = Planner.name) -> PreparedReplay:
        """Read the recordings, find people's paths to their exits, and give them slots.

        Prints how many people are simulated and played back. Its table has the floor plan of each recording.
        """
        recorded = self._scenes()
        # steps of 0.4 s from 0 on; a track with a hole goes on as another person's
        tracks = [scene.tracks.resampled(STEP_SECONDS) for scene in recorded]
        bank = MapBank([scene.grid for scene in recorded if scene.grid is not None], self.unknown)
        ways = planner_class(planner)(bank, clearance, cell=CELL)
        map_id = torch.tensor([scene.grid.map_id if scene.grid else -1 for scene in recorded])
        people, xy = people_of(tracks, bank.index(map_id).tolist(), ways, **self._options)
        if not people.controlled.any():
            raise UserError(f"replay: no person in {self.name!r} can be simulated: {people.counts}")
        home = torch.from_numpy(np.stack([scene.home for scene in recorded]))
        return self.with_slots(ways, map_id, home, people, xy)

    def adapted(self, other: PreparedScenario) -> PreparedScenario | None:
        """Return people and their ways of the same recordings, whether all are simulated there or one."""
        if not isinstance(other, PreparedReplay) or getattr(other.scenario, "_data", None) != self._data:
            return None
        return self.with_slots(other.planner, other.tables, other.home, other.persons, other.script.xy)

    def with_slots(
        self,
        planner: Planner,
        map_id: Tensor,
        home: Tensor,
        people: RecordedPeople,
        xy: Tensor,
        name: str = "",
    ) -> PreparedReplay:
        """Give people slots, and print how many are simulated and played back, under a name of their own.

        ``map_id`` is the floor plan of each recording, -1 for none; ``home`` is as of `PreparedReplay`, and
        ``xy`` (N, 2) are the rows of people's tracks, person after person.
        """
        script = Script.of_recordings(people, xy, self.simulated)
        result = PreparedReplay(scenario=self, planner=planner, tables=map_id, script=script, home=home)
        kinds = ", ".join(f"{count} {name}" for name, count in people.counts.items())
        print(
            f"replay {name or self.name}: {len(people.agent)} people in {result.scenes} scenes of at most "
            f"{result.people}: {kinds}" + f"; {int((people.pauses > 0).sum())} stops" * self.waits
        )
        return result

    def layout(self, prepared: PreparedScenario, draws: Draws) -> Layout:
        """Return the recorded beginning of scenes; they follow one another in the order of episodes."""
        script = prepared.script
        if draws.episode is None or script is None:
            raise ValueError("a replay needs the numbers of its episodes, Draws.for_episodes(seed, episode)")
        scene = draws.episode % len(script.scenes.table)
        begun = script.opening(scene)
        pref_speed = torch.where(begun["mask"], script.people.pref_speed[begun["person"]], self.speed)
        return Layout(
            map_id=prepared.tables[script.scenes.table[scene]],
            start=begun["history"][:, :, 0],
            pref_speed=pref_speed,
            top_speed=top_speed_of(pref_speed),
            **begun,
        )


@dataclass(frozen=True, eq=False, kw_only=True)
class PreparedReplay(PreparedScenario):
    """A replay with its people, and the recorded crowd itself.

    Attributes:
        script: Plays them back.
        home: Where the origin of each recording's scenes is in the recording (R, 2), float64: not 0 for
            recordings that are far from their own; see `pedzoo.data.recordings.Scene`.
    """

    script: Script  # type: ignore[misc]  # all fields are named, so that none needs a default
    home: Tensor

    @property
    def persons(self) -> RecordedPeople:
        """The recorded people: row p is ``person`` p of states and rollouts."""
        return self.script.people

    @property
    def scenes(self) -> int:
        """R, scenes of one round."""
        return len(self.script.scenes.table)

    def real(self) -> Rollout:
        """Return the recorded crowd as a rollout of one round, so that it is measured like everything else.

        Slots and trace are those of any rollout of it. ``controlled`` are the people that a policy would
        move, for as long as it would move them if it walked as they did: until they come within 0.3 m of
        their goal. From there on they have ``reached`` it. Others meet them until they really leave, so
        people may stand about at the exit where no policy controls an agent. Some never come so near, because
        the goal is not quite where they left: they reach it by leaving. Contacts are those of `compiled`.
        """
        return joined(list(self.real_parts()))

    def real_parts(self) -> Iterator[Rollout]:
        """Yield `real` in parts of some scenes, each only as long as these take."""
        fine, physics = substeps(self.fastest_agent), Compiled(self.bank)
        episodes = Episodes(self, "recorded", physics, rules_of(self, TRACE_PER_STEP, fine))
        script = self.script.as_recorded()
        rules = Rules(_still, TRACE_PER_STEP, fine, script=script)
        for number in torch.arange(self.scenes).split(_AT_ONCE):
            start = episodes.begin(Draws.for_episodes(0, number))
            origin, still = script.scenes.origin[start.scene], torch.zeros_like(start.position)
            scheduled = script.people_in_slots(start.scene, origin)
            state = start._replace(
                person=scheduled,
                mask=scheduled >= 0,
                controlled=torch.zeros_like(start.mask),
                goal_id=torch.full_like(scheduled, -1),
            )
            persons, steps = [], []
            for _ in range(int((script.scenes.last_exit[start.scene] - origin).max())):
                persons.append(state.person)
                state, _, events = kernel.step(state, still, physics, rules)
                steps.append(events._asdict())
            names = ("trace", "agent_contact", "wall_contact")
            walked = {name: torch.cat([step[name] for step in steps], 2) for name in names}
            walked |= self._arrivals(start.scene, torch.stack(persons, 2), walked["trace"])
            nobody = torch.zeros_like(start.mask)
            yield rollout_of(self.scenario, start, [walked], nobody, torch.zeros_like(start.failed))

    def _arrivals(self, scene: Tensor, person: Tensor, trace: Tensor) -> dict[str, Tensor]:
        """Return the other fields of a rollout over time, for the person in each slot and frame (B, A, F)."""
        script, people, points = self.script, self.persons, TRACE_PER_STEP
        frame = script.scenes.origin[scene].view(-1, 1, 1) + torch.arange(person.shape[2])
        had = script.scored(scene, person.flatten(1)).view_as(person) & (frame >= people.handover[person])
        leaves = had & (frame + 1 == people.last[person])
        begin = script.places(person, frame.expand_as(person)).unsqueeze(3)
        ways = torch.cat((begin, trace.unflatten(2, (-1, points))), 3)
        goal = people.goal.float()[person]
        came = had.unsqueeze(3) & passes_goal(ways[..., :-1, :], ways[..., 1:, :], goal.unsqueeze(3))
        came[..., -1] |= leaves
        person, had = (value.repeat_interleave(points, 2) for value in (person, had))
        point = torch.arange(person.shape[2])
        other = torch.ones_like(had)
        other[..., 1:] = person[..., 1:] != person[..., :-1]
        since = torch.where(other, point, 0).cummax(2).values
        reached = torch.where(came.flatten(2), point, -1).cummax(2).values >= since
        planned = (people.path_length.float() - GOAL_RADIUS).clamp_min(0)[person]
        return {
            "goal": goal.repeat_interleave(points, 2),
            "present": person >= 0,
            "person": person,
            "planned": torch.where(had, planned, 0.0),
            "reached": reached.long(),
            "controlled": had & (other | ~reached.roll(1, 2)),
        }


def _still(state: State) -> Guidance:
    """Return goals where people are, so that all stand."""
    position = state.position
    still, remaining_path = torch.zeros_like(position), torch.zeros_like(state.remaining_path)
    return Guidance(position, still, position, state.goal_point, remaining_path, position)
