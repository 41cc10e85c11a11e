"""What there is: models, their cards, robots, and the shell's completion. Imports no torch."""

import argparse
from collections.abc import Sequence
from fnmatch import fnmatch
from typing import Any

from msgspec.structs import asdict

from pedzoo.cli.check import known
from pedzoo.cli.output import (
    check_outputs,
    plain_console,
    print_tables,
    write_and_print,
    write_json,
    write_text,
)
from pedzoo.cli.parsing import command
from pedzoo.core.errors import UserError, unknown
from pedzoo.core.paths import config_names
from pedzoo.core.registry import (
    COMMANDS,
    MODELS,
    PHYSICS,
    POLICIES,
    ROBOT_POLICIES,
    ROBOT_REWARDS,
    ROBOTS,
    SCENARIOS,
    SENSORS,
    SUITES,
    datasets_of_folds,
)
from pedzoo.models.zoo.card import ModelCard
from pedzoo.models.zoo.card_page import page, results, sections
from pedzoo.models.zoo.store import find, is_file, names, no_model

COLUMNS = {
    "kB": "kB",
    "fold": "fold",
    "goal": "goal",
    "clock": "clock",
    "steps": "steps",
    "ade_m": "ade",
    "fde_m": "fde",
    "min_ade_20_scene_m": "best of 20 ade",
    "min_fde_20_scene_m": "best of 20 fde",
    "door": "door success",
}
"""Keys of a row of ``pedzoo models`` and what the table calls them."""

EXPLAINED = """\
fold: the scene that the model did not see (eth_ucy: it saw all); goal: what it knows of where people go
(window_end leaks the forecast's last position); steps: that it forecasts, of 0.4 s; ade and fde: metres, of
the most likely forecast on the fold's test windows (eth_ucy: validation windows), best of 20 per scene; door
success: share of people who get through. All of a model: pedzoo info NAME"""

SHELLS = ("bash", "zsh")


@command("pedzoo models 'sgan*'")
def models(pattern: str = "*", /, json: str | None = None) -> int:
    """List architectures and pretrained models.

    Args:
        pattern: Which names, with * and ?.
        json: Also write the tables to this file.
    """
    check_outputs(json=json)
    architectures = MODELS.described(pattern)
    weights = [_model(name) for name in names() if fnmatch(name, pattern)]

    def show() -> None:
        from pedzoo.eval.results import ResultTable

        _print_list("architectures (pedzoo fit --config ...):", architectures)
        print("\nmodels (pedzoo.load(name), pedzoo rollout NAME):")
        if good := [row for row in weights if "error" not in row]:
            shown = [key for key in COLUMNS if any(row.get(key) is not None for row in good)]
            cells = [[row["name"], *(_cell(row.get(key)) for key in shown)] for row in good]
            print_tables([ResultTable("", ["name", *(COLUMNS[key] for key in shown)], cells, 1)])
            print(EXPLAINED)
        for row in weights:
            if "error" in row:
                print(f"  {row['name']}: {row['error']}")
        print("" if weights else "  none\n", end="")

    report = {"command": "models", "architectures": architectures, "weights": weights}
    write_and_print(report, json, show)
    return 0


def _model(name: str) -> dict[str, Any]:
    """Return the facts and the headline of a card: errors on its own fold, and success at the door."""
    try:
        entry = find(name)
    except UserError as error:  # one bad card of many: the others are listed all the same
        return {"name": name, "error": str(error)}
    assert entry
    card, fold = entry.card, entry.card.training["fold"]
    result = {"name": name, "kB": card.size // 1000, "fold": fold}
    result |= {key: card.training[key] for key in ("goal", "clock")}
    result["steps"] = card.config.get("protocol", {}).get("pred_len")
    for report in card.evaluations:
        for row in report["rows"]:
            if report["command"] == "forecast" and report["protocol"].get("fold") == fold:
                result |= {key: value for key, value in row["metrics"].items() if key in COLUMNS}
            if row["case"].get("suite") == "door" and "success" in row["metrics"]:
                result["door"] = row["metrics"]["success"]
    return result


def _cell(value: Any) -> str:
    if value is None:
        return "-"
    return f"{value:.3f}" if isinstance(value, float) else str(value)


def _print_list(title: str, rows: Sequence[dict[str, str]], width: int = 0) -> None:
    width = width or max((len(row["name"]) for row in rows), default=0)
    print(title, *(f"  {row['name']:<{width}}  {row['about']}" for row in rows), sep="\n")
    print("" if rows else "  none\n", end="")


@command("pedzoo robots 'turtlebot*'")
def robots(pattern: str = "*", /, json: str | None = None) -> int:
    """List robots, their sensors, rewards and policies.

    Args:
        pattern: Which names, with * and ?.
        json: Also write the lists to this file.
    """
    check_outputs(json=json)
    kinds = {
        "robots": (ROBOTS, "--robot NAME:radius=0.35, pedzoo.make_robot_env(robot=)"),
        "sensors": (SENSORS, "make_robot_env(sensors=[...])"),
        "rewards": (ROBOT_REWARDS, "make_robot_env(reward={NAME: weight})"),
        "policies": (
            ROBOT_POLICIES,
            "pedzoo evaluate NAME --suite robots; policies of people drive robots, too",
        ),
    }
    lists = {kind: registry.described(pattern) for kind, (registry, _) in kinds.items()}

    def show() -> None:
        width = max((len(row["name"]) for rows in lists.values() for row in rows), default=0)
        for kind, rows in lists.items():
            _print_list(f"{kind} ({kinds[kind][1]}):", rows, width)

    write_and_print({"command": "robots", **lists}, json, show)
    return 0


@command("pedzoo info sgan_goal_map.zara1")
def info(name: str, /, json: str | None = None, markdown: str | None = None) -> int:
    """Show a model's card: training, data and its terms, results, checksum.

    Args:
        name: Zoo name, folder with a card, hf://OWNER/REPO or https:// address, or an architecture.
        json: Write the card to this file instead; - for here.
        markdown: Likewise, as a page.
    """
    check_outputs(json=json, markdown=markdown)
    if is_file(name):
        raise UserError(
            f"{name!r} is a file, and cards are asked for by name: FOLDER/ARCH.TAG, or a FOLDER; "
            "`pedzoo export CKPT --zoo` writes the card of a training run"
        )
    if (entry := find(name)) is None and name in MODELS.names():
        weights = ", ".join(one for one in names() if one.startswith(f"{name}.")) or "none"
        raise UserError(f"{name!r} is an architecture ({MODELS.describe(name)}); name its weights: {weights}")
    if entry is None:
        raise no_model(name)
    if json:
        write_json(json, {"command": "info", "card": asdict(entry.card)})
    if markdown:
        write_text(markdown, page(entry.card))
    if not (json or markdown):
        _print_card(entry.card)
    return 0


def _print_card(card: ModelCard) -> None:
    from rich.table import Table

    from pedzoo.eval.results import ResultTable

    console = plain_console(width=110)
    console.print(card.name, style="bold")
    for title, facts in sections(card).items():
        table = Table.grid(padding=(0, 2))
        table.add_column(no_wrap=True)
        table.add_column(overflow="fold")
        for key, value in facts.items():
            table.add_row(f"  {key}", value)
        console.print(f"\n{title}", style="bold")
        console.print(table)
    if not card.evaluations:
        console.print("\nResults: not measured yet")
    for result in results(card):
        console.print(f"\n{result.said}")
        print_tables([ResultTable("", result.head, result.rows, 1)])


@command("pedzoo completion bash > ~/.pedzoo.bash && source ~/.pedzoo.bash")
def completion(shell: str, /) -> int:
    """Let the shell complete commands, options and names.

    Args:
        shell: bash or zsh.
    """
    import shtab

    if shell not in SHELLS:
        raise unknown("shell", shell, SHELLS)
    values = {"--config": config_names(), "--scenario": SCENARIOS.names(), "--suite": SUITES.names()}
    values |= {"--physics": PHYSICS.names(), "--weights": names(), "--data.fold": [*datasets_of_folds()]}
    words = {name: names() for name in ("export", "forecast", "info")}
    words |= {name: [*POLICIES.names(), *names()] for name in ("evaluate", "rollout", "score")}
    parser = argparse.ArgumentParser("pedzoo")
    commands = parser.add_subparsers()
    for name in COMMANDS.names():
        one = commands.add_parser(name, help=COMMANDS.describe(name))
        for option in known().get(name, ["--json"]):
            if option != "--help" and not option.endswith("+"):
                one.add_argument(option, choices=values.get(option))
        if name in words:
            one.add_argument("words", nargs="*", choices=words[name])
    print(shtab.complete(parser, shell))
    return 0
