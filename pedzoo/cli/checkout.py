"""Commands whose code is in ``tools/`` of a checkout and in no wheel."""

from pedzoo.core.errors import UserError
from pedzoo.core.registry import ROOT, folder_of, import_of_checkout


def run_tool(command: str, package: str, argv: list[str]) -> int:
    """Run a command with the module ``command`` of a package in ``tools/``; returns the exit code.

    Raises:
        UserError: This pedzoo was installed from a wheel.
    """
    if not (folder_of(package) / "command.py").is_file():
        raise UserError(
            f"{command}: needs a checkout of pedzoo's repository, and {ROOT} is none: "
            f"git clone the repository, run tools/setup in it, then .venv/bin/pedzoo {command}"
        )
    return import_of_checkout(f"{package}.command").run(argv)
