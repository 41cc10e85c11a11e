"""Pages are plain English: their sentences are short."""

from __future__ import annotations

import re

import pytest
from helpers.pages import PAGES, ROOT, sentences

MOST = 25
"""Words of a sentence."""

TEXTS = PAGES | {"CONTRIBUTING.md": (ROOT / "CONTRIBUTING.md").read_text()}


def long(texts: list[str]) -> list[str]:
    """Return those with too many words."""
    return [text for text in texts if len([word for word in text.split() if re.search(r"\w", word)]) > MOST]


@pytest.mark.parametrize("page", TEXTS)
def test_sentences_are_short(page: str) -> None:
    assert len(sentences(TEXTS[page])) > 3
    assert long(sentences(TEXTS[page])) == []


def test_sentences_of_the_glossary_are_short() -> None:
    rows = [line for line in PAGES["docs/glossary.md"].splitlines() if line.startswith("| **")]
    cells = [re.sub(r"`[^`]*`,?", "", cell) for row in rows for cell in row.strip("| ").split(" | ")]
    assert len(cells) > 160 and long([one for cell in cells for one in re.split(r"(?<=[.?!])\s", cell)]) == []


def test_long_sentences_are_found() -> None:
    words = " ".join(["word"] * MOST)
    page = f"# {words} more\n\nShort. {words}.\n\n- `a b` {words}.\n- {words}\n  more.\n\n| {words} more |\n"
    assert long(sentences(page)) == [f"- code {words}.", f"- {words} more."]
    assert long(sentences(f"```bash\n{words} more\n```\n`core/spec.py`, `core/registry.py`: {words}.")) == []
