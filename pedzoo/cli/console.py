"""The terminal as every command writes to it: text as it is."""

from rich.console import Console


def plain_console(stderr: bool = False, width: int = 120) -> Console:
    """Return a console that prints every text as it is.

    Rich would read brackets as styles and ``:door:`` as a picture: names, paths and settings have both.

    Args:
        stderr: Write there instead of to the standard output.
        width: Characters of a line where there is no terminal.
    """
    console = Console(stderr=stderr, markup=False, emoji=False, highlight=False)
    if not console.is_terminal:
        console.width = width
    return console
