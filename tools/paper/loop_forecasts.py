"""What training in the loop costs in forecasts: errors of weights beside those of the weights before."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from pedzoo.core.spec import parse
from pedzoo.eval.results import ResultTable
from pedzoo.models.zoo.card import ModelCard
from pedzoo.models.zoo.store import find

MOST = 1.15
"""How much larger ADE may become."""


def forecasts(policies: Iterable[str]) -> ResultTable | None:
    """Return ADE of the most likely forecast beside that of the weights before, None where there are none.

    Both cards have to tell of the same windows by the same protocol; ``pedzoo evaluate NAME --from-card``
    measures them again.

    Args:
        policies: Any; those that are no weights of the zoo, or began with none, are left out.
    """
    body = []
    for name in dict.fromkeys(parse(policy).name for policy in policies):
        entry = find(name)
        before = _begun_with(entry.card) if entry else None
        if entry is None or before is None:
            continue
        for report in entry.card.evaluations:
            mine, theirs = _ade(report), _ade(_same(before, report))
            if mine is None or theirs is None:
                continue
            ratio = mine / theirs
            met = "met" if ratio <= MOST else f"{ratio:.3f}, not at most {MOST}"
            where = f"{report['protocol']['fold']} {report['protocol']['split']}"
            body.append([name, where, met, f"{mine:.4f}", before.name, f"{theirs:.4f}", f"{ratio:.3f}"])
    title = f"forecasts: ade_m at most {MOST} x that of the weights before (cards, goal of the window's end)"
    head = ["weights", "windows", "target", "ade_m", "before", "ade_m", "ratio"]
    return ResultTable(title, head, body, 2) if body else None


def _begun_with(card: ModelCard) -> ModelCard | None:
    """Return the card of the weights with which a training began."""
    name = (card.training["overrides"] or {}).get("weights")
    entry = find(name) if isinstance(name, str) else None
    return entry.card if entry else None


def _same(card: ModelCard, report: dict[str, Any]) -> dict[str, Any] | None:
    """Return the report of a card that has the command and the protocol of another one."""
    wanted = report["command"], report["protocol"]
    return next((one for one in card.evaluations if (one["command"], one["protocol"]) == wanted), None)


def _ade(report: dict[str, Any] | None) -> float | None:
    if report is None or report["command"] != "forecast":
        return None
    return report["rows"][0]["metrics"].get("ade_m")
