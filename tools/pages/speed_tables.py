"""The tables of docs/speed.md that BENCH.json and DEVICES.json in checkpoints/results give, as Markdown."""

from __future__ import annotations

import json
from typing import Any

from pedzoo.core.paths import shipped

RESULT = shipped("checkpoints") / "results" / "BENCH.json"
DEVICES = RESULT.with_name("DEVICES.json")

SIZES = ("1 x 5", "64 x 5", "1024 x 5", "1 x 100", "1 x 500")
"""Columns: scenes and people of each."""

ROWS = {
    "env + go_to_goal": "environment alone (`go_to_goal`), steps of 0.4 s",
    "env + orca:dt=0.4": "with ORCA and walls, 0.4 s",
    "env + social_force": "with social force and walls, 0.1 s",
    "env + sgan_goal_map.zara1": "with SGAN+goal+map, 0.4 s",
    "sgan_goal_map.zara1 alone": "SGAN+goal+map alone",
    "pyrvo, from python": "RVO2 from Python, the same walls, nothing else",
    "VMAS, lidar": "VMAS `navigation` with lidar, no walls, 0.1 s",
}
"""Rows of the first table, and what they are called."""

LARGE = "1024 x 5"
VERSUS = (
    ("environment alone, 0.4 s", "VMAS with lidar, 0.1 s", ("env + go_to_goal",), "times_vmas_lidar"),
    ("environment alone, 0.1 s", "VMAS with lidar, 0.1 s", ("env + go_to_goal:dt=0.1",), "times_vmas_lidar"),
    ("environment and ORCA", "RVO2 alone", ("env + orca:dt=0.4",), "times_pyrvo_from_python"),
    (
        "environment and ORCA without walls / with walls",
        "RVO2's bare C++",
        ("env + orca:dt=0.4,walls=false", "env + orca:dt=0.4"),
        "times_pyrvo_bare",
    ),
    (
        "environment and SGAN+goal+map",
        "the network alone",
        ("env + sgan_goal_map.zara1",),
        "times_network",
    ),
)
"""Rows of the second table: pedzoo, the other, the rows that are compared, and with what."""


def steps() -> str:
    """Return agent-steps per second, a column for each size."""
    report, lines = known(), [f"| scenes x people | {' | '.join(SIZES)} |", f"|---|{'---|' * len(SIZES)}"]
    for name, said in ROWS.items():
        values = [value(report, name, size, "agent_steps_per_s") for size in SIZES]
        lines.append(f"| {said} | {' | '.join('' if one is None else rounded(one) for one in values)} |")
    versions = report["versions"]
    machine = f"{report['machine']['cpu']}, torch {versions['torch']}, commit {versions['commit']}"
    return "\n".join([*lines, "", f"{machine}; medians of {report['protocol']['turns']} turns."])


def versus() -> str:
    """Return how often pedzoo is as fast as others in the largest size."""
    report, lines = known(), ["| pedzoo | other | times |", "|---|---|---|"]
    for ours, other, names, metric in VERSUS:
        values = [value(report, name, LARGE, metric) for name in names]
        lines.append(f"| {ours} | {other} | {' / '.join('-' if v is None else f'{v:.1f}' for v in values)} |")
    return "\n".join(lines)


def devices() -> str:
    """Return agent-steps per second on CPU and GPU, and how many times as fast the GPU is."""
    report = json.loads(DEVICES.read_text())
    rates = {(row["policy"], row["size"], row["device"]): row["agent_steps_per_s"] for row in report["rows"]}
    sizes = list(dict.fromkeys(size for _, size, _ in rates))
    said = " | ".join(size.replace("x", " x ") for size in sizes)
    lines = [f"| scenes x people: CPU / GPU | {said} |", f"|---|{'---|' * len(sizes)}"]
    for policy in dict.fromkeys(policy for policy, _, _ in rates):
        pairs = [(rates[policy, size, "cpu"], rates[policy, size, "cuda"]) for size in sizes]
        cells = (f"{rounded(cpu)} / {rounded(gpu)} ({gpu / cpu:.2g})" for cpu, gpu in pairs)
        lines.append(f"| `{policy}` | {' | '.join(cells)} |")
    about, named = report["machine"], " and ".join(report["machine"]["devices"])
    busy = f"{about['load']:.0f} programs ran"
    return "\n".join([*lines, "", f"{named}; {busy}; torch {report['torch']}. In brackets: GPU / CPU."])


def known() -> dict[str, Any]:
    """Return the report."""
    return json.loads(RESULT.read_text())


def value(report: dict[str, Any], name: str, size: str, metric: str) -> float | None:
    """Return a figure of a row of the section loop, None where there is none."""
    rows = (row for row in report["rows"] if row["section"] == "loop" and row["case"].get("size") == size)
    return next((row["metrics"].get(metric) for row in rows if row["name"] == name), None)


def rounded(number: float) -> str:
    """Return a number with three digits that count."""
    digits = max(0, len(str(int(number))) - 3)
    return f"{round(number, -digits):,.0f}"
