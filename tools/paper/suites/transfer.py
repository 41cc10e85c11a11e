"""Robots among each kind of people: in rooms of training, on floor plans never seen, in recorded crowds."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar, NamedTuple

from pedzoo.core.spec import parse
from pedzoo.eval.suite import EvaluationCase, EvaluationOptions
from pedzoo.eval.suites.replay import digest_of
from pedzoo.eval.suites.robots import APARTMENTS, ROBOT, Robots
from tools.zoo.robots import PEOPLE

EPISODES = 50

FOLD = "zara1"
"""The recorded crowd."""

REACTING = "sgan"
"""The kind of people that recorded people become where they react."""


class Place(NamedTuple):
    """Where robots drive.

    Attributes:
        title: What tables call it.
        scenario: With settings.
        effort: What an episode costs beside others.
    """

    title: str
    scenario: str
    effort: float


_TRAINED = ",".join(f"apartment.{seed}" for seed in range(10, 18))

PLACES: Mapping[str, Place] = {
    "rooms": Place("floor plans of training", f"goals:map=[{_TRAINED}],people=6,goals=1,pool=12", 7.0),
    "doors": Place("doors", "door:people=6", 5.0),
    "unseen": Place("floor plans never seen", f"goals:map=[{APARTMENTS}],people=6,goals=1,pool=12", 7.0),
}
"""By name; people of each of `PEOPLE` walk in all of them."""

RECORDED: Mapping[str, Place] = {
    "played back": Place("recorded people who do not react", f"replay:fold={FOLD},simulated=one", 300.0),
    "reacting": Place("recorded people who react", f"replay:fold={FOLD},simulated=around", 900.0),
}
"""A robot takes the place of one person after the other."""


class Transfer(Robots):
    """Every place with every kind of people; robots may have learned among any of them."""

    accepted_options: ClassVar[tuple[str, ...]] = ("episodes", "robot")

    def cases(self, options: EvaluationOptions) -> list[EvaluationCase]:
        """Return a case for each place and kind of people, and two of a recorded crowd."""
        result = [
            self._case(options, where, place, kind, people, options.number(EPISODES))
            for where, place in PLACES.items()
            for kind, people in PEOPLE.items()
        ]
        for where, place in RECORDED.items():
            # in place of `root` in the scenario: `Spec` keeps commas in folders
            spec = parse(place.scenario)
            if options.root is not None:
                spec = spec._replace(settings=dict(spec.settings) | {"root": options.root})
            case = self._case(options, where, place, REACTING, PEOPLE[REACTING], 0)
            result.append(case._replace(scenario=spec, inputs=digest_of(FOLD, options.root)))
        return result

    def _case(
        self, options: EvaluationOptions, where: str, place: Place, kind: str, people: str, episodes: int
    ) -> EvaluationCase:
        more: dict[str, Any] = {"physics": options.physics or "compiled", "robot": options.robot or ROBOT}
        return EvaluationCase(
            suite=self.name,
            name=f"{where} {kind}",
            scenario=place.scenario,
            episodes=episodes,
            case={"place": where, "people": kind},
            effort=place.effort,
            table=f"{self.name} {where}",
            shares=where,
            people=people,
            **more,
        )

    def notes(self, options: EvaluationOptions, policies: Any) -> list[str]:
        """Return which robot drives."""
        return [f"the robot is {options.robot or ROBOT}; a touch ends its episode"]
