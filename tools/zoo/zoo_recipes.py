"""What is in the zoo: every config, on which fold, with which protocol, and where its runs lie."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pedzoo.core.paths import config_names
from pedzoo.core.types import PRED_LEN, GoalProtocol, TimeBase
from pedzoo.data.datasets.eth_ucy import SCENES
from pedzoo.models.zoo.publish import WHOLE_WALKS, monitored, zoo_name
from pedzoo.train.run import RunFolder
from tools.zoo.robots import is_finished

EVERYTHING = "eth_ucy"
"""The fold of ETH/UCY that leaves nothing out."""

GOALS: dict[str, GoalProtocol] = {
    "sgan_nopool": "none", "sgan": "none", "social_vrnn": "none", "sgan_goal_destination": "destination",
    "closed_loop/social_walker": "destination",
    "closed_loop/social_walker_indoor": "destination",
    "closed_loop/social_walker_styled": "destination",
    "anchors": "none", "anchor_mlp": "none", "anchor_net": "none",
    "anchor_net_goal_destination": "destination",
    **dict.fromkeys(("open_loop/mdn_walker", "closed_loop/mdn_walker"), "destination"),
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
    def folder(self) -> str:
        """``open_loop`` or ``closed_loop`` for controllers, whose configs are in folders; else empty."""
        return self.config.rpartition("/")[0]

    @property
    def on_crowds(self) -> bool:
        """Whether it trains on whole recorded crowds from the start."""
        return self.config.rpartition("/")[2] in WHOLE_WALKS

    @property
    def goal(self) -> GoalProtocol:
        """Its goal protocol."""
        return GOALS.get(self.config, "window_end")

    @property
    def clock(self) -> TimeBase:
        """The benchmark's for tables; the true one for controllers, which meet people at their real speed."""
        return "true" if self.folder or self.fold == EVERYTHING else "benchmark"

    @property
    def monitor(self) -> str:
        """The validation metric that chooses checkpoint and seed: what the model is made for."""
        if self.on_crowds:
            return "val/unlike"
        if self.config.endswith("mdn_walker"):
            return "rollout/stl" if self.folder == "closed_loop" else "val/nll"
        if self.folder == "closed_loop":
            return "val/ade" if self.config == "closed_loop/sgan_goal_map" else "rollout/stl"
        if self.config in ANCHORED:
            return "val/min_ade_20_agent"
        return "val/min_ade_20_scene" if self.config in ("sgan", "sgan_nopool") else "val/ade"

    @property
    def best(self) -> Callable[..., Any]:
        """``min`` or ``max``: which of its values is best."""
        return max if self.monitor.startswith("rollout/") else min

    @property
    def begins_with(self) -> str | None:
        """The zoo name of the weights that a closed-loop training goes on with."""
        if self.folder != "closed_loop" or self.on_crowds:
            return None
        forecaster = self.config.replace("closed", "open")
        if forecaster not in config_names():  # the paper's network has no recipe for walkers alone
            forecaster = self.config.rpartition("/")[2]
        return dataclasses.replace(self, config=forecaster).name

    @property
    def name(self) -> str:
        """The zoo name of its weights."""
        protocol = {"fold": self.fold, "goal": self.goal, "clock": self.clock, "pred_len": self.pred_len}
        return zoo_name(self.config, protocol)

    @property
    def options(self) -> dict[str, str]:
        """The options of ``pedzoo fit`` beside the seed."""
        options = {"config": self.config, "data.fold": self.fold, "monitor": self.monitor}
        if self.begins_with:
            options |= {"weights": self.begins_with, "monitor_mode": self.best.__name__}
            if self.fold in SCENES:
                # five trainings for replays of unseen folds alone: half as long each
                options["trainer.max_epochs"] = "7"
        else:
            # these weights are chosen open loop, and evaluated in closed loop afterwards
            options["rollout.scenarios"] = "null"
            if self.config.startswith(("anchor_mlp", "anchor_net")) and self.fold == "univ":
                # a third of the others' windows: as many steps as they have
                options["trainer.max_epochs"] = "56" if self.config == "anchor_net" else "120"
        if self.pred_len != PRED_LEN:
            options["data.pred_len"] = str(self.pred_len)
            if self.config in ANCHORED:
                options["model.generator.architecture.steps"] = str(self.pred_len)
        if self.clock != "benchmark":
            options["data.clock"] = self.clock
        return options

    def runs(self, root: Path) -> Path:
        """Return the folder below which ``pedzoo fit`` writes its runs."""
        return root if self.folder else root / f"p{self.pred_len}"

    def run(self, seed: int, root: Path) -> RunFolder:
        """Return the run folder that ``pedzoo fit`` chooses."""
        return RunFolder(self.runs(root) / self.config.replace("/", ".") / f"{self.fold}-seed{seed}")

    def finished(self, root: Path) -> dict[int, float]:
        """Return the seeds whose training is done, each with its best validation value."""
        done = (seed for seed in range(self.seeds) if is_finished(self.run(seed, root)))
        return {seed: self.best(monitored(self.run(seed, root).path, self.monitor).values()) for seed in done}


CONFIGS = ("sgan_goal_map", "sgan_goal", "sgan", "sgan_nopool", "social_vrnn")

ANCHORED = ("anchors", "anchor_mlp", "anchor_net")
"""Those whose modes are futures of a fixed length; a best of 20 is what they are made for."""

CONTROLLERS = ("approach_net_goal", "approach_net_goal_map", "anchor_net_goal_map")
CONTROLLER = ("open_loop", "closed_loop")
"""Configs of controllers, and the halves of a controller's training, each with its weights."""

RECIPES = [
    *(Recipe(config, EVERYTHING) for config in CONFIGS),
    *(Recipe(config, fold) for config in CONFIGS for fold in SCENES),
    *(Recipe("sgan_goal_destination", fold) for fold in SCENES),
    *(Recipe(config, fold, pred_len=12) for config in ("sgan", "sgan_nopool") for fold in SCENES),
    *(Recipe(config, fold, pred_len) for pred_len in (12, 8) for config in ANCHORED for fold in SCENES),
    *(Recipe(f"anchor_net_goal{end}", fold) for end in ("_destination", "") for fold in SCENES),
    *(Recipe(f"{half}/{config}", EVERYTHING) for config in CONTROLLERS for half in CONTROLLER),
    Recipe("closed_loop/sgan_goal_map", EVERYTHING, seeds=1),
    *(Recipe("open_loop/approach_net_goal_map", fold) for fold in SCENES),
    *(Recipe("closed_loop/approach_net_goal_map", fold, seeds=1) for fold in SCENES),
    *(Recipe(f"{half}/anchor_net_goal_map", fold, seeds=1) for half in CONTROLLER for fold in SCENES),
    *(
        Recipe(f"{stage}/mdn_walker", fold, seeds=1)
        for stage in ("open_loop", "closed_loop")
        for fold in ("mixed", *(f"mixed_{scene}" for scene in SCENES))
    ),
    *(
        Recipe(f"closed_loop/social_walker{end}", fold)
        for end in ("", "_indoor", "_styled")
        for fold in (EVERYTHING, *SCENES)
    ),
]
