"""Draw pictures of README and docs: python tools/pages/readme_pictures.py [gif|snippet|video]; default: all.

``docs/pictures/apartment.gif``: people and a robot in an apartment, from above, 12 s in real time.
``docs/pictures/controller.png``: what the README's Python code does. The code is taken from the README.
``docs/pictures/video.png``: three moments of a video of pybullet's camera.
"""

import re
import sys
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import cv2
import numpy as np
import torch
from PIL import Image

from pedzoo.core.types import BODY_RADIUS, TRACE_SECONDS
from pedzoo.eval.comparison import PolicyRollout
from pedzoo.eval.robots import robot_rollout
from pedzoo.eval.rollout import rollout
from pedzoo.maps.procedural import generate
from pedzoo.policies.controller.controller import Controller
from pedzoo.sim.drawing import EDGE, ROBOT_BODY, SHOULDERS, Camera, Canvas, headings_along, person_color
from pedzoo.sim.rollout import RobotRollout
from pedzoo.viz.plots import draw
from pedzoo.viz.video import film, film_robots

ROOT = Path(__file__).parents[2]
PICTURES = ROOT / "docs" / "pictures"

APARTMENT, PEOPLE, WALKERS = 25, 7, "approach_net_goal_map.indoor"
ROBOT, DRIVER = "turtlebot4:radius=0.25", "orca"
"""Seed of the floor plan, number of people, their policy, the robot's body and its policy."""

EPISODES, SECONDS, SIZE = 30, 12.0, (1200, 800)
"""Of the GIF: episodes to choose from, its length, and its pixels."""

EVERY, WIDTH, FINER, COLORS = 25, 1000, 2, 96
"""Of `snippet`: steps of 0.1 s between two figures; pixels, supersampling, and colours of the picture."""


def apartment(out: Path = PICTURES / "apartment.gif") -> None:
    """Walk some episodes, choose the liveliest and film its first 12 s."""
    scenario = f"goals:map=apartment.{APARTMENT},people={PEOPLE},goals=3,pool=40"
    both, env = robot_rollout(
        DRIVER, scenario, ROBOT, WALKERS, episodes=EPISODES, robot_goals=3, ends_at="none"
    )
    episode = liveliest(both)
    title = f"{PEOPLE} people by {WALKERS}, a robot with its lidar, real time"
    film_robots(both, env, out, title, episode, SIZE, SECONDS)
    walked, points = both.episodes(slice(episode, episode + 1)).walked, round(SECONDS / TRACE_SECONDS)
    touches = int((walked.agent_contact | walked.wall_contact)[0, :, :points].sum())
    print(f"{out}: episode {episode}, touches {touches}, {out.stat().st_size / 1e6:.1f} MB")


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
    code = re.findall(r"```python\n(.*?)```", (ROOT / "README.md").read_text(), re.DOTALL)[0]
    walks = recorded(code)
    kind, seed = re.findall(r'"(apartment|office)\.(\d+)"', code)[0]
    plan = generate(kind, int(seed))
    wide, high = plan.size
    large = WIDTH * FINER, round(WIDTH * FINER * high / wide)
    floor = np.array(cv2.resize(draw(plan), large, interpolation=cv2.INTER_NEAREST), np.uint8)
    canvas = Canvas(floor, Camera("top", (wide / 2, high / 2), wide))
    canvas.disc(walks.pop("robot")[0], 0.3, ROBOT_BODY)
    paths = torch.stack([*walks.values()])
    facing, drawn = headings_along(paths), []
    for person, way in enumerate(paths):
        red, green, blue = ((2 * part + 255) // 3 for part in person_color(person))
        canvas.line(way, (red, green, blue), 3 * FINER)
    for moment in range(0, paths.shape[1], EVERY):
        for person, place in enumerate(paths[:, moment]):
            # a figure over that of another moment would look like a collision
            if all((place - other).norm() > 2 * SHOULDERS[1] for other in drawn):
                canvas.person(place, float(facing[person, moment]), BODY_RADIUS, person_color(person))
                x, y = canvas.pixels(place[None].numpy())[0, 0] // 16 + (14 * FINER, -10 * FINER)
                write(canvas.image, f"{moment / 10:g} s", int(x), int(y), person_color(person), FINER)
        drawn += [*paths[:, moment]]
    small = cv2.resize(canvas.image, None, fx=1 / FINER, fy=1 / FINER, interpolation=cv2.INTER_AREA)
    picture = np.vstack((small, np.full((34, WIDTH, 3), 255, np.uint8)))
    said = f"Ann (red) and Ben (blue) every {EVERY / 10:g} s; the robot stands"
    write(picture, said, 8, len(picture) - 10, EDGE)
    Image.fromarray(picture).quantize(COLORS).save(out, optimize=True)
    print(out)


def write(image: Any, text: str, x: int, y: int, color: tuple[int, int, int], size: int = 1) -> None:
    """Write into a picture, a line that begins at a pixel."""
    cv2.putText(image, text, (x, y), cv2.FONT_HERSHEY_SIMPLEX, 0.55 * size, color, size, cv2.LINE_AA)


def recorded(code: str) -> dict[Any, torch.Tensor]:
    """Run code that steps a controller, and return all positions (T, 2) by id."""
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
    return {name: torch.from_numpy(np.stack(places)) for name, places in walks.items()}


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


if __name__ == "__main__":
    for wanted in sys.argv[1:] or ("gif", "snippet", "video"):
        {"gif": apartment, "snippet": snippet, "video": video}[wanted]()
