"""Many workers do what one does, and no way of ending leaves anything behind.

A worker takes 2.5 s to start, so few tests have any.
"""

import gc
import multiprocessing
import os
import signal
import subprocess
import sys
import threading
import time
from collections import Counter
from collections.abc import Iterator
from importlib.util import find_spec
from multiprocessing import resource_tracker
from pathlib import Path
from types import ModuleType
from typing import Any

import cloudpickle
import pytest
import torch
from helpers.errands import answer, fail, pause, process_of

from pedzoo.core.errors import UserError
from pedzoo.eval import parallel
from pedzoo.eval.parallel import JobQueue, finished

needs_ray = pytest.mark.skipif(find_spec("ray") is None, reason="needs Ray")
BACKENDS = ["processes", pytest.param("ray", marks=[needs_ray, pytest.mark.slow])]


@pytest.fixture(scope="module")
def ray() -> Iterator[Any]:
    """A cluster of two processors, which takes ten seconds to start."""
    import ray  # pyright: ignore[reportMissingImports]

    ray.init(address="local", num_cpus=2, include_dashboard=False, log_to_driver=False)
    yield ray
    ray.shutdown()


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


@pytest.mark.parametrize("how", ["closed", "ctrl-c"])
def test_workers_are_processes_that_end_with_the_iterator(how: str) -> None:
    results = finished([0, 0, 100, 100], pause, 2)
    processes = {next(results)[1] for _ in range(2)}
    assert os.getpid() not in processes and all(map(is_alive, processes))
    shared = os.listdir("/dev/shm")  # torch puts a number of the process into the names of shared tensors
    assert not [name for name in shared if any(f"_{process}_" in name for process in processes)]
    if how == "closed":
        results.close()
    else:
        everybody = [*processes, os.getpid()]
        press = threading.Timer(0.3, lambda: [os.kill(one, signal.SIGINT) for one in everybody])
        press.start()
        with pytest.raises(KeyboardInterrupt):
            next(results)
        press.join()
    assert not any(map(is_alive, processes))


def test_a_killed_worker_is_named_while_others_are_busy() -> None:
    message = r"^worker \d of 2 is killed by SIGKILL \(in job 1, 'kill'\); .* fewer workers"
    with pytest.raises(RuntimeError, match=message):
        list(finished(["long", "kill"], fail, 2))
    with parallel._processes(1) as (worker,):
        assert worker.death(SystemExit(7)) == "gone with exit code 7"


def test_errors_of_a_worker_can_be_sent_and_say_where_they_were(monkeypatch) -> None:
    """In this process: `fail` is what a worker does, and a module is gone before it loads the function."""
    expected = (UserError, "no map 'x': expected a file"), (RuntimeError, "OwnError: cannot be rebuilt")
    for job, (kind, message) in zip(("user", "own"), expected, strict=True):
        result, error, _ = cloudpickle.loads(parallel._do(3, cloudpickle.dumps((fail, job))))
        assert result == b"" and type(error) is kind and str(error) == message
        assert "in job 3 in a worker" in error.__notes__[0] and "in fail" in error.__notes__[0]
    gone = ModuleType("gone")
    exec("def work(job): return job", gone.__dict__)
    monkeypatch.setitem(sys.modules, "gone", gone)
    task = cloudpickle.dumps((gone.work, 1))
    monkeypatch.delitem(sys.modules, "gone")
    _, error, _ = cloudpickle.loads(parallel._do(0, task))
    assert isinstance(error, UserError)
    assert "cannot load the jobs or their function: No module named" in str(error)


EARLY = """
import os, signal, threading
from multiprocessing.context import SpawnProcess
from helpers.errands import process_of
from pedzoo.eval.parallel import finished

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


def test_ctrl_c_while_workers_start_leaves_no_word() -> None:
    command, how = [sys.executable, "-c", EARLY], {"cwd": Path(__file__).parents[1], "timeout": 100}
    done = subprocess.run(command, capture_output=True, text=True, start_new_session=True, **how)
    assert (done.stdout, done.stderr) == ("interrupted\n", "")


SCRIPT = """
class Job:
    size = 2
class Odd(Exception): pass
def work(job):
    if job.size > 2: raise Odd('size')
    return helper(job)
def helper(job): return job.size
"""


def test_jobs_of_a_script_or_a_notebook_need_no_guard(monkeypatch, tmp_path) -> None:
    script = tmp_path / "script.py"
    script.write_text("raise RuntimeError('a worker runs the script')")
    main = ModuleType("__main__")
    main.__file__ = str(script)
    exec(SCRIPT, main.__dict__)
    monkeypatch.setitem(sys.modules, "__main__", main)
    jobs = [main.Job(), main.Job(), main.Job()]
    jobs[2].size = 3
    seen = {}
    with pytest.raises(main.Odd, match="size"):
        for number, result in finished(jobs, main.work, 2):
            seen[number] = result
    assert seen and set(seen.values()) == {2}


def test_what_cannot_be_done_is_refused(monkeypatch) -> None:
    with pytest.raises(UserError, match=r"cannot be sent these jobs .*lock.*workers=1"):
        list(finished([threading.Lock()] * 2, str, 2))
    with pytest.raises(UserError, match=r"^workers 0: expected at least 1"):
        finished([1], process_of, 0)
    with pytest.raises(UserError, match=r"unknown backend 'rat': did you mean 'ray'"):
        finished([1], process_of, 2, "rat")  # pyright: ignore[reportArgumentType]
    monkeypatch.setattr("pedzoo.core.errors.find_spec", lambda name: None)
    with pytest.raises(UserError, match=r"the backend ray needs ray, .*pip install .*\[ray\]'"):
        finished([1], process_of, 2, "ray")


def test_a_worker_stays_with_its_group_and_then_helps() -> None:
    order = [number for number, _ in finished([5, 6, 7, 8], process_of, group=lambda job: job % 2)]
    assert order == [0, 2, 1, 3] and list(finished([], process_of, 4)) == []
    queue = JobQueue(list("abacaba"))  # a: 0 2 4 6, b: 1 5, c: 3
    assert [queue.take(), queue.take(), queue.take("b")] == [(0, "a"), (1, "b"), (5, "b")]
    assert [queue.take("b"), queue.take("c")] == [(3, "c"), (2, "a")]  # nothing but a is left
    assert [queue.take("a"), queue.take("a"), queue.take("a")] == [(4, "a"), (6, "a"), None]


@pytest.mark.parametrize("backend", BACKENDS)
def test_two_workers_give_what_one_gives_and_leave_nothing(backend, elsewhere, monkeypatch, request) -> None:
    resource_tracker.ensure_running()  # the first processes would leave it open
    if backend == "ray":
        request.getfixturevalue("ray")
    else:
        monkeypatch.setenv("PEDZOO_HOME", "elsewhere")
        # a worker does not look into the working directory
        Path("multiprocessing.py").write_text("raise SystemExit(3)")
    torch.set_num_threads(2)
    gc.collect()  # what other tests left open is closed before it is counted
    opened = set(os.listdir("/proc/self/fd"))
    jobs, together = [(seed, str(elsewhere)) for seed in range(9)], {}
    try:
        with pytest.warns(UserWarning, match="is odd") as caught:
            for number, result in finished(jobs, answer, 2, backend, group=lambda job: job[0] // 2):
                time.sleep(0 if together else 0.5)  # a busy caller loses no result
                together[number] = result
        if backend == "processes":
            assert set(os.listdir("/proc/self/fd")) == opened
            assert not any(Path(file.read_text()).exists() for file in elsewhere.glob("lock*"))
        with pytest.warns(UserWarning, match="is odd"):
            alone = dict(finished(jobs, answer))
        assert torch.get_num_threads() == 2
    finally:
        torch.set_num_threads(1)
    assert together == alone
    assert sorted(alone) == list(range(9)) and alone[0]["state"] == (1, str(elsewhere))
    assert {str(one.message) for one in caught} == {f"job {seed} is odd" for seed in range(9)}
    done = Counter((elsewhere / "done").read_text().split())
    assert done == {str(seed): 2 for seed in range(9)}  # once alone, once together


@needs_ray
@pytest.mark.slow
def test_ray_tells_of_errors_and_deaths_and_its_cluster_stays(ray: Any) -> None:
    with pytest.raises(UserError, match=r"^no map 'x': expected a file"):
        list(finished(["user"], fail, 1, "ray"))
    with pytest.raises(RuntimeError, match=r"^worker 0 of 1 is dead: .*\(in job 0, 'kill'\)"):
        list(finished(["kill"], fail, 1, "ray"))
    with pytest.raises(UserError, match=r"^workers 3: the Ray cluster has 2 processors"):
        list(finished(range(3), process_of, 3, "ray"))
    assert ray.is_initialized()


@needs_ray
def test_a_cluster_is_started_where_none_runs(monkeypatch) -> None:
    import ray  # pyright: ignore[reportMissingImports]

    called: list[Any] = []

    def init(address: str, num_cpus: int = 0, **_: Any) -> None:
        called.append((address, num_cpus))
        if address == "auto":
            raise ConnectionError

    monkeypatch.setattr(ray, "is_initialized", lambda: False)
    monkeypatch.setattr(ray, "init", init)
    monkeypatch.setattr(ray, "shutdown", lambda: called.append("shutdown"))
    monkeypatch.setattr(ray, "cluster_resources", dict)
    with pytest.raises(UserError, match="workers 2: the Ray cluster has 0 processors"):
        list(finished(range(3), process_of, 2, "ray"))
    assert called == [("auto", 0), ("local", 2), "shutdown"]
