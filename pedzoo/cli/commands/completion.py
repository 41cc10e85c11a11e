"""``pedzoo completion``: commands, options and names on the tab key of a shell."""

import argparse
from importlib import import_module

from pedzoo.cli.check import known
from pedzoo.cli.parsing import known_options, parser_of
from pedzoo.core.errors import unknown
from pedzoo.core.paths import config_names
from pedzoo.core.registry import PHYSICS, POLICIES, SCENARIOS, SUITES, Registry, datasets_of_folds
from pedzoo.models.zoo.store import names

HELP = "let the shell complete commands, options and names"
EXAMPLE = "pedzoo completion bash > ~/.pedzoo.bash && source ~/.pedzoo.bash"

SHELLS = ("bash", "zsh")


def run(shell: str, /) -> int:
    """Print the shell's code.

    Args:
        shell: bash or zsh.
    """
    import shtab

    if shell not in SHELLS:
        raise unknown("shell", shell, SHELLS)
    print(shtab.complete(_parser(), shell))
    return 0


def _parser() -> argparse.ArgumentParser:
    """Return a parser of all commands with the names that their words and options may have."""
    values = {"--config": config_names(), "--scenario": SCENARIOS.names(), "--suite": SUITES.names()}
    values |= {"--physics": PHYSICS.names(), "--weights": names(), "--data.fold": [*datasets_of_folds()]}
    words = {name: names() for name in ("export", "forecast", "info")}
    words |= {name: [*POLICIES.names(), *names()] for name in ("evaluate", "rollout", "score")}
    result = argparse.ArgumentParser("pedzoo")
    commands = result.add_subparsers()
    registry = Registry("command", __name__.rpartition(".")[0])
    for command in registry.names():
        module = registry.module_of(command)
        parser = commands.add_parser(command, help=registry.constant(command, "HELP"))
        for option in known().get(command) or (_options(module) if module else []):
            if option != "--help" and not option.endswith("+"):
                parser.add_argument(option, choices=values.get(option))
        if command in words:
            parser.add_argument("words", nargs="*", choices=words[command])
    return result


def _options(module: str) -> list[str]:
    options = known_options(parser_of(import_module(module)))
    return ["--json"] if options == ["--help"] else options
