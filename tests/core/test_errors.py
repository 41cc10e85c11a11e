"""The core without its extras: it loads, steps, walks and evaluates, and names what is missing."""

import json
import os
import re
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from pedzoo.core import errors
from pedzoo.core.errors import UserError

BARE = """
import json, sys
import importlib.metadata
from pedzoo.core.errors import EXTRAS

absent = {module for modules in EXTRAS.values() for module in modules} | {"opencv-python-headless"}


class Without:
    def __init__(self, finder):
        self.finder = finder

    def find_spec(self, name, path=None, target=None):
        return None if name.partition(".")[0] in absent else self.finder.find_spec(name, path, target)

    def find_distributions(self, context):
        known = getattr(self.finder, "find_distributions", None)
        return [] if known is None or str(context.name).lower() in absent else known(context)


sys.meta_path[:] = [Without(finder) for finder in sys.meta_path]
"""
"""Makes a process one in which no extra is installed."""

WALKS = """
import pedzoo

controller = pedzoo.controller("approach_net_goal_map.indoor")
velocity = controller.step({"ann": (0, 0), "bo": (3, 0)}, goals={"ann": (3, 0), "bo": (0, 0)})
walked, env = pedzoo.rollout("approach_net_goal_map.indoor", "perpendicular:people=2", episodes=1)
row = pedzoo.evaluate(["go_to_goal"], ["door"], episodes=1)["rows"][0]
said = {
    "model": type(pedzoo.load("sgan_goal.zara1")).__name__,
    "stepped": sorted(velocity),
    "physics": type(env.physics).__name__,
    "failed": bool(walked.failed.any()),
    "episodes": row["n"],
    "loaded": sorted(absent & sys.modules.keys()),
}
print(json.dumps(said))
"""

COMMANDS = {
    "rollout go_to_goal --plot OUT.png": "video",
    "rollout go_to_goal --video OUT.webm": "video",
    "fit --config sgan_nopool": "train",
    "forecast constant_velocity": "train",
    "demo --out OUT": "train",
    "rollout go_to_goal --physics bullet": "bullet",
    "export constant_velocity --onnx OUT.onnx": "onnx",
    "evaluate go_to_goal --suite door --quick --workers 2 --backend ray": "ray",
}


def bare(code: str, folder: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    environment = {**os.environ, "PEDZOO_HOME": str(folder)}
    command = [sys.executable, "-c", BARE + code, *arguments]
    return subprocess.run(command, capture_output=True, text=True, cwd=folder, env=environment, check=False)


def test_the_core_loads_steps_walks_and_evaluates(tmp_path) -> None:
    done = bare(WALKS, tmp_path)
    assert done.returncode == 0, done.stderr
    said: dict[str, Any] = json.loads(done.stdout.splitlines()[-1])
    expected = {"model": "SGAN", "stepped": ["ann", "bo"], "physics": "Compiled", "episodes": 1}
    assert said == expected | {"failed": False, "loaded": []}


def test_commands_name_the_missing_extra_in_one_line(tmp_path) -> None:
    code = "from pedzoo.cli.main import main\n"
    code += "for line in sys.argv[1:]: print(main(line.split()), 'torch' in sys.modules)"
    commands = [line.replace("OUT", str(tmp_path / "out")) for line in COMMANDS]
    done = bare(code, tmp_path, *commands)
    said = [line.split() for line in done.stdout.splitlines()]
    assert [code for code, _ in said] == ["2"] * len(COMMANDS), done.stderr
    assert said[0] == said[1] == ["2", "False"]  # at once
    lines = done.stderr.splitlines()
    assert len(lines) == len(COMMANDS), done.stderr
    for line, extra in zip(lines, COMMANDS.values(), strict=True):
        assert "not installed here" in line and errors.install_command(extra) in line


def test_python_is_told_as_the_command_line_is(monkeypatch) -> None:
    monkeypatch.setattr(errors, "find_spec", lambda name: None)
    for extra in errors.EXTRAS:
        command = re.escape(errors.install_command(extra))
        with pytest.raises(UserError, match=rf"^this needs \w.*not installed here: {command}$"):
            errors.need(extra, "this")
    assert errors.missing_extra(ModuleNotFoundError("none of ours", name="of_ones_own")) is None


@pytest.mark.parametrize(
    "origin, command",
    [
        (None, "'pedzoo[onnx]'"),
        ({"url": "file:///a%20b/pedzoo", "dir_info": {"editable": True}}, "-e '/a b/pedzoo[onnx]'"),
        ({"url": "file:///a/pedzoo", "dir_info": {}}, "'/a/pedzoo[onnx]'"),
        ({"url": "https://b.org/p", "vcs_info": {"vcs": "git"}}, "'pedzoo[onnx] @ git+https://b.org/p'"),
        ({"url": "file:///a/p.whl", "archive_info": {}}, "'pedzoo[onnx] @ file:///a/p.whl'"),
    ],
)
def test_messages_name_an_install_that_works(
    origin: dict[str, Any] | None, command: str, monkeypatch
) -> None:
    """From where this installation came: a checkout, git, a file; the index where nothing else is known."""
    written = SimpleNamespace(read_text=lambda name: origin and json.dumps(origin))
    monkeypatch.setattr("importlib.metadata.distribution", lambda name: written)
    assert errors.install_command("onnx") == f"pip install {command}"
