"""Pictures of pages as people see them: ``python -m tools.pages.screenshots [site] [report]``.

``docs/pictures/site.png``: the first page of the site; build it before with ``python tools/pages/site``.
``docs/report_desktop.png``, ``report_phone.png``, ``report_dark.png``: a report of people in a flat.

It needs Chromium (Debian: ``apt install chromium``) and playwright.
"""

import shutil
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from io import BytesIO
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from PIL import Image
from playwright.sync_api import sync_playwright

from pedzoo.core.paths import write_atomically
from pedzoo.eval.comparison import Comparison
from pedzoo.viz.episodes import Replay

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"

POLICIES = ["orca:radius=0.3", "approach_net_goal_map.indoor"]
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
        for name in wanted or ["site", "report"]:
            {"site": site, "report": report}[name](chromium)


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


def shot(data: bytes, out: Path) -> None:
    """Write a picture, made small."""
    small = BytesIO()
    Image.open(BytesIO(data)).convert("RGB").save(small, "PNG", optimize=True)
    write_atomically(out, small.getvalue())
    print(out)


if __name__ == "__main__":
    main(sys.argv[1:])
