"""Draw success in the loop against ADE over trainings: python tools/pages/plot_training.py RUN... OUT.png."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from pedzoo.core.errors import UserError
from pedzoo.models.export.run_record import monitored

ERROR, SUCCESS, CLEAN, IN_TIME = "val/ade", "rollout/success", "rollout/clean", "rollout/stl"
"""What is drawn of the metrics that `pedzoo fit` logs."""


def plot_training(runs: Sequence[str | Path], path: str | Path) -> None:
    """Draw success in the loop against ADE over trainings into a PNG.

    Left, by epoch: above the share of people who reach their goals, that of episodes in which all do and
    all avoid contacts, and success weighted by time; below ADE. Right: success weighted by time (with a
    safety layer nearly all arrive, and how fast is what training changes) against ADE, a point for
    every validation.

    Args:
        runs: Run folders of ``pedzoo fit``, with ``metrics.csv``.
        path: The picture.

    Raises:
        UserError: A run has no validation with both kinds of numbers.
    """
    figure = Figure(figsize=(11, 4.6), layout="constrained")
    panels = figure.subplot_mosaic([["shares", "against"], ["error", "against"]])
    shares, error, against = panels["shares"], panels["error"], panels["against"]
    for number, run in enumerate(map(Path, runs)):
        if not (run / "metrics.csv").is_file():
            raise UserError(f"no training in {str(run)!r}: expected a run folder with metrics.csv")
        wanted = (ERROR, SUCCESS, CLEAN, IN_TIME)
        ade, success, clean, in_time = (monitored(run, metric) for metric in wanted)
        both = sorted(ade.keys() & in_time.keys())
        if not both:
            raise UserError(
                f"run {str(run)!r} has no validation with {ERROR} and {IN_TIME}:"
                " train with --rollout.scenarios"
            )
        color, named = f"C{number}", number == 0
        _over_epochs(shares, success, "--", color, "people who arrive" if named else None)
        _over_epochs(shares, clean, ":", color, "clean episodes" if named else None)
        _over_epochs(shares, in_time, "-", color, "success weighted by time" if named else None)
        _over_epochs(error, ade, "-", color)
        _against(against, both, ade, in_time, color, f"{run.parent.name}/{run.name}")
    shares.set(ylabel="share", ylim=(0, 1.03), title="over training")
    shares.legend(loc="lower right", fontsize=8)
    error.set(xlabel="epoch", ylabel="ADE, metres", xlim=shares.get_xlim(), ylim=(0, None))
    against.set(xlabel="ADE on validation windows, metres", ylabel="success weighted by time")
    against.set_title("success against ADE; numbers are epochs, rings the best")
    against.legend(loc="lower right", fontsize=8)
    Path(path).parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=110)


def _over_epochs(
    axes: Axes, values: dict[int, float], style: str, color: str, label: str | None = None
) -> None:
    epochs = sorted(values)
    axes.plot(epochs, [values[at] for at in epochs], style, color=color, label=label, marker=".")


def _against(
    axes: Axes, epochs: list[int], ade: dict[int, float], success: dict[int, float], color: str, name: str
) -> None:
    """Draw the way of one run, its first and last and best point with their epochs."""
    x, y = [ade[epoch] for epoch in epochs], [success[epoch] for epoch in epochs]
    axes.plot(x, y, "-o", color=color, markersize=3, linewidth=0.8, label=name)
    best = max(epochs, key=success.__getitem__)
    for epoch in sorted({epochs[0], best, epochs[-1]}):
        at = ade[epoch], success[epoch]
        axes.annotate(f"{epoch}", at, (3, 4), textcoords="offset points", fontsize=8, color=color)
    axes.plot(ade[best], success[best], "o", color=color, markersize=7, fillstyle="none")


if __name__ == "__main__":
    if len(sys.argv) < 3:
        raise SystemExit(__doc__)
    try:
        plot_training(sys.argv[1:-1], sys.argv[-1])
    except UserError as error:
        raise SystemExit(str(error)) from error
