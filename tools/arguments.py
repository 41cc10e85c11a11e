"""The parser of the tools' commands."""

import argparse
from typing import NoReturn

from pedzoo.core.errors import UserError


class Arguments(argparse.ArgumentParser):
    """argparse with pedzoo's exit code and one line in place of the usage."""

    def __init__(self, command: str, about: str, example: str) -> None:
        """Set up ``pedzoo command``."""
        super().__init__(
            f"pedzoo {command}",
            description=about,
            epilog=f"example: {example}",
            allow_abbrev=False,
            formatter_class=argparse.RawDescriptionHelpFormatter,
        )

    def error(self, message: str) -> NoReturn:
        """Refuse the command line."""
        raise UserError(f"{message} (see {self.prog} --help)")
