"""What pedzoo does when all goes wrong: hostile files, kills, full disks, long runs.

```
python -m tools.reliability                 # all, for hours; goes on where it was
python -m tools.reliability --quick         # minutes: little of each
python -m tools.reliability fuzz:ros kills  # parts, or one thing of a part
```
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from pedzoo.core.paths import write_atomically
from tools.reliability import fuzz, kills, long_run
from tools.reliability.kills import TRAININGS
from tools.reliability.page import Goals, State, page, wrong
from tools.reliability.readers import READERS
from tools.reliability.suite import attack

RESULTS = Path(__file__).parents[2] / "checkpoints" / "results"
QUICK = Path("runs", "reliability")

PARTS: dict[str, Iterable[str]] = {
    "suite": ["all"],
    "fuzz": READERS,
    "kills": TRAININGS,
    "long": Goals().long,
}
"""What there is to try, by part."""


class Run:
    """A run of all or some parts, whose figures are in one file.

    Attributes:
        folder: Where its figures are.
        goals: What is wanted.
        state: What was done.
    """

    def __init__(self, quick: bool, folder: Path) -> None:
        """Read what was done before."""
        self._quick, self.folder = quick, folder
        self.goals = Goals(300, 1, {"comings": 200, "torch": 30_000, "bullet": 600}) if quick else Goals()
        self.state = self.read()

    def read(self) -> State:
        """Return what was done, as it is written down."""
        file = self.folder / "RELIABILITY.json"
        known: State = json.loads(file.read_text()) if file.is_file() else {}
        return {part: known.get(part, {}) for part in PARTS}

    def go_on(self, part: str, thing: str) -> None:
        """Go on with one thing in this process."""
        done: Any = self.state[part]
        if part == "suite":
            attack(done, self._quick)
        elif part == "fuzz":
            fuzz.go_on(thing, self.goals.fuzz, done.setdefault(thing, {}), self.save)
        elif part == "kills":
            kills.go_on(thing, self.goals.kills, done.setdefault(thing, []), self.save)
        else:
            long_run.go_on(thing, self.goals.long[thing], done.setdefault(thing, []), self.save)
        self.save()

    def elsewhere(self, one: str) -> int:
        """Go on with ``PART:THING`` in a process of its own, which disturbs no other; return how it ended."""
        print(one, flush=True)
        more = ["--to", str(self.folder), *(["--quick"] if self._quick else [])]
        return subprocess.run([sys.executable, "-m", "tools.reliability", one, *more], check=False).returncode

    def save(self) -> None:
        """Write down what was done, and make the page."""
        state = f"{json.dumps(self.state, indent=1)}\n"
        write_atomically(self.folder / "RELIABILITY.json", state.encode())
        write_atomically(self.folder / "RELIABILITY.md", page(self.state, self.goals).encode())


def named(word: str, parser: argparse.ArgumentParser) -> list[str]:
    """Return all of a part, or the one thing of it that a word names, as ``PART:THING``."""
    part, _, thing = word.partition(":")
    if part not in PARTS or thing not in ("", *PARTS[part]):
        parser.error(f"{word!r}: expected one of {', '.join(PARTS.get(part, PARTS))}")
    return [word] if thing else [f"{part}:{one}" for one in PARTS[part]]


def main(argv: list[str] | None = None) -> int:
    """Go on with what is asked for; return 1 where something was lost."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("parts", nargs="*", metavar="PART[:THING]", help="suite, fuzz, kills, long; all")
    parser.add_argument("--quick", action="store_true", help=f"little of each, with figures in {QUICK}")
    parser.add_argument("--to", type=Path, help=f"folder of the figures; {RESULTS}")
    options = parser.parse_args(argv)
    folder = options.to or (QUICK if options.quick else RESULTS)
    run = Run(options.quick, folder)
    asked = [one for word in options.parts or PARTS for one in named(word, parser)]
    if len(asked) == 1:
        run.go_on(*asked[0].split(":"))
        return 0
    ended = {one: run.elsewhere(one) for one in asked}
    lost = [f"{one} ended with {code}" for one, code in ended.items() if code] + wrong(run.read())
    print("\n".join(lost) or "nothing was lost, and no file did harm")
    return bool(lost)


if __name__ == "__main__":
    raise SystemExit(main())
