"""Kills: trainings that are killed at random moments, whole or one process of two, and resumed to their end.

Weights and ``metrics.csv`` are compared with those of a training that nobody killed.

    python -m tools.kills                    # ten trainings of each kind, for hours
    python -m tools.kills sgan --trainings 2
"""

import argparse
import os
import shlex
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np
import torch

from pedzoo.train.run import rows_of

ROOT = Path(__file__).parents[1]

ANY = "--trainer.enable_progress_bar=false --trainer.max_epochs=8 --trainer.accelerator=cpu"
DATA = f"{ANY} --data.fold embedded --data.loading.batch_size=8 --trainer.limit_train_batches=2"
DATA += " --trainer.limit_val_batches=1"
SHORT, OFTEN = f"{DATA} --model.samples=2", "--trainer.check_val_every_n_epoch=1"
TWO = "--trainer.devices=2 --trainer.strategy=ddp_find_unused_parameters_true"
LOOP = f"{DATA} {OFTEN} --rollout.scenarios=[hallway] --rollout.episodes=2 --model.steps=2"
LOOP += " --model.courses='[{scenario: hallway, scenes: 4}]'"
ROBOT = f"{ANY} {OFTEN} --model.envs=4 --model.steps=8 --model.updates=2 --model.episodes=2"
ROBOT += " --model.minibatches=2 --model.policy.width=16 --model.scenarios"

TRAININGS = {
    name: shlex.split(f"--config {words}")
    for name, words in {
        "sgan": f"sgan {SHORT}",
        "sgan in two processes": f"sgan {SHORT} {TWO}",
        "anchor_net": f"anchor_net {SHORT} --monitor=val/ade",
        "likelihood": f"open_loop/mdn_walker {DATA} {OFTEN} --model.states=400",
        "self-play": f"closed_loop/mdn_walker {DATA} {OFTEN} --model.steps=4 --model.states=400",
        "closed_loop/approach_net_goal": f"closed_loop/approach_net_goal {LOOP}",
        "closed_loop/social_walker": f"closed_loop/social_walker {LOOP} --trainer.max_epochs=3",
        "robot/ppo": f"robot/ppo {ROBOT}=\"['crowdnav:crowds=16']\"",
        "robot/rooms": f"robot/rooms {ROBOT}=\"['door:people=2']\"",
    }.items()
}

KILLS = 2
"""Of one training."""

PATIENCE = 120.0
"""Seconds in which a training ends by itself of which one process was killed."""


class Training:
    """A training at the command line, whose processes are a group of their own."""

    def __init__(self, words: list[str], folder: Path) -> None:
        """Start it in a folder."""
        self._said = folder / "said.txt"
        gone = ("LOCAL_RANK", "NODE_RANK", "PEDZOO_RUN")
        env = {key: value for key, value in os.environ.items() if key not in gone}
        with self._said.open("w") as said:
            self.process = subprocess.Popen(
                [sys.executable, "-m", "pedzoo.cli.main", "fit", *words],
                cwd=folder,
                env=env | {"PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1"},
                stdout=said,
                stderr=subprocess.STDOUT,
                start_new_session=True,
            )

    def wait_until_it_trains(self) -> float:
        """Return when the first epoch begins, or the training has ended; seconds of a clock."""
        while "run folder:" not in self._said.read_text() and self.process.poll() is None:
            time.sleep(0.01)
        return time.monotonic()

    def others(self) -> list[int]:
        """Return the numbers of its living processes but the first."""
        words = ["ps", "-eo", "pid=,pgid=,stat="]
        lines = subprocess.run(words, capture_output=True, text=True, check=True).stdout.splitlines()
        known = [line.split() for line in lines]
        own = str(self.process.pid)
        return [int(pid) for pid, group, state in known if group == own != pid and state[0] != "Z"]

    def kill(self, whom: str) -> bool:
        """Kill ``all``, the ``first`` or a ``second`` process; return whether the rest ended by itself."""
        second = self.others() if whom == "second" else []
        if whom == "all" or (whom == "second" and not second):
            os.killpg(self.process.pid, signal.SIGKILL)
        else:
            os.kill(second[0] if second else self.process.pid, signal.SIGKILL)
        late = time.monotonic() + PATIENCE
        while (self.process.poll() is None or self.others()) and time.monotonic() < late:
            time.sleep(0.05)
        if alone := self.process.poll() is not None and not self.others():
            return alone
        os.killpg(self.process.pid, signal.SIGKILL)
        self.process.wait()
        return False


def outcome(run: Path) -> tuple[dict[str, Any], list[dict[str, str]]]:
    """Return weights and rows of a run that is done, without speeds, which depend on the machine."""
    rows = rows_of(run / "metrics.csv")
    rows = [{name: row[name] for name in row if not name.endswith("_per_s")} for row in rows]
    return torch.load(run / "checkpoints" / "last.ckpt")["state_dict"], rows


def runs_in(folder: Path) -> list[Path]:
    """Return the runs of the trainings in a folder, the one that was written last at the end."""
    return sorted(folder.glob("runs/*/*"), key=lambda path: path.stat().st_mtime)


def whole(words: list[str], folder: Path) -> tuple[Path, float]:
    """Return the run of a training that nobody kills, and how many seconds it trained."""
    training = Training(words, folder)
    began = training.wait_until_it_trains()
    if training.process.wait():
        raise SystemExit(f"it does not train: {(folder / 'said.txt').read_text()[-2000:]}")
    return runs_in(folder)[-1], time.monotonic() - began


def killed(words: list[str], folder: Path, seconds: float, draw: np.random.Generator) -> dict[str, Any]:
    """Kill a training some times, resume it each time, and return what became of it."""
    result: dict[str, Any] = {"kills": 0, "not ended by itself": 0, "wrong": ""}
    victims = ("all", "first", "second") if "--trainer.devices=2" in words else ("all",)
    asked = words
    for number in range(KILLS + 1):
        training = Training(asked, folder)
        training.wait_until_it_trains()
        if number < KILLS:
            time.sleep(draw.uniform(0, seconds))
        if number < KILLS and training.process.poll() is None:
            result["kills"] += 1
            result["not ended by itself"] += not training.kill(str(draw.choice(victims)))
        elif training.process.wait():
            return result | {"wrong": (folder / "said.txt").read_text()[-2000:]}
        else:
            break
        saved = [run for run in runs_in(folder) if (run / "checkpoints" / "last.ckpt").is_file()]
        asked = ["--resume", str(saved[-1].relative_to(folder))] if saved else words
    return result


def difference(run: Path, other: Path) -> str:
    """Return in words what is different in two runs, nothing where all is equal."""
    (weights, rows), (others, other_rows) = outcome(run), outcome(other)
    unlike = [key for key in weights if not torch.equal(weights[key], others[key])]
    return f"weights {unlike}" if unlike else "" if rows == other_rows else "metrics.csv"


def tried(kind: str, trainings: int) -> list[dict[str, Any]]:
    """Kill and resume trainings of a kind of `TRAININGS`, and return what became of each."""
    done: list[dict[str, Any]] = []
    with tempfile.TemporaryDirectory() as home:
        folders = [Path(home, str(number)) for number in range(trainings + 1)]
        for folder in folders:
            folder.mkdir()
        expected, seconds = whole(TRAININGS[kind], folders[-1])
        for number, folder in enumerate(folders[:-1]):
            draw = np.random.default_rng([number, *kind.encode()])
            result = killed(TRAININGS[kind], folder, seconds, draw)
            result["wrong"] = result["wrong"] or difference(runs_in(folder)[-1], expected)
            done.append(result)
            print(kind, result, file=sys.stderr, flush=True)
    return done


def main() -> int:
    """Print a row for each kind; returns 1 where something was lost or a process left over."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("kinds", nargs="*", metavar="TRAINING", help=f"some of {', '.join(TRAININGS)}")
    parser.add_argument("--trainings", type=int, default=10, help="of each kind (default: 10)")
    options = parser.parse_args()
    print("| training | trainings | kills | processes left over | lost |\n|---|---|---|---|---|")
    lost = 0
    for kind in options.kinds or TRAININGS:
        done = tried(kind, options.trainings)
        kills, left = (sum(one[name] for one in done) for name in ("kills", "not ended by itself"))
        wrong = sum(bool(one["wrong"]) for one in done)
        print(f"| {kind} | {len(done)} | {kills} | {left} | {wrong} |", flush=True)
        lost += left + wrong
    return bool(lost)


if __name__ == "__main__":
    sys.exit(main())
