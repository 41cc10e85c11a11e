"""One HTML file: its own style, script and data, and no address of anything else."""

from __future__ import annotations

import base64
import hashlib
import html
import json
from collections.abc import Mapping
from importlib import resources
from string import Template
from typing import Any

SCRIPTS = ("dom", "decode", "scene", "charts", "inspect", "table", "player", "main")
"""Files of the script, in this order."""

LARGEST = 3_000_000
"""Bytes of a page: it opens at once, and fits an e-mail."""


def page(content: Mapping[str, Any], title: str = "pedzoo report", live: str | None = None) -> str:
    """Return the page.

    Names in ``content`` may come from any file. They stand in JSON without ``<``, the script writes them as
    text, and the page's policy runs no script but its own.

    Args:
        content: ``about``, ``cases``, ``plans``, ``tables``, ``charts`` and ``notes``, as of
            `pedzoo.viz.report.content_of`.
        title: In the head of the page.
        live: Where people who walk now are asked for, on the server that the page is from.
    """
    style, body = _asset("page.css"), "".join(_asset(f"{name}.js") for name in SCRIPTS)
    script = f"'use strict';\n(() => {{\n{body}}})();\n"
    sources = f"style-src {_hash(style)}; script-src {_hash(script)}; img-src data:"
    sources += "; connect-src 'self'" if live else ""
    policy = f"default-src 'none'; {sources}; base-uri 'none'; form-action 'none'"
    # JSON that no HTML parser takes for anything else
    data = json.dumps({**content, "live": live}, separators=(",", ":"), allow_nan=False)
    for sign in "<>&\u2028\u2029":
        data = data.replace(sign, f"\\u{ord(sign):04x}")
    return Template(_asset("page.html")).substitute(
        title=html.escape(title),
        policy=html.escape(policy, quote=True),
        style=style,
        script=script,
        data=data,
    )


def framed(content: Mapping[str, Any], title: str, height: int = 640) -> str:
    """Return the page as a frame for notebooks, ``height`` pixels high; its script sees nothing outside."""
    inside = html.escape(page(content, title), quote=True)
    return (
        f'<iframe srcdoc="{inside}" sandbox="allow-scripts" title="{html.escape(title, quote=True)}" '
        f'style="width:100%;height:{int(height)}px;border:0"></iframe>'
    )


def _asset(name: str) -> str:
    return (resources.files("pedzoo.viz") / "assets" / name).read_text(encoding="utf-8")


def _hash(text: str) -> str:
    return f"'sha256-{base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()}'"
