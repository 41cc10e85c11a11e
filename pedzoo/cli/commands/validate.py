"""``pedzoo validate``."""

from pedzoo.cli.training import train

HELP = "open-loop metrics on the validation windows"
EXAMPLE = "pedzoo validate --ckpt_path runs/sgan_goal/zara1-seed0/checkpoints/best.ckpt"


def run(argv: list[str]) -> int:
    """Run the command; returns the exit code."""
    return train("validate", argv, HELP, EXAMPLE)
