"""Robots among people: agent-steps per second with a lidar among walls beside others, and PPO's samples."""

from __future__ import annotations

import logging
import tempfile
import warnings
from collections.abc import Iterator
from typing import Any

import lightning as L

from pedzoo.cli.robot_training import RobotTrainingCLI
from pedzoo.core.spec import parse
from pedzoo.policies.load import load_robot_policy
from pedzoo.sim.robot_parts.make import make_robot_env
from tools.bench.figures import Measured, Row
from tools.bench.peer import Scenes, running
from tools.bench.scenes import Size, sizes
from tools.bench.section import Section
from tools.bench.sections.loop import ActiveRollout
from tools.bench.turns import Clock, Side, in_turns, ratio, repeated

PLAN = "apartment.7"
SENSES = ("goal", "odometry", "people")
LIDAR = "lidar:beams=64"
SIZES = (Size(1, 5), Size(64, 5), Size(1024, 5))
QUICK = (Size(2, 5),)

DRIVES = {
    "people orca": ("orca", True),
    "people orca, no lidar": ("orca", False),
    "people sgan_goal_map.indoor": ("sgan_goal_map.indoor", True),
}
"""Who walks the people, and whether the robot has a lidar."""

CONFIGS = {"robot/ppo": "crowdnav:people=5,crowds=16", "robot/rooms": "door:people=4"}
"""Whose PPO is timed, and the scenario of a quick run."""

SMALL = ("--model.envs=4", "--model.steps=4", "--model.minibatches=2")


class Robots(Section):
    """An agent-step is one decision of the robot, with what one agent does until the next one.

    Ours has, for 0.2 s: the robot's policy (straight to the waypoint), two decisions of people with ORCA or
    half of one of a network, trace points every 0.1 s, walls, contacts, goals, guidance, all sensors, reward
    and resets. ``scene_s_per_s`` has how much time passes in all scenes together.
    """

    takes = 14, 276

    def rows(self) -> Iterator[Row]:
        """Measure every size, then PPO."""
        for size in sizes(self.settings, QUICK if self.settings.quick else SIZES):
            yield from self._size(size)
        for config in CONFIGS:
            yield self._learning(config)

    def _size(self, size: Size) -> Iterator[Row]:
        """Time all sides at one size."""
        settings, agents = self.settings, size.people + 1
        plan = settings.maps[0] if settings.maps else PLAN
        where = {"size": str(size), "map": plan}
        drives = {name: Drive(size, plan, *how, settings.quick) for name, how in DRIVES.items()}
        sides: dict[str, Side] = {
            name: repeated(drive.step, size.scenes * agents, settings.clock, drive.least)
            for name, drive in drives.items()
        }
        polygons = next(iter(drives.values())).env.bank.walls.outlines.polygons()[0]
        walls = [polygon.tolist() for polygon in polygons]
        failed: dict[str, str] = {}
        with running(settings) as peers:
            about = Scenes("robots", size.scenes, agents, {}, walls, [], [], [], [])
            rivals = [case for peer in peers for case in peer.cases([about])]
            for peer in peers:
                self.versions |= peer.versions
            sides |= {case.title: case.side for case in rivals}
            speeds = in_turns(sides, settings.turns, settings.seconds, failed=failed)
        for name, drive in drives.items():
            metrics = measured(speeds[name], agents, drive.env.decision_dt)
            metrics |= {
                case.metric: ratio(speeds[name], speeds[case.title])
                for case in rivals
                if case.title not in failed
            }
            yield Row("robots", name, where, metrics)
        for case in rivals:
            if case.title in failed:
                yield Row("robots", case.title, where, {}, (), f"failed: {failed[case.title]}")
            else:
                metrics = measured(speeds[case.title], agents, case.step_seconds)
                yield Row("robots", case.title, where, metrics, (), case.note)

    def _learning(self, config: str) -> Row:
        """Time updates of PPO as ``pedzoo fit`` makes them: gathering decisions and learning from them."""
        settings = self.settings
        options = ["--config", config, f"--model.updates={settings.turns + 1}", "--model.imitate=0"]
        options += ["--trainer.max_epochs=1", "--trainer.limit_val_batches=0"]
        options += ["--trainer.enable_progress_bar=false"]
        if settings.quick:
            options += [*SMALL, "--model.scenarios", f'["{CONFIGS[config]}"]']
        for name in ("lightning.pytorch", "lightning.fabric"):
            logging.getLogger(name).setLevel(logging.WARNING)
        with tempfile.TemporaryDirectory() as folder, warnings.catch_warnings():
            warnings.simplefilter("ignore")
            cli = RobotTrainingCLI([*options, "--runs", folder], "", "")
            updates, model = Updates(settings.clock), cli.model
            cli.trainer.callbacks = [updates]  # pyright: ignore[reportAttributeAccessIssue]
            cli.trainer.fit(model)
        samples = model.envs * model.steps * len(model.scenarios)
        speeds = [samples / seconds for seconds in updates.seconds[1:]]  # loops are compiled in the first one
        names = " + ".join(parse(scenario).name for scenario in model.scenarios)
        where = {"size": f"{model.envs} x {len(model.scenarios)}", "map": names}
        note = f"updates of {samples} decisions, {model.passes} passes in {model.minibatches} minibatches"
        return Row("robots", f"PPO {config}", where, {"samples_per_s": Measured.of(speeds)}, (), note)


def measured(speeds: list[float], agents: int, step: float) -> dict[str, Measured]:
    """Return agent-steps per second, and seconds of scenes that pass in one second."""
    return {
        "agent_steps_per_s": Measured.of(speeds),
        "step_s": Measured.of([step]),
        "scene_s_per_s": Measured.of([speed * step / agents for speed in speeds]),
    }


class Drive(ActiveRollout):
    """Robots that drive straight among people."""

    def __init__(self, size: Size, plan: str, people: str, lidar: bool, quick: bool = False) -> None:
        """Make the environment, and drive for about an episode."""
        scenario = f"goals:map={plan},people={size.people}"
        sensors = [*SENSES, *([LIDAR] if lidar else [])]
        env = make_robot_env(scenario, "disc", people, size.scenes, sensors)
        super().__init__(env, load_robot_policy("straight"), quick)


class Updates(L.Callback):
    """Keeps how many seconds each update takes."""

    def __init__(self, now: Clock) -> None:
        """Take the clock."""
        self.now, self.seconds = now, list[float]()

    def on_train_batch_start(self, *given: Any, **more: Any) -> None:
        """An update begins."""
        self._begun = self.now()

    def on_train_batch_end(self, *given: Any, **more: Any) -> None:
        """An update has ended."""
        self.seconds.append(self.now() - self._begun)
