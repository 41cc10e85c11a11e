"""Validation in the loop: the weights as they are walk through scenes, and the metrics stand beside ADE."""

import copy
import math
import re
import tempfile
from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path
from typing import Any, cast

import lightning as L
import torch
from lightning.pytorch.callbacks import Callback
from lightning.pytorch.loggers import WandbLogger
from lightning.pytorch.utilities import rank_zero_only
from torch import Tensor

from pedzoo.core.adapters import logged_step
from pedzoo.core.errors import UserError, unknown
from pedzoo.core.machine import usual_physics
from pedzoo.core.types import OBS_LEN
from pedzoo.models.base import Forecaster
from pedzoo.train.module import ForecastModule, is_own

METRICS = (
    *("success", "episode_success", "clean", "deadlock", "failed"),
    *("agent_contacts_per_min", "wall_contacts_per_min", "least_distance_m"),
    *("time_ratio", "path_ratio", "stl"),
)
"""Logged metrics of every scenario; ``pedzoo rollout`` prints the rest."""

BEST: dict[str, str] = {
    **dict.fromkeys(("success", "episode_success", "clean", "stl"), "max"),
    **dict.fromkeys(("deadlock", "failed", "agent_contacts_per_min", "wall_contacts_per_min"), "min"),
}
"""Which value of a metric is best, where there is no doubt."""

MEANS = ("success", "clean", "stl")
"""Of these the mean over the scenarios is logged too, as ``rollout/METRIC``, to choose checkpoints by."""

USUAL = "door", "compiled"
"""Scenario and physics of the shipped configs, where all of pedzoo's models with goals can walk."""

FILM = (480, 360)  # width and height of videos, pixels
FILM_SECONDS = 20.0  # of an episode, at most


class ClosedLoopValidation(Callback):
    """Runs rollouts of the current weights after every n-th validation, logs ``rollout/SCENARIO/METRIC``.

    Episodes are always the first ones of ``seed``, as in ``pedzoo rollout``. Several processes share them
    and add up their sums. A value without data, such as the time of people none of whom arrived, is NaN.

    In validations without a rollout other callbacks see the last values, which are no better ones. The first
    validation of a process always has a rollout, also in a resumed run, so that there is a last value.

    Training is not affected: a copy of the model walks on the CPU, and the state of torch's generator is
    restored. The sanity check runs no episode, ``fast_dev_run`` one per process, ``pedzoo test`` none.

    Simulation is imported for the first walk, or at once where another one than `USUAL` is asked for.
    """

    def __init__(
        self,
        scenarios: list[str] | None = None,
        every: int = 1,
        episodes: int = 16,
        physics: str | None = None,
        seed: int = 0,
        deterministic: bool = False,
        picture: bool = True,
        video: bool = False,
    ) -> None:
        """Set the scenarios, and how often they run.

        Args:
            scenarios: With settings, as ``door,goals:people=4,goals=2``; null for none.
            every: Validations from one rollout to the next.
            episodes: Of each scenario.
            physics: ``compiled`` (fastest), ``torch``, ``bullet`` (pybullet) or ``file.py:Class``; null for
                what the variable ``PEDZOO_PHYSICS`` says, or ``compiled``.
            seed: Of the scenes.
            deterministic: Without noise.
            picture: Send a picture of the paths to Weights & Biases if that is a logger.
            video: Likewise a video of the first episode.

        Raises:
            UserError: An unknown name or setting, or a number out of range.
        """
        if min(every, episodes) < 1:
            raise UserError(f"--rollout.every {every} --rollout.episodes {episodes}: expected at least 1")
        names = scenarios or []
        if twice := next((name for name in names if names.count(name) > 1), None):
            raise UserError(f"--rollout.scenarios: {twice!r} is given twice")
        self.scenarios: dict[str, Any] = {name: name for name in names}
        physics = physics or usual_physics(fast=True)
        if not {*names, physics} <= {*USUAL}:
            from pedzoo.sim.make import make_scenario, physics_class

            physics_class(physics).check()
            self.scenarios = {name: make_scenario(name) for name in names}
        self.every, self.episodes, self.physics, self.seed = every, episodes, physics, seed
        self.deterministic, self.picture, self.video = deterministic, picture, video
        self._validations = 0
        self._walker: Any = None
        self._envs: dict[str, Any] = {}

    @property
    def names(self) -> list[str]:
        """Everything that is logged."""
        each = [f"rollout/{scenario}/{metric}" for scenario in self.scenarios for metric in METRICS]
        return [*each, *(f"rollout/{metric}" for metric in MEANS if self.scenarios)]

    def case(self, scenario: str) -> dict[str, Any]:
        """Return what a row about a scenario says of where and how often people walked."""
        noise = "none" if self.deterministic else "sampled"
        case = {"scenario": scenario, "physics": self.physics, "seed": self.seed, "noise": noise}
        return {"case": case, "n": self.episodes}

    def check_monitor(self, monitor: str | None, mode: str) -> None:
        """Check a monitored rollout metric. Raises UserError: none, or ``mode`` keeps the worst."""
        if monitor is None or not monitor.startswith("rollout/"):
            return
        if not self.scenarios:
            raise UserError(f"--monitor {monitor}: this training has no rollouts; set --rollout.scenarios")
        if monitor not in self.names:
            raise unknown("metric to --monitor", monitor, self.names)
        best = BEST.get(monitor.rpartition("/")[2], mode)
        if mode != best:
            raise UserError(f"--monitor {monitor}: its best value is the {best}: add --monitor_mode {best}")

    def check(self, model: Forecaster, data: Any = None) -> None:
        """Let an untrained copy decide once. Raises UserError: it cannot walk, or not in numbers."""
        observed = data.obs_len if data is not None else OBS_LEN
        if self.scenarios and observed != OBS_LEN:
            raise UserError(
                f"people walk by the last {OBS_LEN} steps, and --data.obs_len is {observed}: "
                "train with --rollout.scenarios null"
            )
        if {*self.scenarios, self.physics} <= {*USUAL} and not is_own(model):
            return
        from pedzoo.sim.make import make_env

        walker = _walking_copy(model)
        for name, scenario in self.scenarios.items():
            env = make_env(scenario, physics=self.physics, seed=self.seed)
            self.scenarios[name] = env.prepared  # planned once
            with _isolated(self.seed), closing(env.physics):
                decided = walker(env.reset())
                if not bool(decided["agents", "action"].isfinite().all()):
                    kind = type(model).__name__
                    raise UserError(f"{kind} gives no numbers in {name}: train with --rollout.scenarios null")
                env.step(decided)

    def setup(self, trainer: L.Trainer, pl_module: L.LightningModule, stage: str) -> None:
        """Check the model."""
        self.close()
        if not self.scenarios or stage == "test":
            return
        if not isinstance(pl_module, ForecastModule):
            raise UserError(
                f"{type(pl_module).__name__} has no forecaster to walk: expected a ForecastModule"
            )
        self.check(pl_module.generator, getattr(trainer, "datamodule", None))

    def on_validation_epoch_end(self, trainer: L.Trainer, pl_module: L.LightningModule) -> None:
        """Walk, and log; model and environments are made for the first walk."""
        if not self.scenarios or trainer.sanity_checking:
            return
        number = self._validations
        self._validations += 1
        if self._walker is not None and number % self.every:
            return
        assert isinstance(pl_module, ForecastModule)
        with _isolated(self.seed):
            self._walker = self._walker or _walking_copy(pl_module.generator)
            self._walker.model.load_state_dict(pl_module.generator.state_dict())
            means = dict.fromkeys(MEANS, torch.tensor(0.0))
            for name in self.scenarios:
                result = self._measure(name, trainer, pl_module.device)
                for key in METRICS:
                    value = result.get(key, torch.tensor(math.nan))
                    pl_module.log(f"rollout/{name}/{key}", value, prog_bar=key == "success", sync_dist=True)
                    if key in means:
                        means[key] = means[key] + value.float().cpu() / len(self.scenarios)
            for key, value in means.items():
                pl_module.log(f"rollout/{key}", value, sync_dist=True)

    def _measure(self, name: str, trainer: L.Trainer, device: torch.device) -> dict[str, Tensor]:
        """Return the metrics of a scenario over the episodes of all processes."""
        from pedzoo.eval.comparison import PolicyRollout
        from pedzoo.eval.rollout import walk
        from pedzoo.metrics.closed_loop import NAMES, closed_loop
        from pedzoo.sim.make import make_env, physics_class
        from pedzoo.sim.rollout import joined

        sums = dict.fromkeys(NAMES, torch.zeros(2, dtype=torch.float64))
        episodes = trainer.world_size if cast("Any", trainer).fast_dev_run else self.episodes
        first, episodes = share(episodes, trainer.global_rank, trainer.world_size)
        if episodes:  # there may be more processes than episodes
            if name not in self._envs:
                rounds = -(-episodes // physics_class(self.physics).scenes_at_once)
                scenes, where = -(-episodes // rounds), self.scenarios[name]
                env = make_env(where, scenes, self.physics, seed=self.seed, first_episode=first)
                env.policy_name = "the model in training"
                self._envs[name] = env
            env = self._envs[name]
            env.set_seed(self.seed)
            rollout = joined(list(walk(self._walker, env, episodes, self.deterministic)))
            sums |= {name: torch.stack(one[:2]).sum(1) for name, one in closed_loop(rollout).items()}
            if self.picture or self.video:
                walked = PolicyRollout(type(self._walker.model).__name__, rollout, env)
                _log_media(trainer, name, walked, self.picture, self.video)
        together = torch.stack([*sums.values()])
        if trainer.world_size > 1:
            together = cast("Tensor", trainer.strategy.reduce(together.to(device), reduce_op="sum"))
        return {name: one[0] / one[1] for name, one in zip(NAMES, together, strict=True) if one[1] > 0}

    def close(self, *_: Any, **__: Any) -> None:
        """Let go of model and environments."""
        for env in self._envs.values():
            env.physics.close()
        self._walker, self._envs = None, {}

    teardown = on_exception = close  # Lightning calls no teardown after an error or Ctrl-C

    def state_dict(self) -> dict[str, Any]:
        """Return how many validations there were: a resumed run keeps the rhythm."""
        return {"validations": self._validations}

    def load_state_dict(self, state_dict: dict[str, Any]) -> None:
        """Go on counting."""
        self._validations = state_dict["validations"]

    def __getstate__(self) -> dict[str, Any]:
        return self.__dict__ | {"_walker": None, "_envs": {}}  # copies are without the state of a run


def share(episodes: int, rank: int, processes: int) -> tuple[int, int]:
    """Return the first episode of the process ``rank``, and how many it has, as equal as can be."""
    each, more = divmod(episodes, processes)
    return rank * each + min(rank, more), each + (rank < more)


def _walking_copy(model: Forecaster) -> Any:
    """Return a `Walker` of a copy: on the CPU, where environments are, and in eval mode."""
    from pedzoo.policies.walker import Walker

    return Walker(copy.deepcopy(model).cpu().eval())


@contextmanager
def _isolated(seed: int) -> Iterator[None]:
    """Leave the state of a training as it is; random numbers that are not drawn by scene have their own."""
    # not in inference mode, as Lightning validates: environments keep what they make
    with torch.inference_mode(False), torch.no_grad(), torch.random.fork_rng(devices=[]):
        torch.manual_seed(seed)
        yield


@rank_zero_only
def _log_media(trainer: L.Trainer, scenario: str, walked: Any, picture: bool, video: bool) -> None:
    """Send paths and a video to Weights & Biases, where it logs: ``rollout/SCENARIO/ways`` and ``/video``."""
    loggers = [logger for logger in trainer.loggers if isinstance(logger, WandbLogger)]
    if not loggers:
        return
    from pedzoo.viz.trajectories import plot_rollouts
    from pedzoo.viz.video import film

    key = "rollout/" + re.sub(r"[^\w.,=-]", "_", scenario)  # names files, too
    shown = [walked._replace(name=f"{walked.name}, epoch {trainer.current_epoch}")]
    step = logged_step(trainer)
    with tempfile.TemporaryDirectory() as folder:
        paths, film_of_walk = Path(folder, "ways.png"), Path(folder, "walk.webm")
        if picture:
            plot_rollouts(shown, paths)
        if video:
            film(shown, film_of_walk, size=FILM, seconds=FILM_SECONDS)
        for logger in loggers:
            if picture:
                logger.log_image(f"{key}/ways", [str(paths)], step)
            if video:
                logger.log_video(f"{key}/video", [str(film_of_walk)], step)
