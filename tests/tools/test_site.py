"""`tools/pages/site`: what the site is made of exists. `tools/test` builds it."""

from __future__ import annotations

import re
import runpy
from importlib import import_module
from pathlib import Path
from typing import Any

import pytest

SITE = Path(__file__).parents[2] / "tools" / "pages" / "site"


@pytest.fixture(scope="module")
def site() -> dict[str, Any]:
    return runpy.run_path(str(SITE / "__main__.py"), run_name="site")


def test_every_page_of_docs_is_in_the_navigation(site: dict[str, Any]) -> None:
    listed = set(re.findall(r": docs/(\w+\.md)$", (SITE / "mkdocs.yml").read_text(), re.MULTILINE))
    assert listed == {page.name for page in (site["ROOT"] / "docs").glob("*.md")} - {"README.md"}


def test_everything_of_the_api_exists(site: dict[str, Any]) -> None:
    for name in (name for line in site["API"].values() for name in line.partition(": ")[2].split()):
        module, _, last = f"pedzoo.{name}".rpartition(".")
        assert hasattr(import_module(module), last) or import_module(f"pedzoo.{name}"), name


def test_everything_that_is_copied_exists(site: dict[str, Any]) -> None:
    assert [name for name in site["COPIED"] if not (site["ROOT"] / name).exists()] == []
