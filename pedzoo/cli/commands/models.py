"""``pedzoo models``: what can be trained and what can be loaded, read without importing torch."""

from fnmatch import fnmatch
from typing import Any

from pedzoo.cli.output import check_outputs, print_tables, write_and_print
from pedzoo.core.errors import UserError
from pedzoo.core.registry import MODELS
from pedzoo.models.zoo.store import find, names

HELP = "list architectures and pretrained models"
EXAMPLE = "pedzoo models 'sgan*'"

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
"""Keys of a row and what the table calls them."""

EXPLAINED = """\
fold: the scene that the model did not see (eth_ucy: it saw all); goal: what it knows of where people go
(window_end leaks the forecast's last position); steps: that it forecasts, of 0.4 s; ade and fde: metres, of
the most likely forecast on the fold's test windows (eth_ucy: validation windows), best of 20 per scene; door
success: share of people who get through. All of a model: pedzoo info NAME"""


def run(pattern: str = "*", /, json: str | None = None) -> int:
    """Print both tables.

    Args:
        pattern: Which names, with * and ?.
        json: Also write the tables to this file.
    """
    check_outputs(json=json)
    architectures = MODELS.described(pattern)
    weights = [_row(name) for name in names() if fnmatch(name, pattern)]
    report = {"command": "models", "architectures": architectures, "weights": weights}
    write_and_print(report, json, lambda: _print(architectures, weights))
    return 0


def _row(name: str) -> dict[str, Any]:
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


def _print(architectures: list[dict[str, str]], weights: list[dict[str, Any]]) -> None:
    from pedzoo.eval.results import ResultTable

    print("architectures (pedzoo fit --config ...):")
    width = max((len(row["name"]) for row in architectures), default=0)
    for row in architectures:
        print(f"  {row['name']:<{width}}  {row['about']}")
    print(f"{'' if architectures else '  none'}\nmodels (pedzoo.load(name), pedzoo rollout NAME):")
    if good := [row for row in weights if "error" not in row]:
        shown = [key for key in COLUMNS if any(row.get(key) is not None for row in good)]
        cells = [[row["name"], *(_cell(row.get(key)) for key in shown)] for row in good]
        print_tables([ResultTable("", ["name", *(COLUMNS[key] for key in shown)], cells, 1)])
        print(EXPLAINED)
    for row in weights:
        if "error" in row:
            print(f"  {row['name']}: {row['error']}")
    print("" if weights else "  none\n", end="")


def _cell(value: Any) -> str:
    if value is None:
        return "-"
    return f"{value:.3f}" if isinstance(value, float) else str(value)
