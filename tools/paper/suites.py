"""The suites of the paper's tables, and of what controllers in the loop have to show, for ``--suite``."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from itertools import product
from pathlib import Path
from typing import Any, ClassVar

import torch
from torch import Tensor

from pedzoo.core.spec import Spec, parse
from pedzoo.eval.rollout import joined, prepare, walk
from pedzoo.eval.suite import EvaluationCase, EvaluationOptions, ShareDone, Suite, WorkUnit, prepared
from pedzoo.eval.suites.replay import Replay, digest_of
from pedzoo.eval.suites.robots import APARTMENTS, ROBOT, Robots
from pedzoo.eval.suites.scenes import CELLS, EPISODES, GIVEN, POOL, Goals
from pedzoo.maps.plans import load_plan
from pedzoo.metrics import arrival, contacts
from pedzoo.metrics.closed_loop import closed_loop
from pedzoo.metrics.ratios import Ratio, ratio, summarised
from pedzoo.policies.load import load_policy
from pedzoo.policies.walker import has_noise, walkers
from pedzoo.sim.rollout import Rollout
from tools.paper.meetings import (
    OUTCOMES,
    PAPERS_OUTCOMES,
    first_through,
    outcome_ratios,
    passing_side,
    varied,
)
from tools.paper.method import PAPERS_WORLD, WORLDS
from tools.zoo.robots import PEOPLE

Columns = ClassVar[tuple[str, ...]]

# Table II

APARTMENTS_2 = tuple(f"apartment.{seed}" for seed in range(3))
"""Floor plans of Table II where none is given: every episode draws one of them."""

SPEEDS = {"0.5": (0.5, 0.0), "1.3": (1.3, 0.2)}
"""m/s, mean and deviation: as all of iGibson's people do, and as people walk."""


class Table2(Suite):
    """Table II: each cell at both speeds, on the floor plans that are given or on three drawn ones.

    All policies walk in the paper's world; in each world with one change the first of them walks, too.
    """

    warm_start: ClassVar[str] = WORLDS[PAPERS_WORLD].warm_start
    accepted_options: Columns = ("episodes", "maps")
    columns: Columns = (
        *("success", "episode_success", "time_s", "seconds_per_goal", "goals_per_person"),
        *("agent_contacts_per_min", "wall_contacts_per_min"),
    )

    def cases(self, options: EvaluationOptions) -> list[EvaluationCase]:
        """Return five cases for each world and speed; errors of a floor plan that is not there."""
        files = list(options.maps or APARTMENTS_2)
        name = "drawn" if not options.maps else Path(files[0]).stem if len(files) == 1 else GIVEN
        inputs = " ".join(load_plan(file).digest for file in files)
        result = []
        every = product(WORLDS.items(), SPEEDS.items(), CELLS)
        for (world, how), (speed, (mean, deviation)), (people, goals) in every:
            cell = {"map": files, "people": people, "goals": goals, "pool": POOL}
            spec = Spec("goals", cell | {"speed": mean, "speed_std": deviation})
            where = {"map": name, "world": world, "speed": speed}
            where |= {"people": str(people), "goals": str(goals)}
            more: dict[str, Any] = {"inputs": inputs, "effort": people * goals / mean, **how.settings}
            more |= {"table": f"{self.name} {speed} m/s, {world}", "shares": ", ".join(files)}
            label = f"{world} {speed} m/s {people}/{goals}"
            result.append(self.case(options, label, spec, EPISODES, where, how.physics, **more))
        return result

    def units(
        self, case: EvaluationCase, policies: Sequence[str], seeds: tuple[int, ...], deterministic: bool
    ) -> list[WorkUnit]:
        """Return the work on a case: of all policies in the paper's world, of the first one in others."""
        walk = policies if case.case["world"] == PAPERS_WORLD else policies[:1]
        return super().units(case, walk, seeds, deterministic)

    def more(self, rollout: Rollout) -> dict[str, Ratio]:
        """Return ``seconds_per_goal``, of episodes in which every person reaches all goals in time."""
        last = arrival.episode_seconds(rollout)
        return {"seconds_per_goal": ratio(*arrival.seconds_per_goal(last, rollout.reached, rollout.mask))}


# Figure 4

SPEED_RATIO = 0.7
"""Speed of the one from the right, divided by that of the one from the left, where they are unequal."""

_HEAD_ON = "door:offset=0,speed_std=0"
NARROW_DOORS = {
    "equal": _HEAD_ON,
    "unequal": f"{_HEAD_ON},speed_ratio={SPEED_RATIO}",
    "alone": f"{_HEAD_ON},people=1",
}
"""A single person has no one to avoid: a policy that is blocked there does not fit through the door."""


class Figure4(Suite):
    """Figure 4: two people of equal speed, two of unequal speed, and one alone, at a narrow door."""

    warm_start: ClassVar[str] = WORLDS[PAPERS_WORLD].warm_start
    accepted_options: Columns = ("episodes",)
    headline: Columns = ("success", "agent_contact_episodes")
    columns: Columns = (
        *("success", *(f"outcome_{name}" for name in OUTCOMES), *PAPERS_OUTCOMES),
        *("agent_contact_episodes", "wall_contact_episodes", "time_s", "least_distance_m"),
        *("symmetry_index", "yield_delay_s", "bearing_sweep_deg"),
    )

    def cases(self, options: EvaluationOptions) -> list[EvaluationCase]:
        """Return three cases for each speed, each with a table of its own: a mean over them says nothing."""
        how, result = WORLDS[PAPERS_WORLD], []
        for speed, (name, scenario) in product(SPEEDS, NARROW_DOORS.items()):
            where, more = {"speed": speed, "speeds": name}, {"table": f"{self.name} {speed} m/s {name}"}
            spec = f"{scenario},speed={speed}"
            more |= how.settings
            result.append(self.case(options, f"{speed} {name}", spec, 100, where, how.physics, **more))
        return result

    def more(self, rollout: Rollout) -> dict[str, Ratio]:
        """Return how the two get past each other."""
        return outcome_ratios(rollout)


# Controllers in the loop

_WIDE = "width=[0.7,0.8,0.9,1.0,1.1,1.2]"
_SIDES = "offset=[-0.4,0.0,0.3,0.6]"
_VARIED = f"{_WIDE},thickness=[0.1,0.15,0.2],{_SIDES}"
_HARD = f"door:width=[0.7,0.75,0.8,0.85],thickness=[0.1,0.15,0.2],{_SIDES},away=[2.5,4],sync=0.4"

DOORWAYS: dict[str, tuple[str, int, str, int]] = {
    "varied": (f"door:{_VARIED},away=[2.5,4]", 1000, "bullet", 2),
    "hard": (_HARD, 500, "bullet", 2),
    "mirror": (f"door:{_VARIED},jitter=0,speed_std=0", 500, "bullet", 2),
    "2 against 2": (f"door:{_VARIED},people=4", 200, "bullet", 4),
    "3 against 1": (f"door:{_VARIED},people=4,from_right=1", 200, "bullet", 4),
    "queue of 6": (f"door:{_VARIED},people=6,from_right=0", 200, "bullet", 6),
    "standing": (f"standing:{_WIDE},{_SIDES}", 300, "bullet", 2),
    "flow of 20": (
        "room_exit:people=20,entering=0,width=[0.8,0.9,1.0,1.1,1.2]", 20, "compiled", 20,
    ),
}  # fmt: skip
"""Scenario, episodes of a whole run, physics, and people in each episode."""


class LoopDoors(Suite):
    """Doors to hold up at: varied, hard, symmetric, crowded and obstructed ones, and the flow of a queue."""

    accepted_options: Columns = ("episodes",)
    headline: Columns = ("clean",)
    columns: Columns = (
        *("clean", "episode_success", "contact_free", "deadlock", "failed"),
        *("agent_contact_episodes", "wall_contact_episodes", "time_ratio_median", "least_distance_m"),
        *("symmetry_m", "yield_delay_s", "faster_first", "specific_flow_per_m_s", "acceleration_m_per_s2"),
    )

    def cases(self, options: EvaluationOptions) -> list[EvaluationCase]:
        """Return one case for each doorway, with a table of its own: a mean over them says nothing."""
        result = []
        for name, (scenario, episodes, physics, people) in DOORWAYS.items():
            more: dict[str, Any] = {"effort": float(people), "table": f"{self.name} {name}"}
            result.append(self.case(options, name, scenario, episodes, {"doorway": name}, physics, **more))
        return result


CROWDS = {20: 6, 50: 4}
"""People in an office, and episodes of a whole run."""

OFFICES = tuple(f"office.{seed}" for seed in range(3))
"""Where the crowds walk; every episode draws one of them."""


class LoopBuildings(Goals):
    """The cases of ``goals``, on floor plans that no training walks through, and crowds with fast physics."""

    headline: Columns = ("episode_success", "contact_free")
    columns: Columns = (
        *("success", "episode_success", "contact_free", "clean", "deadlock", "failed"),
        *("agent_contacts_per_min", "wall_contacts_per_min", "contacts_per_min"),
        *("time_ratio", "time_ratio_median", "path_ratio"),
    )

    def cases(self, options: EvaluationOptions) -> list[EvaluationCase]:
        """Return those of `Goals` and one for each crowd; errors as there."""
        # of 40 places in an office few people have the same goal
        settings: dict[str, Any] = {"map": list(OFFICES), "goals": 1, "pool": 40}
        result = super().cases(options)
        for people, episodes in CROWDS.items():
            name, spec = f"crowd of {people}", Spec("goals", settings | {"people": people})
            where = {"map": "offices", "people": str(people), "goals": "1"}
            more: dict[str, Any] = {"effort": 3.0 * people, "table": f"{self.name} {name}"}
            result.append(self.case(options, name, spec, episodes, where, shares="offices", **more))
        return result

    def more(self, rollout: Rollout) -> dict[str, Ratio]:
        """Return ``contacts_per_min``: touches of others and of walls together."""
        scored = rollout.scored
        agents, walls = (
            contacts.contact_events(which & scored) for which in (rollout.agent_contact, rollout.wall_contact)
        )
        return {"contacts_per_min": ratio(agents + walls, contacts.person_minutes(scored))}


class LoopReplay(Replay):
    """Recorded crowds, all simulated: each fold has a table of its own, because each has to look human."""

    simulated: Columns = ("all",)
    columns: Columns = (
        *("realism", "success", "deadlock", "time_ratio_median", "closed_loop_ade_m"),
        *("acceleration_p95_ratio", "acceleration_p99_ratio"),
        *("agent_contact_excess", "agent_contact_excess_per_min", "wall_contact_excess_per_min"),
    )

    def cases(self, options: EvaluationOptions) -> list[EvaluationCase]:
        """Return a case for each fold of which there are recordings, else for the embedded one."""
        result = super().cases(options)
        return [case._replace(table=f"{self.name} {case.case['fold']}") for case in result]


DRAWS = 10
"""Of the noise, for each scene."""

ALSO = ("clean", "contact_free", "episode_success")
"""What says whether variety costs safety."""

CHOICES: dict[str, tuple[str, Callable[[Rollout], Tensor]]] = {
    "who goes first": (_HARD, first_through),
    "passing side": ("hallway:width=[2.0,2.5,3.0],aside=0.2,delay=0.5", passing_side),
}
"""What two people settle between them, at the hard door and nearly head-on in a corridor: where, and which
way, of a rollout (E,) float64: 0 or 1, NaN where they did not settle it."""


class LoopNoise(Suite):
    """What a model's noise changes: the same scenes are walked with several draws of it.

    A policy without noise would walk every scene alike: it has no rows.
    """

    accepted_options: Columns = ("episodes",)
    counted: ClassVar[str] = "scenes"
    headline: Columns = ("varied",)
    columns: Columns = ("varied", "disagreement", "settled", *ALSO)

    def cases(self, options: EvaluationOptions) -> list[EvaluationCase]:
        """Return one case for each choice."""
        effort = 2.0 * DRAWS
        return [
            self.case(
                options, name, scenario, 200, {"choice": name}, effort=effort, table=f"{self.name} {name}"
            )
            for name, (scenario, _) in CHOICES.items()
        ]

    def units(
        self, case: EvaluationCase, policies: Any, seeds: tuple[int, ...], deterministic: bool
    ) -> list[WorkUnit]:
        """Return the work on a case, of policies that have noise."""
        noisy = [] if deterministic else [name for name in policies if has_noise(load_policy(name))]
        return super().units(case, noisy, seeds, deterministic)

    def rows(self, unit: WorkUnit, tell: ShareDone | None = None) -> list[dict[str, Any]]:
        """Walk one unit, ``n`` scenes with `DRAWS` draws of noise each; intervals are over scenes."""
        case, settle = unit.case, CHOICES[unit.case.name][1]
        scenario, step = prepared(case.scenario, case.inputs), 0.0
        paths, also = [], {key: [] for key in ALSO}
        for draw in range(DRAWS):
            walked = []
            for number, seed in enumerate(unit.seeds):
                policy, env = prepare(
                    unit.walks, scenario, case.physics, case.episodes, seed, device=unit.device
                )
                for walker in walkers(policy):
                    walker.noise_seed = draw
                step = env.decision_dt
                try:
                    walked.extend(walk(policy, env, case.episodes))
                finally:
                    env.physics.close()
                if tell:
                    tell((draw + (number + 1) / len(unit.seeds)) / DRAWS)
            rollout = joined(walked)
            paths.append(settle(rollout))
            result = closed_loop(rollout)
            for key in ALSO:
                also[key].append(result[key].above)
        settled = torch.stack(paths, dim=1)
        ratios: dict[str, Ratio] = varied(settled)
        for key, values in also.items():
            total = torch.stack(values, dim=1)
            ratios[key] = ratio(total, torch.ones_like(total))
        metrics, intervals = summarised(ratios)
        row = {"name": unit.policy, "case": {}, "decision_dt_s": step, "n": len(settled), "draws": DRAWS}
        return [row | {"metrics": metrics, "ci95": intervals, "per_agent": []}]


# Robots

FOLD = "zara1"
"""The recorded crowd."""

REACTING = "sgan"
"""The kind of people that recorded people become where they react."""

_TRAINED = ",".join(f"apartment.{seed}" for seed in range(10, 18))

Places = Mapping[str, tuple[str, str, float]]
"""What tables call a place, the scenario, and what an episode costs beside others."""

PLACES: Places = {
    "rooms": ("floor plans of training", f"goals:map=[{_TRAINED}],people=6,goals=1,pool=12", 7.0),
    "doors": ("doors", "door:people=6", 5.0),
    "unseen": ("floor plans never seen", f"goals:map=[{APARTMENTS}],people=6,goals=1,pool=12", 7.0),
}
"""By name; people of each of `PEOPLE` walk in all of them."""

RECORDED: Places = {
    "played back": ("recorded people who do not react", f"replay:fold={FOLD},simulated=one", 300.0),
    "reacting": ("recorded people who react", f"replay:fold={FOLD},simulated=around", 900.0),
}
"""A robot takes the place of one person after the other."""


class Transfer(Robots):
    """Robots in each place with each kind of people; they may have learned among any of them."""

    accepted_options: Columns = ("episodes", "robot")

    def cases(self, options: EvaluationOptions) -> list[EvaluationCase]:
        """Return a case for each place and kind of people, and two of a recorded crowd."""
        kinds = [(place, kind) for place in PLACES for kind in PEOPLE]
        result = []
        for place, kind in [*kinds, *((place, REACTING) for place in RECORDED)]:
            _, scenario, effort = {**PLACES, **RECORDED}[place]
            more: dict[str, Any] = {"effort": effort, "table": f"{self.name} {place}", "shares": place}
            more |= {"people": PEOPLE[kind], "robot": options.robot or ROBOT}
            where = {"place": place, "people": kind}
            case = self.case(options, f"{place} {kind}", scenario, 50, where, **more)
            if place in RECORDED:  # as many episodes as there are
                spec = parse(scenario)
                if options.root is not None:  # in place of a text: `Spec` keeps commas in folders
                    spec = spec._replace(settings=dict(spec.settings) | {"root": options.root})
                digest = digest_of(FOLD, options.root)
                case = case._replace(scenario=spec, inputs=digest, episodes=0)
            result.append(case)
        return result

    def notes(self, options: EvaluationOptions, policies: Any) -> list[str]:
        """Return which robot drives."""
        return [f"the robot is {options.robot or ROBOT}; a touch ends its episode"]
