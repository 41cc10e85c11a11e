"""``pedzoo info``: everything that is known about a model, from its card, without importing torch."""

from __future__ import annotations

from typing import TYPE_CHECKING

from msgspec.structs import asdict

from pedzoo.cli.output import check_outputs, print_tables, write_json, write_text
from pedzoo.core.errors import UserError
from pedzoo.core.registry import MODELS
from pedzoo.models.zoo.card_page import page, results, sections
from pedzoo.models.zoo.store import find, is_file, names, no_model

if TYPE_CHECKING:
    from pedzoo.models.zoo.card import ModelCard

HELP = "show a model's card: training, data and its terms, results, checksum"
EXAMPLE = "pedzoo info sgan_goal_map.zara1"


def run(name: str, /, json: str | None = None, markdown: str | None = None) -> int:
    """Print or write the card.

    Args:
        name: Zoo name, folder with a card, hf://OWNER/REPO or https:// address, or an architecture.
        json: Write the card to this file instead; - for here.
        markdown: Likewise, as a page.
    """
    check_outputs(json=json, markdown=markdown)
    if is_file(name):
        raise UserError(
            f"{name!r} is a file, and cards are asked for by name: FOLDER/ARCH.TAG, or a FOLDER; "
            "`pedzoo export CKPT --zoo` writes the card of a training run"
        )
    if (entry := find(name)) is None and name in MODELS.names():
        weights = ", ".join(one for one in names() if one.startswith(f"{name}.")) or "none"
        raise UserError(f"{name!r} is an architecture ({MODELS.describe(name)}); name its weights: {weights}")
    if entry is None:
        raise no_model(name)
    card = entry.card
    if json:
        write_json(json, {"command": "info", "card": asdict(card)})
    if markdown:
        write_text(markdown, page(card))
    if not (json or markdown):
        _print(card)
    return 0


def _print(card: ModelCard) -> None:
    from rich.table import Table

    from pedzoo.cli.progress import plain_console
    from pedzoo.eval.results import ResultTable

    console = plain_console(width=110)
    console.print(card.name, style="bold")
    for title, facts in sections(card).items():
        table = Table.grid(padding=(0, 2))
        table.add_column(no_wrap=True)
        table.add_column(overflow="fold")
        for key, value in facts.items():
            table.add_row(f"  {key}", value)
        console.print(f"\n{title}", style="bold")
        console.print(table)
    if not card.evaluations:
        console.print("\nResults: not measured yet")
    for result in results(card):
        console.print(f"\n{result.said}")
        print_tables([ResultTable("", result.head, result.rows, 1)])
