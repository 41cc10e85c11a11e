"""The page in a real browser: it plays, is fast enough, and is quiet on the console."""

import json
import math
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from urllib.parse import quote

import numpy as np
import pytest

from pedzoo.eval.packed_episodes import _differences, _text, packed_plan
from pedzoo.maps.grid import OccupancyGrid
from pedzoo.viz.report import content_of, page

sync_api = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
pytestmark = pytest.mark.skipif(CHROMIUM is None, reason="no Chromium here (Debian: apt install chromium)")

POINTS = 600

CASE = "goals:map=apartment.7,people=8,goals=3,pool=8"
"""Longer than a phone is wide."""


def crowd(people: int, seed: int, touch: bool = False) -> dict[str, Any]:
    """An episode in which all walk on circles for a minute; person 0 stands at (1, 1)."""
    time = np.arange(POINTS + 1) / 10
    tracks = []
    for i in range(people):
        angle = 2 * math.pi * i / people + 0.2 * (1 + seed) * time / (1 + i % 3)
        radius = 2.0 + 6 * (i % 7) / 7
        tracks.append(np.stack((10 + radius * np.cos(angle), 10 + radius * np.sin(angle)), 1))
    tracks[0] = np.ones_like(tracks[0])
    common = {"radius": 0.15, "first": 0, "goals": [[0, 10.0, 10.0]], "wall": []}
    entries = [{"slot": i, "person": i, "robot": i == 1, "touch": [], **common} for i in range(people)]
    entries[0]["touch"] = [[100, 104]] if touch else []
    return {
        "episode": 0, "seed": seed, "plan": "1", "points": POINTS, "dt": 0.1, "people": entries,
        "counts": [POINTS + 1] * people, "xy": _text(np.concatenate([_differences(one) for one in tracks])),
        "values": {"success": 1 - 0.5 * touch, "agent_contacts": int(touch), "wall_contacts": 0, "failed": 0},
    }  # fmt: skip


@pytest.fixture(scope="module")
def file(tmp_path_factory) -> Path:
    cells = np.ones((420, 420), dtype=np.uint8)
    cells[10:-10, 10:-10] = 0
    rows = []
    for name, success, shift in (("<b>orca</b>", 0.5, 0), ("sgan", 1.0, 1)):
        episodes = [crowd(50, 0, touch=not shift), crowd(8, 1)]
        rows.append(
            {"name": name, "case": {}, "n": 2, "metrics": {"success": success, "time_ratio": 2.0 - success},
             "ci95": {}, "episodes": episodes}
        )  # fmt: skip
    folder = tmp_path_factory.mktemp("page")
    report = {"command": "rollout", "rows": rows, "plans": {"1": packed_plan(OccupancyGrid(cells, 0.05))}}
    (folder / "r.json").write_text(json.dumps(report | {"protocol": {"scenario": CASE}}))
    (folder / "page.html").write_text(page(content_of([folder / "r.json"])))
    return folder / "page.html"


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    with sync_api.sync_playwright() as started:
        one = started.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox"])
        yield one
        one.close()


@pytest.fixture
def tab(browser: Any, file: Path, request) -> Iterator[Any]:
    given = getattr(request, "param", {})
    context = browser.new_context(**{"viewport": {"width": 1200, "height": 900}, **given})
    tab, said = context.new_page(), []
    tab.on("console", lambda message: said.append(message.text))
    tab.on("pageerror", lambda error: said.append(str(error)))
    tab.on(
        "request", lambda one: said.append(one.url) if not one.url.startswith(("file:", "data:")) else None
    )
    tab.goto(file.as_uri())
    yield tab
    assert said == []  # no errors, and nothing was asked for
    context.close()


def seconds(tab: Any) -> float:
    return float(tab.inner_text("#clock").split()[0])


def test_playing_advances_until_it_is_stopped(tab: Any) -> None:
    assert seconds(tab) == 0
    tab.click("#play")
    tab.wait_for_timeout(1500)  # the page's policy forbids conditions as text
    assert seconds(tab) > 0.5
    tab.keyboard.press("Space")
    stopped = seconds(tab)
    tab.wait_for_timeout(300)
    assert seconds(tab) == stopped


def test_fifty_people_on_both_sides_are_30_frames_per_second(tab: Any) -> None:
    """Counted in time of the page's own thread: other work on the machine does not matter."""
    tools = tab.context.new_cdp_session(tab)
    tools.send("Performance.enable", {"timeDomain": "threadTicks"})

    def spent() -> float:
        values = tools.send("Performance.getMetrics")["metrics"]
        return next(one["value"] for one in values if one["name"] == "TaskDuration")

    draw = "range.value = 5 * i; range.dispatchEvent(new Event('input'))"
    each = f"for (let i = 0; i < 60; i++) {{ {draw} }}"
    before = spent()
    tab.evaluate(f"() => {{ const range = document.getElementById('time'); {each} }}")
    assert (spent() - before) / 60 < 1 / 30


def test_scrubbing_keys_and_layers(tab: Any) -> None:
    tab.evaluate("document.activeElement.blur()")
    keys = {"ArrowRight": 0.1, "Shift+ArrowRight": 1.1, "ArrowLeft": 1.0, "End": 60, "Home": 0}
    for key, time in keys.items():
        tab.keyboard.press(key)
        assert seconds(tab) == pytest.approx(time)
    before = tab.evaluate("document.querySelector('canvas').toDataURL()")
    tab.keyboard.press("p")
    assert tab.get_attribute("#layer-space", "aria-pressed") == "true"
    assert tab.evaluate("document.querySelector('canvas').toDataURL()") != before
    tab.keyboard.press("ArrowDown")
    assert "1.0" in tab.input_value("#episode")
    tab.keyboard.press("+")
    assert tab.input_value("#speed") == "2"


def test_tables_sort_mark_the_best_and_lead_to_episodes(tab: Any) -> None:
    tab.locator("td button").first.click()
    assert tab.input_value("#episode") == "0.0"  # the one that failed
    assert tab.input_value(".stage select") == "<b>orca</b>"
    tab.keyboard.press("Space")
    names = "[...document.querySelectorAll('tbody th')].map((one) => one.textContent)"
    assert tab.evaluate(names)[0] == "<b>orca</b>"
    tab.locator("thead th button", has_text="success").click()
    assert tab.evaluate(names)[0] == "sgan"
    assert tab.locator("td.best").all_inner_texts() == ["1.00", "1.00"]


def test_a_click_on_a_person_shows_what_it_does(tab: Any) -> None:
    box = tab.locator("canvas").first.bounding_box()
    # person 0 stands at (1, 1), in the lower left corner of all that is seen, 0.6 m from the edges
    left = box["x"] + (box["width"] - box["height"]) / 2
    tab.mouse.click(left + 18, box["y"] + box["height"] - 18)
    tab.wait_for_selector("#person svg")
    assert tab.inner_text("#person h3") == "person 0"
    assert tab.locator("#person svg").count() == 3
    tab.keyboard.press("Escape")
    assert tab.is_hidden("#person")


def test_a_link_names_case_and_time(browser: Any, file: Path) -> None:
    tab = browser.new_page()
    tab.goto(file.as_uri() + "#t=3.5")
    assert seconds(tab) == 3.5
    tab.goto(file.as_uri() + f"#case={quote(CASE)}&a=sgan&b=&episode=1.0&t=12.5")
    assert seconds(tab) == 12.5 and tab.input_value(".stage select") == "sgan"
    tab.click("#layer-names")
    tab.keyboard.press("End")
    assert "t=60.0" in tab.url and "episode=1.0" in tab.url


@pytest.mark.parametrize("tab", [{"viewport": {"width": 390, "height": 844}}], indirect=True)
def test_a_phone_needs_no_sideways_scrolling(tab: Any) -> None:
    tab.evaluate("location.hash = location.hash + '&who=0.0'")
    tab.wait_for_selector("#person svg")
    assert tab.evaluate("document.documentElement.scrollWidth") <= 390
    boxes = [one.bounding_box() for one in tab.locator(".stage").all()]
    assert boxes[1]["y"] > boxes[0]["y"]  # one below the other


@pytest.mark.parametrize("tab", [{"color_scheme": "dark"}], indirect=True)
def test_dark_mode(tab: Any) -> None:
    assert tab.evaluate("getComputedStyle(document.body).backgroundColor") == "rgb(21, 23, 27)"
