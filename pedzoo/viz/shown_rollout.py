"""`pedzoo.rollout`: episodes that a notebook shows by itself."""

from __future__ import annotations

from collections.abc import Callable
from functools import wraps
from pathlib import Path
from typing import NamedTuple, ParamSpec

from pedzoo.eval import rollout as walked
from pedzoo.eval.comparison import PolicyRollout
from pedzoo.sim.env import PedestrianEnv
from pedzoo.sim.rollout import Rollout
from pedzoo.viz.report.episode import Replay

P = ParamSpec("P")


class ShownRollout(NamedTuple):
    """What a policy did. It unpacks into its two parts, and a notebook shows its episodes.

    Attributes:
        rollout: The episodes.
        env: Where they were walked.
    """

    rollout: Rollout
    env: PedestrianEnv

    def __repr__(self) -> str:
        return f"ShownRollout({self.env.policy_name!r}: {len(self.rollout.failed)} episodes)"

    def _repr_html_(self) -> str:
        return self._replay()._repr_html_()

    def save(self, path: str | Path) -> None:
        """Write the episodes as a page, whole or not at all.

        Raises:
            UserError: It does not end in .html or .htm, or cannot be written.
        """
        self._replay().save(path)

    def _replay(self) -> Replay:
        name = self.env.policy_name
        return Replay([PolicyRollout(name, *self)], name, self.env.seed)


def _shown(function: Callable[P, tuple[Rollout, PedestrianEnv]]) -> Callable[P, ShownRollout]:
    @wraps(function)
    def shown(*args: P.args, **kwargs: P.kwargs) -> ShownRollout:
        return ShownRollout(*function(*args, **kwargs))

    return shown


rollout = _shown(walked.rollout)
