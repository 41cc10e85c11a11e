"""Robots among people from above, with what their lidar sees."""

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from pedzoo.core.errors import UserError
from pedzoo.core.geometry import direction_of, move_to_scene
from pedzoo.core.paths import atomic_write
from pedzoo.core.types import TRACE_SECONDS
from pedzoo.sim.drawing import (
    ROBOT_BODY,
    ROBOT_FRONT,
    Camera,
    Canvas,
    Image,
    as_array,
    draw_floor,
    free_corners,
    headings_along,
    person_color,
)
from pedzoo.sim.physics._base import Bodies
from pedzoo.sim.robots.env import RobotEnv
from pedzoo.sim.rollout import RobotRollout
from pedzoo.viz.video import ShownEpisode, check_video_path, labelled, write_video

FINER = 2
"""Pictures are drawn so many times larger, and made smaller: lines are smooth then."""

MARGIN, WHOLE = 0.4, 20.0
"""Metres around what is seen: a floor plan of at most so many metres, or all ways on a larger one."""

SHOWN, RECENT = 6, 30
"""One in so many beams is drawn, and so many trace points of the ways: 3 s."""

COLORS, SWATCH = 48, 12
"""Of a GIF; and rows of pixels by which the colours of people count, however small people are."""


def film_robots(
    rollout: RobotRollout, env: RobotEnv, path: str | Path, title: str = "", episode: int = 0, **settings: Any
) -> None:
    """Write a moving picture in real time of one episode, from above: ``.gif``, ``.webm`` or ``.mp4``.

    Other arguments are those of `robot_frames`.

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
    import cv2

    episodes = len(rollout.walked.failed)
    if not 0 <= episode < episodes:
        raise UserError(f"episode {episode}: there are {episodes}, 0 to {episodes - 1}")
    shown, unknown = ShownEpisode(rollout.walked, episode), env.scenario.unknown
    one, seen, first = shown.rollout, shown.seen, len(shown.path) - rollout.robots
    plan, large = env.bank.grid(one.map_id), (size[0] * FINER, size[1] * FINER)
    if plan is not None and max(plan.cells.shape) * plan.resolution <= WHOLE:
        corners = torch.from_numpy(free_corners(plan, unknown)).float()
        seen = torch.cat((seen, move_to_scene(corners.unsqueeze(0), one.pose)[0]))
    camera = Camera("top").around(seen, large, MARGIN)
    floor, radius = draw_floor(plan, unknown, one.pose[0], large, camera), one.radius[0].tolist()
    heading, facing = rollout.heading[episode, :, : shown.length + 1], headings_along(shown.path)
    ends = _lidar_ends(shown, heading, env, max(beams, 1), reach)
    frames = shown.length if seconds is None else min(shown.length, round(seconds / TRACE_SECONDS))
    for frame in range(frames + 1):
        canvas, place = Canvas(floor.copy(), camera), shown.path[:, frame]
        here = shown.present[:, frame].nonzero()[:, 0].tolist()
        for robot in (agent for agent in here if agent >= first and beams):
            _draw_lidar(canvas, place[robot], ends[frame, robot - first])
        for agent in here:
            color = ROBOT_BODY if agent >= first else person_color(agent)
            canvas.line(shown.path[agent, max(0, frame - RECENT) : frame + 1], color, FINER)
            canvas.goal(shown.goal[agent, min(frame, shown.length - 1)], color, FINER)
        for agent in here:
            if agent >= first:
                canvas.disc(place[agent], radius[agent], ROBOT_BODY)
            else:
                canvas.person(place[agent], float(facing[agent, frame]), radius[agent], person_color(agent))
        for robot, angle in enumerate(heading[:, frame], first):
            tip = place[robot] + radius[robot] * direction_of(angle)
            canvas.line(torch.stack((place[robot], tip)), ROBOT_FRONT, 2 * FINER)
        image = cv2.resize(canvas.image, size, interpolation=cv2.INTER_AREA).astype(np.uint8)
        yield labelled(image, title, frame * TRACE_SECONDS)


def _lidar_ends(shown: ShownEpisode, heading: Tensor, env: RobotEnv, beams: int, reach: float) -> Tensor:
    """Return where the beams of all robots end in every frame (F, R, N, 2), metres."""
    place, one = shown.path.transpose(0, 1), shown.rollout
    direction = direction_of(heading.T.unsqueeze(2) + 2 * torch.pi * torch.arange(beams) / beams)
    origin = place[:, -len(heading) :].unsqueeze(2).expand_as(direction)
    same = (value.expand(len(place), -1) for value in (one.map_id.unsqueeze(1), one.pose, one.radius))
    bodies = Bodies(place, shown.present.T, *same)
    far = env.physics.rays(bodies, origin.flatten(1, 2), direction.flatten(1, 2), reach)
    return origin + far.view(*direction.shape[:3], 1) * direction


def _draw_lidar(canvas: Canvas, origin: Tensor, ends: Tensor) -> None:
    """Draw the area that a lidar sees, and its beams."""
    import cv2

    image, points = canvas.image, canvas.pixels(as_array(ends))
    area = image.copy()
    cv2.fillPoly(area, [points], ROBOT_FRONT, cv2.LINE_AA, 4)
    image[:] = cv2.addWeighted(area, 0.22, image, 0.78, 0)
    area[:] = image
    middle = canvas.pixels(as_array(origin)[None])
    lines = [np.concatenate((middle, end[None])) for end in points[::SHOWN]]
    cv2.polylines(area, lines, False, ROBOT_FRONT, 1, cv2.LINE_AA, 4)
    image[:] = cv2.addWeighted(area, 0.5, image, 0.5, 0)


def _write_gif(path: Path, frames: Sequence[Image]) -> None:
    """Write pictures (H, W, 3) uint8 RGB as a GIF that runs in real time, whole or not at all."""
    from PIL import Image as Pillow

    pictures = [Pillow.fromarray(frame) for frame in frames]
    # one palette for all frames: what does not move does not flicker, and takes no room
    bodies = [np.full((SWATCH, frames[0].shape[1], 3), person_color(agent), np.uint8) for agent in range(10)]
    palette = Pillow.fromarray(np.vstack([*frames[:: max(1, len(frames) // 4)], *bodies])).quantize(COLORS)
    first, *rest = (picture.quantize(palette=palette, dither=Pillow.Dither.NONE) for picture in pictures)
    every = round(1000 * TRACE_SECONDS)
    try:
        with atomic_write(path) as part:
            first.save(part, save_all=True, append_images=rest, duration=every, loop=0, optimize=False)
    except OSError as error:
        raise UserError(f"cannot write {str(path)!r}: {error.strerror}") from error
