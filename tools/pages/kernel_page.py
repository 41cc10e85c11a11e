"""Writes checkpoints/results/KERNEL.md: the numbers of every shipped card, then and now.

    pedzoo evaluate NAME ... --from-card --json FILE     # as many files as you like
    python tools/bench/before_after.py --peer ... --json speed.json      # and the other two, if you like
    python tools/pages/robots_respected.py --json robots.json
    python tools/pages/kernel_page.py FILE... --speed speed.json --robots robots.json --out KERNEL.md

The cards were measured before the kernel (pedzoo/sim/kernel.py); what has changed since and why stands in
`WHY`, and every number outside of the card's 95 % interval is listed.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

COLUMNS = {
    "success": "success",
    "agent_contacts_per_min": "contacts / min",
    "wall_contacts_per_min": "wall contacts / min",
    "time_ratio": "time ratio",
    "path_ratio": "path ratio",
    "ade_m": "ADE, m",
    "fde_m": "FDE, m",
}

WHY = """What changed between the two, in the order of how much it moves:

1. **Goals**: no agent starts within 1 m of its first goal, and later goals are drawn ahead. `goals drawn`
   has other goals than before, so its numbers are of other episodes.
2. **Ratios of sums**: `time_ratio` and `path_ratio` were means of ratios over people.
3. **Walls**: an agent slides along the wall that it is nearest to and the one that it ran into last; before,
   it was pushed out of walls up to three times. Agents that scrape along corners touch them at other moments.
4. **Blending**: velocities blend over 0.1 s between two decisions. Decisions end where they ended before,
   except where the top speed forbids to catch up. The paths between differ by up to 0.05 s times the change
   of velocity, so contacts between two decisions move.
5. **Safety layer**: it keeps the blended path clear and not a straight one, and its rounds end with a settled
   scene. Two people at a door come up to 5 cm nearer to each other than before, and still do not touch.
6. **ORCA's part**: ORCA takes all of the avoidance of agents that it does not move. That changes the warm
   start of scenes in which a person stands.
7. **Stochastic models** whose first step crosses a threshold by a rounding walk another way from there on.

Forecasts do not pass through the kernel: they are the same to the last digit shown."""


def main() -> None:
    """Read the reports and write the page."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("files", nargs="+", type=Path)
    parser.add_argument("--speed", type=Path, help="Report of tools/bench/before_after.py.")
    parser.add_argument("--robots", type=Path, help="Report of tools/pages/robots_respected.py.")
    parser.add_argument("--out", type=Path, required=True)
    given = parser.parse_args()
    rows = [row for file in given.files for row in json.loads(file.read_text())["rows"] if "card" in row]
    lines = list(page(rows))
    if given.speed:
        lines += ["", *speed_table(json.loads(given.speed.read_text()))]
    if given.robots:
        lines += ["", *robots_table(json.loads(given.robots.read_text()))]
    given.out.write_text("\n".join(lines) + "\n")
    print(f"{given.out}: {len({row['name'] for row in rows})} cards")


def page(rows: Sequence[dict[str, Any]]) -> Iterator[str]:
    """Yield the lines of the page."""
    same = [value for row in rows for value in row["same"].values()]
    names = sorted({row["name"] for row in rows})
    yield "# Shipped cards before and after the kernel"
    yield ""
    agree, differ, unsure = (sum(value is one for value in same) for one in (True, False, None))
    yield (
        f"{len(names)} cards measured again by `pedzoo evaluate NAME --from-card`: {agree} of {len(same)} "
        f"numbers are equal or lie in the card's 95 % interval, {differ} do not, {unsure} differ and have no "
        "interval."
    )
    yield ""
    yield WHY
    yield ""
    yield from main_table(rows)
    yield ""
    yield "## Every number outside of its interval"
    yield ""
    yield "| model | case | number | card | now |"
    yield "|---|---|---|---|---|"
    for row in rows:
        for metric, agrees in row["same"].items():
            if agrees is not True:
                case, now = row["case"]["evaluation"], row["metrics"].get(metric)
                yield f"| `{row['name']}` | {case} | {metric} | {shown(row['card'][metric])} | {shown(now)} |"


def main_table(rows: Sequence[dict[str, Any]]) -> Iterator[str]:
    """Yield the table of all cards: before, an arrow, and now; one value where both are the same."""
    yield "| model | case | n | " + " | ".join(COLUMNS.values()) + " |"
    yield "|---" * (3 + len(COLUMNS)) + "|"
    for row in rows:
        cells = [both(row["card"].get(key), row["metrics"].get(key)) for key in COLUMNS]
        if any(cells):
            start = f"| `{row['name']}` | {row['case']['evaluation']} | {row['n']:.0f} | "
            yield start + " | ".join(cells) + " |"


def speed_table(report: dict[str, Any]) -> Iterator[str]:
    """Yield the section of speeds, before and after and of peers."""
    yield "## Speed"
    yield ""
    asked = report["protocol"]
    commits = f"commits {asked['before']} and {asked['after']}"
    turns = f"{asked['turns']} turns of {asked['seconds_per_turn']} s"
    yield (
        f"Agent-steps per second of one thread, {commits} in turns, in one run of "
        f"`python tools/bench/before_after.py` ({turns}). Read the ratios; bars are those of the issue. "
        "`kernel.step` is a plain loop without observations."
    )
    yield ""
    yield "| what | size | physics | before | after | after / before | bar |"
    yield "|---|---|---|---|---|---|---|"
    for row in report["rows"]:
        metrics, case = row["metrics"], row["case"]
        if "times_before" in metrics:
            speeds = f"{metrics['before_agent_steps_per_s']:,.0f} | {metrics['after_agent_steps_per_s']:,.0f}"
            bars = ", ".join(
                f"{bar['bar'].split()[-1]} {'met' if bar['ok'] else 'MISSED'}" for bar in row["bars"]
            )
            ratio = f"{metrics['times_before']:.2f}"
            yield f"| {row['name']} | {case['size']} | {case['physics']} | {speeds} | {ratio} | {bars} |"
        elif "before_percent" in metrics:
            shares = f"{metrics['before_percent']:.0f} % | {metrics['after_percent']:.0f} %"
            yield f"| {row['name']} | {case['size']} | | {shares} | | below 25 % |"
    yield ""
    yield "| other programs | size | agent-steps/s | step, s |"
    yield "|---|---|---|---|"
    for row in report["rows"]:
        if "agent_steps_per_s" in row["metrics"]:
            speed, case = row["metrics"]["agent_steps_per_s"], row["case"]
            yield f"| {row['name']} | {case['size']} | {speed:,.0f} | {case['step_s']} |"


def robots_table(report: dict[str, Any]) -> Iterator[str]:
    """Yield the section of robots that keep their course."""
    yield "## Robots are respected"
    yield ""
    yield (
        "A disc of 0.5 m that is parked or drives at 1 m/s and reacts to nothing, nine lateral offsets, by "
        "`python tools/pages/robots_respected.py`. A touch is a distance below 0.65 m between centres."
    )
    yield ""
    yield "| policy | case | runs | touches | arrived | nearest, m |"
    yield "|---|---|---|---|---|---|"
    for row in report["rows"]:
        metrics, case = row["metrics"], row["case"]
        counts = f"{row['n']} | {metrics['touches']:.0f} | {metrics['arrived']:.0f}"
        yield f"| `{row['name']}` | {case} | {counts} | {metrics['nearest_m']:.3f} |"


def both(before: float | None, now: float | None) -> str:
    """Return the two values of a cell."""
    if before is None and now is None:
        return ""
    first, second = shown(before), shown(now)
    return first if first == second else f"{first} → {second}"


def shown(value: float | None) -> str:
    """Return a value with three significant digits."""
    return "-" if value is None else f"{value:.3g}"


if __name__ == "__main__":
    main()
