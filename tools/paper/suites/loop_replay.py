"""Recorded crowds, all simulated: each fold has a table of its own, because each has to look human."""

from __future__ import annotations

from typing import ClassVar

from pedzoo.eval.suite import EvaluationCase, EvaluationOptions
from pedzoo.eval.suites.replay import Replay


class LoopReplay(Replay):
    """The cases of `Replay` in which all people are simulated."""

    simulated: ClassVar[tuple[str, ...]] = ("all",)
    columns: ClassVar[tuple[str, ...]] = (
        "realism",
        "success",
        "deadlock",
        "time_ratio_median",
        "closed_loop_ade_m",
        "acceleration_p95_ratio",
        "acceleration_p99_ratio",
        "agent_contact_excess",
        "agent_contact_excess_per_min",
        "wall_contact_excess_per_min",
    )

    def cases(self, options: EvaluationOptions) -> list[EvaluationCase]:
        """Return a case for each fold of which there are recordings, else for the embedded one.

        Raises:
            UserError: A folder was asked for that has none.
        """
        result = super().cases(options)
        return [case._replace(table=f"{self.name} {case.case['fold']}") for case in result]
