"""Floor plans by name or file: the maps of scenarios, controllers and datamodules."""

import re
from difflib import get_close_matches
from pathlib import Path

from pedzoo.core.errors import UserError
from pedzoo.maps.files.read import read_plan
from pedzoo.maps.from_rectangles import rectangles, room, wall
from pedzoo.maps.grid import OccupancyGrid

FILES = (".yaml", ".yml", ".png", ".pgm", ".jpg", ".jpeg")
"""Endings of map files."""

_DRAWN = re.compile(r"(?P<kind>[a-z_]+)\.(?P<seed>\d{1,18})(?P<bare>\.bare)?")


def load_plan(name: str | Path) -> OccupancyGrid:
    """Return the floor plan of a name or a file.

    Args:
        name: ``flat``; a kind of `pedzoo.maps.procedural` and a seed, ``apartment.7`` or ``office.7``, with
            ``.bare`` behind it without furniture; or a file, as `pedzoo.maps.files.read.read_plan` takes it.

    Raises:
        UserError: There is no such plan; or the file is missing or broken.
    """
    text = str(name)
    if Path(text).suffix.lower() in FILES:
        return read_plan(text)
    if text == "flat":
        return flat()
    from pedzoo.maps.procedural.plan import KINDS, generate

    if (drawn := _DRAWN.fullmatch(text)) and drawn["kind"] in KINDS:
        return generate(drawn["kind"], int(drawn["seed"]), furnished=0.0 if drawn["bare"] else 1.0).grid
    if "/" in text or "\\" in text or Path(text).exists():
        return read_plan(text)  # which says what files it takes
    kind, _, rest = text.partition(".")
    near = get_close_matches(kind, ["flat", *KINDS], n=1)
    seed = rest if re.fullmatch(r"\d{1,18}(\.bare)?", rest) else "7"
    hint = f"did you mean '{near[0] if near[0] == 'flat' else f'{near[0]}.{seed}'}'? " if near else ""
    known = ", ".join(["flat", *(f"{kind}.SEED" for kind in KINDS)])
    raise UserError(
        f"unknown floor plan {text!r}: {hint}known: {known} (SEED.bare without furniture), and files: a ROS "
        "map yaml or an image"
    )


def flat() -> OccupancyGrid:
    """Return four rooms of about 4.5 x 3.5 m along a corridor of 1.8 m: a floor plan that needs no file."""
    walls = room((0.0, 0.0), (9.1, 9.0), 0.1)
    for y in (3.65, 5.55):
        walls += wall((0.0, y), (9.1, y), 0.1, doors=[(2.25, 0.9), (6.85, 0.9)])
    for low, high in ((0.0, 3.6), (5.6, 9.0)):
        walls += wall((4.55, low), (4.55, high), 0.1)
    return rectangles(walls, 0.05, name="flat")
