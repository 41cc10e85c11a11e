"""Episodes of policies that have just walked, as a page and in a notebook."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from pedzoo.core.errors import UserError
from pedzoo.core.paths import PAGES, check_ending, write_atomically
from pedzoo.eval.comparison import PolicyRollout, row
from pedzoo.eval.packed_episodes import packed_episodes
from pedzoo.viz.report.content import add_report, shorten
from pedzoo.viz.report.page import framed, page


class Replay:
    """Episodes to look at: a notebook shows them, `save` writes them as a page of their own.

    Attributes:
        name: What stands above them.
    """

    def __init__(self, walked: Sequence[PolicyRollout], name: str = "episodes", seed: int = 0) -> None:
        """Take what policies did in the same scenes.

        Raises:
            UserError: There is nothing.
        """
        if not walked:
            raise UserError("nothing to show: expected at least one rollout")
        self.name, self._walked, self._seed = name, list(walked), seed

    def __repr__(self) -> str:
        names = ", ".join(one.name for one in self._walked)
        return f"Replay({self.name!r}: {names}; {len(self._walked[0].rollout.failed)} episodes)"

    def _repr_html_(self) -> str:
        return framed(self._content(), self.name)

    def save(self, path: str | Path) -> None:
        """Write the page, whole or not at all.

        Raises:
            UserError: It does not end in .html or .htm, or cannot be written.
        """
        check_ending(f"page {str(path)!r}", path, PAGES)
        try:
            write_atomically(Path(path).resolve(), page(self._content(), self.name).encode())
        except OSError as error:
            raise UserError(f"cannot write {str(path)!r}: {error.strerror}") from error

    def _content(self) -> dict[str, Any]:
        report: dict[str, Any] = {"command": "rollout", "rows": [], "plans": {}, "seeds": [self._seed]}
        report["protocol"] = {"scenario": self.name}
        for one in self._walked:
            episodes, plans = packed_episodes(one.rollout, one.env.bank, len(one.rollout.failed), self._seed)
            report["rows"].append(row(one.name, one.rollout) | {"episodes": episodes})
            report["plans"] |= plans
        content: dict[str, Any] = {"cases": [], "plans": {}, "tables": [], "charts": [], "notes": []}
        add_report(content, report)
        shorten(content)
        return {**content, "about": f"seed {self._seed}"}
