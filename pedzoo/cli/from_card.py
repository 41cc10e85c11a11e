"""``pedzoo evaluate NAME --from-card``: the numbers on a model card, done again."""

from collections.abc import Sequence
from itertools import groupby
from typing import Any

from pedzoo.cli.output import print_tables, write_json
from pedzoo.cli.progress import progress_bar
from pedzoo.core.machine import versions
from pedzoo.eval.cards import ComparedNumber, RepeatedReport, about, again, compare
from pedzoo.eval.results import ResultTable
from pedzoo.models.zoo.store import find, no_model

_WORDS = {True: "yes", False: "NO", None: "no interval"}


def redo(names: Sequence[str], root: str | None, workers: int, json: str | None) -> int:
    """Do all that the cards of some models say again and print it; returns the exit code.

    Args:
        names: Of models with a card.
        root: Folder with recordings; None for the variable ``PEDZOO_DATA``.
        workers: Processes that walk.
        json: File for the report.

    Returns:
        1 where a number is another one, or where none of a card could be looked at.

    Raises:
        UserError: A name without a card, or a card without numbers.
    """
    cards = {}
    for name in names:
        if (entry := find(name)) is None:
            raise no_model(name, kind="model with a card")
        cards[name] = entry.card
    rows: list[dict[str, Any]] = []
    agree = True
    seeds = sorted({seed for card in cards.values() for one in card.evaluations for seed in one["seeds"]})
    report = {"command": "evaluate", "protocol": {"from_card": list(cards)}, "seeds": seeds}
    report |= {"versions": versions(), "rows": rows}
    for name, card in cards.items():
        with progress_bar() as progress:
            result = again(card, name, root, workers, progress)
        numbers = [number for one in result if one.now for number in compare(one.before, one.now)]
        rows += _rows(name, result, numbers)
        if json and json != "-":
            write_json(json, report)
        _tell(name, result, numbers)
        agree = agree and bool(numbers) and all(number.same is not False for number in numbers)
    if json == "-":
        write_json(json, report)
    return int(not agree)


def _tell(name: str, result: Sequence[RepeatedReport], numbers: Sequence[ComparedNumber]) -> None:
    """Print the table of a card, what a reader of it has to know, and the sum of it all."""
    body = [
        [one.case, one.metric, _shown(one.card, one.interval), _shown(one.now), _WORDS[one.same]]
        for one in numbers
    ]
    if body:
        print_tables([ResultTable(name, ["case", "number", "card", "now", "same"], body, 2)])
    for one in result:
        what = about(one.before["protocol"])
        if not one.now:
            print(f"{what}: skipped, {one.why}")
            continue
        then, now = one.before["versions"], one.now["versions"]
        packages = [key for key in then if key != "commit" and then[key] != now.get(key)]
        if changed := [f"{key} {then[key]} (here {now.get(key, 'absent')})" for key in packages]:
            print(f"{what}: the card was made with {', '.join(changed)}")
    if not numbers:
        print(f"{name}: nothing of its card could be done again")
        return
    same, unsure = (sum(one.same is which for one in numbers) for which in (True, None))
    text = f"{name}: {same} of {len(numbers)} numbers are those of the card"
    print(text + f"; {unsure} differ and have no interval to judge by" * bool(unsure))


def _shown(value: float | None, interval: Sequence[float] | None = None) -> str:
    if value is None:
        return "-"
    return f"{value:.4g}" + (f" [{interval[0]:.3g}, {interval[1]:.3g}]" if interval else "")


def _rows(
    name: str, result: Sequence[RepeatedReport], numbers: Sequence[ComparedNumber]
) -> list[dict[str, Any]]:
    """Return a row for every case, with the card's numbers beside today's, and for what was skipped."""
    rows: list[dict[str, Any]] = []
    for case, group in groupby(numbers, key=lambda number: number.case):
        mine = {number.metric: number for number in group}
        people = mine.pop("n")
        now = {metric: number.now for metric, number in mine.items() if number.now is not None}
        row = {"name": name, "case": {"evaluation": case}, "n": people.now, "metrics": now, "ci95": {}}
        row["card"] = {metric: number.card for metric, number in mine.items()}
        rows.append(row | {"same": {metric: number.same for metric, number in mine.items()}})
    for one in result:
        if not one.now:
            case = {"evaluation": about(one.before["protocol"]), "skipped": one.why}
            rows.append({"name": name, "case": case, "n": 0, "metrics": {}, "ci95": {}})
    return rows
