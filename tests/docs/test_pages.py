"""Everything that README and docs/ tell people to type works, page by page; pages are plain English."""

import re
import runpy
import shlex
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from helpers.training import SHORT

import pedzoo
from pedzoo.cli.commands import demo
from pedzoo.cli.main import main
from pedzoo.core.paths import config_names
from pedzoo.metrics.closed_loop import NAMES
from pedzoo.sim.gym import IDS

ROOT = Path(__file__).parents[2]
PAGES = {
    path.relative_to(ROOT).as_posix(): path.read_text()
    for path in (ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md")))
}
"""Their texts, by their paths."""


def blocks(page: str, language: str) -> list[str]:
    """Return the code blocks of a language."""
    return re.findall(rf"```{language}\n(.*?)```", PAGES[page], re.DOTALL)


def commands(page: str) -> list[list[str]]:
    """Return the words of all ``pedzoo`` commands behind ``pedzoo``, in order."""
    lines = [line.partition("#")[0].strip() for block in blocks(page, "bash") for line in block.splitlines()]
    lines = [line.removeprefix("PYTHONPATH=. ") for line in lines]
    return [shlex.split(line)[1:] for line in lines if line.startswith("pedzoo ")]


def files(page: str) -> dict[str, str]:
    """Return the files that a page lets its reader write: blocks whose first line is ``# NAME``."""
    texts = [*blocks(page, "python"), *blocks(page, "yaml")]
    named = (re.match(r"# (\S+\.(?:py|yaml))\n", text) for text in texts)
    return {name[1]: text for name, text in zip(named, texts, strict=True) if name}


def snippets(page: str) -> list[str]:
    """Return the Python code that is not a file."""
    return [code for code in blocks(page, "python") if code not in files(page).values()]


FIT = [*SHORT, "--rollout.episodes=1"]
LOOP = ["--model.steps=2", "--model.courses=[{scenario: hallway, scenes: 2}]", "--rollout.scenarios=[door]"]
TUNED = "demo/runs/sgan_goal/embedded-seed0/checkpoints/best.ckpt"
LESS = {
    "fit": FIT,
    "forecast": ["--samples", "2"],
    "rollout": ["--episodes", "1", "--video_seconds", "0.5"],
    "evaluate": ["--suite", "door", "--episodes", "1", "--workers", "1"],
    **{name: [] for name in ("models", "info", "robots", "export", "plans")},
}
"""Options by which commands take less time."""

ELSEWHERE = {
    r"evaluate \S+ --from-card": "tests/eval/test_card_numbers.py",
    r"evaluate straight .*": "tests/eval/test_robots.py",
    r"evaluate .* --keep_episodes .*": "tests/eval/test_rollout.py",
    r"evaluate .* --data.files .*": "tests/eval/test_evaluate.py",
    r"export \S+ --onnx .*": "tests/models/test_onnx.py",
    r"bench .*": "tests/tools/test_bench.py",
    r"reproduce .*": "tests/tools/test_reproduce.py",
    r"report .*": "tests/viz/test_report.py",
    r"view .*": "tests/viz/test_video.py",
    r"fit --config closed_loop/(?!.*losses).*|rollout runs/.*": "tests/train/test_in_the_loop.py",
    r"fit --config (ppo|robot)/.*": "tests/train/test_configs.py",
}
"""Commands that other tests run, and where; those of the demo are run by tests/cli/test_demo.py."""

DEMO = [shlex.split(command) for _, command in (*demo.steps(), *demo.last_steps(TUNED))]


def elsewhere(words: list[str]) -> str | None:
    """Return the pattern of a command that another test runs."""
    command = " ".join(words)
    return next((one for one in ELSEWHERE if re.fullmatch(one, command)), "demo" if words in DEMO else None)


MADE = {
    "README.md": ("door.png", "door.webm"),
    "docs/simulate.md": ("door.png", "door.webm", "walk.json", "plans.png"),
    "docs/evaluate.md": ("out.json", "walked.json", "walked.md"),
    "docs/extending.md": ("rooms.yaml", "rooms.png"),
    "docs/zoo.md": ("zoo/sgan_goal.embedded/card.yaml", "my_model/README.md"),
}
"""Files that the commands of a page have to write."""


@pytest.fixture
def readers_folder(tmp_path, monkeypatch) -> Path:
    """A working directory with the files that a reader is supposed to have."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    plaza = ROOT / "pedzoo" / "data" / "embedded"
    table = np.loadtxt(plaza / "plaza_test.csv", delimiter=",", skiprows=1)
    table[:, 0] *= 4  # recorded at 0.1 s
    for name in ("a.csv", "b.csv"):
        np.savetxt(tmp_path / name, table, "%g", ",", header="frame,agent,x,y", comments="")
    plan = (plaza / "plaza.yaml").read_text()
    (tmp_path / "plan.yaml").write_text(plan)
    (tmp_path / "plaza.png").write_bytes((plaza / "plaza.png").read_bytes())
    return tmp_path


@pytest.mark.parametrize("page", [page for page in PAGES if commands(page)])
def test_commands(page: str, readers_folder: Path, shared: Path, monkeypatch) -> None:
    monkeypatch.setenv("PEDZOO_DATA", str(shared / "data"))
    for name, text in files(page).items():
        (readers_folder / name).write_text(text)
    if "my_map.py" in files(page):
        runpy.run_path("my_map.py")
    if page == "docs/zoo.md":  # its reader has trained before
        first = shlex.split("fit --config sgan_goal --data.fold embedded")
        assert main([*first, *FIT]) == 0
    for one in (words for words in commands(page) if not elsewhere(words)):
        shorter = ["--no-evaluation"] if "--zoo" in one else LESS[one[0]]
        shorter = [*shorter, *LOOP] if "closed_loop/approach_net_goal_map" in one else shorter
        assert main([*one, *shorter]) == 0, one
    for file in MADE.get(page, ()):
        assert (readers_folder / file).is_file(), file


def test_what_other_tests_run_is_on_a_page() -> None:
    everything = [words for page in PAGES for words in commands(page)]
    assert {elsewhere(words) for words in everything} - {None, "demo"} == {*ELSEWHERE}
    assert [words for words in DEMO if words not in everything] == []
    assert all((ROOT / file).is_file() for file in ELSEWHERE.values())


@pytest.mark.parametrize("page", [page for page in PAGES if snippets(page) and page != "docs/robots.md"])
def test_python_code(page: str, readers_folder: Path) -> None:
    results = []
    for code in snippets(page):
        results.append(scope := {})
        exec(compile(code, page, "exec"), scope)
    checks = {"README.md": six_lines, "docs/zoo.md": forecasts, "docs/simulate.md": walks}
    checks.get(page, lambda *_: None)(*results)


def six_lines(scope: dict) -> None:
    people, goals = scope["people"], scope["goals"]
    assert all(np.linalg.norm(np.subtract(people[name], goals[name])) < 0.4 for name in ("ann", "ben"))


def forecasts(scope: dict) -> None:
    scenes, samples, people, steps, _ = scope["futures"].shape
    assert (samples, steps) == (20, 8)
    assert scope["batch"]["agents", "mask"].shape == (scenes, people)


def walks(own: dict, beside_a_robot: dict, walk: dict) -> None:
    assert set(own["velocity"]) == {"anna", 7}
    assert own["people"]["anna"][0] > -3  # she set out from -9
    assert list(beside_a_robot["velocity"]) == ["anna"]
    assert walk["trace"].shape == (8, 50, 5, 4, 2)


def test_files_and_the_readme_are_short() -> None:
    lengths = {name: len(text.splitlines()) - 1 for page in PAGES for name, text in files(page).items()}
    assert len(lengths) > 6 and {name: count for name, count in lengths.items() if count > 30} == {}
    (code,) = blocks("README.md", "python")
    assert len(PAGES["README.md"].splitlines()) <= 150 and len(code.strip().splitlines()) <= 6


def test_the_two_scripts_of_the_readme_can_be_run() -> None:
    scripts = re.findall(r"^\./(\S+)", blocks("README.md", "bash")[0], re.MULTILINE)
    assert len(scripts) == 2
    for script in scripts:
        assert (ROOT / script).stat().st_mode & 0o111, script


@pytest.mark.parametrize("page", PAGES)
def test_every_linked_file_and_heading_exists(page: str) -> None:
    for link, _, heading in re.findall(r"\]\((?!http)([^)#]*)(#([^)]*))?\)", PAGES[page]):
        target = (ROOT / page).parent / link if link else ROOT / page
        assert target.exists(), link
        if heading:
            assert heading in anchors(target.read_text()), f"{link}#{heading}"


def anchors(text: str) -> set[str]:
    """Return the names by which code hosts link headings."""
    titles = re.findall(r"^#+ (.*)$", text, re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", title.lower()).replace(" ", "-") for title in titles}


def test_the_table_of_configs_is_complete() -> None:
    assert [page for page, text in PAGES.items() if "install 'pedzoo[" in text] == [], "there is no index"
    table = PAGES["docs/train.md"].partition("| config | model |")[2].partition("\n\n")[0]
    names = (line.split("|")[1] for line in table.splitlines() if line.startswith("| `"))
    named = {name for cell in names for name in re.findall(r"`([\w/]+)`", cell)}
    assert named == set(config_names())


def test_every_metric_has_a_row_with_formula_and_unit() -> None:
    rows = re.findall(
        r"^\| (`.*?) \| (.+?) \| (.+?) \| (.+?) \| (.+?) \|$", PAGES["docs/evaluate.md"], re.MULTILINE
    )
    explained: set[str] = set()
    for cell, formula, unit, better, _ in rows:
        names = re.findall(r"`(\w+)`", cell)
        explained |= {name if not name.startswith("_") else names[0] + name for name in names}
        assert formula and unit and better in ("higher", "lower", "real", "1", "-"), cell
    assert set(NAMES) - explained == set()


# docs/robots.md

*CALLS, OWN = blocks("docs/robots.md", "python")


def test_the_code_runs() -> None:
    for code in CALLS:
        exec(compile(code, "docs/robots.md", "exec"), {})
    assert set(re.findall(r"`(pedzoo/\w+-v0)`", PAGES["docs/robots.md"])) == set(IDS)


def test_a_robot_a_sensor_and_a_reward_of_ones_own(elsewhere: Path) -> None:
    (elsewhere / "mine.py").write_text(OWN)
    own: dict[str, Any] = {"robot": "mine.py:Scooter:top_speed=2", "sensors": ["goal", "mine.py:Clock"]}
    own |= {"reward": {"mine.py:Hurry": 0.5}, "people": "go_to_goal"}
    env: Any = pedzoo.make_robot_env("circle:people=4", **own)
    seen = env.reset(seed=0)
    assert env.action_spec["robots", "action"].space.high[0, 0].tolist() == [2.0, 2.0]
    for _ in range(5):
        seen["robots", "action"] = torch.tensor([[[2.0, 0.0]]])
        seen = env.step(seen)["next"]
    assert seen["robots", "observation", "clock"].item() == pytest.approx(1.0)
    assert seen["robots", "reward"].item() == pytest.approx(0.5 * 2.0, rel=0.05)


# Sentences

MOST = 25
"""Words of a sentence."""

TEXTS = PAGES | {"CONTRIBUTING.md": (ROOT / "CONTRIBUTING.md").read_text()}


def sentences(text: str) -> list[str]:
    """Return the sentences of a page's prose; a piece of code counts as one word, a Python file as none.

    Code blocks and tables are left out: they are no sentences, and most tables are generated.
    """
    prose = re.sub(r"```.*?```|^[|#][^\n]*|<!--.*?-->", "\n", text, flags=re.DOTALL | re.MULTILINE)
    prose = re.sub(r"`[\w/]+\.py`,?", "", prose)
    prose = re.sub(r"!?\[([^\]]*)\]\([^)]*\)", r"\1", re.sub(r"`[^`]*`", "code", prose))
    return [" ".join(one.split()) for one in re.split(r"(?<=[.?!])\s+|\n\s*\n|\n\s*(?=[-*] |\d+\. )", prose)]


def long(texts: list[str]) -> list[str]:
    """Return those with too many words."""
    return [text for text in texts if len([word for word in text.split() if re.search(r"\w", word)]) > MOST]


@pytest.mark.parametrize("page", TEXTS)
def test_sentences_are_short(page: str) -> None:
    assert len(sentences(TEXTS[page])) > 3
    assert long(sentences(TEXTS[page])) == []


def test_long_sentences_are_found() -> None:
    rows = [line for line in PAGES["docs/glossary.md"].splitlines() if line.startswith("| **")]
    cells = [re.sub(r"`[^`]*`,?", "", cell) for row in rows for cell in row.strip("| ").split(" | ")]
    assert len(cells) > 160 and long([one for cell in cells for one in re.split(r"(?<=[.?!])\s", cell)]) == []
    words = " ".join(["word"] * MOST)
    page = f"# {words} more\n\nShort. {words}.\n\n- `a b` {words}.\n- {words}\n  more.\n\n| {words} more |\n"
    assert long(sentences(page)) == [f"- code {words}.", f"- {words} more."]
    assert long(sentences(f"```bash\n{words} more\n```\n`core/spec.py`, `core/registry.py`: {words}.")) == []
