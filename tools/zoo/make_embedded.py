"""Makes the embedded dataset: synthetic people on a synthetic plaza, the same bytes on every machine.

Run ``python tools/zoo/make_embedded.py [FOLDER]``; it takes some seconds and needs numpy only. People arrive
at random at the gates, alone or in small groups, walk at the speed they like to another gate, stop now and
then, and avoid each other by looking ahead to where they would come closest. See ``plaza.py`` for why
nothing here calls `exp` or `sin`.
"""

import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from plaza import CLEARANCE, GATE_WEIGHTS, GATES, HIGH, LOW, STOPS, Roads, norm, right, visible, wall, write

STEP, SUBSTEPS = 0.4, 8
DT = STEP / SUBSTEPS
SPLITS = {"train": (1, 360), "val": (2, 80), "test": (3, 80)}  # seed, people
MOST_PEOPLE = 20
RELAX, TURN = 0.5, 0.6  # s; how quickly a person takes the velocity they want, and turns to the next bend
HORIZON, ELBOW, AVOID = 3.5, 0.9, 1.8  # s looked ahead, m kept when passing, m/s^2 at most for it
WOBBLE_TIME, WOBBLE_SIDE, WOBBLE_SPEED = 1.6, 0.08, 0.08  # s, m/s, share of the own speed


@dataclass
class Party:
    """People who walk together, and how long they stand where they stop."""

    wait: float
    abreast: np.ndarray  # unit vector along which they stand side by side
    leave_at: float = -1.0


@dataclass
class Way:
    """The points that one person still has to walk through."""

    points: list[np.ndarray]
    stop: int  # index of the point where they stand a while; -1: none ahead


class Crowd:
    """The people now on the plaza, one row each."""

    def __init__(self) -> None:
        """Nobody is there."""
        self.agent = self.party = np.zeros(0, int)
        self.slot = self.speed = np.zeros(0)  # place to the right of the party's middle, m
        self.here = self.velocity = self.course = np.zeros((0, 2))  # the last: the smooth heading
        self.seen = np.zeros(0, bool)  # they have entered the picture
        self.wobble = np.zeros((0, 4))  # side, speed, and what drives them

    def keep(self, rows: np.ndarray) -> None:
        """Drops all other people."""
        for name, value in vars(self).items():
            setattr(self, name, value[rows])

    def add(self, **row: object) -> None:
        """Lets one person in."""
        for name, value in row.items():
            setattr(self, name, np.concatenate([getattr(self, name), np.array([value])]))


class Plaza:
    """One recording in the making."""

    def __init__(self, seed: int, people: int) -> None:
        """Starts empty, until ``people`` have come and gone."""
        self.random = np.random.Generator(np.random.PCG64(seed))
        self.people, self.arrived, self.time = people, 0, 0.0
        self.roads, self.crowd = Roads(), Crowd()
        self.parties: list[Party] = []
        self.paths: list[Way] = []  # by agent

    def gauss(self, *shape: int) -> np.ndarray:
        """About normal: 12 uniform draws added (numpy may change the stream of `normal`, never this one)."""
        return self.random.random((12, *shape)).sum(axis=0) - 6.0

    def pick(self, weights: list[float]) -> int:
        """An index, as often as its weight says."""
        total = np.cumsum(np.array(weights, float))
        return int((self.random.random() * total[-1] >= total).sum())

    def arrive(self) -> None:
        """Lets a party in, now and then: quiet and busy minutes take turns."""
        phase = (self.time / 140.0) % 1.0
        rate = 0.10 + 0.56 * (1.0 - abs(2.0 * phase - 1.0))
        if self.arrived >= self.people or self.random.random() >= rate * STEP:
            return
        size = min(1 + self.pick([0.70, 0.22, 0.08]), self.people - self.arrived)
        names = list(GATES)
        gate = names[self.pick([GATE_WEIGHTS[n] for n in names])]
        exit_gate = names[self.pick([GATE_WEIGHTS[n] * (n != gate) for n in names])]
        share, exit_share = 0.15 + 0.7 * self.random.random(2)
        (a, b), (c, d) = np.array(GATES[gate]), np.array(GATES[exit_gate])
        start, end = a + share * (b - a), c + exit_share * (d - c)
        stop, wait = -1, 3.0 + 9.0 * self.random.random()
        if self.random.random() < 0.08:
            place = STOPS[self.pick([1.0] * len(STOPS))] + 0.7 * (self.random.random(2) - 0.5)
            route = self.roads.route(start, place)
            stop = len(route) - 1
            route = route + self.roads.route(place, end)
        else:
            route = self.roads.route(start, end)
        # People do not turn exactly at the corner: bends are pushed away from the wall by up to 0.6 m.
        for k in range(len(route) - 1):
            moved = route[k] + 0.6 * self.random.random() * wall(route[k][None])[1][0]
            before = route[k - 1] if k else start
            if k != stop and visible(before, moved) and visible(moved, route[k + 1]):
                route[k] = moved
        speed = float(np.clip(1.3 + 0.2 * self.gauss(), 0.75, 1.85)) * (1.0, 0.95, 0.9)[size - 1]
        heading = (route[0] - start) / norm(route[0] - start)
        slots = 0.65 * (np.arange(size) - (size - 1) / 2)
        places = start + slots[:, None] * right(heading) - 0.25 * self.random.random((size, 1)) * heading
        if (wall(places)[0] < 0.2).any() or len(self.crowd.agent) + size > MOST_PEOPLE:
            return  # too many for the door, or for the plaza
        if (norm(places[:, None] - self.crowd.here[None]) < 0.9).any():
            return
        for place, slot in zip(places, slots, strict=True):
            pace = speed * (1.0 + 0.02 * self.gauss())
            self.crowd.add(agent=self.arrived, party=len(self.parties), slot=slot, speed=pace)
            self.crowd.add(here=place, velocity=0.95 * pace * heading, course=heading, seen=False)
            self.crowd.add(wobble=self.gauss(4))
            self.paths.append(Way(list(route), stop))
            self.arrived += 1
        before = route[stop - 1] if stop > 0 else start
        facing = route[max(stop, 0)] - before
        self.parties.append(Party(wait, right(facing / norm(facing))))

    def look(self) -> None:
        """Every person picks the point to walk to: the next of the route as soon as it is in sight."""
        check = int(self.time / STEP) % 4 == 0
        for agent, number, here in zip(self.crowd.agent, self.crowd.party, self.crowd.here, strict=True):
            way, party = self.paths[agent], self.parties[number]
            near = float(norm(way.points[0] - here)[0])
            if way.stop == 0:
                if near < 0.9 and party.leave_at < 0:
                    party.leave_at = self.time + party.wait
                done = 0 <= party.leave_at < self.time
            elif len(way.points) > 1:
                done = visible(here, way.points[1], CLEARANCE if near > 0.8 else 0.1)
            else:
                done = False
            if done:
                way.points, way.stop = way.points[1:], way.stop - 1
            elif check and not visible(here, way.points[0], 0.05):  # pushed out of sight of it
                last = way.stop if way.stop >= 0 else len(way.points) - 1
                around = self.roads.route(here, way.points[last])
                way.points = around + way.points[last + 1 :]
                way.stop = len(around) - 1 if way.stop >= 0 else -1

    def walk(self) -> None:
        """Moves every person by one sub-step."""
        c, n = self.crowd, len(self.crowd.agent)
        stopping = np.array([self.paths[a].stop == 0 for a in c.agent])
        ahead = np.array([self.paths[a].points[0] for a in c.agent]) - c.here
        ahead += (stopping * c.slot)[:, None] * np.array([self.parties[p].abreast for p in c.party])
        left = norm(ahead)[:, 0]
        c.course += DT / TURN * (ahead / left[:, None] - c.course)
        heading = c.course / norm(c.course)
        pace = np.where(stopping, np.minimum(c.speed, 0.7 * left), c.speed)
        standing = stopping & (left < 0.9)
        gap, away = wall(c.here)

        # Wobble: noise filtered twice, so that not even the acceleration is rough.
        rate = DT / WOBBLE_TIME
        c.wobble[:, 2:] += np.sqrt(2 * rate) * self.gauss(n, 2) - rate * c.wobble[:, 2:]
        c.wobble[:, :2] += 2 * rate * (c.wobble[:, 2:] - c.wobble[:, :2])
        calm = np.where(standing, 0.1, 1.0)
        side, faster = calm * WOBBLE_SIDE * c.wobble[:, 0], WOBBLE_SPEED * c.wobble[:, 1]
        pace = pace * (1.0 + np.clip(faster, -0.6, 0.4))
        wanted = pace[:, None] * c.course + side[:, None] * right(heading)

        # Groups walk abreast where there is room, one behind the other where there is not.
        together = c.party[:, None] == c.party[None]
        size = together.sum(axis=0)
        middle = np.stack([(together * c.here[:, k : k + 1]).sum(axis=0) / size for k in (0, 1)], -1)
        course = np.stack([(together * heading[:, k : k + 1]).sum(axis=0) / size for k in (0, 1)], -1)
        room = np.clip((gap - 0.3) / 0.7, 0.2, 1.0) * c.slot
        pull = middle + room[:, None] * right(course / norm(course)) - c.here
        pull = pull * np.minimum(0.6, 0.4 / norm(pull))
        wanted += np.where((size > 1) & ~standing, 1.0, 0.0)[:, None] * pull

        force = (wanted - c.velocity) / RELAX + self.avoid(heading, together, standing)
        force += np.clip(0.55 - gap, 0.0, 0.5)[:, None] * 5.0 * away
        force *= np.minimum(1.0, 3.5 / norm(force))
        c.velocity = c.velocity + DT * force
        c.velocity *= np.minimum(1.0, 1.3 * c.speed[:, None] / norm(c.velocity))
        # Walls stop people: they slide along at 0.2 m.
        into = np.minimum(0.0, (c.velocity * away)[:, :1] + (c.velocity * away)[:, 1:])
        touching = (gap < 0.2)[:, None]
        c.velocity = np.where(touching, c.velocity - into * away, c.velocity)
        c.here = c.here + DT * c.velocity + np.clip(0.2 - gap, 0.0, 0.05)[:, None] * away

    def avoid(self, heading: np.ndarray, together: np.ndarray, standing: np.ndarray) -> np.ndarray:
        """Accelerations that keep people apart; first axis the other person, second the one who reacts."""
        c = self.crowd
        offset, drift = c.here[:, None] - c.here[None], c.velocity[:, None] - c.velocity[None]
        closing = -(offset * drift)[..., 0] - (offset * drift)[..., 1]
        speed2 = drift[..., 0] * drift[..., 0] + drift[..., 1] * drift[..., 1]
        when = np.clip(closing / (speed2 + 1e-3), 0.0, HORIZON)
        # Pretending that the other passes a little to the left makes people who meet head-on keep right.
        nearest = offset + when[..., None] * drift - 0.12 * right(heading)[None]
        miss = norm(nearest)
        ahead = (offset * heading[None])[..., 0] + (offset * heading[None])[..., 1] > 0
        urge = AVOID * np.clip(1.0 - miss[..., 0] / ELBOW, 0.0, 1.0) * (1.0 - when / HORIZON) * (closing > 0)
        urge *= np.where(ahead, 1.0, 0.2) * ~together * np.where(standing, 0.15, 1.0)
        apart = norm(offset)
        reach = np.where(together, 0.55, 0.7)
        shove = 7.0 * np.clip(reach - apart[..., 0], 0.0, 0.5) * (c.agent[:, None] != c.agent[None])
        return -(urge[..., None] * nearest / miss + shove[..., None] * offset / apart).sum(axis=0)

    def record(self) -> str:
        """Runs until the last person has left and returns the recording as CSV."""
        lines = ["frame,agent,x,y"]
        frame = 0
        while self.arrived < self.people or len(self.crowd.agent):
            self.arrive()
            crowd = self.crowd
            inside = ((crowd.here > LOW) & (crowd.here < HIGH)).all(axis=1)
            crowd.seen |= inside
            for agent, (x, y) in zip(crowd.agent[inside], crowd.here[inside], strict=True):
                lines.append(f"{frame},{agent},{x + 0.0:.3f},{y + 0.0:.3f}")
            if len(crowd.agent):
                self.look()
                for _ in range(SUBSTEPS):
                    self.walk()
                outside = ~((crowd.here > LOW) & (crowd.here < HIGH)).all(axis=1)
                paths = [self.paths[a] for a in crowd.agent]
                left = norm(np.array([way.points[-1] for way in paths]) - crowd.here)[:, 0]
                arrived = np.array([len(way.points) == 1 for way in paths]) & (left < 0.45)
                crowd.keep(~(crowd.seen & (outside | arrived)))
            frame += 1
            self.time += STEP
            if frame > 20000:
                raise RuntimeError(f"{len(crowd.agent)} people are stuck at {crowd.here.tolist()}")
        return "\n".join(lines) + "\n"


def main(folder: Path) -> None:
    """Writes the recordings and the floor plan."""
    folder.mkdir(parents=True, exist_ok=True)
    for split, (seed, people) in SPLITS.items():
        # newline="" keeps the bytes the same on Windows.
        (folder / f"plaza_{split}.csv").write_text(Plaza(seed, people).record(), newline="")
    write(folder)


if __name__ == "__main__":
    home = Path(__file__).resolve().parents[2] / "pedzoo" / "data" / "embedded"
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else home)
