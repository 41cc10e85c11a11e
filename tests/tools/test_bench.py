"""`pedzoo bench`: turns, ratios, programs that answer, and mistakes."""

import json
from pathlib import Path

import pytest

from pedzoo.cli.main import main
from pedzoo.core.errors import UserError
from tools.bench.command import SECTIONS, asked, in_turns, rows
from tools.bench.programs import ROOT, Case, Program, checkout

ANSWERS = """
import json, sys
for line in sys.stdin:
    question = json.loads(line)
    case = {"section": "environment", "name": "walk", "scenes": 2, "people": 3, "note": ""}
    answer = {"name": "other", "versions": {"other": "1"}, "cases": [case]}
    print(json.dumps(answer if "sections" in question else LAST), flush=True)
"""


def program(folder: Path, last: str) -> Program:
    script = folder / "other.py"
    script.write_text(ANSWERS.replace("LAST", last))
    return Program("other", script)


class Fixed:
    """A program whose steps take given times."""

    def __init__(self, name: str, seconds: list[float], said: list[str]) -> None:
        self.name, self.left, self.said = name, list(seconds), said

    def ask(self, question: dict[str, float], patience: float) -> dict[str, float]:
        self.said.append(self.name)
        return {"seconds": self.left.pop(0)}


def case(owner: object, name: str = "walk") -> Case:
    return Case(owner, 0, "environment", name, 2, 5, "")  # pyright: ignore[reportArgumentType]


def test_programs_take_turns_and_ratios_are_of_a_turn() -> None:
    said: list[str] = []
    ours = case(Fixed("pedzoo", [0.1, 0.2, 0.4], said))
    other = case(Fixed("before", [0.2, 0.4, 0.8], said), "same size, another name")
    taken, failed = in_turns([ours, other], 3, 0.0)
    assert said == ["pedzoo", "before", "before", "pedzoo", "pedzoo", "before"] and not failed
    mine, theirs = rows(taken)
    assert mine["metrics"] == pytest.approx({"ms": 200, "agent_steps_per_s": 50})
    assert mine["quartiles"]["ms"] == pytest.approx([150, 300])
    assert theirs["metrics"]["times_as_fast"] == pytest.approx(2) and theirs["beside"] == "walk"


def test_a_program_answers_and_its_errors_are_told(tmp_path) -> None:
    other = program(tmp_path, '{"seconds": 0.5}')
    (one,) = other.cases({"environment": [(2, 3)]})
    assert one.seconds(0.0) == 0.5 and other.versions == {"other": "1"}
    other.close()
    broken = program(tmp_path, '{"error": "no room"}')
    taken, failed = in_turns(broken.cases({}), 2, 0.0)
    broken.close()
    assert not taken and list(failed) == ["other: walk, 2 x 3"] and "no room" in str(failed)
    silent = program(tmp_path, "sys.exit('gone')")
    (one,) = silent.cases({})
    with pytest.raises(UserError, match=r"other\.py of other: answered .*gone"):
        one.seconds(0.0)
    silent.close()
    with pytest.raises(UserError, match="no peer"):
        Program("none", tmp_path / "none.py")


def test_rvo2_is_a_peer() -> None:
    pytest.importorskip("pyrvo")
    peer = Program("RVO2", ROOT / "tools" / "bench" / "peers" / "pyrvo_orca.py")
    cases = peer.cases({"policies": [(2, 5)], "environment": [(1, 5)]})
    assert [one.name for one in cases] == ["RVO2 from Python", "RVO2 bare"]
    assert all(one.seconds(0.0) > 0 for one in cases)
    peer.close()


def test_sizes_are_those_of_the_sections() -> None:
    assert asked(["environment", "start"], ["64x5"]) == {"environment": [(64, 5)]}
    with pytest.raises(UserError, match="--size 3x3: expected some of 1x5, 64x5"):
        asked(["robots"], ["3x3"])
    with pytest.raises(UserError, match="expected scenes x people"):
        asked(["robots"], ["many"])


def test_a_commit_is_checked_out_and_removed() -> None:
    with checkout("HEAD") as tree:
        assert (tree / "pedzoo" / "__init__.py").is_file()
    assert not tree.exists()
    with pytest.raises(UserError, match="no-such"), checkout("no-such"):
        pass


def test_a_run_from_the_command_line(tmp_path, capsys) -> None:
    file = tmp_path / "speed.json"
    words = ["bench", "forecast", "--size", "1x10", "--turns", "1", "--seconds", "0", "--json", str(file)]
    assert main(words) == 0
    report = json.loads(file.read_text())
    assert {row["name"] for row in report["rows"]} >= {"sgan_nopool.zara1", "anchor_net.zara1"}
    assert all(row["metrics"]["ms"] > 0 for row in report["rows"]) and not report["failed"]
    assert "agent-steps/s" in capsys.readouterr().out


def test_mistakes_and_help(capsys) -> None:
    for words, said in (
        (["forecst"], "did you mean 'forecast'"),
        (["robots", "--turns", "0"], "expected 1 or more"),
    ):
        assert main(["bench", *words]) == 2 and said in capsys.readouterr().err
    with pytest.raises(SystemExit):
        main(["bench", "--help"])
    shown = capsys.readouterr().out
    assert all(name in shown for name in SECTIONS)
