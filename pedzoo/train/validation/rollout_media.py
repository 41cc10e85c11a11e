"""How people walked, where the metrics are looked at: pictures and videos for Weights & Biases."""

import re
import tempfile
from pathlib import Path

import lightning as L
from lightning.pytorch.loggers import WandbLogger
from lightning.pytorch.utilities import rank_zero_only

from pedzoo.core.adapters import logged_step
from pedzoo.eval.comparison import PolicyRollout

FILM = (480, 360)
"""Width and height of videos, pixels."""

FILM_SECONDS = 20.0
"""Of an episode, at most."""


@rank_zero_only
def log_rollout_media(
    trainer: L.Trainer, scenario: str, walked: PolicyRollout, picture: bool, video: bool
) -> None:
    """Send what can be seen to all loggers of Weights & Biases: ``rollout/SCENARIO/ways`` and ``/video``.

    Without such a logger nothing is drawn. The picture has the paths of all episodes, the video is of the
    first.
    """
    loggers = [logger for logger in trainer.loggers if isinstance(logger, WandbLogger)]
    if not loggers:
        return
    from pedzoo.viz.trajectories import plot_rollouts
    from pedzoo.viz.video import film

    key = "rollout/" + re.sub(r"[^\w.,=-]", "_", scenario)  # names files, too
    shown = [walked._replace(name=f"{walked.name}, epoch {trainer.current_epoch}")]
    step = logged_step(trainer)
    with tempfile.TemporaryDirectory() as folder:
        paths, walk = Path(folder, "ways.png"), Path(folder, "walk.webm")
        if picture:
            plot_rollouts(shown, paths)
        if video:
            film(shown, walk, size=FILM, seconds=FILM_SECONDS)
        for logger in loggers:
            if picture:
                logger.log_image(f"{key}/ways", [str(paths)], step)
            if video:
                logger.log_video(f"{key}/video", [str(walk)], step)
