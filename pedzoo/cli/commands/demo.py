"""``pedzoo demo``: the first minutes with pretrained models. Its steps are commands to type."""

import shlex
from pathlib import Path

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


def steps(out: str = "demo", epochs: int = 20, physics: str = "bullet") -> list[tuple[str, str]]:
    """Return the commands of the demo: what each shows, and what to type behind ``pedzoo``."""
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


def compared(tuned: str) -> tuple[str, str]:
    """Return the last command, whose model is known only then: what it shows, and what to type."""
    models = f"{NAME} {tuned}"
    title = "before and after fine-tuning, between the trivial baselines"
    return title, f"forecast {models} --data.fold embedded --samples 5"


def reported(out: str) -> tuple[str, str]:
    """Return the command that makes a page of all: what it shows, and what to type."""
    title = "everything on one page: open it in a browser, click a number, a person, play"
    return title, f"report {out}/door.json {out}/apartment.json {out}/runs -o {out}/report.html"


def run(argv: list[str]) -> int:
    """Do all steps; returns the exit code."""
    from pedzoo.cli.arguments import Arguments

    parser = Arguments("demo", HELP, EXAMPLE)
    parser.add_argument(
        "--out", default="demo", metavar="FOLDER", help="where everything goes (default: demo)"
    )
    parser.add_argument(
        "--epochs", type=int, default=20, help="epochs of fine-tuning (default: 20, about a minute)"
    )
    options = parser.parse_args(argv)

    from pedzoo.cli.main import main
    from pedzoo.cli.output import check_outputs
    from pedzoo.core.errors import UserError, need

    need("train", "the demo")
    need("video", "the demo")
    from pedzoo.sim.make import usual_physics

    if options.epochs < 1:
        raise UserError(f"--epochs {options.epochs}: expected at least 1")
    out = Path(options.out)
    check_outputs(out=str(out / "door.json"))
    physics = usual_physics()
    commands = steps(shlex.quote(options.out), options.epochs, physics)
    total = len(commands) + 3
    for number, (title, command) in enumerate(commands, start=1):
        _announce(number, total, title, command)
        if code := main(shlex.split(command)):
            return code
    tuned = _newest(out / "runs")
    title, command = compared(shlex.quote(str(tuned)))
    _announce(total - 2, total, title, command)
    if code := main(shlex.split(command)):
        return code
    print(f"\n{total - 1}/{total} from Python: a controller for any simulator, and a picture of forecasts")
    _in_python(tuned, out / "forecasts.png")
    title, command = reported(shlex.quote(options.out))
    _announce(total, total, title, command)
    if code := main(shlex.split(command)):
        return code
    print(f"\neverything is in {out}: report.html door.png door.webm apartment.png forecasts.png runs")
    return 0


def _announce(number: int, total: int, title: str, command: str) -> None:
    print(f"\n{number}/{total} {title}\n$ pedzoo {command}", flush=True)


def _in_python(tuned: Path, picture: Path) -> None:
    import pedzoo
    from pedzoo.data.datamodule import TrajectoryDataModule
    from pedzoo.viz.plots import plot_forecasts

    print(f'>>> walker = pedzoo.load("{CONTROLLER}").controller()')
    print('>>> walker.step({"anna": (0, 0), "ben": (4, 0.2)}, {"anna": (6, 0), "ben": (-2, 0)})')
    walker = pedzoo.load(CONTROLLER).controller()
    velocity = walker.step({"anna": (0, 0), "ben": (4, 0.2)}, {"anna": (6, 0), "ben": (-2, 0)})
    print({name: tuple(round(float(part), 2) for part in value) for name, value in velocity.items()})
    print(f'>>> plot_forecasts(pedzoo.load("{tuned}"), data, "{picture}")')
    data = TrajectoryDataModule(fold="embedded", goal="window_end")
    plot_forecasts(pedzoo.load(str(tuned)), data, picture)


def _newest(runs: Path) -> Path:
    from pedzoo.train.run import RunFolder

    return RunFolder(max(runs.glob("*/*"), key=lambda folder: folder.stat().st_mtime)).best
