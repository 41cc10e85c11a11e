"""Videos of an episode: what the physics' camera sees every 0.1 s, one panel per policy."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Literal

import numpy as np
import torch
from torch import Tensor

from pedzoo.core.errors import UserError, need
from pedzoo.core.geometry import direction_of, move_to_map
from pedzoo.core.paths import CODECS, atomic_write, check_ending
from pedzoo.core.types import TRACE_SECONDS
from pedzoo.eval.comparison import PolicyRollout
from pedzoo.sim.drawing import (
    ROBOT_BODY,
    ROBOT_FRONT,
    Camera,
    Canvas,
    Image,
    as_array,
    headings_along,
    person_color,
)
from pedzoo.sim.physics._base import Bodies
from pedzoo.sim.physics._pybullet import quiet
from pedzoo.sim.robots.env import RobotEnv
from pedzoo.sim.rollout import RobotRollout, Rollout

BEAMS, REACH, SHOWN = 180, 3.0, 6
"""Of a lidar in films of robots, its metres, and one beam in so many that is drawn."""

COLUMNS, MARGIN = 3, 0.6
"""Panels beside each other, and metres around people's paths that are seen."""

HEADER, GAP = 30, 6
"""Pixels above each panel for its name, and white ones to its right."""

HEADING, PITCH = math.radians(60), math.radians(45)
"""Where the perspective camera looks: obliquely, so that doors are seen in walls along either axis."""


def film(
    walked: Sequence[PolicyRollout],
    path: str | Path,
    episode: int = 0,
    view: Literal["top", "perspective"] = "perspective",
    size: tuple[int, int] = (640, 480),
    seconds: float | None = None,
    progress: Callable[[str, int, int], None] | None = None,
) -> None:
    """Write a video in real time of the same episode of all policies, side by side, ``.webm`` or ``.mp4``.

    A panel whose episode is over stands still until the last one is. The rollouts' physics must not be
    closed; ``perspective`` is where it has one. The size of a panel is even numbers of pixels. ``progress``
    is called with a word, frames done and frames in all.

    Raises:
        UserError: No such episode, another suffix, or the file cannot be written.
    """
    check_video_path(path)
    for one in walked:
        check_episode(one, episode)
    shown = [ShownEpisode(one.rollout, episode) for one in walked]
    seen = torch.cat([one.seen for one in shown])
    camera = Camera(view, heading=HEADING, pitch=PITCH).around(seen, size, MARGIN)
    frames = max(one.length for one in shown) + 1
    if seconds is not None:
        frames = min(frames, round(seconds / TRACE_SECONDS) + 1)
    panels = [_panel(*one, size, camera) for one in zip(walked, shown, strict=True)]

    def pictures() -> Iterator[Image]:
        latest = [np.empty(0, np.uint8)] * len(panels)
        for i in range(frames):
            latest = [next(one, picture) for one, picture in zip(panels, latest, strict=True)]
            yield _side_by_side(latest)
            if progress:
                progress("video", i + 1, frames)

    write_video(path, pictures(), 1 / TRACE_SECONDS)


def film_robots(
    rollout: RobotRollout,
    env: RobotEnv,
    path: str | Path,
    title: str = "",
    episode: int = 0,
    size: tuple[int, int] = (640, 480),
    seconds: float = 12.0,
) -> None:
    """Write a GIF in real time of the first ``seconds`` of an episode, from above, with what lidars see.

    Raises:
        UserError: No such episode, another suffix, or the file cannot be written.
    """
    from PIL import Image as Pillow

    check_ending(f"film {str(path)!r}", path, (".gif",))
    walked = PolicyRollout(title, rollout.walked, env)
    check_episode(walked, episode)
    shown, first = ShownEpisode(rollout.walked, episode), rollout.walked.mask.shape[1] - rollout.robots
    camera, radius = Camera("top").around(shown.seen, size, 1.0), rollout.walked.radius[episode].tolist()
    heading = rollout.heading[episode, :, : shown.length + 1]
    ends, pictures = _lidar_ends(shown, heading, env), []
    for frame, picture in zip(
        range(round(seconds / TRACE_SECONDS) + 1), _panel(walked, shown, size, camera), strict=False
    ):
        canvas = Canvas(np.ascontiguousarray(picture[HEADER:]), camera)
        for robot, angle in enumerate(heading[:, frame], first):
            place = shown.path[robot, frame]
            _draw_lidar(canvas, place, ends[frame, robot - first])
            canvas.disc(place, radius[robot], ROBOT_BODY)
            tip = place + radius[robot] * direction_of(angle)
            canvas.line(torch.stack((place, tip)), ROBOT_FRONT, 2)
        pictures.append(Pillow.fromarray(np.vstack((picture[:HEADER], canvas.image))))
    # one palette for all frames: what does not move does not flicker
    some = [np.asarray(picture) for picture in pictures[:: max(1, len(pictures) // 4)]]
    palette = Pillow.fromarray(np.vstack(some)).quantize(96)
    start, *rest = (picture.quantize(palette=palette, dither=Pillow.Dither.NONE) for picture in pictures)
    every = round(1000 * TRACE_SECONDS)
    with atomic_write(Path(path)) as part:
        start.save(part, save_all=True, append_images=rest, duration=every, loop=0, optimize=False)


def _lidar_ends(shown: ShownEpisode, heading: Tensor, env: RobotEnv) -> Tensor:
    """Return where the beams of all robots end in every frame (F, R, N, 2), metres."""
    place, one = shown.path.transpose(0, 1), shown.rollout
    direction = direction_of(heading.T.unsqueeze(2) + 2 * torch.pi * torch.arange(BEAMS) / BEAMS)
    origin = place[:, -len(heading) :].unsqueeze(2).expand_as(direction)
    same = (value.expand(len(place), -1) for value in (one.map_id.unsqueeze(1), one.pose, one.radius))
    bodies = Bodies(place, shown.present.T, *same)
    far = env.physics.rays(bodies, origin.flatten(1, 2), direction.flatten(1, 2), REACH)
    return origin + far.view(*direction.shape[:3], 1) * direction


def _draw_lidar(canvas: Canvas, origin: Tensor, ends: Tensor) -> None:
    """Draw the area that a lidar sees, and its beams."""
    import cv2

    area, points = canvas.image.copy(), canvas.pixels(as_array(ends))
    cv2.fillPoly(area, [points], ROBOT_FRONT, cv2.LINE_AA, 4)
    middle = canvas.pixels(as_array(origin)[None])
    lines = [np.concatenate((middle, end[None])) for end in points[::SHOWN]]
    cv2.polylines(area, lines, False, ROBOT_BODY, 1, cv2.LINE_AA, 4)
    canvas.image[:] = cv2.addWeighted(area, 0.25, canvas.image, 0.75, 0)


def check_video_path(path: str | Path) -> None:
    """Raise the error that a file name gives which no video can have, or a package that is missing."""
    need("video", "a video")
    check_ending(f"video {str(path)!r}", path, CODECS)


def check_episode(walked: PolicyRollout, episode: int) -> None:
    """Raise the error that the number of an episode gives which has not been walked."""
    episodes = len(walked.rollout.failed)
    if not 0 <= episode < episodes:
        raise UserError(f"episode {episode}: {walked.name} has walked {episodes}, 0 to {episodes - 1}")


def write_video(path: str | Path, frames: Iterable[Image], rate: float) -> None:
    """Write pictures (H, W, 3) uint8 RGB at ``rate`` per second, whole or not at all, and read the file back.

    All have the same even height and width.

    Raises:
        UserError: Another suffix, or what was written is not what is read.
    """
    import cv2

    check_video_path(path)
    path = Path(path)
    codec = cv2.VideoWriter.fourcc(*CODECS[path.suffix.lower()])
    writer, size, count = None, (0, 0), 0
    with atomic_write(path) as part:
        for frame in frames:
            if writer is None:
                size = (frame.shape[1], frame.shape[0])
                with quiet(2):
                    writer = cv2.VideoWriter(str(part), codec, rate, size)
                if not writer.isOpened():
                    raise UserError(f"cannot write {str(path)!r}: is its folder writable, the disk full?")
            writer.write(cv2.cvtColor(frame, cv2.COLOR_RGB2BGR))
            count += 1
        if writer is None:
            raise UserError(f"{str(path)!r}: a video needs at least one frame")
        writer.release()
        if (result := read_video(part)) != (count, size):
            raise UserError(f"{str(path)!r}: {count} frames of {size} were written, {result} can be read")


def read_video(path: str | Path) -> tuple[int, tuple[int, int]]:
    """Return how many frames of a video can be decoded, and their width and height (0 for none)."""
    import cv2

    with quiet(2):
        video = cv2.VideoCapture(str(path))
    count, size = 0, (0, 0)
    while (read := video.read())[0]:
        count, size = count + 1, (read[1].shape[1], read[1].shape[0])
    video.release()
    return count, size


class ShownEpisode:
    """One episode of a rollout; point 0 is where it begins, and the P others follow every 0.1 s.

    Attributes:
        path: Positions (A, 1 + P, 2), metres, in the frame of the scene, or of its map.
        goal: What agents head for until each next point (A, P, 2), likewise.
        present: Which agents are there at each point (A, 1 + P) bool.
        seen: All these positions and goals (N, 2) together.
        stays: Slot, first and last point of each person's stay.
    """

    def __init__(self, rollout: Rollout, episode: int, on_map: bool = False) -> None:
        """Take one episode of several."""
        one = self.rollout = rollout.episodes(slice(episode, episode + 1))
        self.length = int(one.length[0])
        path, goal = (move_to_map(xy, one.pose) if on_map else xy for xy in (one.path, one.goal))
        self.path, self.goal = path[0, :, : self.length + 1], goal[0, :, : self.length]
        present = torch.cat((one.mask.unsqueeze(2), one.present), dim=2)
        self.present = present[0, :, : self.length + 1]
        self.seen = torch.cat((self.path[self.present], self.goal[self.present[:, 1:]]))
        self.stays = rollout.stays(episode)


def _panel(
    walked: PolicyRollout, shown: ShownEpisode, size: tuple[int, int], camera: Camera
) -> Iterator[Image]:
    """Yield the pictures of an episode, each below a line with the policy's name and the time."""
    physics, one, heading = walked.env.physics, shown.rollout, headings_along(shown.path)
    if camera.view not in physics.views:
        camera = replace(camera, view="top")

    def taken(i: int, people: bool = True) -> Image:
        """Return what the physics' camera sees, with or without people."""
        place, present = shown.path[None, :, i], shown.present[None, :, i] & people
        map_id = one.map_id.unsqueeze(1)
        bodies = Bodies(place, present, map_id, one.pose, one.radius, heading[None, :, i], one.kind)
        return physics.image(bodies, 0, size, camera)

    empty = taken(0, people=False)
    for i in range(shown.length + 1):
        bodies, canvas = taken(i), Canvas(empty.copy(), camera)
        for person, first, last in shown.stays:
            if first <= i <= last:
                canvas.line(shown.path[person, first : i + 1], person_color(person))
                canvas.goal(shown.goal[person, min(i, shown.length - 1)], person_color(person))
        # bodies stand on the marks of the floor
        there = (bodies != empty).any(axis=-1, keepdims=True)
        yield labelled(np.where(there, bodies, canvas.image), walked.name, i * TRACE_SECONDS)


def labelled(image: Image, name: str, seconds: float) -> Image:
    """Return the picture under a line with name and time."""
    import cv2

    line = np.full((HEADER, image.shape[1], 3), 255, dtype=np.uint8)
    clock, font, scale = f"{seconds:.1f} s", cv2.FONT_HERSHEY_SIMPLEX, 0.5
    right = image.shape[1] - 10 - cv2.getTextSize("00.0 s", font, scale, 1)[0][0]
    while len(name) > 8 and cv2.getTextSize(name, font, scale, 1)[0][0] > right - 30:
        name = f"...{name[4:]}"  # the end of a path says more than its beginning
    for text, x in ((name, 10), (clock, right)):
        cv2.putText(line, text, (x, HEADER - 10), font, scale, (30, 30, 30), 1, cv2.LINE_AA)
    return np.vstack((line, image))


def _side_by_side(panels: list[Image]) -> Image:
    """Return one picture, in rows of at most `COLUMNS` panels; a shorter last row stands in the middle."""
    columns = 2 if len(panels) == 4 else min(COLUMNS, len(panels))
    panels = [np.pad(panel, ((0, 0), (0, GAP), (0, 0)), constant_values=255) for panel in panels]
    rows = [np.hstack(panels[i : i + columns]) for i in range(0, len(panels), columns)]
    room = rows[0].shape[1] - rows[-1].shape[1]
    rows[-1] = np.pad(rows[-1], ((0, 0), (room // 2, room - room // 2), (0, 0)), constant_values=255)
    return np.vstack(rows)
