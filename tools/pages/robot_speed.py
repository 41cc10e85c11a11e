r"""Writes checkpoints/results/ROBOT_SPEED.md from a report of ``pedzoo bench robots``.

pedzoo bench robots --crowdnav ../CrowdNav --peer_python ../venv_peers/bin/python --json ROBOT_SPEED.json \
        --peer tools/bench/peers/{vmas_navigation,jaxnav,crowdnav_gym}.py
python tools/pages/robot_speed.py ROBOT_SPEED.json --out ROBOT_SPEED.md
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from tools.bench.figures import Measured, Row
from tools.bench.tables import text

INTRO = """Scenes of 5 people and a robot with a lidar of 64 beams, one thread, processor time, all sides of
a size in turns; medians ± half the distance of the quartiles. An agent-step is one decision of the robot with
what one agent does until the next one; `step, s` is how much time that is. Steps differ in length and in what
is in them, so the last column has the seconds that pass in all scenes in one second of the processor."""

NOTES = """- Ours, in `apartment.7`: 0.2 s with the robot's policy (straight to the waypoint), people's
  decisions, contacts and goals every 0.1 s, walls, guidance around them, all sensors, rewards and resets.
- VMAS' `navigation`: 0.1 s, random actions, no agent plans; 16 of the 192 edges of the same walls, or none.
- JaxNav: 0.1 s, random actions, walls of its own; agents that touched something stand. One robot's rays are
  computed; JaxNav itself computes those of all.
- **CrowdNav's own gym has one environment, no walls and no lidar, and its people decide every 0.25 s**; a
  robot that goes straight, RVO2 through pyrvo.
- A sample of PPO is one decision of one robot: gathering it and learning from it, in four passes. People of
  `robot/ppo` do not see the robot and are walked once, before. `robot/rooms`: 32 beams, 4 to 6 people."""


def main() -> None:
    """Read the report and write the page."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("file", type=Path, help="Report of pedzoo bench robots --json.")
    parser.add_argument("--out", type=Path, required=True)
    given = parser.parse_args()
    given.out.write_text("\n".join(page(json.loads(given.file.read_text()))) + "\n")


def page(report: dict[str, Any]) -> Iterator[str]:
    """Yield the lines of the page."""
    rows = [Row.from_json(row) for row in report["rows"] if row["section"] == "robots"]
    yield "# Speed of robots among people"
    yield ""
    yield INTRO
    yield ""
    yield "| scenes x people | what | agent-steps/s | step, s | seconds of scenes per second |"
    yield "|---|---|---:|---:|---:|"
    walking = [row for row in rows if "samples_per_s" not in row.metrics]
    for row in walking:
        name = f"pedzoo, {row.name}" if row.name.startswith("people") else row.name
        cells = [cell(row, name) for name in ("agent_steps_per_s", "step_s", "scene_s_per_s")]
        yield f"| {row.case['size']} | {name} | {' | '.join(cells)} |"
    yield ""
    yield "| training | where | scenes x scenarios | samples/s |"
    yield "|---|---|---|---:|"
    for row in rows:
        if "samples_per_s" in row.metrics:
            size, where = row.case["size"], row.case["map"]
            yield f"| {row.name} | {where} | {size} | {cell(row, 'samples_per_s')} |"
    yield ""
    yield NOTES
    yield from (f"- {row.name}, {row.case['size']}: {row.note}." for row in walking if not row.metrics)
    yield ""
    yield machine(report)


def cell(row: Row, metric: str) -> str:
    """Return a value with its spread; a dash for none."""
    value: Measured | None = row.metrics.get(metric)
    return "-" if value is None else text(value)


def machine(report: dict[str, Any]) -> str:
    """Return where and how it was measured, and how busy the machine was."""
    about, asked = report["machine"], report["protocol"]
    busy = max(about["load_before"] or 0.0, about["load_after"] or 0.0)
    line = (
        f"{about['cpu']}, {about['cores']} cores; {asked['turns']} turns of at least "
        f"{asked['seconds_per_turn']:g} s; load of the machine {about['load_before']} before and "
        f"{about['load_after']} after."
    )
    if busy > asked["threads"] + 0.5:
        line += " **Other programs ran beside it and shared its caches: read the ratios.**"
    return line


if __name__ == "__main__":
    main()
