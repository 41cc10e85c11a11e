"""The floor plan of the embedded dataset: walls, gates, routes between them, and the picture of it all.

Everything is axis-aligned boxes and one disc, so that distances are exact and the picture (0.1 m cells) is
too. Only ``+ - * / sqrt`` are used on purpose: those are the same to the last bit on every machine, `exp` and
`sin` are not, and the committed recordings must come out of the script byte for byte.
"""

import heapq
import struct
import zlib
from pathlib import Path

import numpy as np

RESOLUTION = 0.1
LOW, HIGH = np.array([-12.0, -8.0]), np.array([12.0, 8.0])
CLEARANCE = 0.4

YAML = f"""image: plaza.png
resolution: {RESOLUTION}
origin: [{LOW[0]}, {LOW[1]}, 0.0]
negate: 0
occupied_thresh: 0.65
free_thresh: 0.196
"""

# (x0, y0, x1, y1) in metres. The yard on the right is reached through the gap at x = 8: 1.5 m wide.
BOXES = np.array(
    [
        [-13.0, 6.8, -8.7, 9.0],  # north-west building, left of its door
        [-8.7, 7.7, -7.5, 9.0],  # back of the doorway
        [-7.5, 6.8, -2.6, 9.0],  # north-west building, right of its door
        [3.0, 7.2, 8.4, 9.0],  # north building
        [-5.2, -9.0, 1.6, -7.0],  # south building
        [6.6, -9.0, 8.4, -6.4],  # south-east building
        [8.0, -9.0, 8.4, -0.8],  # wall below the gap
        [8.0, 0.7, 8.4, 9.0],  # wall above the gap
        [11.0, 5.0, 13.0, 9.0],  # north-east house
        [10.6, -9.0, 13.0, -4.6],  # south-east house
        [3.2, 2.2, 5.4, 4.0],  # kiosk
        [0.8, -3.4, 3.6, -2.6],  # planter
        [-9.4, -3.8, -8.2, -2.2],  # planter
    ]
)
FOUNTAIN, FOUNTAIN_RADIUS = np.array([-3.0, 0.4]), 1.7

# Name: the two ends of the line at which people appear and disappear.
GATES = {
    "west": ((-12.2, -2.5), (-12.2, 5.4)),
    "south_west": ((-10.6, -8.2), (-6.2, -8.2)),
    "north": ((-1.6, 8.2), (2.2, 8.2)),
    "south": ((2.6, -8.2), (5.8, -8.2)),
    "east": ((12.2, -3.0), (12.2, 2.8)),
    "yard": ((9.2, 8.2), (10.2, 8.2)),
    "door": ((-8.15, 7.1), (-8.05, 7.1)),
}
GATE_WEIGHTS = {"west": 5, "south_west": 3, "north": 4, "south": 3, "east": 3, "yard": 0.15, "door": 0.7}
# Where people stop for a while: at the kiosk, on the rim of the fountain, at a planter, under the north wall.
STOPS = np.array([[2.4, 3.1], [4.2, 1.3], [-3.4, 3.0], [-1.6, -1.9], [-7.3, -3.0], [4.4, 6.0], [-4.6, 5.5]])


def norm(vectors: np.ndarray) -> np.ndarray:
    """Lengths of (..., 2) vectors, kept as a last axis of one, never zero."""
    return np.sqrt(vectors[..., :1] * vectors[..., :1] + vectors[..., 1:] * vectors[..., 1:]) + 1e-9


def right(vectors: np.ndarray) -> np.ndarray:
    """Vectors turned by 90 degrees to the right."""
    return np.stack([vectors[..., 1], -vectors[..., 0]], -1)


def wall(points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the signed distance of points (N, 2) to the nearest wall and the direction away from it."""
    centred = points[None] - (BOXES[:, None, :2] + BOXES[:, None, 2:]) / 2
    beyond = np.abs(centred) - (BOXES[:, None, 2:] - BOXES[:, None, :2]) / 2
    out = np.maximum(beyond, 0.0)
    gap = np.sqrt(out[..., 0] * out[..., 0] + out[..., 1] * out[..., 1])
    gap += np.minimum(np.maximum(beyond[..., 0], beyond[..., 1]), 0.0)
    best = gap.argmin(axis=0)
    rows = np.arange(len(points))
    gap, centred, beyond, out = (values[best, rows] for values in (gap, centred, beyond, out))
    # Inside a box the way out is through its nearest side.
    side = np.where(beyond[:, :1] > beyond[:, 1:], [1.0, 0.0], [0.0, 1.0])
    away = np.where(centred < 0, -1.0, 1.0) * np.where(gap[:, None] > 0, out, side)
    away = away / np.where(gap > 1e-9, gap, 1.0)[:, None]
    spoke = points - FOUNTAIN
    radius = np.sqrt(spoke[:, 0] * spoke[:, 0] + spoke[:, 1] * spoke[:, 1])
    closer = radius - FOUNTAIN_RADIUS < gap
    away = np.where(closer[:, None], spoke / np.maximum(radius, 1e-9)[:, None], away)
    return np.where(closer, radius - FOUNTAIN_RADIUS, gap), away


def visible(start: np.ndarray, end: np.ndarray, clearance: float = CLEARANCE) -> bool:
    """Whether the straight line keeps ``clearance`` from every wall; half a metre may go along one."""
    delta = end - start
    length = float(norm(delta)[0])
    count = int(length / 0.2) + 2
    share = np.arange(count) / (count - 1)
    needed = np.where(share * length < 0.5, 0.02, clearance)
    return bool((wall(start + share[:, None] * delta)[0] >= needed).all())


def _corners() -> np.ndarray:
    """Return the points that routes may bend at: near corners, around the fountain, at gap and door."""
    out, diagonal = 0.75, 0.7071 * (FOUNTAIN_RADIUS + 0.9)
    points = [[7.4, -0.05], [9.0, -0.05], [-8.1, 6.1]]
    for x0, y0, x1, y1 in BOXES:
        points += [[x0 - out, y0 - out], [x1 + out, y0 - out], [x0 - out, y1 + out], [x1 + out, y1 + out]]
    for x, y in ((1, 1), (1, -1), (-1, 1), (-1, -1)):
        points.append([FOUNTAIN[0] + x * diagonal, FOUNTAIN[1] + y * diagonal])
    for x, y in ((1, 0), (-1, 0), (0, 1), (0, -1)):
        points.append([FOUNTAIN[0] + x * diagonal * 1.4142, FOUNTAIN[1] + y * diagonal * 1.4142])
    points = np.array(points)
    fits = (wall(points)[0] > 0.6) & (points > LOW).all(1) & (points < HIGH).all(1)
    return points[fits]


class Roads:
    """Shortest routes between any two points of the plaza, bending at obstacle corners."""

    def __init__(self) -> None:
        """Finds which bends see each other."""
        self.bends = _corners()
        self.links = [
            [j for j in range(len(self.bends)) if j != i and visible(self.bends[i], self.bends[j])]
            for i in range(len(self.bends))
        ]

    def route(self, start: np.ndarray, end: np.ndarray) -> list[np.ndarray]:
        """Returns the points to walk through, the end included, the start not.

        Raises:
            ValueError: If no route exists, which means that the floor plan was edited into pieces.
        """
        if visible(start, end):
            return [end]
        last = [j for j, bend in enumerate(self.bends) if visible(bend, end)]
        first = [j for j, bend in enumerate(self.bends) if visible(start, bend)]
        queue: list[tuple[float, int, tuple[int, ...]]] = [
            (float(norm(self.bends[j] - start)[0]), j, (j,)) for j in first
        ]
        heapq.heapify(queue)
        done: set[int] = set()
        while queue:
            cost, node, path = heapq.heappop(queue)
            if node == -1:
                return [self.bends[j] for j in path[:-1]] + [end]
            if node in done:
                continue
            done.add(node)
            if node in last:
                heapq.heappush(queue, (cost + float(norm(end - self.bends[node])[0]), -1, (*path, -1)))
            for j in self.links[node]:
                heapq.heappush(
                    queue, (cost + float(norm(self.bends[j] - self.bends[node])[0]), j, (*path, j))
                )
        raise ValueError(f"no route from {start} to {end}")


def write(folder: Path) -> None:
    """Writes the floor plan: an 8-bit grey PNG, 0 occupied, 254 free, top row first (ROS map_server form).

    Stored, not compressed: what a compressor returns differs between versions of zlib.
    """
    width, height = (int(n) for n in np.rint((HIGH - LOW) / RESOLUTION))
    x = LOW[0] + (np.arange(width) + 0.5) * RESOLUTION
    y = HIGH[1] - (np.arange(height) + 0.5) * RESOLUTION
    cells = np.stack(np.meshgrid(x, y), -1).reshape(-1, 2)
    image = np.where(wall(cells)[0] <= 0, 0, 254).astype(np.uint8).reshape(height, width)
    raw = np.concatenate([np.zeros((height, 1), np.uint8), image], 1).tobytes()
    if len(raw) > 65535:
        raise ValueError("one stored deflate block holds 65535 bytes: make the map smaller")
    stored = b"\x78\x01\x01" + struct.pack("<HH", len(raw), 65535 - len(raw)) + raw
    data = stored + struct.pack(">I", zlib.adler32(raw))
    header = struct.pack(">IIBBBBB", width, height, 8, 0, 0, 0, 0)
    chunks = ((b"IHDR", header), (b"IDAT", data), (b"IEND", b""))
    content = b"".join(
        struct.pack(">I", len(body)) + name + body + struct.pack(">I", zlib.crc32(name + body))
        for name, body in chunks
    )
    (folder / "plaza.png").write_bytes(b"\x89PNG\r\n\x1a\n" + content)
    (folder / "plaza.yaml").write_text(YAML, newline="")  # the bytes are the same on Windows
