"""A folder as the Hugging Face hub wants it: weights, card, and a README made of the card. Needs no torch."""

import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import yaml

from pedzoo.core.errors import UserError, unknown
from pedzoo.core.paths import CARD, WEIGHTS, write_atomically
from pedzoo.models.zoo.card import ModelCard, read_card, write_card
from pedzoo.models.zoo.card_page import page
from pedzoo.models.zoo.layout import card_files, weights_beside
from pedzoo.models.zoo.store import find, names, weights_of

TAGS = ("pedestrians", "trajectory-forecasting", "social-navigation", "crowd-simulation")

TERMS_FILE = "LICENSE.md"
"""Says on whose terms weights may be used."""

LICENCES = ("mit", "apache-2.0", "bsd-3-clause", "cc-by-4.0", "cc-by-sa-4.0", "cc-by-nc-4.0", "cc0-1.0")
"""Licences that the hub knows by these names; all others are ``other`` there."""


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
    card = replace(entry.card, file=WEIGHTS, url=None)
    there = set(card_files(folder))
    if (own := folder / CARD).is_file():
        there.add(read_card(own).name)
    if others := sorted(there - {card.name}):
        raise UserError(
            f"folder {str(folder)!r} holds {', '.join(others)} already: a repository of the hub is one "
            f"model's, so give {card.name} a folder of its own"
        )
    files = [folder / WEIGHTS, own, folder / "README.md", folder / TERMS_FILE]
    weights = weights_of(entry).read_bytes()
    if (earlier := folder / f"{card.name}.yaml").is_file():
        weights_beside(earlier, read_card(earlier)).unlink(missing_ok=True)
        earlier.unlink()
    write_atomically(files[0], weights)
    write_card(card, files[1])
    write_atomically(files[2], readme(card).encode())
    write_atomically(files[3], terms(card).encode())
    return files


def readme(card: ModelCard) -> str:
    """Return the page of a card with the front matter by which the hub, and pedzoo, know what is there."""
    front = yaml.safe_dump(_front(card), sort_keys=False, allow_unicode=True, width=110)
    return f"---\n{front}---\n\n{page(card)}\n{_FROM_HERE}"


def terms(card: ModelCard) -> str:
    """Return what the licence of a card means, as a page of Markdown."""
    said = card.data
    return (
        f"# Licence of the weights of {card.name}: {card.licence}\n\n"
        f"They were trained on: {said['source']}.\n\nTerms: {said['terms']}.\n\n"
        f"To cite: {said['citation']}.\n\n"
        "The code of pedzoo, which loads them, is under the MIT licence.\n"
    )


_FROM_HERE = """## From this repository

```python
import pedzoo  # pip install . in a checkout of pedzoo

model = pedzoo.load("hf://OWNER/REPOSITORY")  # as this page's address says
```

Weights are plain safetensors: nothing in this repository is code. They are checked against the card's sha256.
"""


def _front(card: ModelCard) -> dict[str, Any]:
    licence = card.licence.lower()
    result: dict[str, Any] = {"license": licence}
    if licence not in LICENCES:
        slug = re.sub(r"[^a-z0-9.]+", "-", licence).strip("-")
        result = {"license": "other", "license_name": slug, "license_link": TERMS_FILE}
    result |= {"library_name": "pedzoo", "model_name": card.name, "tags": [*TAGS, card.architecture]}
    if results := [_result(report, row) for report in card.evaluations for row in report["rows"]]:
        result["model-index"] = [{"name": card.name, "results": results}]
    return result


def _result(report: dict[str, Any], row: dict[str, Any]) -> dict[str, Any]:
    """Return a row of a report as the hub's ``model-index`` has it: a task, a dataset and metrics."""
    task = {"forecast": "trajectory-forecasting"}.get(report["command"], "closed-loop-simulation")
    case = " ".join(str(value) for value in row["case"].values()) or str(row.get("table", task))
    if "goal" in report["protocol"]:  # a number without it would be compared with others of another protocol
        case += f", goal {report['protocol']['goal']}"
    metrics = [{"type": key, "value": value} for key, value in row["metrics"].items()]
    dataset = {"type": re.sub(r"[^a-z0-9]+", "-", case.lower()).strip("-"), "name": case}
    return {"task": {"type": task}, "dataset": dataset, "metrics": metrics}
