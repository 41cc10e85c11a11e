"""Commands that read their words themselves: trainings, and those of a checkout's ``tools/``."""

from pedzoo.cli.parsing import command
from pedzoo.core.errors import UserError
from pedzoo.core.registry import ROOT, folder_of, import_of_checkout


@command("pedzoo fit --config sgan_goal --data.fold zara1 --model.lr 1e-3")
def fit(argv: list[str]) -> int:
    """Train a model; ends by printing the next command."""
    from pedzoo.cli.training import train

    return train("fit", argv)


@command("pedzoo validate --ckpt_path runs/sgan_goal/zara1-seed0/checkpoints/best.ckpt")
def validate(argv: list[str]) -> int:
    """Open-loop metrics on the validation windows."""
    from pedzoo.cli.training import train

    return train("validate", argv)


@command("pedzoo test --ckpt_path runs/sgan_goal/zara1-seed0/checkpoints/best.ckpt")
def test(argv: list[str]) -> int:
    """Open-loop metrics on the scene that was left out."""
    from pedzoo.cli.training import train

    return train("test", argv)


@command("pedzoo bench policies --before HEAD~1 --peer tools/bench/peers/pyrvo_orca.py --json speed.json")
def bench(argv: list[str]) -> int:
    """Every speed figure, as ratios measured in one run, beside other programs where they are given."""
    return _run_tool("bench", "tools.bench", argv)


@command("pedzoo reproduce table2 --quick --out results")
def reproduce(argv: list[str]) -> int:
    """The paper's tables and figure beside ours and baselines; what controllers have to show; CrowdNav."""
    return _run_tool("reproduce", "tools.paper", argv)


def _run_tool(name: str, package: str, argv: list[str]) -> int:
    if not (folder_of(package) / "command.py").is_file():
        raise UserError(
            f"{name}: needs a checkout of pedzoo's repository, and {ROOT} is none: "
            f"git clone the repository, run tools/setup in it, then .venv/bin/pedzoo {name}"
        )
    return import_of_checkout(f"{package}.command").run(argv)
