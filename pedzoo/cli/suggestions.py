"""Words of a command line, and what a wrong one gets for an answer. Imports nothing heavy."""

from difflib import get_close_matches

from pedzoo.core.errors import UserError
from pedzoo.core.paths import config_names
from pedzoo.core.spec import split, unquoted


def given(argv: list[str], flag: str) -> str | None:
    """Return the value that ``flag`` has on the command line, None where it is not there."""
    for i, word in enumerate(argv):
        name, joined, value = word.partition("=")
        if name == flag and (joined or i + 1 < len(argv)):
            return value if joined else argv[i + 1]
    return None


def whole_numbers(option: str, text: str) -> list[int]:
    """Return the numbers of ``0,1,2``.

    Raises:
        UserError: Something else is among them.
    """
    try:
        return [int(part) for part in text.split(",") if part.strip()]
    except ValueError:
        raise UserError(f"{option} {text}: expected whole numbers between commas") from None


def split_names(text: str) -> list[str]:
    """Split at commas, but for those between the settings behind a name's colon."""
    result: list[str] = []
    for part in split(text):
        goes_on = bool(result) and ":" in result[-1] and "=" in part.partition(":")[0]
        result = [*result[:-1], f"{result[-1]},{part}"] if goes_on else [*result, part]
    return [unquoted(part) for part in result]


def unknown_option(given: str, known: list[str]) -> str:
    """Return the message for an option that does not exist, with the nearest one."""
    if given in known:  # it belongs to a model, and there is none yet
        return f"{given} needs a model: choose one with --config NAME ({shipped_configs()}) or --model CLASS"
    parent, _, leaf = given.rpartition(".")
    below = [name for name in known if name.startswith(f"{parent}.") or name.rpartition(".")[0] == parent]
    below.sort(key=lambda name: name.count("."))
    # of two with one name, the first of those that are nested least
    siblings = {name.rpartition(".")[2].lstrip("-"): name for name in reversed(below)}
    near = [siblings[name] for name in get_close_matches(leaf.lstrip("-"), siblings, n=1)]
    # `--lr` for `--model.lr`, then a misspelt parent
    near += [name for name in known if name.rpartition(".")[2] == leaf.lstrip("-")]
    near += get_close_matches(given, known, n=1, cutoff=0.7)
    return f"unknown option {given}" + (f": did you mean {near[0]}?" if near else "; --help lists all")


NO_POLICIES = "no policies: name them before the options, as in orca go_to_goal --episodes 20"


def without_model() -> str:
    """Return the message for a training without a model."""
    return f"no model: choose one with --config NAME ({shipped_configs()}) or --model CLASS"


def shipped_configs() -> str:
    """Return the names of all shipped configs, as messages list them."""
    return ", ".join(config_names()) or "none shipped"
