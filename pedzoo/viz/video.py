"""Videos of an episode: what the physics' camera sees every 0.1 s, one panel per policy."""

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Literal

import numpy as np
import torch

from pedzoo.core.errors import UserError, need
from pedzoo.core.geometry import move_to_map
from pedzoo.core.paths import CODECS, atomic_write, check_ending
from pedzoo.core.types import TRACE_SECONDS
from pedzoo.eval.comparison import PolicyRollout
from pedzoo.sim.drawing import Camera, Canvas, Image, headings_along, person_color
from pedzoo.sim.physics._base import Bodies
from pedzoo.sim.physics._pybullet import quiet
from pedzoo.sim.rollout import Rollout

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
    panels = [panel(*one, size, camera) for one in zip(walked, shown, strict=True)]

    def pictures() -> Iterator[Image]:
        latest = [np.empty(0, np.uint8)] * len(panels)
        for i in range(frames):
            latest = [next(one, picture) for one, picture in zip(panels, latest, strict=True)]
            yield _side_by_side(latest)
            if progress:
                progress("video", i + 1, frames)

    write_video(path, pictures(), 1 / TRACE_SECONDS)


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


def panel(
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
