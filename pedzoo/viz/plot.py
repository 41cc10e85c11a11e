"""One call for a picture of what policies did."""

from collections.abc import Mapping
from pathlib import Path

from pedzoo.core.errors import need
from pedzoo.eval.comparison import PolicyRollout
from pedzoo.sim.env import PedestrianEnv
from pedzoo.sim.rollout import Rollout

Walked = tuple[Rollout, PedestrianEnv]
"""What `pedzoo.rollout` returns."""


def plot(walked: Walked | Mapping[str, Walked], path: str | Path, episode: int = 0) -> None:
    """Draw an episode at four moments, and the paths of all episodes; a row of panels per policy.

    Args:
        walked: What `pedzoo.rollout` returned, or several of these by name, all in the same scenario.
        path: ``.png``, ``.pdf`` or ``.svg``; its folder is made where it is missing.
        episode: Number of the episode.

    Raises:
        UserError: No such episode, another suffix, or the file cannot be written.
    """
    need("video", "a plot")
    from pedzoo.viz.trajectories import plot_rollouts

    named = walked if isinstance(walked, Mapping) else {walked[1].policy_name: walked}
    plot_rollouts([PolicyRollout(name, *one) for name, one in named.items()], path, episode)
