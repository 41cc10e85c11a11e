"""Pictures of matplotlib as files: which names they may have, and how they are written."""

from io import BytesIO
from pathlib import Path

from matplotlib.figure import Figure

from pedzoo.core.errors import UserError
from pedzoo.core.paths import PLOTS, check_ending, write_atomically


def check_plot_path(path: str | Path) -> None:
    """Raise the error that a file name gives which no plot can have."""
    check_ending(f"plot {str(path)!r}", path, PLOTS)


def write_figure(figure: Figure, path: str | Path, dpi: int = 130) -> None:
    """Write a picture, whole or not at all; its folder is made where it is missing.

    Raises:
        UserError: Another ending than `pedzoo.core.paths.PLOTS`, or the file cannot be written.
    """
    check_plot_path(path)
    data = BytesIO()
    figure.savefig(data, format=Path(path).suffix[1:].lower(), dpi=dpi)
    try:
        write_atomically(Path(path), data.getvalue())
    except OSError as error:
        raise UserError(f"cannot write {str(path)!r}: {error.strerror}") from error
