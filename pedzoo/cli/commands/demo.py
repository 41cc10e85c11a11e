"""``pedzoo demo``: the first minutes with pretrained models. Its steps are commands to type."""

import shlex
from pathlib import Path

from pedzoo.cli.output import check_outputs
from pedzoo.cli.parsing import call, command
from pedzoo.core.errors import at_least_one, need
from pedzoo.core.registry import COMMANDS

CONTROLLER = "approach_net_goal_map.indoor"
"""The best that there is to walk with, trained in the loop."""

NAME = "sgan_goal.eth_ucy"
"""Trained to forecast alone: shows what the loop is good for, and is fine-tuned in a minute."""

POLICIES = f"{CONTROLLER} {NAME} orca:radius=0.3 social_force:preset=indoor"
METRICS = "success,deadlock,agent_contacts_per_min,wall_contacts_per_min,time_ratio,least_distance_m"
EPISODES = 10
FILM_SECONDS = 8


def steps(out: str = "demo", epochs: int = 20, physics: str = "bullet") -> list[tuple[str, str]]:
    """Return what the first steps show, and what to type behind ``pedzoo`` for each."""
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


def last_steps(tuned: str, out: str = "demo") -> list[tuple[str, str]]:
    """Return likewise the steps that begin with the tuned model's file."""
    return [
        (
            "before and after fine-tuning, between the trivial baselines",
            f"forecast {NAME} {tuned} --data.fold embedded --samples 5",
        ),
        (
            "everything on one page: open it in a browser, click a number, a person, play",
            f"report {out}/door.json {out}/apartment.json {out}/runs -o {out}/report.html",
        ),
    ]


@command("pedzoo demo")
def demo(out: str = "demo", epochs: int = 20) -> int:
    """The first minutes: pretrained models walk beside ORCA and social force, one is fine-tuned.

    Args:
        out: Where everything goes.
        epochs: Epochs of fine-tuning; 20 take about a minute.
    """
    need("train", "the demo")
    need("video", "the demo")
    from pedzoo.core.machine import usual_physics

    at_least_one("--epochs", epochs)
    folder, written = Path(out), shlex.quote(out)
    check_outputs(out=str(folder / "door.json"))
    commands = steps(written, epochs, usual_physics())
    total = len(commands) + 3
    for number, (title, words) in enumerate(commands, start=1):
        _do(f"{number}/{total} {title}", words)
    from pedzoo.train.run import RunFolder

    latest = max((folder / "runs").glob("*/*"), key=lambda run: run.stat().st_mtime)
    tuned = RunFolder(latest).best
    (compared, words), (reported, last) = last_steps(shlex.quote(str(tuned)), written)
    _do(f"{total - 2}/{total} {compared}", words)
    print(f"\n{total - 1}/{total} from Python: a controller for any simulator, and a picture of forecasts")
    _in_python(tuned, folder / "forecasts.png")
    _do(f"{total}/{total} {reported}", last)
    print(f"\neverything is in {folder}: report.html door.png door.webm apartment.png forecasts.png runs")
    return 0


def _do(title: str, words: str) -> None:
    """Print what a step shows and what to type, and do it."""
    print(f"\n{title}\n$ pedzoo {words}", flush=True)
    name, *rest = shlex.split(words)
    call(COMMANDS.get(name), rest)


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
