"""`pedzoo bench`: turns, ratios, bars, other programs that misbehave, and what two runs have in common."""

from __future__ import annotations

import json
import re
import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from pedzoo.cli.main import main
from pedzoo.core.errors import UserError
from pedzoo.maps.plans import load_plan
from tools.bench import BENCHMARKS
from tools.bench.compare import compare, read_report
from tools.bench.figures import Measured, Row, Verdict
from tools.bench.peer import Peer, Scenes, running
from tools.bench.run import Run
from tools.bench.scenes import LARGEST, Size, scenario
from tools.bench.section import NotGivenError, Section, Settings
from tools.bench.sections.loop import BARE, MODEL, ORCA, SHORT, Loop
from tools.bench.sections.memory import Memory, cells
from tools.bench.sections.orca import Orca
from tools.bench.sections.profile import NETWORK, PLANNER, RESETS, REST, WALKING, Split
from tools.bench.sections.robots import Robots
from tools.bench.tables import print_bench
from tools.bench.turns import in_turns, ratio, repeated, versus

ROOT = Path(__file__).parents[2]
PEERS = ROOT / "tools" / "bench" / "peers"
SCENES = Scenes("loop", 2, 3, {}, [], [], [], [], [])


class Clock:
    """A clock that is moved by hand."""

    def __init__(self) -> None:
        """Begin at zero."""
        self.time = 0.0

    def __call__(self) -> float:
        """Return the time."""
        return self.time

    def works(self, seconds: float) -> None:
        """Let time pass."""
        self.time += seconds


# figures and turns


def test_median_and_quartiles() -> None:
    assert Measured.of([5.0, 1.0, 2.0, 4.0, 3.0]) == Measured(3.0, 2.0, 4.0, 5)
    assert Measured.of([7.0]) == Measured(7.0, 7.0, 7.0, 1)


def test_sides_take_turns() -> None:
    seen: list[str] = []
    sides = {name: lambda seconds, name=name: seen.append(name) or seconds for name in "ab"}
    assert in_turns(sides, 3, 0.5) == {"a": [0.5] * 3, "b": [0.5] * 3}
    assert seen == ["a", "b"] * 3


def test_a_call_is_repeated_for_the_time_and_the_number_that_is_asked_for() -> None:
    clock = Clock()
    side = repeated(lambda: clock.works(0.25), work=10, now=clock, least=1)
    assert side(1.0) == 40 and clock.time == 1.0
    assert side(0.1) == 40 and clock.time == 1.25  # one call at least
    assert repeated(lambda: clock.works(0.25), 10, clock, least=8)(0.1) == 40 and clock.time == 3.25


def test_ratios_are_of_the_same_turn() -> None:
    """A burst of load in the second turn slows both sides, and their ratio not at all."""
    assert ratio([10.0, 2.0, 10.0], [5.0, 1.0, 5.0]) == Measured(2.0, 2.0, 2.0, 3)
    assert ratio([1.0, 3.0, 5.0], [6.0]) == Measured(0.5, 0.5, 0.5, 1)
    result = versus([0.001, 0.002], [0.004, 0.008], "them")
    assert result["pedzoo_ms"].value == 1.5 and result["them_ms"].value == 6.0
    assert result["times_them"].value == 4.0


def test_bars() -> None:
    row = made(1.5)
    assert row.at_least("times_them", 1.5) == Verdict("times_them >= 1.5", True)
    assert str(row.at_least("times_them", 2)) == "times_them >= 2 MISSED"
    assert not row.at_least("absent", 0).ok and not row.below("absent", 9).ok
    assert row.below("step_ms", 11).ok and not row.below("step_ms", 10).ok


@pytest.mark.parametrize(
    ("section", "name", "metric", "bar"),
    [
        (Loop, BARE, "times_vmas_lidar", 3.0),
        (Loop, SHORT, "times_vmas_lidar", 3.0),
        (Loop, ORCA, "times_pyrvo_from_python", 1.0),
        (Orca, "no walls", "times_pyrvo_from_python", 3.0),
        (Orca, "walls", "times_pyrvo_from_python", 1.0),
    ],
)
def test_bars_beside_other_programs(section: type[Any], name: str, metric: str, bar: float) -> None:
    def verdicts(size: Size, **times: float) -> list[Verdict]:
        row = Row("", name, {}, {key: Measured.of([value]) for key, value in times.items()})
        judge = section(Settings())._bars
        return judge(row, name, size) if section is Loop else judge(row, size)

    asked = f"{metric} >= {bar:g}"
    assert verdicts(LARGEST, **{metric: 1.01 * bar}) == [Verdict(asked, True)]
    assert verdicts(LARGEST, **{metric: 0.99 * bar}) == [Verdict(asked, False)]
    (absent,) = verdicts(LARGEST, times_other=9.0)
    assert (absent.bar, absent.ok) == (asked, None)
    assert "not given (--peer tools/bench/peers/" in absent.why
    assert (ROOT / absent.why.partition("--peer ")[2].rstrip(")")).is_file()
    assert not verdicts(Size(64, 5), **{metric: 9.0})


def test_the_bar_of_a_models_loop() -> None:
    def ok(speed: float, times: float) -> bool | None:
        metrics = {"agent_steps_per_s": Measured.of([speed]), "times_network": Measured.of([times])}
        (verdict,) = Loop(Settings())._bars(Row("", MODEL, {}, metrics), MODEL, LARGEST)
        return verdict.ok

    assert ok(1e5, 0.1) and ok(1e3, 0.5)
    assert ok(99_999, 0.49) is False
    assert not Loop(Settings())._bars(made(9.0), "social_force", LARGEST)


@pytest.mark.parametrize(
    ("settings", "megabytes", "ok", "why"),
    [
        (Settings(maps=("office.7",)), 1999.0, True, ""),
        (Settings(maps=("office.7",)), 2000.0, False, ""),
        (Settings(), 9.0, None, "no floor plans given (--map FILE...)"),
        (Settings(maps=("office.7",), quick=True), 9.0, None, "4 scenes in place of 64 (--quick)"),
    ],
)
def test_the_bar_of_memory(settings: Settings, megabytes: float, ok: bool | None, why: str) -> None:
    row = Row("memory", "walked", {}, {"peak_mb": Measured.of([megabytes])})
    assert Memory(settings)._bar(row) == Verdict("peak_mb < 2,000", ok, why)


def test_what_was_not_judged_is_told(capsys: pytest.CaptureFixture[str]) -> None:
    metrics = {f"times_pyrvo_{name}": Measured.of([2.0]) for name in ("from_python", "bare")}
    row = Row("loop", "env + go_to_goal", {"size": "1024 x 5"}, metrics)
    alone = report(replace(row, bars=[row.beside("times_vmas_lidar", 3)]))
    alone["skipped"], alone["protocol"]["threads"] = {}, 99
    alone["machine"] |= {"load_before": None, "load_after": None}
    print_bench(alone)
    printed = capsys.readouterr().out
    assert "no bars judged" in printed and "0 of 0" not in printed
    assert (
        "loop: env + go_to_goal (1024 x 5): times_vmas_lidar >= 3 not judged: VMAS with lidar not given "
        "(--peer tools/bench/peers/vmas_navigation.py)"
    ) in printed
    head = printed.partition("go_to_goal")[0].split()
    assert "from_python" in head and "bare" in head  # both ratios to RVO2
    alone["rows"].append(made(2.0, bars=[Verdict("a", True), Verdict("b", False)]).as_json())
    print_bench(alone)
    assert "1 of 2 bars met" in capsys.readouterr().out


def test_rows_survive_json() -> None:
    bars = Verdict("times_them >= 1", True), Verdict("times_others >= 1", None, "not given")
    row = made(1.5, bars=bars, note="of one run")
    assert Row.from_json(json.loads(json.dumps(row.as_json()))) == row


def test_the_profile_gives_every_moment_to_one_part() -> None:
    clock = Clock()
    split = Split(clock)
    split.timed(NETWORK, clock.works)(5.0)
    clock.works(1.0)

    def guide() -> None:
        clock.works(1.0)
        split.timed(WALKING, clock.works)(2.0)
        clock.works(0.5)

    split.timed(PLANNER, guide)()
    with split.part(RESETS):  # whatever it calls is part of it
        guide()
        split.timed(PLANNER, clock.works)(0.5)
        clock.works(1.0)
    clock.works(0.5)
    shares = split.shares()
    assert split.total == 15.0 and sum(shares.values()) == pytest.approx(1)
    wanted = {NETWORK: 5, PLANNER: 1.5, WALKING: 2, RESETS: 5, REST: 1.5}
    assert {part: share * 15 for part, share in shares.items() if share} == pytest.approx(wanted)


# two runs


def made(times: float, milliseconds: float = 10.0, name: str = "step", **more: Any) -> Row:
    """Return a row with a time and a ratio, quartiles 1 % about them."""
    metrics = {
        key: Measured(value, 0.99 * value, 1.01 * value, 5)
        for key, value in (("times_them", times), ("step_ms", milliseconds), ("peak_mb", milliseconds))
    }
    return Row("loop", name, {"size": "1 x 5"}, metrics, **more)


def report(*rows: Row, **changes: Any) -> dict[str, Any]:
    """Return a report of some machine."""
    return {
        "command": "bench",
        "protocol": {"threads": 1, "device": "cpu", "clock": "processor time", "quick": False},
        "machine": {"cpu": "fast", "cores": 2, "system": "Linux"},
        "versions": {"pedzoo": "0.1.0", "commit": "a", "torch": "2.13"},
        "yardstick_ms": {"loop": 10.0},
        "rows": [row.as_json() for row in rows],
    } | changes


def test_changes_beyond_noise_are_marked() -> None:
    new = report(made(1.52, 8.0), versions={"pedzoo": "0.2.0", "commit": "b", "torch": "2.13"})
    result = compare(report(made(1.5, 10.0), made(1.0, name="gone")), new)
    assert not result.warnings  # another commit is what two runs are for
    marks = {change.metric: change.mark for change in result.changes}
    assert marks == {"times_them": "", "step_ms": "faster", "peak_mb": "less"}
    assert result.changes[1].ratio == 0.8
    assert result.gone == ["loop: gone (1 x 5)"] and not result.added
    back = compare(new, report(made(1.0, 10.0)))
    assert [change.mark for change in back.changes] == ["slower", "slower", "more"]


def test_wide_quartiles_hide_a_change() -> None:
    noisy = Row("loop", "step", {"size": "1 x 5"}, {"step_ms": Measured(8.0, 5.0, 10.5, 5)})
    (change,) = compare(report(made(1.5)), report(noisy)).changes
    assert change.ratio == 0.8 and not change.mark


@pytest.mark.parametrize(
    ("part", "key", "value"),
    [("machine", "cpu", "slow"), ("machine", "cores", 96), ("protocol", "threads", 8)],
)
def test_only_ratios_are_compared_between_machines(part: str, key: str, value: Any) -> None:
    old, new = report(made(1.5)), report(made(1.0))
    new[part] = new[part] | {key: value}
    result = compare(old, new)
    assert [change.metric for change in result.changes] == ["times_them"]
    assert any(f"another {key}" in warning and str(value) in warning for warning in result.warnings)
    assert "only ratios" in result.warnings[-1]


def test_other_versions_and_protocols_are_told() -> None:
    new = report(made(1.5), versions={"torch": "2.14", "pyrvo": "0.4.3"})  # a peer that was not there before
    new["protocol"] = new["protocol"] | {"quick": True}
    result = compare(report(made(1.5)), new)
    assert result.warnings == [
        "measured with quick False then, True now",
        "another torch: 2.13 then, 2.14 now",
    ]
    assert len(result.changes) == 3


def test_what_the_machine_did_itself_is_not_marked() -> None:
    """A fixed job took 1.4 times as long: so do all times, and only what is slower than that has changed."""
    old = report(made(1.5, 10.0), made(1.5, 10.0, name="jump"))
    new = report(made(1.5, 14.4), made(1.2, 16.0, name="jump"), yardstick_ms={"loop": 14.0})
    result = compare(old, new)
    assert "loop: the machine itself was 1.40 times as slow now" in result.warnings[-1]
    marks = [change.mark for change in result.changes]
    assert marks == ["", "", "more", "slower", "slower", "more"]
    assert not compare(report(made(1.5)), report(made(1.5), yardstick_ms={"orca": 99.0})).warnings


@pytest.mark.parametrize("text", ["", "[]", '{"rows": [{}]}', '{"command": "forecast", "rows": []}'])
def test_other_files_are_no_reports(text: str, tmp_path: Path) -> None:
    (tmp_path / "old.json").write_text(text)
    with pytest.raises(UserError, match=r"--compare '.*old\.json'"):
        read_report(tmp_path / "old.json")
    with pytest.raises(UserError, match="cannot be read"):
        read_report(tmp_path / "absent.json")


# other programs

GOOD = """
for line in sys.stdin:
    question = json.loads(line)
    if "cases" in question:
        (size,) = question["cases"]
        case = {"name": "fast", "step_seconds": 0.1, "note": ""}
        case |= {key: size[key] for key in ("scenes", "people")}
        answer = {"name": "Them", "versions": {"them": 1}, "cases": [case]}
    else:
        answer = {"agent_steps_per_s": 1000 * question["seconds"] + question["run"]}
    print(json.dumps(answer), flush=True)
"""
CASES = 'print(json.dumps({"name": "T", "versions": {}, "cases": %s}), flush=True)\n'
CASE = '[{"name": "n", "scenes": 1, "people": 1, "step_seconds": 0.1, "note": ""}]'


@pytest.fixture
def peer(tmp_path: Path) -> Iterator[Any]:
    """Start a peer of some lines of Python."""
    started: list[Peer] = []

    def start(lines: str, patience: float = 20.0) -> Peer:
        script = tmp_path / "them.py"
        script.write_text(f"import json, sys, time\n{lines}")
        started.append(Peer(script, sys.executable, 1, patience))
        return started[-1]

    yield start
    for one in started:
        one.close()


def test_a_peer_answers(peer: Any) -> None:
    them = peer(GOOD)
    (case,) = them.cases([SCENES])
    assert (case.title, case.metric) == ("Them, fast", "times_them_fast")
    assert (case.scenes, case.people, case.step_seconds) == (2, 3, 0.1)
    assert them.versions == {"them": "1"}
    assert case.side(0.5) == 500 and case.side(2.0) == 2000


@pytest.mark.parametrize(
    ("lines", "said"),
    [
        ("1 / 0", "ended with exit code 1 when asked for its cases; it said: .*ZeroDivisionError"),
        ("print('hello', flush=True)\ntime.sleep(60)", "printed 'hello' in place of a JSON object"),
        ("print('[1]', flush=True)\ntime.sleep(60)", r"printed '\[1\]' in place of a JSON object"),
        ("print('no GPU', file=sys.stderr, flush=True)\ntime.sleep(60)", "did not answer within .* no GPU"),
        ('print(json.dumps({"error": "no licence"}), flush=True)', "cannot do its cases: no licence"),
        (CASES % "[{}]", "gave cases that are none"),
        (CASES % "3", "gave cases that are none"),
    ],
)
def test_a_peer_without_cases(peer: Any, lines: str, said: str) -> None:
    them = peer(lines, patience=0.7 if "stderr" in lines else 20.0)
    with pytest.raises(UserError, match=rf"peer them\.py {said}"):
        them.cases([SCENES._replace(position=[[0.0] * 2] * 100_000)])  # more than a pipe holds
    them.close()
    assert them._process.poll() is not None


@pytest.mark.parametrize(
    ("lines", "said"),
    [
        ("raise SystemExit(3)", "ended with exit code 3 when asked for 'n' for 0.1 s"),
        ("print('{}', flush=True)\ntime.sleep(60)", "gave no agent_steps_per_s for 'n'"),
        ("print('{\"agent_steps_per_s\": 0}', flush=True)", "gave no agent_steps_per_s"),
    ],
)
def test_a_peer_that_fails_while_it_works(peer: Any, lines: str, said: str) -> None:
    them = peer(f"sys.stdin.readline()\n{CASES % CASE}sys.stdin.readline()\n{lines}")
    (case,) = them.cases([SCENES])
    with pytest.raises(UserError, match=said):
        case.side(0.1)


def test_no_such_peer(tmp_path: Path) -> None:
    with pytest.raises(UserError, match="no peer"):
        Peer(tmp_path / "absent.py", sys.executable, 1)
    with pytest.raises(UserError, match="--peer_python 'absent' does not start"):
        Peer(PEERS / "pyrvo_orca.py", "absent", 1)


def test_rvo2_is_a_peer() -> None:
    pytest.importorskip("pyrvo")
    them = Peer(PEERS / "pyrvo_orca.py", sys.executable, 1)
    orca = {"dt": 0.1, "neighbor_dist": 5.0, "max_neighbors": None, "time_horizon": 2.0}
    orca |= {"time_horizon_obst": 2.0, "radius": 0.2}
    walls = [[[-1.0, 1.0], [-1.0, -1.0], [4.0, -1.0], [4.0, 1.0]]]
    still = [[[0.0, 0.0], [1.0, 0.0]]] * 2
    try:
        cases = them.cases([Scenes("orca", 2, 2, orca, walls, still, still, still, [[1.3, 1.3]] * 2)])
        assert [case.metric for case in cases] == ["times_pyrvo_from_python", "times_pyrvo_bare"]
        assert all(case.side(0.01) > 0 for case in cases)
    finally:
        them.close()


ENVS = {
    "crowd_sim": """
import gym, rvo2
from gym.envs.registration import register
register(id="CrowdSim-v0")
class CrowdSim(gym.Env):
    def configure(self, config):
        self.people = config.getint("sim", "human_num")
    def set_robot(self, robot):
        self.robot = robot
    def reset(self, phase):
        self.sim = rvo2.PyRVOSimulator(0.25, 10, 10, 5, 5, 0.3, 1)
        for place in range(self.people):
            self.sim.addAgent((2.0 * place, 0.0), 10, 10, 5, 5, 0.31, 1.0, (0.0, 0.0))
        self.left = 3
        return self.sim
    def step(self, action):
        assert action == "on" and self.left and self.sim.getNumAgents() == self.people == 5
        self.sim.setAgentPosition(0, (0.0, 0.0))
        self.sim.setAgentPrefVelocity(0, (0.0, 0.5))
        self.sim.doStep()
        assert self.sim.getAgentVelocity(0)[1] > 0
        self.left -= 1
        return self.sim, 0.0, not self.left, None
""",
    "policy/linear": "class Linear:\n    def act(self, seen):\n        return 'on'\n",
    "utils/robot": """
class Robot:
    def __init__(self, config, section):
        assert config.get(section, "policy") == "none"
    def set_policy(self, policy):
        self.act = policy.act
""",
}
"""What CrowdNav's gym looks like from outside: episodes of three steps."""


def test_crowdnavs_gym_is_a_peer(tmp_path: Path) -> None:
    pytest.importorskip("pyrvo")
    for name, text in ENVS.items():
        file = tmp_path / "crowd_sim" / "envs" / f"{name}.py"
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(text)
    config = tmp_path / "crowd_nav" / "configs" / "env.config"
    config.parent.mkdir(parents=True)
    config.write_text("[sim]\nhuman_num = 7\n[robot]\npolicy = none\n")
    asked = [SCENES._replace(section="robots", scenes=scenes, people=6) for scenes in (1, 64)]
    settings = Settings(peers=(PEERS / "crowdnav_gym.py",), crowdnav=tmp_path)
    with running(settings) as (them,):
        (case,) = them.cases([*asked, SCENES])
        assert (case.title, case.scenes, case.people, case.step_seconds) == ("CrowdNav, gym", 1, 6, 0.25)
        assert case.side(0.01) > 0
    with running(Settings(peers=settings.peers)) as (them,):
        assert not them.cases([SCENES])  # other sections need no checkout
        with pytest.raises(UserError, match="is no checkout of CrowdNav: git clone https"):
            them.cases(asked)


def test_a_peer_that_fails_does_not_end_the_section_robots(tmp_path: Path) -> None:
    script = tmp_path / "them.py"
    script.write_text("import json, sys\n" + GOOD.replace("agent_steps_per_s", "nothing"))
    settings = Settings(seconds=0.01, turns=1, quick=True, peers=(script,))
    rows = {row.name: row for row in Robots(settings)._size(Size(1, 2))}
    assert rows["people orca"].metrics["agent_steps_per_s"].value > 0
    assert not rows["Them, fast"].metrics
    assert "failed: peer them.py gave no agent_steps_per_s" in rows["Them, fast"].note


# runs


class Fake(Section):
    """A benchmark that finds the same row each time."""

    def rows(self) -> Iterator[Row]:
        """Give one row, and another where there is time."""
        self.versions["them"] = "7"
        yield made(2.0, bars=(Verdict("times_them >= 3", False),), note="all of it")
        if self.settings.quick:
            raise NotGivenError("needs more time")
        yield made(3.0, name="jump")


def test_a_run_from_the_command_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = str(tmp_path / "not" / "there" / "new.json")
    fake = f"{__file__}:Fake"
    assert main(["bench", fake, "--seconds", "0.1", "--json", file]) == 0
    assert main(["bench", fake, "--seconds", "0.1", "--compare", file]) == 0
    printed = capsys.readouterr()
    assert "times_them >= 3 MISSED" in printed.out and "0 of 1 bars met" in printed.out
    assert "step: all of it" in printed.out and "0 of 6 figures changed" in printed.out
    assert "loop: jump (1 x 5)" in printed.err
    content = read_report(file)
    assert content["versions"]["them"] == "7" and content["machine"]["cpu"]
    assert content["protocol"]["threads"] == 1 and content["protocol"]["clock"] == "processor time"
    assert [Row.from_json(row).name for row in content["rows"]] == ["step", "jump"]


def test_an_unfinished_run_tells_what_it_has(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = str(tmp_path / "part.json")
    assert main(["bench", f"{__file__}:Fake", "--quick", "--json", file]) == 2
    printed = capsys.readouterr()
    assert "only what was measured by then" in printed.out and "needs more time" in printed.err
    content = json.loads(Path(file).read_text())
    assert content["interrupted"] and len(content["rows"]) == 1


def test_what_no_person_asked_for_is_skipped(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(BENCHMARKS, "names", lambda: ["sgan"])
    run = Run([], Settings())
    run.go(lambda row: None)
    assert not run.rows and "--sgan FOLDER" in run.report()["skipped"]["sgan"]


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["lop"], "unknown benchmark 'lop': did you mean 'loop'?"),
        (["loop", "--device", "cuda"], "are of the CPU only"),
        (["loop", "--seconds", "-1"], "expected above 0"),
        (["loop", "--size", "many"], "--size many: expected scenes x people such as 1024x5"),
        (["loop", "--size", "0x5"], "expected at least one scene"),
        (["loop", "--seconds", "0"], "seconds 0.0, turns 5, threads 1: expected above 0"),
        (["loop", "--turns", "0"], "turns 0, threads 1: expected above 0"),
        (["loop", "--json", "."], "--json .: is a folder, expected a file"),
        (["loop", "--json", f"{__file__}/a.json"], "test_bench.py' is a file, expected a folder"),
        (["loop", "--peer", "nowhere.py"], "no peer 'nowhere.py'"),
        (
            ["loop", "--peer", __file__, "--peer_python", "absent"],
            "--peer_python 'absent' does not start",
        ),
        (["memory", "--map", "ofice.7"], "did you mean 'office.7'"),
        (["loop", "--compare", "absent.json"], "cannot be read"),
        (["sgan"], "git clone https://github.com/agrimgupta92/sgan"),
        (["sgan", "--sgan", "nowhere"], "'nowhere' is no checkout of Social GAN"),
    ],
)
def test_mistakes(
    words: list[str], said: str, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """All are noticed before anything is measured."""
    monkeypatch.setattr(Loop, "rows", lambda self: pytest.fail("measured"))
    assert main(["bench", *words]) == 2
    assert said in capsys.readouterr().err


def test_help_names_every_section(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        main(["bench", "--help"])
    printed = capsys.readouterr().out
    assert all(f"  {name} " in printed for name in BENCHMARKS.names())


def test_drawn_floor_plans_are_maps() -> None:
    drawn = ("apartment.7",)
    assert scenario(5, drawn).bank.grids[0].name == drawn[0]
    assert cells(drawn[0]) == load_plan(drawn[0]).cells.size
    run = Run(["planner", "controller"], Settings(seconds=0.01, turns=1, quick=True, maps=drawn))
    said: list[str] = []
    run.go(lambda row: None, said.append)
    assert {row.section for row in run.rows if row.case["map"] == drawn[0]} == {"planner", "controller"}
    assert re.fullmatch(r"planner: section 1 of 2, about \d+ s to go", said[0])
    assert re.fullmatch(r"controller: section 2 of 2, about \d+ (s|min) to go", said[1])


@pytest.mark.parametrize("name", [name for name in BENCHMARKS.names() if name != "sgan"])
def test_every_section_runs(name: str) -> None:
    run = Run([name], Settings(seconds=0.01, turns=1, quick=True))
    run.go(lambda row: None)
    content = run.report()
    assert json.loads(json.dumps(content, allow_nan=False))["rows"]
    assert content["yardstick_ms"][name] > 0
    assert len({row.key for row in run.rows}) == len(run.rows)
    for row in run.rows:
        assert row.section == name and row.metrics
        assert all(result.value >= 0 for result in row.metrics.values())
