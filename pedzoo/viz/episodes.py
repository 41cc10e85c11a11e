"""Episodes of policies that have just walked: in a notebook, as a page, as a plot."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import wraps
from pathlib import Path
from typing import Any, NamedTuple, ParamSpec

from pedzoo.core.errors import UserError, need
from pedzoo.core.paths import PAGES, check_ending, write_atomically
from pedzoo.eval import rollout as walked
from pedzoo.eval.comparison import PolicyRollout, row
from pedzoo.eval.packed_episodes import packed_episodes
from pedzoo.sim.env import PedestrianEnv
from pedzoo.sim.rollout import Rollout
from pedzoo.viz.report import add_report, empty_content, framed, page, shorten

P = ParamSpec("P")

Walked = tuple[Rollout, PedestrianEnv]
"""What `pedzoo.rollout` returns."""


class Replay:
    """Episodes to look at: a notebook shows them, `save` writes them as a page of their own."""

    def __init__(self, walked: Sequence[PolicyRollout], name: str = "episodes", seed: int = 0) -> None:
        """Take what policies did in the same scenes; `UserError` of nothing."""
        if not walked:
            raise UserError("nothing to show: expected at least one rollout")
        self.name, self._walked, self._seed = name, list(walked), seed

    def __repr__(self) -> str:
        names = ", ".join(one.name for one in self._walked)
        return f"Replay({self.name!r}: {names}; {len(self._walked[0].rollout.failed)} episodes)"

    def _repr_html_(self) -> str:
        return framed(self._content(), self.name)

    def save(self, path: str | Path) -> None:
        """Write the page, whole or not at all; `UserError` of another ending, or where it cannot be."""
        check_ending(f"page {str(path)!r}", path, PAGES)
        write_atomically(Path(path).resolve(), page(self._content(), self.name).encode())

    def _content(self) -> dict[str, Any]:
        rows, plans = [], {}
        for one in self._walked:
            episodes, its = packed_episodes(one.rollout, one.env.bank, len(one.rollout.failed), self._seed)
            rows.append(row(one.name, one.rollout) | {"episodes": episodes})
            plans |= its
        content, about = empty_content(), {"command": "rollout", "protocol": {"scenario": self.name}}
        add_report(content, {**about, "rows": rows, "plans": plans})
        shorten(content)
        return {**content, "about": f"seed {self._seed}"}


class ShownRollout(NamedTuple):
    """What a policy did, and where. It unpacks into these two, and a notebook shows its episodes."""

    rollout: Rollout
    env: PedestrianEnv

    def __repr__(self) -> str:
        return f"ShownRollout({self.env.policy_name!r}: {len(self.rollout.failed)} episodes)"

    def _repr_html_(self) -> str:
        return self._replay()._repr_html_()

    def save(self, path: str | Path) -> None:
        """Write the episodes as a page; errors as of `Replay.save`."""
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


def plot(walked: Walked | Mapping[str, Walked], path: str | Path, episode: int = 0) -> None:
    """Draw an episode at four moments, and the paths of all episodes; a row of panels per policy.

    ``walked`` is what `pedzoo.rollout` returned, or several of these by name, all in the same scenario; the
    path ends in ``.png``, ``.pdf`` or ``.svg``.

    Raises:
        UserError: No such episode, another suffix, or the file cannot be written.
    """
    need("video", "a plot")
    from pedzoo.viz.trajectories import plot_rollouts

    named = walked if isinstance(walked, Mapping) else {walked[1].policy_name: walked}
    plot_rollouts([PolicyRollout(name, *one) for name, one in named.items()], path, episode)
