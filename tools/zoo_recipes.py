"""What is in the zoo: every config, on which fold, with which protocol, and where its runs lie."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from pedzoo.data.datasets.eth_ucy import EVERYTHING, SCENES
from pedzoo.eval.publish import zoo_name
from pedzoo.eval.run_record import monitored
from pedzoo.train.run import RunFolder
from pedzoo.types import PRED_LEN, Clock, GoalProtocol

GOALS: dict[str, GoalProtocol] = {
    "sgan": "none", "sgan_pool": "none", "social_vrnn": "none", "sgan_goal_destination": "destination"
}  # fmt: skip
"""Goal protocols of the configs that are not trained for ``window_end``."""


@dataclass(frozen=True)
class Recipe:
    """One zoo name: a config on a fold, under one protocol."""

    config: str
    fold: str = "zara1"
    pred_len: int = PRED_LEN
    seeds: int = 3

    @property
    def goal(self) -> GoalProtocol:
        """Its goal protocol."""
        return GOALS.get(self.config, "window_end")

    @property
    def clock(self) -> Clock:
        """The benchmark's for tables; the true one for controllers, which meet people at their real speed."""
        return "true" if self.fold == EVERYTHING else "benchmark"

    @property
    def monitor(self) -> str:
        """The validation metric that chooses checkpoint and seed: what the model is made for."""
        return "val/min_ade_20_scene" if self.config in ("sgan", "sgan_pool") else "val/ade"

    @property
    def name(self) -> str:
        """The zoo name of its weights."""
        protocol = {"fold": self.fold, "goal": self.goal, "clock": self.clock, "pred_len": self.pred_len}
        return zoo_name(self.config, protocol)

    @property
    def options(self) -> dict[str, str]:
        """What ``pedzoo fit`` is told beside the seed."""
        options = {"config": self.config, "data.fold": self.fold, "monitor": self.monitor}
        if self.pred_len != PRED_LEN:
            options["data.pred_len"] = str(self.pred_len)
        if self.clock != "benchmark":
            options["data.clock"] = self.clock
        return options

    def runs(self, root: Path) -> Path:
        """Return the folder that ``pedzoo fit`` is told to write its runs below."""
        return root / f"p{self.pred_len}"

    def run(self, seed: int, root: Path) -> RunFolder:
        """Return the run folder that ``pedzoo fit`` chooses."""
        return RunFolder(self.runs(root) / self.config / f"{self.fold}-seed{seed}")

    def finished(self, root: Path) -> dict[int, float]:
        """Return the seeds whose training is done, each with its best validation value."""
        done = (seed for seed in range(self.seeds) if (self.run(seed, root).path / "finished").is_file())
        return {seed: min(monitored(self.run(seed, root).path, self.monitor).values()) for seed in done}


CONFIGS = ("sgan_goal_map", "sgan_goal", "sgan", "social_vrnn", "sgan_goal_map_alexnet", "sgan_pool")

RECIPES = [
    *(Recipe(config, EVERYTHING) for config in CONFIGS),
    *(Recipe(config, fold) for config in CONFIGS for fold in SCENES),
    Recipe("sgan_goal_destination"),
    *(Recipe(config, fold, pred_len=12) for config in ("sgan", "sgan_pool") for fold in SCENES),
]
