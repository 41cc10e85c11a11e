"""Validation in the loop: the weights as they are walk through scenes, and the metrics stand beside ADE."""

import math
from contextlib import closing
from typing import Any, cast

import lightning as L
import torch
from lightning.pytorch.callbacks import Callback
from torch import Tensor

from pedzoo.core.errors import UserError, unknown
from pedzoo.core.types import OBS_LEN
from pedzoo.metrics.closed_loop import ClosedLoopScore
from pedzoo.models.base import Forecaster
from pedzoo.policies.walker import Walker
from pedzoo.sim.make import make_env, make_scenario, physics_class
from pedzoo.sim.scenario import PreparedScenario, Scenario
from pedzoo.train.modules.module import ForecastModule
from pedzoo.train.validation.rollout_media import log_rollout_media
from pedzoo.train.validation.validation_scenario import ValidationScenario, isolated, share, walking_copy

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


class ClosedLoopValidation(Callback):
    """Runs rollouts of the current weights after every n-th validation, logs ``rollout/SCENARIO/METRIC``.

    The values stand in the same row of every logger as ``val/ade``. Episodes are always the first ones of
    ``seed``, as in ``pedzoo rollout``. Several processes share them and add up their sums. A value without
    data, such as the time of people none of whom arrived, is NaN.

    In validations without a rollout nothing is logged, and other callbacks see the last values, as Lightning
    does it: the checkpoint of the best value does not take the same for better. The first validation of a
    process always has a rollout, also in a resumed run, so that there is a last value.

    Training is not affected: a copy of the model walks, on the CPU and with its own floor plans, and the
    state of torch's generator is restored. The sanity check runs no episode, ``fast_dev_run`` one per
    process, ``pedzoo validate`` all. ``pedzoo test`` runs none: recordings alone are tested there.
    """

    def __init__(
        self,
        scenarios: list[str] | None = None,
        every: int = 1,
        episodes: int = 16,
        physics: str = "compiled",
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
            physics: ``compiled`` (fastest), ``torch``, ``bullet`` (pybullet) or ``file.py:Class``.
            seed: Of the scenes.
            deterministic: Without noise.
            picture: Send a picture of the paths to Weights & Biases if that is a logger.
            video: Likewise a video of the first episode.

        Raises:
            UserError: An unknown name or setting, or a number out of range.
        """
        if min(every, episodes) < 1:
            raise UserError(f"--rollout.every {every} --rollout.episodes {episodes}: expected at least 1")
        self.physics = physics
        physics_class(self.physics).check()
        names = scenarios or []
        if twice := next((name for name in names if names.count(name) > 1), None):
            raise UserError(f"--rollout.scenarios: {twice!r} is given twice")
        self.scenarios: dict[str, Scenario | PreparedScenario] = {name: make_scenario(name) for name in names}
        self.every, self.episodes, self.seed = every, episodes, seed
        self.deterministic, self.picture, self.video = deterministic, picture, video
        self._validations = 0
        self._checked: Forecaster | None = None
        self._forget()

    def _forget(self) -> None:
        self._walker: Walker | None = None
        self._validation_scenarios: list[ValidationScenario] = []
        self._walked = False

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
        """Check that a monitored rollout metric is logged here, and that ``mode`` fits it.

        Raises:
            UserError: It starts with ``rollout/``, and no scenario has it, or ``mode`` would keep the worst.
        """
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
        """Let an untrained copy decide once, so that models that cannot walk fail before the training.

        Raises:
            UserError: The model needs other inputs than an environment has, or does not answer in numbers.
        """
        observed = data.obs_len if data is not None else OBS_LEN
        if self.scenarios and observed != OBS_LEN:
            raise UserError(
                f"people walk by the last {OBS_LEN} steps, and --data.obs_len is {observed}: "
                "train with --rollout.scenarios null"
            )
        walker = walking_copy(model)
        for name, scenario in self.scenarios.items():
            env = make_env(scenario, physics=self.physics, seed=self.seed)
            self.scenarios[name] = env.prepared  # planned once
            with isolated(self.seed), closing(env.physics):
                decided = walker(env.reset())
                if not bool(decided["agents", "action"].isfinite().all()):
                    kind = type(model).__name__
                    raise UserError(f"{kind} gives no numbers in {name}: train with --rollout.scenarios null")
                env.step(decided)
        self._checked = model

    def setup(self, trainer: L.Trainer, pl_module: L.LightningModule, stage: str) -> None:
        """Copy the model and make the environments, once."""
        if not self.scenarios or stage == "test":
            return
        if not isinstance(pl_module, ForecastModule):
            raise UserError(
                f"{type(pl_module).__name__} has no forecaster to walk: expected a ForecastModule"
            )
        if self._checked is not pl_module.generator:
            self.check(pl_module.generator, getattr(trainer, "datamodule", None))
        self.close()
        self._walker = walking_copy(pl_module.generator)
        episodes = trainer.world_size if cast("Any", trainer).fast_dev_run else self.episodes
        first, episodes = share(episodes, trainer.global_rank, trainer.world_size)
        for name, scenario in self.scenarios.items():
            self._validation_scenarios.append(
                ValidationScenario(name, scenario, self.physics, self.seed, first, episodes)
            )

    def on_validation_epoch_end(self, trainer: L.Trainer, pl_module: L.LightningModule) -> None:
        """Walk, and log."""
        if self._walker is None or trainer.sanity_checking:
            return
        number = self._validations
        self._validations += 1
        if self._walked and number % self.every:
            return
        self._walked = True
        assert isinstance(pl_module, ForecastModule)
        with isolated(self.seed):
            self._walker.model.load_state_dict(pl_module.generator.state_dict())
            means = dict.fromkeys(MEANS, torch.tensor(0.0))
            for scenario in self._validation_scenarios:
                result = self._measure(scenario, self._walker, trainer, pl_module.device)
                values = {key: result.get(key, torch.tensor(math.nan)) for key in METRICS}
                for key, value in values.items():
                    shown = key == "success"
                    pl_module.log(f"rollout/{scenario.name}/{key}", value, prog_bar=shown, sync_dist=True)
                for key in means:
                    means[key] = means[key] + values[key].float().cpu() / len(self._validation_scenarios)
            for key, value in means.items():
                pl_module.log(f"rollout/{key}", value, sync_dist=True)

    def _measure(
        self, scenario: ValidationScenario, walker: Walker, trainer: L.Trainer, device: torch.device
    ) -> dict[str, Tensor]:
        """Return the metrics of a scenario over the episodes of all processes."""
        walked, score = scenario.walk(walker, self.deterministic), ClosedLoopScore()
        if walked is not None:
            score.update(walked.rollout)
            if self.picture or self.video:
                log_rollout_media(trainer, scenario.name, walked, self.picture, self.video)
        if trainer.world_size > 1:
            score.to(device)  # where processes talk to each other
        return score.compute()

    def teardown(self, trainer: L.Trainer, pl_module: L.LightningModule, stage: str) -> None:
        """Close the environments."""
        self.close()

    def on_exception(
        self, trainer: L.Trainer, pl_module: L.LightningModule, exception: BaseException
    ) -> None:
        """Close the environments: Lightning calls no teardown after an error or Ctrl-C."""
        self.close()

    def close(self) -> None:
        """Let go of model and environments."""
        for scenario in self._validation_scenarios:
            scenario.close()
        self._forget()

    def state_dict(self) -> dict[str, Any]:
        """Return how many validations there were: a resumed run keeps the rhythm."""
        return {"validations": self._validations}

    def load_state_dict(self, state_dict: dict[str, Any]) -> None:
        """Go on counting."""
        self._validations = state_dict["validations"]

    def __getstate__(self) -> dict[str, Any]:
        """Copy and pickle without the state of a run."""
        return self.__dict__ | {
            "_walker": None,
            "_validation_scenarios": [],
            "_walked": False,
            "_checked": None,
        }
