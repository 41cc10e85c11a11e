"""Draw success in the loop against ADE over trainings: python tools/plot_training.py RUN... OUT.png."""

from __future__ import annotations

import sys

from pedzoo.errors import UserError
from pedzoo.eval.training_plot import plot_training

if __name__ == "__main__":
    if len(sys.argv) < 3:
        raise SystemExit(__doc__)
    try:
        plot_training(sys.argv[1:-1], sys.argv[-1])
    except UserError as error:
        raise SystemExit(str(error)) from error
