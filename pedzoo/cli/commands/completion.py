"""``pedzoo completion``: commands, options and names on the tab key of a shell."""

HELP = "let the shell complete commands, options and names"
EXAMPLE = "pedzoo completion bash > ~/.pedzoo.bash && source ~/.pedzoo.bash"

SHELLS = ("bash", "zsh")

_BASH = """\
_pedzoo() {
    local IFS=$'\\n' word="${COMP_WORDS[COMP_CWORD]}"
    local known="$(pedzoo completion words "${COMP_WORDS[@]:1:COMP_CWORD-1}" 2>/dev/null)"
    COMPREPLY=($(compgen -W "$known" -- "$word"))
}
complete -o default -F _pedzoo pedzoo
"""
_START = {"bash": "", "zsh": "autoload -U +X bashcompinit && bashcompinit\n"}


def run(argv: list[str]) -> int:
    """Print the shell's code, or the words that can follow those of a command line; returns the exit code."""
    from pedzoo.cli.arguments import Arguments
    from pedzoo.core.errors import unknown

    if argv[:1] == ["words"]:
        print("\n".join(_following(argv[1:])))
        return 0
    parser = Arguments("completion", HELP, EXAMPLE)
    parser.add_argument("shell", help=f"{' or '.join(SHELLS)}")
    shell = parser.parse_args(argv).shell
    if shell not in SHELLS:
        raise unknown("shell", shell, SHELLS)
    print(_START[shell] + _BASH, end="")
    return 0


def _following(words: list[str]) -> list[str]:
    """Return what can follow the words of a command line, the command first."""
    from pedzoo.cli.checks import known
    from pedzoo.cli.main import COMMANDS
    from pedzoo.core.paths import config_names
    from pedzoo.core.registry import PHYSICS, POLICIES, SCENARIOS, SUITES, datasets_of_folds
    from pedzoo.models.zoo.store import names

    if not words:
        return COMMANDS.names()
    values = {
        "--config": config_names,
        "--scenario": SCENARIOS.names,
        "--suite": SUITES.names,
        "--physics": PHYSICS.names,
        "--weights": names,
        "--data.fold": lambda: [*datasets_of_folds()],
    }
    if words[-1] in values:
        return values[words[-1]]()
    options = [name for name in known()["options"].get(words[0], ["--help", "--json"]) if name[-1] != "+"]
    policies = POLICIES.names() if words[0] in ("evaluate", "rollout", "score") else []
    takes_models = words[0] in ("evaluate", "export", "forecast", "info", "rollout", "score")
    return [*options, *policies, *(names() if takes_models else [])]
