"""``pedzoo robots``: bodies, sensors, rewards and policies of robots, read without importing torch."""

from pedzoo.cli.output import check_outputs, write_and_print
from pedzoo.core.registry import ROBOT_POLICIES, ROBOT_REWARDS, ROBOTS, SENSORS

HELP = "list robots, their sensors, rewards and policies"
EXAMPLE = "pedzoo robots 'turtlebot*'"

LISTS = {
    "robots": (ROBOTS, "--robot NAME:radius=0.35, pedzoo.make_robot_env(robot=)"),
    "sensors": (SENSORS, "make_robot_env(sensors=[...])"),
    "rewards": (ROBOT_REWARDS, "make_robot_env(reward={NAME: weight})"),
    "policies": (ROBOT_POLICIES, "pedzoo evaluate NAME --suite robots; policies of people drive robots, too"),
}
"""By kind: the registry that is listed, and the options that accept its names."""


def run(pattern: str = "*", /, json: str | None = None) -> int:
    """Print the lists.

    Args:
        pattern: Which names, with * and ?.
        json: Also write the lists to this file.
    """
    check_outputs(json=json)
    lists = {kind: registry.described(pattern) for kind, (registry, _) in LISTS.items()}
    write_and_print({"command": "robots", **lists}, json, lambda: _print(lists))
    return 0


def _print(lists: dict[str, list[dict[str, str]]]) -> None:
    width = max((len(row["name"]) for rows in lists.values() for row in rows), default=0)
    for kind, rows in lists.items():
        print(f"{kind} ({LISTS[kind][1]}):")
        for row in rows:
            print(f"  {row['name']:<{width}}  {row['about']}")
        print("" if rows else "  none\n", end="")
