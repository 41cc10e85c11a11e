"""Robots among people from above, with what their lidar sees."""

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from pedzoo.core.errors import UserError
from pedzoo.core.geometry import direction_of, move_to_scene
from pedzoo.core.paths import atomic_write
from pedzoo.core.types import TRACE_SECONDS
from pedzoo.sim.camera import ROBOT_BODY, ROBOT_FRONT, Camera, free_corners, person_color
from pedzoo.sim.drawing import draw_disc, draw_floor, draw_goal, draw_person, draw_way, headings_along
from pedzoo.sim.physics._base import Bodies
from pedzoo.sim.robots.env import RobotEnv
from pedzoo.sim.robots.rollout import RobotRollout
from pedzoo.viz.video import Image, ShownEpisode, check_video_path, labelled, write_video

FINER = 2
"""Pictures are drawn so many times larger, and made smaller: lines are smooth then."""

MARGIN, WHOLE = 0.4, 20.0
"""Metres around what is seen: a floor plan of at most so many metres, or all ways on a larger one."""

SHOWN = 6
"""One in so many beams is drawn."""

COLORS, SWATCH = 48, 12
"""Of a GIF; and rows of pixels by which the colours of people count, however small people are."""

RECENT = 30
"""Trace points of the ways that are drawn, 3 s."""


def film_robots(
    rollout: RobotRollout, env: RobotEnv, path: str | Path, title: str = "", episode: int = 0, **settings: Any
) -> None:
    """Write a moving picture in real time of one episode, from above.

    Arguments are those of `robot_frames`, beside ``path``: ``.gif``, ``.webm`` or ``.mp4``.

    Raises:
        UserError: No such episode, another suffix, or the file cannot be written.
    """
    moving = Path(path).suffix.lower() == ".gif"
    if not moving:
        check_video_path(path)
    frames = robot_frames(rollout, env, title, episode, **settings)
    if moving:
        _write_gif(Path(path), list(frames))
    else:
        write_video(path, frames, 1 / TRACE_SECONDS)


def robot_frames(
    rollout: RobotRollout,
    env: RobotEnv,
    title: str = "",
    episode: int = 0,
    beams: int = 180,
    reach: float = 4.0,
    size: tuple[int, int] = (420, 360),
    seconds: float | None = None,
) -> Iterator[Image]:
    """Yield the pictures (H, W, 3) uint8 RGB of every 0.1 s of an episode.

    Args:
        rollout: What happened.
        env: Where; its physics must not be closed.
        title: Stands above it.
        episode: Its number.
        beams: Of the lidars, all around, of which every sixth is drawn; 0 for none.
        reach: Of these lidars, metres.
        size: Width and height in pixels, even numbers.
        seconds: Of the episode, at most; all of it by default.

    Raises:
        UserError: No such episode.
    """
    episodes = len(rollout.walked.failed)
    if not 0 <= episode < episodes:
        raise UserError(f"episode {episode}: there are {episodes}, 0 to {episodes - 1}")
    scene = _Scene(rollout, episode, env, beams, reach, size)
    frames = scene.points if seconds is None else min(scene.points, round(seconds / TRACE_SECONDS))
    for frame in range(frames + 1):
        yield labelled(scene.draw(frame), title, frame * TRACE_SECONDS)


class _Scene:
    """One episode; frame i is 0.1 s after the one before, frame 0 where the episode begins."""

    def __init__(
        self,
        rollout: RobotRollout,
        episode: int,
        env: RobotEnv,
        beams: int,
        reach: float,
        size: tuple[int, int],
    ) -> None:
        shown = ShownEpisode(rollout.walked, episode)
        self.size, self.robots, self.radius = size, rollout.robots, shown.rollout.radius[0]
        self.points, self.path, self.goal, self.present = shown.length, shown.path, shown.goal, shown.present
        self.heading = rollout.heading[episode, :, : self.points + 1]
        self.facing = headings_along(self.path).T
        self.large = large = size[0] * FINER, size[1] * FINER
        grid = next((grid for grid in env.bank.grids if grid.map_id == int(shown.rollout.map_id[0])), None)
        seen, map_id, pose = shown.seen, shown.rollout.map_id, shown.rollout.pose
        if grid is not None and max(grid.cells.shape) * grid.resolution <= WHOLE:
            corners = torch.from_numpy(free_corners(grid, env.scenario.unknown)).float()
            seen = torch.cat((seen, move_to_scene(corners.unsqueeze(0), pose)[0]))
        self.camera = camera = Camera("top").around(seen, large, MARGIN)
        self.to_pixel = camera.to_pixel(large)
        self.floor = draw_floor(grid, env.scenario.unknown, pose[0], large, camera)
        self.ends = self._rays(map_id, pose, env, beams, reach)

    def _rays(self, map_id: Tensor, pose: Tensor, env: RobotEnv, beams: int, reach: float) -> Tensor:
        """Return where the beams of all robots end in every frame (F, R, N, 2), metres."""
        frames = self.path.shape[1]
        angle = 2 * torch.pi * torch.arange(beams) / max(beams, 1)
        angle = self.heading.T.unsqueeze(2) + angle
        direction = direction_of(angle)
        origin = self.path[-self.robots :].transpose(0, 1).unsqueeze(2).expand_as(direction)
        if not beams:
            return origin
        bodies = Bodies(
            self.path.transpose(0, 1),
            self.present.T,
            map_id.expand(frames).unsqueeze(1),
            pose.expand(frames, -1),
            self.radius.expand(frames, -1),
        )
        far = env.physics.rays(bodies, origin.flatten(1, 2), direction.flatten(1, 2), reach)
        return origin + far.view(*direction.shape[:3], 1) * direction

    def draw(self, frame: int) -> Image:
        """Return a frame without its title."""
        import cv2

        image = self.floor.copy()
        robots = range(len(self.path) - self.robots, len(self.path))
        here = self.present[:, frame].nonzero()[:, 0].tolist()
        for number, robot in enumerate(robots):
            if robot in here and self.ends.shape[2]:
                self._lidar(image, self.path[robot, frame], self.ends[frame, number])
        for agent in here:
            color = ROBOT_BODY if agent in robots else person_color(agent)
            way = self.path[agent, max(0, frame - RECENT) : frame + 1]
            draw_way(image, way, self.camera, self.large, color, FINER)
            goal = self.goal[agent, min(frame, self.goal.shape[1] - 1)]
            draw_goal(image, goal, self.camera, self.large, color, FINER)
        for agent in here:
            place, wide = self.path[agent, frame], float(self.radius[agent])
            if agent in robots:
                draw_disc(image, self.to_pixel, place, wide, ROBOT_BODY)
            else:
                facing, color = float(self.facing[frame, agent]), person_color(agent)
                draw_person(image, self.to_pixel, place, facing, wide, color)
        for number, robot in enumerate(robots):
            ahead = direction_of(self.heading[number, frame]) * self.radius[robot]
            tip = self._pixels(torch.stack((self.path[robot, frame], self.path[robot, frame] + ahead)))
            cv2.polylines(image, [tip.reshape(-1, 1, 2)], False, ROBOT_FRONT, 2 * FINER, cv2.LINE_AA, 4)
        return cv2.resize(image, self.size, interpolation=cv2.INTER_AREA).astype(np.uint8)

    def _lidar(self, image: Image, origin: Tensor, ends: Tensor) -> None:
        """Draw the area that a lidar sees, and its beams."""
        import cv2

        points = self._pixels(ends)
        area = image.copy()
        cv2.fillPoly(area, [points.reshape(-1, 1, 2)], ROBOT_FRONT, cv2.LINE_AA, 4)
        image[:] = cv2.addWeighted(area, 0.22, image, 0.78, 0)
        area[:] = image
        middle = self._pixels(origin.unsqueeze(0))[0]
        lines = [np.stack((middle, end)).reshape(-1, 1, 2) for end in points[::SHOWN]]
        cv2.polylines(area, lines, False, ROBOT_FRONT, 1, cv2.LINE_AA, 4)
        image[:] = cv2.addWeighted(area, 0.5, image, 0.5, 0)

    def _pixels(self, places: Tensor) -> NDArray[np.int32]:
        """Return places (N, 2), metres, in sixteenths of pixels."""
        pixels = places.double().numpy() @ self.to_pixel[:, :2].T + self.to_pixel[:, 2]
        return np.round(pixels * 16).astype(np.int32)


def _write_gif(path: Path, frames: Sequence[Image]) -> None:
    """Write pictures (H, W, 3) uint8 RGB as a GIF that runs in real time, whole or not at all.

    Raises:
        UserError: The file cannot be written.
    """
    from PIL import Image as Pillow

    pictures = [Pillow.fromarray(frame) for frame in frames]
    # one palette for all frames: what does not move does not flicker, and takes no room
    bodies = [np.full((SWATCH, frames[0].shape[1], 3), person_color(agent), np.uint8) for agent in range(10)]
    palette = Pillow.fromarray(np.vstack([*frames[:: max(1, len(frames) // 4)], *bodies])).quantize(COLORS)
    pictures = [picture.quantize(palette=palette, dither=Pillow.Dither.NONE) for picture in pictures]
    try:
        with atomic_write(path) as part:
            every = round(1000 * TRACE_SECONDS)
            more = {"append_images": pictures[1:], "duration": every, "loop": 0, "optimize": False}
            pictures[0].save(part, save_all=True, **more)
    except OSError as error:
        raise UserError(f"cannot write {str(path)!r}: {error.strerror}") from error
