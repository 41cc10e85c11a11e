"""Draw pictures of README and docs: python tools/pages/readme_pictures.py [gif|snippet|video]; default: all.

``docs/pictures/apartment.gif``: people and a robot in an apartment, from above, 12 s in real time.
``docs/pictures/controller.png``: what the README's Python code does. The code is taken from the README.
``docs/pictures/video.png``: three moments of a video of pybullet's camera.
"""

from __future__ import annotations

import re
import sys
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import cv2
import numpy as np
import torch
from PIL import Image

from pedzoo.core.types import TRACE_SECONDS
from pedzoo.eval.comparison import PolicyRollout
from pedzoo.eval.robots import robot_rollout
from pedzoo.eval.rollout import rollout
from pedzoo.maps.procedural.plan import generate
from pedzoo.policies.controller.controller import Controller
from pedzoo.sim.camera import person_color
from pedzoo.sim.drawing import SHOULDERS
from pedzoo.sim.physics._base import Bodies
from pedzoo.sim.robots.rollout import RobotRollout
from pedzoo.viz.plan_sheet import draw
from pedzoo.viz.video import film
from tools.pages.canvas import COLORS, ROBOT_COLOR, Canvas, headings, pale, save_gif

ROOT = Path(__file__).parents[2]
PICTURES = ROOT / "docs" / "pictures"

APARTMENT, PEOPLE, WALKERS, ROBOT, DRIVER = 25, 7, "sgan_goal_map.indoor", "turtlebot4:radius=0.25", "orca"
"""Seed of the floor plan, number of people, their policy, the robot's body and its policy."""

EVERY = 25
"""Steps of 0.1 s between two figures of a person in `snippet`."""

SECONDS, FRAME_SECONDS, WIDTH = 12.0, 0.08, 1200
"""Of the GIF: its length, time between frames and pixels."""

EPISODES, BEAMS, REACH, TRAIL = 30, 120, 3.0, 2.5
"""Episodes to choose from; beams and reach (m) of the lidar drawn; seconds of a trail."""


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

    canvas, frames = canvas_of("apartment", APARTMENT, WIDTH), []
    facing = [headings(way) for way in path[:-1]]
    colors = [person_color(person) for person in range(PEOPLE)]
    for moment in np.arange(0.0, SECONDS, FRAME_SECONDS) / TRACE_SECONDS:
        now, before = int(moment), max(0, int(moment - TRAIL / TRACE_SECONDS))
        here = path[:, now] + (moment - now) * (path[:, now + 1] - path[:, now])
        canvas.clear()
        canvas.area(here[-1] + beams[now])
        for person, color in enumerate(colors):
            canvas.goal(one.walked.goal[0, person, now].numpy(), color)
            canvas.trail([*path[person, before : now + 1], here[person]], color)
        canvas.trail([*path[-1, before : now + 1], here[-1]], ROBOT_COLOR)
        for person, color in enumerate(colors):
            canvas.person(here[person], facing[person][now], color)
        canvas.robot(here[-1], float(one.heading[0, 0, now]), float(radius[-1]))
        frames.append(canvas.finished(f"{PEOPLE} people by {WALKERS}, a robot with its lidar, real time"))
    save_gif(frames, out, [*colors, *map(pale, colors)], FRAME_SECONDS)
    touches = int((one.walked.agent_contact | one.walked.wall_contact)[0, :, : points - 1].sum())
    print(f"{out}: episode {episode}, touches {touches}, {out.stat().st_size / 1e6:.1f} MB")


def canvas_of(kind: str, seed: int, width: int) -> Canvas:
    """Return the canvas of a procedural floor plan; ``width`` in pixels of the finished picture."""
    plan = generate(kind, seed)
    return Canvas(Image.fromarray(draw(plan)), plan.size, width)


def liveliest(both: RobotRollout) -> int:
    """Return the episode with most people near each other or the robot, of those that last long enough."""
    points = round(SECONDS / TRACE_SECONDS)
    path = both.walked.path[:, :, :points]
    gap = (path.unsqueeze(1) - path.unsqueeze(2)).norm(dim=-1)
    pairs = torch.ones(gap.shape[1:3]).triu(1)[None, :, :, None]
    met = ((gap < 1.3) * pairs).sum((1, 2, 3)) + 2 * (gap[:, -1] < 1.5).sum((1, 2))
    moved = (path.diff(dim=2).norm(dim=-1) > 0.03).float().mean((1, 2))
    # shoulders are drawn wider than the disc that touches are measured with: none may lie over the robot
    clear = gap[:, -1, :-1].amin((1, 2)) > both.walked.radius[:, -1] + SHOULDERS[1]
    fits = (both.seconds > SECONDS + TRACE_SECONDS) & clear
    return int((met.float() * moved**4).where(fits, torch.tensor(-1.0)).argmax())


def snippet(out: Path = PICTURES / "controller.png") -> None:
    """Run the first Python block of the README, and draw where its people walked."""
    readme = (ROOT / "README.md").read_text()
    code = re.findall(r"```python\n(.*?)```", readme, re.DOTALL)[0]
    walks, plan = recorded(code)
    canvas = canvas_of(*plan, width=1000)
    robot = walks.pop("robot")
    canvas.robot(robot[-1], 0.0, 0.3)
    people = [(way, headings(np.array(way)), person_color(i)) for i, way in enumerate(walks.values())]
    for way, _, color in people:
        canvas.trail(way, color)
    drawn: list[Any] = []
    for moment in range(0, len(robot), EVERY):
        for way, facing, color in people:
            # a figure over that of another moment would look like a collision
            if all(np.linalg.norm(way[moment] - other) > 2 * SHOULDERS[1] for other in drawn):
                canvas.person(way[moment], facing[moment], color)
                canvas.label(way[moment], f"{moment / 10:g} s", color)
        drawn += [way[moment] for way, _, _ in people]
    picture = canvas.finished(f"Ann (red) and Ben (blue) every {EVERY / 10:g} s; the robot stands")
    picture.quantize(COLORS).save(out, optimize=True)
    print(out)


def video(out: Path = PICTURES / "video.png") -> None:
    """Film two people at a door with pybullet, and put three of its pictures side by side."""
    walked = PolicyRollout(WALKERS, *rollout(WALKERS, "door", "bullet", 1))
    with TemporaryDirectory() as folder:
        film([walked], Path(folder) / "door.webm", size=(480, 360))
        reader, frames = cv2.VideoCapture(str(Path(folder) / "door.webm")), []
        while (frame := reader.read())[0]:
            frames.append(frame[1][..., ::-1])
    moments = [frames[round(part * len(frames))] for part in (0.25, 0.42, 0.6)]
    Image.fromarray(np.hstack(moments)).quantize(COLORS, dither=Image.Dither.NONE).save(out, optimize=True)
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
    for wanted in sys.argv[1:] or ("gif", "snippet", "video"):
        {"gif": apartment, "snippet": snippet, "video": video}[wanted]()
