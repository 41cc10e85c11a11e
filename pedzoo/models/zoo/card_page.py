"""What people read of a model card: the same parts on a terminal and on a page of Markdown. No torch."""

from collections.abc import Iterable, Mapping, Sequence
from typing import Any, NamedTuple

from pedzoo.models.zoo.card import ModelCard
from pedzoo.models.zoo.store import ROBOTS

_OF_PEOPLE = (
    "A pedestrian model of pedzoo: it forecasts trajectories, and one step at a time it walks.\n",
    '```python\nimport pedzoo\n\nmodel = pedzoo.load("{}")\n```\n',
    "```\npedzoo rollout {} --scenario door\n```\n",
)

_OF_ROBOT = (
    "A robot that learned among simulated people.\n",
    "```python\nfrom pedzoo.policies.load import load_robot_policy\n\n"
    'policy = load_robot_policy("{}")\n```\n',
)


class Results(NamedTuple):
    """A table of what was measured: metrics as rows, cases as columns.

    Attributes:
        said: How: the command and its protocol.
        head: The columns; the first one has the names of metrics.
        rows: Cells.
    """

    said: str
    head: list[str]
    rows: list[list[str]]


def page(card: ModelCard) -> str:
    """Return the card as a page of Markdown."""
    parts = [
        f"# {card.name}\n",
        *(part.format(card.name) for part in (_OF_ROBOT if card.name.startswith(ROBOTS) else _OF_PEOPLE)),
        "## Results\n",
        *(f"{result.said}\n\n{_table(result.head, result.rows)}" for result in results(card)),
        *([] if card.evaluations else ["Not measured yet.\n"]),
    ]
    for title, facts in sections(card).items():
        parts.append(f"## {title}\n\n{_table(('', ''), facts.items())}")
    return "\n".join(parts)


def sections(card: ModelCard) -> dict[str, dict[str, str]]:
    """Return what a card says beside its results, as titled lists of texts; what is not known is left out."""
    training = card.training | {
        "seeds": ", ".join(f"{seed}: {value:.4f}" for seed, value in (card.training["seeds"] or {}).items()),
        "command": " ".join(map(str, card.training["command"] or [])),
        "overrides": ", ".join(f"{key}={value}" for key, value in (card.training["overrides"] or {}).items()),
    }
    result: dict[str, Mapping[str, Any]] = {
        "Weights": {
            "file": card.file,
            "size": f"{card.size:,} bytes",
            "sha256": card.sha256,
            "url": card.url,
            "licence": card.licence,
        },
        "Training": training,
        "Data": card.data | {"recordings": ", ".join(map(str, card.data["recordings"]))},
        "Protocol": card.config.get("protocol", {}),
        "Settings": {"architecture": card.architecture, **card.config["init"]},
        "Versions": card.versions,
    }
    return {
        title: {str(key): str(value) for key, value in facts.items() if value not in (None, "")}
        for title, facts in result.items()
        if facts
    }


def results(card: ModelCard) -> list[Results]:
    """Return a table for every evaluation."""
    return [_results(report, card.name) for report in card.evaluations]


def _results(report: Mapping[str, Any], own: str) -> Results:
    rows = report["rows"]
    metrics = list(dict.fromkeys(metric for row in rows for metric in row["metrics"]))
    cells = [["n", *(str(row["n"]) for row in rows)]]
    cells += [[metric, *(_number(row, metric) for row in rows)] for metric in metrics]
    protocol = report["protocol"]
    said = f"{_said(report['command'])}: {_said(protocol)}; seeds {_said(report['seeds'])}"
    if protocol.get("goal") == "window_end":
        said += ". The goal is where the person is at the window's end: it leaks the answer's last position"
    return Results(said, ["", *(_case(row, own) for row in rows)], cells)


def _said(value: Any) -> str:
    """Return a value of a protocol as it is said: what is true by its name, what is false not at all."""
    if isinstance(value, Mapping):
        parts = (
            (key, "" if one is True else f" {_said(one)}") for key, one in value.items() if one is not False
        )
        return ", ".join(f"{key}{text}" for key, text in parts)
    return " ".join(map(_said, value)) if isinstance(value, list) else str(value)


def _case(row: Mapping[str, Any], own: str) -> str:
    """Return what tells a row from others: its table or case, and its name where it is another model's."""
    case = row.get("table") or " ".join(str(value) for value in row["case"].values())
    return str(case) if row["name"] == own else f"{row['name']} {case}".rstrip()


def _number(row: Mapping[str, Any], metric: str) -> str:
    """Return a metric with its 95 % interval, a dash where there is none."""
    if metric not in row["metrics"]:
        return "-"
    interval = ", ".join(f"{end:.3f}" for end in row["ci95"].get(metric, []))
    return f"{row['metrics'][metric]:.3f}" + (f" [{interval}]" if interval else "")


def _table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """Return a table of Markdown; what would end a cell is written so that it does not."""
    lines = [head, ["---"] * len(head), *rows]
    cells = [[" ".join(cell.replace("|", "\\|").split()) for cell in line] for line in lines]
    return "\n".join(f"| {' | '.join(line)} |" for line in cells) + "\n"
