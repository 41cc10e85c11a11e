"""``pedzoo fit``: train a model. The code is in `pedzoo.cli.training`."""

from pedzoo.cli.training import train

HELP = "train a model; ends by printing the next command"
EXAMPLE = "pedzoo fit --config sgan_goal --data.fold zara1 --model.lr 1e-3"


def run(argv: list[str]) -> int:
    """Run the command; returns the exit code."""
    return train("fit", argv, HELP, EXAMPLE)
