"""What people read of a model card, on a terminal, as Markdown, and as a folder of the Hugging Face hub.

Needs no torch.
"""

import re
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import msgspec
import yaml

from pedzoo.core.errors import UserError, unknown
from pedzoo.core.paths import CARD, WEIGHTS, write_atomically
from pedzoo.models.zoo.card import ModelCard, card_files, read_card, write_card
from pedzoo.models.zoo.store import ROBOTS, find, names, weights_of

TAGS = ("pedestrians", "trajectory-forecasting", "social-navigation", "crowd-simulation")

TERMS_FILE = "LICENSE.md"  # says on whose terms weights may be used

LICENCES = ("mit", "apache-2.0", "bsd-3-clause", "cc-by-4.0", "cc-by-sa-4.0", "cc-by-nc-4.0", "cc0-1.0")
"""Licences that the hub knows by these names; all others are ``other`` there."""

_OF_PEOPLE = """A pedestrian model of pedzoo: it forecasts trajectories, and one step at a time it walks.

```python
import pedzoo

model = pedzoo.load("{0}")
```

```
pedzoo rollout {0} --scenario door
```
"""

_OF_ROBOT = """A robot that learned among simulated people.

```python
from pedzoo.policies.load import load_robot_policy

policy = load_robot_policy("{0}")
```
"""

_FROM_HERE = """## From this repository

```python
import pedzoo  # pip install . in a checkout of pedzoo

model = pedzoo.load("hf://OWNER/REPOSITORY")  # as this page's address says
```

Weights are plain safetensors: nothing in this repository is code. They are checked against the card's sha256.
"""


_LEAKS = ". The goal is where the person is at the window's end: it leaks the answer's last position"


class Results(NamedTuple):
    """A table of what was measured: metrics as rows, cases as columns; and how, by which command."""

    said: str
    head: list[str]
    rows: list[list[str]]


def page(card: ModelCard) -> str:
    """Return the card as a page of Markdown."""
    parts = [
        f"# {card.name}\n",
        (_OF_ROBOT if card.name.startswith(ROBOTS) else _OF_PEOPLE).format(card.name),
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
    weights = {key: getattr(card, key) for key in ("file", "size", "sha256", "url", "licence")}
    result: dict[str, Mapping[str, Any]] = {
        "Weights": weights | {"size": f"{card.size:,} bytes"},
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
    tables = []
    for report in card.evaluations:
        rows, protocol = report["rows"], report["protocol"]
        metrics = dict.fromkeys(metric for row in rows for metric in row["metrics"])
        cells = [["n", *(str(row["n"]) for row in rows)]]
        cells += [[metric, *(_number(row, metric) for row in rows)] for metric in metrics]
        said = f"{_said(report['command'])}: {_said(protocol)}; seeds {_said(report['seeds'])}"
        said += _LEAKS * (protocol.get("goal") == "window_end")
        tables.append(Results(said, ["", *(_case(row, card.name) for row in rows)], cells))
    return tables


def _said(value: Any) -> str:
    """Format a value of a protocol; true flags by name, false ones omitted."""
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
    return f"{row['metrics'][metric]:.3f}" + f" [{interval}]" * bool(interval)


def _table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """Return a table of Markdown; what would end a cell is written so that it does not."""
    lines = [head, ["---"] * len(head), *rows]
    cells = [[" ".join(cell.replace("|", "\\|").split()) for cell in line] for line in lines]
    return "\n".join(f"| {' | '.join(line)} |" for line in cells) + "\n"


def write_hub(name: str, folder: str | Path) -> list[Path]:
    """Write a model as a folder that can be uploaded as it is, and return its files.

    ``pedzoo.load(folder)`` loads it again, and once it is uploaded ``pedzoo.load("hf://OWNER/REPO")`` does.
    Files of the same model are replaced.

    Raises:
        UserError: There is no such model, or the folder holds another one.
    """
    if (entry := find(name)) is None:
        raise unknown("model with a card", name, names())
    folder = Path(folder)
    # the files of the folder belong together, wherever they were from
    card = msgspec.structs.replace(entry.card, url=None)
    there = set(card_files(folder))
    if (folder / CARD).is_file():
        there.add(read_card(folder / CARD).name)
    if others := sorted(there - {card.name}):
        raise UserError(
            f"folder {str(folder)!r} holds {', '.join(others)} already: a repository of the hub is one "
            f"model's, so give {card.name} a folder of its own"
        )
    pages = {"README.md": readme(card), TERMS_FILE: terms(card)}
    write_atomically(folder / WEIGHTS, weights_of(entry).read_bytes())
    write_card(card, folder / CARD)
    for page_name, text in pages.items():
        write_atomically(folder / page_name, text.encode())
    return [folder / one for one in (WEIGHTS, CARD, *pages)]


def readme(card: ModelCard) -> str:
    """Return the page of a card with the front matter by which the hub, and pedzoo, know what is there."""
    licence = card.licence.lower()
    front: dict[str, Any] = {"license": licence}
    if licence not in LICENCES:
        slug = re.sub(r"[^a-z0-9.]+", "-", licence).strip("-")
        front = {"license": "other", "license_name": slug, "license_link": TERMS_FILE}
    front |= {"library_name": "pedzoo", "model_name": card.name, "tags": [*TAGS, card.architecture]}
    measured = []
    for report, row in ((one, row) for one in card.evaluations for row in one["rows"]):
        task = {"forecast": "trajectory-forecasting"}.get(report["command"], "closed-loop-simulation")
        case = " ".join(str(value) for value in row["case"].values()) or str(row.get("table", task))
        if "goal" in report["protocol"]:  # without it numbers of several protocols would be compared
            case += f", goal {report['protocol']['goal']}"
        metrics = [{"type": key, "value": value} for key, value in row["metrics"].items()]
        dataset = {"type": re.sub(r"[^a-z0-9]+", "-", case.lower()).strip("-"), "name": case}
        measured.append({"task": {"type": task}, "dataset": dataset, "metrics": metrics})
    if measured:
        front["model-index"] = [{"name": card.name, "results": measured}]
    head = yaml.safe_dump(front, sort_keys=False, allow_unicode=True, width=110)
    return f"---\n{head}---\n\n{page(card)}\n{_FROM_HERE}"


def terms(card: ModelCard) -> str:
    """Return what the licence of a card means, as a page of Markdown."""
    said = card.data
    return (
        f"# Licence of the weights of {card.name}: {card.licence}\n\n"
        f"They were trained on: {said['source']}.\n\nTerms: {said['terms']}.\n\n"
        f"To cite: {said['citation']}.\n\n"
        "The code of pedzoo, which loads them, is under the MIT licence.\n"
    )
