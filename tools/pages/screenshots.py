"""Pictures of pages as people see them: ``python -m tools.pages.screenshots [readme] [site] [report]``.

``docs/pictures/readme.png``: the README, as a code host shows it.
``docs/pictures/site.png``: the first page of the site; build it before with ``python tools/pages/site``.
``docs/report_desktop.png``, ``report_phone.png``, ``report_dark.png``: a report of people in a flat.

It needs Chromium (Debian: ``apt install chromium``) and playwright.
"""

from __future__ import annotations

import shutil
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from io import BytesIO
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import markdown
from PIL import Image
from playwright.sync_api import sync_playwright

from pedzoo.core.paths import write_whole
from pedzoo.eval.comparison import Comparison
from pedzoo.viz.report.episode import Replay

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"

STYLE = """
body { font: 16px/1.5 "DejaVu Sans", sans-serif; color: #1f2328; max-width: 980px; margin: 32px auto; }
h1, h2 { border-bottom: 1px solid #d1d9e0; padding-bottom: .3em; }
pre, code { background: #f6f8fa; border-radius: 6px; font: 13px/1.45 "DejaVu Sans Mono", monospace; }
code { padding: .2em .4em; } pre { padding: 16px; overflow: auto; } pre code { padding: 0; }
table { border-collapse: collapse; } th, td { border: 1px solid #d1d9e0; padding: 6px 13px; }
tr:nth-child(2n) { background: #f6f8fa; } img { max-width: 100%; } a { color: #0969da; }
"""
"""About as a code host sets a README."""

POLICIES = ["orca:radius=0.3", "sgan_goal_map.indoor"]
SCENARIO = "goals:map=apartment.7,people=8,goals=3,pool=8"
MOMENT = "t=9.4&who=3.3"
"""What the report shows: seconds, and the person that is clicked, in the page's address."""

VIEWS: dict[str, dict[str, Any]] = {
    "desktop": {"viewport": {"width": 1100, "height": 900}},
    "phone": {"viewport": {"width": 390, "height": 844}},
    "dark": {"viewport": {"width": 1100, "height": 900}, "color_scheme": "dark"},
}


def main(wanted: list[str]) -> None:
    """Take the pictures that are asked for, by default all."""
    with browser() as chromium:
        for name in wanted or ["readme", "site", "report"]:
            {"readme": readme, "site": site, "report": report}[name](chromium)


@contextmanager
def browser() -> Iterator[Any]:
    """Yield Chromium without a window."""
    program = shutil.which("chromium") or shutil.which("google-chrome")
    if program is None:
        raise SystemExit("there is no Chromium here: apt install chromium")
    with sync_playwright() as started:
        chromium = started.chromium.launch(executable_path=program, args=["--no-sandbox"])
        yield chromium
        chromium.close()


def readme(chromium: Any) -> None:
    """Take the whole README."""
    text = markdown.markdown((ROOT / "README.md").read_text(), extensions=["tables", "fenced_code"])
    page = chromium.new_page(viewport={"width": 1100, "height": 800})
    with TemporaryDirectory(dir=ROOT) as folder:
        file = Path(folder) / "readme.html"
        file.write_text(f"<base href='{ROOT.as_uri()}/'><style>{STYLE}</style>{text}")
        page.goto(file.as_uri(), wait_until="networkidle")
        shot(page.screenshot(full_page=True), DOCS / "pictures" / "readme.png", 0.6)
    page.close()


def site(chromium: Any) -> None:
    """Take the first page of the site."""
    page = chromium.new_page(viewport={"width": 1280, "height": 800})
    page.goto((ROOT / "build" / "site" / "index.html").as_uri(), wait_until="load")
    shot(page.screenshot(), DOCS / "pictures" / "site.png")
    page.close()


def report(chromium: Any) -> None:
    """Take a report's page on a desk, on a phone and in the dark."""
    with TemporaryDirectory() as folder, Comparison(POLICIES, SCENARIO, episodes=4) as comparison:
        comparison.run()
        file = Path(folder) / "apartment.html"
        Replay(comparison.walked, "Eight people in an apartment").save(file)
        for name, view in VIEWS.items():
            page = chromium.new_page(**view)
            page.goto(f"{file.as_uri()}#{MOMENT}", wait_until="load")
            page.keyboard.press("p")
            page.wait_for_timeout(500)
            shot(page.screenshot(full_page=name == "desktop"), DOCS / f"report_{name}.png")
            page.close()


def shot(data: bytes, out: Path, scale: float = 1.0) -> None:
    """Write a picture, made small."""
    picture, small = Image.open(BytesIO(data)).convert("RGB"), BytesIO()
    if scale != 1:
        size = round(scale * picture.width), round(scale * picture.height)
        picture = picture.resize(size, Image.Resampling.LANCZOS).quantize(256, dither=Image.Dither.NONE)
    picture.save(small, "PNG", optimize=True)
    write_whole(out, small.getvalue())
    print(out)


if __name__ == "__main__":
    main(sys.argv[1:])
