"""Tests of the suite that are attacks: what goes wrong in them, counted by its kind."""

from __future__ import annotations

import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

ROOT = Path(__file__).parents[2]

_RUN, _FETCH, _DOWNLOAD = (
    f"tests/{name}.py" for name in ("train/test_run_folder", "core/test_fetch", "data/test_download")
)
_EVALUATE, _WORKERS = "tests/eval/test_evaluate.py", "tests/eval/test_workers.py"

ATTACKS: dict[str, tuple[str, ...]] = {
    "killed in a write": (
        f"{_RUN}::test_a_process_killed_while_it_writes_leaves_the_old_file",
        f"{_RUN}::test_a_run_goes_on_after_it_was_cut_off_in_a_write",
    ),
    "a full disk, or one that cannot be written": (
        f"{_RUN}::test_a_write_that_fails_leaves_the_old_checkpoint",
        f"{_RUN}::test_runs_that_cannot_be_written",
        f"{_RUN}::test_a_full_disk_is_said_in_one_line",
        f"{_EVALUATE}::test_workers_end_when_a_part_cannot_be_kept",
        f"{_FETCH}::test_a_cache_that_cannot_be_written_is_named",
    ),
    "two at once": (
        f"{_RUN}::test_one_process_at_a_time_trains_in_a_folder",
        f"{_RUN}::test_a_dead_process_holds_no_folder",
        f"{_FETCH}::test_many_at_once_download_once",
        f"{_FETCH}::test_two_processes_download_once",
        f"{_DOWNLOAD}::test_an_interrupted_download_is_ended_by_two_at_once",
    ),
    "signals of terminals and of Slurm": (
        "tests/train/test_signals.py",
        f"{_RUN}::test_the_checkpoint_of_another_run_is_not_continued",
    ),
    "a dead worker": (
        f"{_EVALUATE}::test_a_killed_worker_is_named_and_the_table_stays_the_same",
        f"{_WORKERS}::test_ray_tells_of_errors_and_deaths_and_its_cluster_stays",
    ),
    "a dead client of pybullet": (
        "tests/sim/test_physics.py::test_a_closed_physics_and_a_lost_client_say_what_to_do",
    ),
    "a cut or false download": (
        f"{_FETCH}::test_a_wrong_file_leaves_nothing",
        f"{_FETCH}::test_an_endless_answer_is_cut_off",
        f"{_FETCH}::test_a_broken_download_goes_on_where_it_was",
        f"{_FETCH}::test_a_broken_download_restarts_where_the_server_cannot_go_on",
        f"{_FETCH}::test_what_an_earlier_call_left_is_used_or_thrown_away",
        f"{_FETCH}::test_an_interrupted_download_is_continued_by_the_next",
    ),
    "a torn journal": (
        f"{_EVALUATE}::test_a_journal_is_on_the_disk_and_refuses_other_files",
        f"{_EVALUATE}::test_a_journal_does_again_what_is_torn",
    ),
    "a small file with huge demands": ("tests/reliability/test_limits.py",),
}


def attack(state: dict[str, Any], quick: bool) -> None:
    """Run all these tests in one process, and count them.

    Args:
        state: Gets how many tests of each kind there were, and the names of those that failed.
        quick: Whether those that take more than 20 seconds are left out.
    """
    with tempfile.TemporaryDirectory() as folder:
        report = Path(folder, "report.xml")
        command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", f"--junitxml={report}"]
        only = ["-m", "not slow"] if quick else []
        nodes = [node for kind in ATTACKS.values() for node in kind]
        ended = subprocess.run([*command, *only, *nodes], cwd=ROOT, check=False).returncode
        if ended > 1:
            raise SystemExit(f"pytest ended with {ended}: are these its tests?")
        cases = list(ElementTree.parse(report).iter("testcase"))
    for kind, nodes in ATTACKS.items():
        mine = [case for case in cases if any(_is(case, node) for node in nodes)]
        ran = [case for case in mine if case.find("skipped") is None]
        failed = [case for case in ran if case.find("failure") is not None or case.find("error") is not None]
        state[kind] = {"tests": len(ran), "failed": [case.get("name") for case in failed]}


def _is(case: ElementTree.Element, node: str) -> bool:
    """Return whether a case is one of a test, or of a file."""
    file, _, test = node.partition("::")
    name = (case.get("name") or "").partition("[")[0]
    return case.get("classname") == file.removesuffix(".py").replace("/", ".") and test in ("", name)
