"""Apartments: a hall, and four to seven rooms around it."""

from pedzoo.maps.procedural.portable_random import PortableRandom
from pedzoo.maps.procedural.shapes import WALL, Rect, Room, units

SIDES = (7.0, 16.0)
"""Metres: sides that an apartment may have."""

FEWEST, MOST = 4, 7
"""Rooms besides the hall."""

_NARROW = units(2.0)
"""A side that every room has at least."""

_LONGEST = 2.6
"""Longer side of a room by its shorter one, at most."""


def draw_size(dice: PortableRandom) -> tuple[float, float]:
    """Return the outer width and height in metres."""
    width = dice.uniform(8.0, 14.0)
    return width, dice.uniform(8.0, min(14.0, 150.0 / width))


def draw_rooms(dice: PortableRandom, inside: Rect) -> list[Room] | None:
    """Return the hall and the rooms inside the outer walls, the longer side along x; None for a bad draw.

    The hall runs along the middle, and it may end at a room that is as deep as the apartment, or bend. What
    is left is split again and again, the largest room first.
    """
    hall, rooms = _hall(dice, inside)
    area = inside.area
    wanted = min(max(round(area / dice.uniform(13.0, 22.0)), FEWEST), MOST)
    while len(rooms) < wanted:
        rooms.sort(key=lambda room: room.area * (1 + max(room.long / room.short - 1.5, 0)))
        halves = _split(dice, rooms.pop())
        if halves is None:
            return None
        rooms += halves
    if len(rooms) > MOST or any(room.long > _LONGEST * room.short or room.short < _NARROW for room in rooms):
        return None
    return [Room("hall", hall), *_uses(dice, rooms)]


def _hall(dice: PortableRandom, inside: Rect) -> tuple[tuple[Rect, ...], list[Rect]]:
    """Return the hall's parts and the remaining inside."""
    x0, _, x1, _ = inside
    width = dice.integer(units(1.2), units(1.7))
    room = inside.height - width - 2 * WALL
    low = inside.y0 + max(_NARROW + units(0.4), round(room * dice.uniform(0.36, 0.64)))
    low = min(low, inside.y1 - width - 2 * WALL - _NARROW - units(0.4))
    below, above = inside.cut(1, low)
    hall, above = above.cut(1, low + WALL + width)
    form = dice.choice(("end", "end", "bend", "through"))
    if form == "end":
        end = x1 - dice.integer(units(3.2), min(units(4.8), inside.width - units(4.0)))
        return (
            (hall._replace(x1=end - WALL),),
            [part._replace(x1=end - WALL) for part in (below, above)] + [inside._replace(x0=end)],
        )
    if form == "bend":
        turn = x0 + round(inside.width * dice.uniform(0.4, 0.6))
        end = turn + width
        return (
            (hall._replace(x1=end), hall._replace(x0=turn, x1=end, y1=inside.y1)),
            [
                below,
                above._replace(x1=turn - WALL),
                Rect(end + WALL, hall.y0, x1, inside.y1),
            ],
        )
    return (hall,), [below, above]


def _split(dice: PortableRandom, room: Rect) -> tuple[Rect, Rect] | None:
    """Return two rooms of unequal size made of one, None where it is too small."""
    across = 0 if room.width >= room.height else 1
    if room.long < 1.25 * room.short and dice.chance(0.5):
        across = 1 - across
    for axis in (across, 1 - across):
        begin, length = room[axis], (room.width, room.height)[axis]
        if length >= 2 * _NARROW + WALL:
            at = round(length * dice.choice((dice.uniform(0.3, 0.45), dice.uniform(0.55, 0.7))))
            return room.cut(axis, begin + min(max(at, _NARROW), length - WALL - _NARROW))
    return None


def _uses(dice: PortableRandom, rooms: list[Rect]) -> list[Room]:
    """Return the use of each room: the largest to live in, the smallest a bathroom."""
    rooms = sorted(rooms, key=lambda room: room.area)
    uses = ["bathroom", "kitchen", *["bedroom"] * (len(rooms) - 3), "living"]
    if len(rooms) > 5:
        uses[1:3] = [dice.choice(("bathroom", "storage", "study")), "kitchen"]
    return [Room(use, (room,)) for use, room in zip(uses, rooms, strict=True)]
