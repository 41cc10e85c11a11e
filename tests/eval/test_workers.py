"""Many workers do what one does, and no way of ending leaves anything behind."""

from __future__ import annotations

import gc
import multiprocessing
import os
import random
import signal
import subprocess
import sys
import threading
import time
from collections import Counter
from collections.abc import Iterator
from importlib.util import find_spec
from pathlib import Path
from types import ModuleType

import pytest
import torch
from helpers.errands import answer, complain, fail, lock, pause, process_of
from torchrl.envs.utils import ExplorationType, set_exploration_type

from pedzoo.core.errors import UserError
from pedzoo.eval.workers.pool import JobQueue, finished, grouped

needs_ray = pytest.mark.skipif(find_spec("ray") is None, reason="needs Ray")
BACKENDS = ["processes", pytest.param("ray", marks=[needs_ray, pytest.mark.slow])]


@pytest.fixture(autouse=True)
def neither_hangs_nor_leaves_processes() -> Iterator[None]:
    def give_up(*_: object) -> None:
        raise TimeoutError("a test hangs")

    before = signal.signal(signal.SIGALRM, give_up)
    signal.alarm(150)
    yield
    signal.alarm(0)
    signal.signal(signal.SIGALRM, before)
    assert multiprocessing.active_children() == []


def is_alive(process: int) -> bool:
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    return True


@pytest.mark.parametrize("backend", BACKENDS)
def test_many_workers_give_what_one_gives_and_do_nothing_twice(
    backend, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    if backend == "processes":
        monkeypatch.setenv("PEDZOO_HOME", "elsewhere")
    monkeypatch.chdir(tmp_path)
    if backend == "processes":  # a worker does not look into the working directory
        Path("multiprocessing.py").write_text("raise SystemExit(3)")
    torch.set_num_threads(2)
    try:
        jobs = [(seed, str(tmp_path)) for seed in range(9)]
        with set_exploration_type(ExplorationType.MEAN):
            alone = dict(finished(jobs, answer))
            together = dict(finished(jobs, answer, 2, backend, group=lambda job: job[0] // 2))
        assert torch.get_num_threads() == 2
    finally:
        torch.set_num_threads(1)
    assert together == alone
    assert sorted(alone) == list(range(9)) and alone[0]["state"] == (1, True, "MEAN", str(tmp_path))
    done = Counter((tmp_path / "done").read_text().split())
    assert done == {str(seed): 2 for seed in range(9)}  # once alone, once together


def test_results_come_one_by_one_from_other_processes_which_end_with_the_iterator() -> None:
    results = finished(range(4), process_of, 2)
    processes = {next(results)[1][1] for _ in range(2)}
    assert os.getpid() not in processes and all(map(is_alive, processes))
    results.close()
    assert not any(map(is_alive, processes))


def test_nothing_stays_open() -> None:
    list(finished(range(4), process_of, 2))
    gc.collect()  # what other tests left open is closed before it is counted
    before = set(os.listdir("/proc/self/fd"))
    processes = {process for _, (_, process) in finished(range(4), process_of, 2)}
    assert set(os.listdir("/proc/self/fd")) == before
    shared = os.listdir("/dev/shm")  # torch puts a number of the process into the names of shared tensors
    assert not [name for name in shared if any(f"_{process}_" in name for process in processes)]
    results = finished(range(2), lock, 2)
    file = Path(next(results)[1])
    assert file.exists()
    results.close()
    assert not file.exists()


def test_no_result_is_lost_while_the_caller_is_busy(tmp_path: Path) -> None:
    jobs = [(seed, str(tmp_path)) for seed in range(6)]
    numbers = []
    for number, _ in finished(jobs, answer, 3):
        if not numbers:
            time.sleep(1.3)
        numbers.append(number)
    assert sorted(numbers) == list(range(6))
    assert len((tmp_path / "done").read_text().split()) == 6


@pytest.mark.parametrize(
    ("job", "kind", "message"),
    [
        ("user", UserError, r"^no map 'x': expected a file"),
        ("own", RuntimeError, r"^OwnError: cannot be rebuilt"),
        (
            "kill",
            RuntimeError,
            r"^worker \d of 2 is killed by SIGKILL \(in job 1, 'kill'\); .* fewer workers",
        ),
        ("exit", RuntimeError, r"^worker \d of 2 is gone with exit code 7 \(in job 1, 'exit'\)"),
    ],
)
def test_errors_of_a_worker_reach_the_caller_while_others_are_busy(job, kind, message) -> None:
    with pytest.raises(kind, match=message) as caught:
        list(finished(["long", job], fail, 2))
    if job in ("user", "own"):
        assert "in fail" in "".join(caught.value.__notes__)  # where it was raised


@needs_ray
@pytest.mark.slow
def test_ray_tells_of_errors_and_of_actors_that_die_and_its_cluster_stays() -> None:
    import ray  # pyright: ignore[reportMissingImports]

    ray.init(address="local", num_cpus=2, include_dashboard=False, log_to_driver=False)
    try:
        with pytest.raises(UserError, match=r"^no map 'x': expected a file"):
            list(finished(["long", "user"], fail, 2, "ray"))
        with pytest.raises(RuntimeError, match=r"^worker 1 of 2 is dead: .*\(in job 1, 'kill'\)"):
            list(finished(["long", "kill"], fail, 2, "ray"))
        with pytest.raises(UserError, match=r"^workers 3: the Ray cluster has 2 processors"):
            list(finished(range(3), process_of, 3, "ray"))
        assert ray.is_initialized()
    finally:
        ray.shutdown()


def test_ctrl_c_ends_all_workers() -> None:
    results = finished([0, 0, 100, 100], pause, 2)
    processes = {next(results)[1] for _ in range(2)}

    def press() -> None:
        for process in [*processes, os.getpid()]:
            os.kill(process, signal.SIGINT)

    timer = threading.Timer(0.3, press)
    timer.start()
    with pytest.raises(KeyboardInterrupt):
        next(results)
    timer.join()
    assert not any(map(is_alive, processes))


EARLY = """
import os, signal, threading
from multiprocessing.context import SpawnProcess
from helpers.errands import process_of
from pedzoo.eval.workers.pool import finished

pressed = threading.Timer(0.3, os.killpg, (0, signal.SIGINT))

def start(self, real=SpawnProcess.start):
    real(self)  # which then imports torch for seconds
    if not pressed.ident:
        pressed.start()

SpawnProcess.start = start
try:
    next(finished(range(2), process_of, 2))
except KeyboardInterrupt:
    print("interrupted")
"""


def test_ctrl_c_while_workers_are_started_leaves_no_word() -> None:
    command, folder = [sys.executable, "-c", EARLY], Path(__file__).parents[1]
    done = subprocess.run(
        command, cwd=folder, capture_output=True, text=True, timeout=100, start_new_session=True
    )
    assert (done.stdout, done.stderr) == ("interrupted\n", "")


@pytest.mark.parametrize("count", [1, 2])
def test_warnings_of_jobs_reach_the_caller(count) -> None:
    with pytest.warns(UserWarning, match="is odd") as caught:
        assert dict(finished(range(2), complain, count)) == {0: 0, 1: 1}
    assert sorted(str(warning.message) for warning in caught) == ["job 0 is odd", "job 1 is odd"]


def test_jobs_and_functions_of_a_script_or_a_notebook_need_no_guard(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    script = tmp_path / "script.py"
    script.write_text("raise RuntimeError('a worker runs the script')")
    for file in (str(script), None):
        main = ModuleType("__main__")
        if file:
            main.__file__ = file
        code = "class Job:\n  size = 2\nclass Odd(Exception): pass\n"
        code += "def work(job):\n  if job.size > 2: raise Odd('size')\n  return helper(job)\n"
        exec(code + "def helper(job): return job.size", main.__dict__)
        with monkeypatch.context() as patch:
            patch.setitem(sys.modules, "__main__", main)
            jobs = [main.Job(), main.Job()]
            if file:
                assert dict(finished(jobs, main.work, 2)) == {0: 2, 1: 2}
            jobs[1].size = 3
            with pytest.raises(main.Odd, match="size"):
                list(finished(jobs, main.work, 2))


def test_what_other_processes_cannot_have_is_a_clear_mistake(monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(UserError, match=r"cannot be sent these jobs .*lock.*workers=1"):
        list(finished([threading.Lock()] * 2, str, 2))
    gone = ModuleType("gone")
    exec("def work(job): return job", gone.__dict__)
    monkeypatch.setitem(sys.modules, "gone", gone)
    with pytest.raises(UserError, match=r"cannot load the jobs or their function: No module named 'gone'"):
        list(finished(range(2), gone.work, 2))
    with pytest.raises(UserError, match=r"^workers 0: expected at least 1"):
        finished([1], process_of, 0)
    with pytest.raises(UserError, match=r"unknown backend 'rat': did you mean 'ray'"):
        finished([1], process_of, 2, "rat")  # pyright: ignore[reportArgumentType]
    monkeypatch.setattr("pedzoo.core.errors.find_spec", lambda name: None)
    with pytest.raises(UserError, match=r"the backend ray needs ray, .*pip install .*\[ray\]'"):
        finished([1], process_of, 2, "ray")


def test_no_jobs_are_no_work() -> None:
    assert list(finished([], process_of, 4)) == []


def test_one_worker_goes_from_group_to_group() -> None:
    order = [number for number, _ in finished([5, 6, 7, 8], process_of, group=lambda job: job % 2)]
    assert order == [0, 2, 1, 3]


def test_a_worker_stays_with_its_group_and_then_helps_where_most_is_left() -> None:
    shares = JobQueue(grouped(list("abacaba")))  # a: 0 2 4 6, b: 1 5, c: 3
    assert shares.take(None) == (0, 0)
    assert shares.take(None) == (1, 1)
    assert shares.take(1) == (5, 1)
    assert shares.take(1) == (3, 2)
    assert shares.take(2) == (2, 0)  # nothing but a is left
    assert [shares.take(0), shares.take(0), shares.take(0)] == [(4, 0), (6, 0), None]


def test_every_job_is_handed_out_once_who_asks() -> None:
    draw = random.Random(0)
    for _ in range(50):
        keys = [draw.randrange(5) for _ in range(draw.randrange(1, 30))]
        groups = grouped(keys)
        shares = JobQueue(groups)
        last: list[int | None] = [None] * 4
        taken = []
        while (share := shares.take(last[worker := draw.randrange(4)])) is not None:
            assert keys[share[0]] == keys[groups[share[1]][0]]
            taken.append(share[0])
            last[worker] = share[1]
        assert sorted(taken) == list(range(len(keys)))
