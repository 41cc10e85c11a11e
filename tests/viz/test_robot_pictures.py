"""Pictures of robots among people: what is seen, how long, and in which files."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from pedzoo.core.errors import UserError
from pedzoo.eval.robots import robot_rollout
from pedzoo.sim.robot_parts.env import RobotEnv
from pedzoo.sim.robot_parts.rollout import RobotRollout
from pedzoo.viz.robots import film_robots, robot_frames
from pedzoo.viz.video import HEADER, read_video

SIZE = (200, 160)


@pytest.fixture(scope="module")
def driven() -> tuple[RobotRollout, RobotEnv]:
    return robot_rollout("straight", "goals:map=flat,people=2,goals=1,pool=8", people="orca", episodes=2)


def test_frames_last_as_long_as_episodes_and_show_lidars(driven: tuple[RobotRollout, RobotEnv]) -> None:
    length = int(driven[0].walked.length[1])
    seen = list(robot_frames(*driven, episode=1, size=SIZE))
    blind = list(robot_frames(*driven, episode=1, size=SIZE, beams=0))
    assert len(seen) == len(blind) == length + 1
    assert all(frame.shape == (SIZE[1] + HEADER, SIZE[0], 3) for frame in seen)
    differ = [(one != other).any(-1).mean() for one, other in zip(seen, blind, strict=True)]
    assert min(differ) > 0.01, "the robot sees something in every frame"
    assert np.any(seen[0] != seen[-1])


def test_files_are_whole(driven: tuple[RobotRollout, RobotEnv], tmp_path: Path) -> None:
    film_robots(*driven, tmp_path / "a.gif", "straight", size=SIZE, seconds=1.0)
    with Image.open(tmp_path / "a.gif") as picture:
        assert (getattr(picture, "n_frames", 1), picture.size) == (11, (SIZE[0], SIZE[1] + HEADER))
        assert picture.info["duration"] == 100
    film_robots(*driven, tmp_path / "a.webm", size=SIZE, seconds=0.5)
    assert read_video(tmp_path / "a.webm") == (6, (SIZE[0], SIZE[1] + HEADER))
    assert sorted(file.name for file in tmp_path.iterdir()) == ["a.gif", "a.webm"]


def test_mistakes_are_told(driven: tuple[RobotRollout, RobotEnv], tmp_path: Path) -> None:
    with pytest.raises(UserError, match="episode 2: there are 2, 0 to 1"):
        film_robots(*driven, tmp_path / "a.gif", episode=2)
    with pytest.raises(UserError, match="ends in"):
        film_robots(*driven, tmp_path / "a.png")
