"""A robot among people: doors, corridors, crossings, apartments, an office, the open; and recorded crowds."""

from collections.abc import Mapping, Sequence
from typing import Any, cast

from pedzoo.core.bodies import RobotBody
from pedzoo.core.errors import UserError
from pedzoo.core.registry import ROBOTS
from pedzoo.core.spec import Spec, build, name_of, parse
from pedzoo.eval.robots import prepared_scenes, robot_rollout, robot_row
from pedzoo.eval.suite import (
    EvaluationCase,
    EvaluationOptions,
    ShareDone,
    Suite,
    WorkUnit,
    kept_episodes,
    with_seeds,
)
from pedzoo.eval.suites.replay import digest_of
from pedzoo.metrics.robots import LEGEND
from pedzoo.policies.load import load_policy, load_robot_policy
from pedzoo.sim.rollout import joined

EPISODES = 50

ROBOT = "disc"
"""The body where nothing else is said."""

PEOPLE = ("orca", "social_force:preset=indoor", "approach_net_goal_map.indoor", "replay")
"""Policies of the people by default."""

REPLAY = "replay"
"""Recorded people, as settings of the scenario of that name; a robot takes the place of one of them."""

APARTMENTS = ",".join(f"apartment.{seed}" for seed in range(4))

SCENES: Mapping[str, tuple[str, float]] = {
    "door": ("door:width=1.2,people=2", 3.0),
    "corridor": ("hallway:people=4", 5.0),
    "crossing": ("intersection:people=4", 5.0),
    "apartment": (f"goals:map=[{APARTMENTS}],people=6,goals=1,pool=12", 7.0),
    "office": ("goals:map=office.0,people=8,goals=1,pool=12", 9.0),
    "open": ("circle:people=5", 6.0),
}
"""Scenarios by what tables call them, and what an episode costs beside others."""


class Robots(Suite):
    """Every scene with every kind of people, and the same scenes without the robot."""

    accepted_options = ("episodes", "people", "robot")
    headline = ("success", "collision_person", "delay_s")
    columns = (
        *("success", "collision_person", "collision_wall", "timeout", "failed"),
        *("stl", "time_s", "delay_s", "intrusion_ratio"),
    )
    legend = LEGEND

    def check(self, policy: str) -> None:
        """Check the name of a robot's policy."""
        load_robot_policy(policy)

    def cases(self, options: EvaluationOptions) -> list[EvaluationCase]:
        """Return a case for each scene and kind of people; recorded people give their places one by one.

        Raises:
            UserError: An unknown body, policy or recording.
        """
        robot = options.robot or ROBOT
        build(ROBOTS, robot, RobotBody)
        result: list[EvaluationCase] = []
        for people in options.people or PEOPLE:
            common: dict[str, Any] = {"table": f"{self.name} {people}", "robot": robot}
            if name_of(people) == REPLAY:
                settings: dict[str, Any] = dict(parse(people).settings) | {"simulated": "one"}
                fold = settings.setdefault("fold", "embedded")
                if options.root is not None and fold != "embedded":
                    settings.setdefault("root", options.root)
                common["inputs"] = "" if "files" in settings else digest_of(fold, settings.get("root"))
                scenario = cast("Spec", parse(people)._replace(settings=settings))
                common |= {"effort": 1000.0, "shares": people, "case": {"scene": REPLAY, "people": people}}
                case = self.case(options, people, scenario, episodes=0, **common)
                result.append(case._replace(episodes=0))  # as many as there are
                continue
            load_policy(people)
            for name, (scenario, effort) in SCENES.items():
                common |= {"effort": effort, "shares": name, "case": {"scene": name, "people": people}}
                result.append(
                    self.case(options, f"{name} {people}", scenario, EPISODES, people=people, **common)
                )
        return result

    def notes(self, options: EvaluationOptions, policies: Sequence[str]) -> list[str]:
        """Return which robot drives, and what people of recordings do."""
        result = [
            f"{self.name}: the robot is {options.robot or ROBOT}; a touch ends its episode; the same scenes "
            "without it say what it does to people"
        ]
        if any(name_of(people) == REPLAY for people in options.people or PEOPLE):
            result.append(
                f"{self.name}: in {REPLAY} the robot takes the place of one person after the other; all "
                "others are played back and do not react, so it delays none of them"
            )
        return result

    def rows(self, unit: WorkUnit, tell: ShareDone | None = None) -> list[dict[str, Any]]:
        """Drive one unit and return its row."""
        case, parts, kept = unit.case, [], {}
        if not (episodes := case.episodes):  # as many as the recording has scenes
            script = prepared_scenes(case.scenario, (case.robot,)).script
            assert script is not None
            episodes = len(script.scenes.table)
        how: dict[str, Any] = {"robot": case.robot, "people": case.people or "orca", "physics": case.physics}
        how |= {"episodes": episodes, "deterministic": unit.deterministic, "device": unit.device}
        for number, seed in enumerate(unit.seeds):

            def share(done: float, number: int = number) -> None:
                if tell:
                    tell((number + done) / len(unit.seeds))

            try:
                part, env = robot_rollout(unit.walks, case.scenario, seed=seed, tell=share, **how)
            except UserError as error:
                raise UserError(f"{case.name}: robot {case.robot}: {error}") from error
            env.physics.close()
            parts.append(part)
            kept = kept or kept_episodes(unit, part.walked, env.bank)
        row = robot_row(unit.policy, joined(parts)) | kept
        with_seeds(row, unit.seeds, episodes)
        return [row]
