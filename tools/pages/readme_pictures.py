"""Draw the README's pictures: python tools/pages/readme_pictures.py [gif|snippet]; both by default.

``docs/pictures/apartment.gif``: people and a robot in an apartment, from above, 12 s in real time.
``docs/pictures/controller.png``: what the README's Python code does. The code is taken from the README.
"""

from __future__ import annotations

import re
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from pedzoo.core.types import TRACE_SECONDS
from pedzoo.eval.robots import robot_rollout
from pedzoo.maps.procedural.plan import generate
from pedzoo.policies.stepping.controller import Controller
from pedzoo.sim.physics_parts.base import Bodies
from pedzoo.sim.physics_parts.camera import person_color
from pedzoo.sim.robot_parts.rollout import RobotRollout
from pedzoo.viz.plan_sheet import draw

ROOT = Path(__file__).parents[2]
PICTURES = ROOT / "docs" / "pictures"

APARTMENT, PEOPLE, WALKERS, ROBOT, DRIVER = 25, 7, "sgan_goal_map.indoor", "turtlebot4:radius=0.25", "orca"
"""Seed of the floor plan, number of people, their policy, the robot's body and its policy."""

SECONDS, FRAME_SECONDS, WIDTH, COLORS = 12.0, 0.08, 1200, 96
"""Of the GIF: its length, time between frames, pixels and colours."""

SWATCH = 12
"""Rows of pixels by which the colours of people count in the palette, however small people are."""

FINER, EPISODES, BEAMS, REACH, TRAIL = 2, 30, 120, 3.0, 2.5
"""Supersampling; episodes to choose from; beams and reach (m) of the lidar drawn; seconds of a trail."""

SHOULDERS, HEAD = (0.13, 0.23), 0.1
"""Half axes of a body along and across its heading, and radius of a head, metres."""

INK, ROBOT_COLOR, LIDAR, RED = (40, 44, 52), (36, 40, 48), (255, 170, 20, 60), (214, 39, 40)


class Canvas:
    """A drawn floor plan, on which bodies are drawn in metres."""

    def __init__(self, kind: str, seed: int, width: int) -> None:
        """Draw the floor; ``width`` in pixels of the finished picture."""
        plan = generate(kind, seed)
        self.scale = width * FINER / plan.size[0]
        size = width * FINER, round(plan.size[1] * self.scale)
        self.floor = Image.fromarray(draw(plan)).resize(size, Image.Resampling.NEAREST).convert("RGB")
        self.clear()

    def clear(self) -> None:
        """Start a new picture."""
        self.image = self.floor.copy()
        self.pen = ImageDraw.Draw(self.image, "RGBA")

    def pixels(self, places: Any) -> list[tuple[float, float]]:
        """Return places (N, 2), metres, in pixels."""
        places = np.asarray(places, dtype=float).reshape(-1, 2)
        height = self.image.height
        return [(x * self.scale, height - y * self.scale) for x, y in places]

    def trail(self, places: Any, color: tuple[int, int, int], metres: float = 0.05) -> None:
        """Draw where an agent was."""
        self.pen.line(self.pixels(places), pale(color), round(metres * self.scale), joint="curve")

    def goal(self, place: Any, color: tuple[int, int, int]) -> None:
        """Draw a ring."""
        self._disc(place, 0.2, None, color, 3 * FINER)

    def person(self, place: Any, heading: float, color: tuple[int, int, int]) -> None:
        """Draw shoulders and a head from above."""
        angle = np.linspace(0, 2 * np.pi, 24)
        along, across = SHOULDERS[0] * np.cos(angle), SHOULDERS[1] * np.sin(angle)
        turn = np.array([[np.cos(heading), np.sin(heading)], [-np.sin(heading), np.cos(heading)]])
        outline = self.pixels(np.asarray(place) + np.stack((along, across), 1) @ turn)
        self.pen.polygon(outline, color, INK, FINER)
        self._disc(place, HEAD, (250, 224, 200), INK, FINER)

    def robot(self, place: Any, heading: float, radius: float) -> None:
        """Draw a disc, and where its front is."""
        self._disc(place, radius, ROBOT_COLOR, INK, FINER)
        tip = np.asarray(place) + radius * np.array([np.cos(heading), np.sin(heading)])
        self.pen.line(self.pixels([place, tip]), LIDAR[:3], 3 * FINER)

    def label(self, place: Any, text: str) -> None:
        """Write beside a place."""
        (x, y), font = self.pixels(place)[0], ImageFont.load_default(15 * FINER)
        self.pen.text((x + 14 * FINER, y - 24 * FINER), text, INK, font)

    def area(self, outline: Any) -> None:
        """Draw what a lidar sees."""
        self.pen.polygon(self.pixels(outline), LIDAR)

    def finished(self, text: str) -> Image.Image:
        """Return the picture in its size, with a line of text at its lower edge."""
        width, height = self.image.width // FINER, self.image.height // FINER
        small = self.image.resize((width, height), Image.Resampling.BOX)
        result = Image.new("RGB", (width, height + 34), "white")
        result.paste(small)
        ImageDraw.Draw(result).text((8, height + 6), text, INK, ImageFont.load_default(19))
        return result

    def _disc(self, place: Any, radius: float, fill: Any, outline: Any, width: int) -> None:
        (x, y), far = self.pixels(place)[0], radius * self.scale
        self.pen.ellipse((x - far, y - far, x + far, y + far), fill, outline, width)


def apartment(out: Path = PICTURES / "apartment.gif") -> None:
    """Walk some episodes, choose the liveliest and draw its first 12 s."""
    scenario = f"goals:map=apartment.{APARTMENT},people={PEOPLE},goals=3,pool=40"
    both, env = robot_rollout(
        DRIVER, scenario, ROBOT, WALKERS, episodes=EPISODES, robot_goals=3, ends_at="none"
    )
    episode = liveliest(both)
    one = both.episodes(slice(episode, episode + 1))
    points = round(SECONDS / TRACE_SECONDS) + 1
    path, radius = one.walked.path[0, :, :points].double().numpy(), one.walked.radius[0]
    origin = one.walked.path[0, -1:, :points].transpose(0, 1)
    angle = 2 * torch.pi * torch.arange(BEAMS) / BEAMS
    direction = torch.stack((angle.cos(), angle.sin()), 1).expand(points, -1, -1)
    bodies = Bodies(
        one.walked.path[0, :, :points].transpose(0, 1),
        torch.ones(points, len(path), dtype=torch.bool),
        one.walked.map_id.expand(points).unsqueeze(1),
        one.walked.pose.expand(points, -1),
        radius.expand(points, -1),
    )
    far = env.physics.rays(bodies, origin.expand(-1, BEAMS, -1), direction, REACH)
    beams = (far.unsqueeze(2) * direction).double().numpy()

    canvas, frames = Canvas("apartment", APARTMENT, WIDTH), []
    facing = [headings(way) for way in path[:-1]]
    for moment in np.arange(0.0, SECONDS, FRAME_SECONDS) / TRACE_SECONDS:
        now, before = int(moment), max(0, int(moment - TRAIL / TRACE_SECONDS))
        here = path[:, now] + (moment - now) * (path[:, now + 1] - path[:, now])
        canvas.clear()
        canvas.area(here[-1] + beams[now])
        colors = [person_color(person) for person in range(PEOPLE)]
        for person, color in enumerate(colors):
            canvas.goal(one.walked.goal[0, person, now].numpy(), color)
            canvas.trail([*path[person, before : now + 1], here[person]], color)
        canvas.trail([*path[-1, before : now + 1], here[-1]], ROBOT_COLOR)
        for person, color in enumerate(colors):
            canvas.person(here[person], facing[person][now], color)
        canvas.robot(here[-1], float(one.heading[0, 0, now]), float(radius[-1]))
        frames.append(canvas.finished(f"{PEOPLE} people by {WALKERS}, a robot with its lidar, real time"))
    save_gif(frames, out)
    touches = int((one.walked.agent_contact | one.walked.wall_contact)[0, :, : points - 1].sum())
    print(f"{out}: episode {episode}, touches {touches}, {out.stat().st_size / 1e6:.1f} MB")


def liveliest(both: RobotRollout) -> int:
    """Return the episode with most people near each other or the robot, of those that last long enough."""
    points = round(SECONDS / TRACE_SECONDS)
    path = both.walked.path[:, :, :points]
    gap = (path.unsqueeze(1) - path.unsqueeze(2)).norm(dim=-1)
    pairs = torch.ones(gap.shape[1:3]).triu(1)[None, :, :, None]
    met = ((gap < 1.3) * pairs).sum((1, 2, 3)) + 2 * (gap[:, -1] < 1.5).sum((1, 2))
    moved = (path.diff(dim=2).norm(dim=-1) > 0.03).float().mean((1, 2))
    lasts = both.seconds > SECONDS + TRACE_SECONDS
    return int((met.float() * moved**4).where(lasts, torch.tensor(-1.0)).argmax())


def pale(color: tuple[int, int, int]) -> tuple[int, int, int]:
    """Return the colour of a trail."""
    red, green, blue = ((2 * part + 255) // 3 for part in color)
    return red, green, blue


def headings(way: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return where a walker faces at every point (T,): its mean direction of 0.6 s, kept while it stands."""
    angle, result = 0.0, np.zeros(len(way))
    for now in range(len(way)):
        move = way[min(now + 3, len(way) - 1)] - way[max(now - 3, 0)]
        if np.linalg.norm(move) > 0.08:
            angle = float(np.arctan2(move[1], move[0]))
        result[now] = angle
    return result


def save_gif(frames: Sequence[Image.Image], out: Path) -> None:
    """Write pictures with one palette: what does not move does not flicker, and takes no room."""
    few = [np.asarray(frame) for frame in frames[:: len(frames) // 6]]
    colors = [person_color(person) for person in range(PEOPLE)]
    few += [np.full((SWATCH, WIDTH, 3), color, np.uint8) for color in (*colors, *map(pale, colors))]
    palette = Image.fromarray(np.vstack(few)).quantize(COLORS)
    first, *rest = (frame.quantize(palette=palette, dither=Image.Dither.NONE) for frame in frames)
    first.save(out, save_all=True, append_images=rest, duration=round(1000 * FRAME_SECONDS), loop=0)


def snippet(out: Path = PICTURES / "controller.png") -> None:
    """Run the first Python block of the README, and draw where its people walked."""
    readme = (ROOT / "README.md").read_text()
    code = re.findall(r"```python\n(.*?)```", readme, re.DOTALL)[0]
    walks, plan = recorded(code)
    canvas = Canvas(*plan, width=1000)
    for number, (person, way) in enumerate(walks.items()):
        color = ROBOT_COLOR if person == "robot" else person_color(number)
        if person == "robot":
            canvas.robot(way[-1], 0.0, 0.3)
            continue
        canvas.trail(way, color)
        shown = way[0] + 1.0
        for moment in range(0, len(way), 20):
            if np.linalg.norm(way[moment] - shown) > 2 * SHOULDERS[1]:
                shown = way[moment]
                canvas.person(shown, headings(np.array(way))[moment], color)
                canvas.label(shown, f"{moment // 10} s")
    canvas.finished("people every 2 s; the robot stands").quantize(COLORS).save(out, optimize=True)
    print(out)


def recorded(code: str) -> tuple[dict[Any, list[Any]], tuple[str, int]]:
    """Run code that steps a controller, and return all positions by id and the plan's kind and seed."""
    walks: dict[Any, list[Any]] = {}
    step = Controller.step

    def watched(self: Controller, people: Any, *rest: Any, **more: Any) -> Any:
        for name, place in {**people, **more.get("others", {})}.items():
            walks.setdefault(name, []).append(np.asarray(place, dtype=float))
        return step(self, people, *rest, **more)

    Controller.step = watched
    try:
        exec(compile(code, "README.md", "exec"), {})
    finally:
        Controller.step = step
    kind, seed = re.findall(r'"(apartment|office)\.(\d+)"', code)[0]
    return walks, (kind, int(seed))


if __name__ == "__main__":
    for wanted in sys.argv[1:] or ("gif", "snippet"):
        {"gif": apartment, "snippet": snippet}[wanted]()
