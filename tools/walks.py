"""Count what a reader meets on the way: the files of pedzoo that five walks enter, and changes of package.

    python -m tools.walks            # each walk, then the files by room
    python -m tools.walks --files    # also their names, in the order in which they are entered

A walk is run and traced (`sys.setprofile`), compiled loops as Python. A file counts when one of its functions
runs. A room is a package: `sim`, `models`.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
from collections import Counter
from collections.abc import Callable
from contextlib import redirect_stdout
from io import StringIO
from types import FrameType
from typing import Any

MODEL = "approach_net_goal_map.indoor"
EPISODE = f"rollout {MODEL} --scenario door --episodes 1 --physics compiled"
FIT = "fit --config sgan_goal --data.fold embedded --runs=FOLDER --trainer.max_epochs=1"
FIT += " --trainer.limit_train_batches=1 --trainer.limit_val_batches=0"


class Trace:
    """Files of pedzoo whose functions run within the block, in the order of their first call."""

    def __init__(self, until: str = "") -> None:
        """End early where a function ``until`` of pedzoo begins."""
        self.files: dict[str, None] = {}
        self.changes, self.until, self.room = 0, until, ""

    def __enter__(self) -> Trace:
        sys.setprofile(self._seen)
        return self

    def __exit__(self, *_: object) -> None:
        sys.setprofile(None)

    def _seen(self, frame: FrameType, event: str, _: Any) -> None:
        _, inside, file = frame.f_code.co_filename.rpartition("/pedzoo/")
        if event != "call" or not inside or frame.f_code.co_name == "<module>":
            return
        if frame.f_code.co_name == self.until:
            sys.setprofile(None)
            return
        self.files.setdefault(file)
        room = file.partition("/")[0]
        self.changes += room != self.room
        self.room = room


def track_to_loss() -> Trace:
    """Walk from recorded tracks to a training loss."""
    import pedzoo
    from pedzoo.data.datamodule import TrajectoryDataModule

    model = pedzoo.load("sgan_goal.zara1")
    with Trace() as trace:
        data = TrajectoryDataModule(fold="embedded", goal="window_end")
        data.setup("fit")
        model.loss(next(iter(data.train_dataloader())))
    return trace


def string_to_velocities() -> Trace:
    """Walk from a policy's name to the velocities that it commands."""
    import pedzoo
    from pedzoo.policies.load import load_policy

    scenes = pedzoo.make_env("door", physics="compiled").reset()
    with Trace() as trace:
        load_policy(MODEL)(scenes)
    return trace


def plan_to_input() -> Trace:
    """Walk from a floor plan's name to what a network reads of it."""
    import torch

    import pedzoo
    from pedzoo.core.geometry import identity_pose
    from pedzoo.maps.bank import MapBank
    from pedzoo.maps.plans import load_plan
    from pedzoo.models.blocks.map_encoders import Viewpoints

    encoder = pedzoo.load(MODEL).map
    with Trace() as trace:
        grid = load_plan("apartment.7")
        bank = MapBank([grid])
        here, row = torch.tensor([[2.0, 2.0]]), torch.full((1,), bank.grids[0].map_id)
        encoder(Viewpoints(bank, here, torch.tensor([[1.0, 0.0]]), row, identity_pose(1)))
    return trace


def command(line: str, until: str = "") -> Trace:
    """Walk through a command, or until a function begins."""
    from pedzoo.cli.main import main

    with tempfile.TemporaryDirectory() as folder, Trace(until) as trace:
        main(line.replace("FOLDER", folder).split())
    return trace


WALKS: dict[str, tuple[str, Callable[[], Trace]]] = {
    "track": ("recorded track to loss", track_to_loss),
    "string": ("a policy's string to velocities", string_to_velocities),
    "plan": ("floor plan to network input", plan_to_input),
    "row": ("an episode to a row", lambda: command(EPISODE)),
    "fit": ("`fit` to its first batch", lambda: command(FIT, "training_step")),
}


def main() -> int:
    """Print the walks, each of a process of its own; returns the exit code."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("walks", nargs="*", metavar="WALK", help=f"some of {', '.join(WALKS)}")
    parser.add_argument("--files", action="store_true", help="name the files")
    parser.add_argument("--here", action="store_true", help="walk in this process")
    options = parser.parse_args()
    for name in options.walks or WALKS:
        if not options.here:
            words = [sys.executable, __file__, name, "--here", *["--files"] * options.files]
            environment = {**os.environ, "NUMBA_DISABLE_JIT": "1", "OMP_NUM_THREADS": "1"}
            subprocess.run(words, check=True, env=environment, stderr=subprocess.DEVNULL)
            continue
        about, walk = WALKS[name]
        with redirect_stdout(StringIO()):
            trace = walk()
        rooms = Counter(file.partition("/")[0] for file in trace.files)
        by_room = ", ".join(f"{room} {count}" for room, count in rooms.most_common())
        print(f"{about}: {len(trace.files)} files, {trace.changes} changes of package; {by_room}", flush=True)
        print("".join(f"    {file}\n" for file in trace.files if options.files), end="")
    return 0


if __name__ == "__main__":
    sys.exit(main())
