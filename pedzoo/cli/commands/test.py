"""``pedzoo test``."""

from pedzoo.cli.training import train

HELP = "open-loop metrics on the scene that was left out"
EXAMPLE = "pedzoo test --ckpt_path runs/sgan_goal/zara1-seed0/checkpoints/best.ckpt"


def run(argv: list[str]) -> int:
    """Run the command; returns the exit code."""
    return train("test", argv, HELP, EXAMPLE)
