"""From goal to goal through buildings, as in Table II of the paper on iGibson."""

from pathlib import Path
from typing import ClassVar

from pedzoo.core.spec import Spec
from pedzoo.eval.suite import EvaluationCase, EvaluationOptions, Suite
from pedzoo.maps.plans import load_plan
from pedzoo.sim.make import usual_physics

CELLS = ((2, 3), (2, 5), (3, 3), (3, 5), (5, 3))
"""People and goals of Table II."""

EPISODES = 20

DRAWN = tuple(f"{kind}.{seed}" for kind in ("apartment", "office") for seed in range(3))
"""Floor plans that need no file; every episode draws one of them."""

GIVEN = "given"
"""What tables call several floor plans that were asked for: every episode draws one of those."""

POOL = 12
"""Places among which goals are drawn, per floor plan: more of them cost seconds and change little."""


class Goals(Suite):
    """Every cell of Table II on drawn floor plans, and again on those that were given.

    The episodes of a cell are spread over its floor plans, so that as many people walk at once. What they do
    on large plans, whose ways take minutes, is waited for once.
    """

    accepted_options: ClassVar[tuple[str, ...]] = ("episodes", "maps")

    def cases(self, options: EvaluationOptions) -> list[EvaluationCase]:
        """Return five cases for the drawn floor plans and five for those that were given.

        Raises:
            UserError: There is no such floor plan.
        """
        plans = {"drawn": list(DRAWN)}
        if options.maps:
            plans[Path(options.maps[0]).stem if len(options.maps) == 1 else GIVEN] = list(options.maps)
        result = []
        for name, files in plans.items():
            inputs = " ".join(load_plan(file).digest for file in files)
            for people, goals in CELLS:
                settings = {"map": files, "people": people, "goals": goals, "pool": POOL}
                case = self.case(
                    options,
                    name=f"{name} {people}/{goals}",
                    scenario=Spec("goals", settings),
                    episodes=EPISODES,
                    case={"map": name, "people": str(people), "goals": str(goals)},
                    physics=usual_physics(),
                    inputs=inputs,
                    effort=people * goals,
                    table=f"{self.name} {name}",
                    shares=name,
                )
                result.append(case)
        return result
