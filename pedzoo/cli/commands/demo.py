"""``pedzoo demo``: the first minutes with pretrained models. Its steps are commands to type."""

import shlex
from importlib import import_module
from pathlib import Path

from pedzoo.cli.output import check_outputs
from pedzoo.cli.parsing import call
from pedzoo.core.errors import at_least_one, need

HELP = "the first minutes: pretrained models walk beside ORCA and social force, one is fine-tuned"
EXAMPLE = "pedzoo demo"

CONTROLLER = "sgan_goal_map.indoor"
"""The best that there is to walk with, trained in the loop."""

NAME = "sgan_goal_map.eth_ucy"
"""Trained to forecast alone: shows what the loop is good for, and is fine-tuned in a minute."""

POLICIES = f"{CONTROLLER} {NAME} orca:radius=0.3 social_force:preset=indoor"
METRICS = "success,deadlock,agent_contacts_per_min,wall_contacts_per_min,time_ratio,least_distance_m"
EPISODES = 10
FILM_SECONDS = 8

Step = tuple[str, str]
"""What is shown, and what to type behind ``pedzoo``."""


def steps(out: str = "demo", epochs: int = 20, physics: str = "bullet") -> list[Step]:
    """Return the commands of the demo."""
    common = f"--physics {physics} --episodes {EPISODES} --metrics {METRICS} --keep_episodes {EPISODES}"
    files = f"--plot {out}/door.png --json {out}/door.json"
    film = f"--video {out}/door.webm --video_seconds {FILM_SECONDS}"
    home = "--scenario goals:map=apartment.7,people=4,goals=1,pool=8"
    return [
        ("pretrained models that were trained where they walk", "models '*.indoor*'"),
        (
            "two people meet at a narrow door",
            f"rollout {POLICIES} --scenario door {common} {files} {film}",
        ),
        (
            "four people walk through an apartment that is drawn from a seed",
            f"rollout {POLICIES} {home} {common} --plot {out}/apartment.png --json {out}/apartment.json",
        ),
        (
            "fine-tuning on other recordings (synthetic people on a plaza, no results to quote)",
            f"fit --weights {NAME} --data.fold embedded --model.lr 1e-3 --trainer.max_epochs {epochs} "
            f"--runs {out}/runs",
        ),
    ]


def compared(tuned: str) -> Step:
    """Return the command whose model is known only after the others."""
    title = "before and after fine-tuning, between the trivial baselines"
    return title, f"forecast {NAME} {tuned} --data.fold embedded --samples 5"


def reported(out: str) -> Step:
    """Return the command that makes a page of all."""
    title = "everything on one page: open it in a browser, click a number, a person, play"
    return title, f"report {out}/door.json {out}/apartment.json {out}/runs -o {out}/report.html"


def run(out: str = "demo", epochs: int = 20) -> int:
    """Do all steps.

    Args:
        out: Where everything goes.
        epochs: Epochs of fine-tuning; 20 take about a minute.
    """
    need("train", "the demo")
    need("video", "the demo")
    from pedzoo.sim.make import usual_physics

    at_least_one("--epochs", epochs)
    folder, written = Path(out), shlex.quote(out)
    check_outputs(out=str(folder / "door.json"))
    commands = steps(written, epochs, usual_physics())
    total = len(commands) + 3
    for number, step in enumerate(commands, start=1):
        _do(number, total, step)
    from pedzoo.train.run import RunFolder

    latest = max((folder / "runs").glob("*/*"), key=lambda run: run.stat().st_mtime)
    tuned = RunFolder(latest).best
    _do(total - 2, total, compared(shlex.quote(str(tuned))))
    print(f"\n{total - 1}/{total} from Python: a controller for any simulator, and a picture of forecasts")
    _in_python(tuned, folder / "forecasts.png")
    _do(total, total, reported(written))
    print(f"\neverything is in {folder}: report.html door.png door.webm apartment.png forecasts.png runs")
    return 0


def _do(number: int, total: int, step: Step) -> None:
    """Print what a step shows and what to type, and do it."""
    title, command = step
    print(f"\n{number}/{total} {title}\n$ pedzoo {command}", flush=True)
    name, *words = shlex.split(command)
    call(import_module(f"pedzoo.cli.commands.{name}"), words)


def _in_python(tuned: Path, picture: Path) -> None:
    import pedzoo
    from pedzoo.data.datamodule import TrajectoryDataModule
    from pedzoo.viz.plots import plot_forecasts

    print(f'>>> walker = pedzoo.controller("{CONTROLLER}")')
    print('>>> walker.step({"anna": (0, 0), "ben": (4, 0.2)}, {"anna": (6, 0), "ben": (-2, 0)})')
    walker = pedzoo.controller(CONTROLLER)
    velocity = walker.step({"anna": (0, 0), "ben": (4, 0.2)}, {"anna": (6, 0), "ben": (-2, 0)})
    print({name: tuple(round(float(part), 2) for part in value) for name, value in velocity.items()})
    print(f'>>> plot_forecasts(pedzoo.load("{tuned}"), data, "{picture}")')
    data = TrajectoryDataModule(fold="embedded", goal="window_end")
    plot_forecasts(pedzoo.load(str(tuned)), data, picture)
