"""Experiment 3: two people, one narrow door. Makes checkpoints/DOOR.md.

    python tools/door_experiment.py

What ORCA does there with iGibson's constants, told apart into geometry (does a lone person fit?) and
avoidance (walls unseen), how the arcs of a small radius look in numbers, and what forecasters do that were
never trained in the loop, and where they fail.
"""

from __future__ import annotations

import argparse
import math
from pathlib import Path

import torch
from page import median, percent, share
from torch import Tensor

from pedzoo.eval.results import markdown_table
from pedzoo.eval.rollout import rollout
from pedzoo.metrics.door import passing_seconds, yield_delay
from pedzoo.metrics.navigation import episode_seconds, finish_seconds, success
from pedzoo.metrics.rollout import Rollout
from pedzoo.paths import shipped, write_whole
from pedzoo.versions import versions

IGIBSON = "speed=0.5,speed_std=0,jitter=0"
RADII = (0.5, 0.3, 0.2, 0.1)
MODELS = ("sgan.zara1", "sgan_goal.zara1", "sgan_goal_map.zara1")


def main() -> None:
    """Walk everything and write the page."""
    raw = argparse.RawDescriptionHelpFormatter
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=raw)
    parser.add_argument("--seeds", type=int, default=10, help="runs per case of ORCA")
    parser.add_argument("--episodes", type=int, default=200, help="episodes per policy of the varied door")
    parser.add_argument("--out", default=str(shipped("checkpoints") / "DOOR.md"))
    options = parser.parse_args()
    parts = [
        "# The narrow door (experiment 3)\n",
        "Made by `python tools/door_experiment.py` in `BulletWorld`"
        f" (torch {versions()['torch']}). Door 0.85 m wide, wall 0.15 m thick; people start at"
        " 2.5 m from the wall after the warm start; the goal is 3 m behind it.\n",
        geometry(),
        avoidance(options.seeds),
        arcs(options.seeds),
        learned(options.episodes),
    ]
    text = "\n".join(parts)
    print(text)
    write_whole(Path(options.out), text.encode())


def walked(policy: str, scenario: str, episodes: int) -> Rollout:
    """Return episodes of the door in pybullet."""
    result, env = rollout(policy, f"door:{scenario}", "bullet", episodes)
    env.world.close()
    return result


def arrived(result: Rollout) -> Tensor:
    """Return who reached the goal in time (E, A)."""
    return success(result.reached, result.goals, result.late, result.failed, result.mask)


def geometry() -> str:
    """A lone person: what the walls alone forbid."""
    rows = []
    for radius in RADII:
        policy = f"orca:preset=igibson,radius={radius},jitter=0"
        seen = walked(policy, f"{IGIBSON},people=1,offset=0", 1)
        unseen = walked(f"{policy},walls=false", f"{IGIBSON},people=1,offset=0", 1)
        rows.append([f"{radius}", *(passed(arrived(one)) for one in (seen, unseen))])
    head = "## Geometry: a lone person, ORCA with iGibson's constants (0.5 m/s, 0.1 s)\n"
    note = (
        "\nWith walls a disk of radius 0.5 m does not fit through 0.85 m: no avoidance is involved."
        " iGibson's own ORCA never sees walls.\n"
    )
    return head + markdown_table(["radius", "walls seen", "walls unseen"], rows) + note


def avoidance(seeds: int) -> str:
    """Two people: blocked or not, with and without jitter."""
    rows = []
    for radius in RADII:
        for walls in ("false", "true"):
            cells = []
            for offset in (0.0, 0.6):
                for jitter, runs in ((0.0, 1), (0.02, seeds)):
                    policy = f"orca:preset=igibson,radius={radius},walls={walls},jitter={jitter}"
                    result = walked(policy, f"{IGIBSON},offset={offset}", runs)
                    both = arrived(result).all(1)
                    seconds = finish_seconds(result.reached, result.goals).amax(1)[both]
                    time = f" @ {float(seconds.median()):.1f} s" if len(seconds) else ""
                    closest = f", stand {least(result):.2f} m apart" if not len(seconds) else ""
                    cells.append(f"{int(both.sum())}/{runs}{time}{closest}")
            rows.append([f"{radius}", "seen" if walls == "true" else "unseen", *cells])
    head = f"## Avoidance: two people, ORCA with iGibson's constants, {seeds} seeds of jitter (0.02 m/s)\n"
    names = ["radius", "walls", "head-on", "head-on, jitter", "offset 0.6 m", "offset 0.6 m, jitter"]
    note = (
        "\nRuns in which both reach their goals, and the median time. Where walls are unseen, what blocks two"
        " people is their mutual avoidance alone.\n"
    )
    return head + markdown_table(names, rows) + note


def arcs(seeds: int) -> str:
    """The circular pattern of a small radius, in numbers."""
    rows = []
    for offset in (0.0, 0.02, 0.1, 0.6):
        for jitter, runs in ((0.0, 1), (0.02, seeds)):
            policy = f"orca:preset=igibson,radius=0.1,walls=false,jitter={jitter}"
            result = walked(policy, f"{IGIBSON},offset={offset}", runs)
            measured = [arc(result, episode) for episode in range(runs)]
            asymmetry, radius, sweep = (torch.tensor(values) for values in zip(*measured, strict=True))
            rows.append(
                [
                    f"{offset:g} m",
                    f"{jitter:g} m/s",
                    f"{int(arrived(result).all(1).sum())}/{runs}",
                    f"{float(asymmetry.max()):.1e} m",
                    spread(radius, "{:.3f}") + " m",
                    spread(sweep, "{:.0f}") + " degrees",
                ]
            )
    head = "## Arcs: radius 0.1 m, walls unseen\n"
    names = ["offset", "jitter", "both pass", "largest p1 + p2", "half the least distance", "bearing sweep"]
    note = (
        "\nThe door's centre is the origin: p1 + p2 = 0 is a perfect point symmetry, nobody yields. The sweep"
        " is how far the bearing of the other turns while the two are within 0.6 m. Exactly head-on and"
        " without jitter nothing breaks the tie: two disks of any radius stop in front of each other.\n"
    )
    return head + markdown_table(names, rows) + note


def arc(result: Rollout, episode: int) -> tuple[float, float, float]:
    """Return asymmetry (m), half the least distance (m) and bearing sweep (degrees) of two people."""
    both = result.present[episode].all(0)
    first, second = result.trace[episode, :, both]
    apart = second - first
    bearing = torch.atan2(apart[:, 1], apart[:, 0])[apart.norm(dim=-1) < 0.6]
    turned = torch.atan2(bearing.diff().sin(), bearing.diff().cos()).sum().abs()
    asymmetry = (first + second).norm(dim=-1).max()
    return float(asymmetry), float(apart.norm(dim=-1).min()) / 2, float(torch.rad2deg(turned))


def spread(values: Tensor, form: str) -> str:
    """Return a value, or the least and the largest of several."""
    ends = [form.format(float(value)) for value in (values.min(), values.max())]
    return ends[0] if ends[0] == ends[1] else " to ".join(ends)


def learned(episodes: int) -> str:
    """What forecasters do in the loop, beside the baselines, and where it goes wrong."""
    rows, failures = [], []
    baselines = [*(f"orca:radius={radius}" for radius in (0.2, 0.3, 0.5)), "go_to_goal", "constant_velocity"]
    for policy in [*baselines, *MODELS]:
        result = walked(policy, "people=2", episodes)
        good = arrived(result)
        agent, wall = (part.any(2).any(1) for part in (result.agent_contact, result.wall_contact))
        seconds = episode_seconds(finish_seconds(result.reached, result.goals), good, result.mask)
        seconds = seconds[seconds.isfinite()]
        time = f"{float(seconds.median()):.1f}" if len(seconds) else "-"
        clean = good.all(1) & ~agent & ~wall
        rows.append([policy, share(good), share(agent), share(wall), share(clean), time])
        failures.append([policy, *analysis(result, agent, wall)])
    head = f"## The varied door, {episodes} episodes: speeds N(1.3, 0.2) m/s, offset 0.6 m, starts jittered\n"
    names = ["policy", "people who arrive", "episodes: people touch", "episodes: a wall is touched"]
    names += ["both arrive, nothing touched", "median time, s"]
    text = head + markdown_table(names, rows)
    text += "\n### How they fail\n"
    names = ["policy", "people first touch: m from the door", "walls touched at the jambs", "elsewhere"]
    names += ["least speed within 2 m", "yield delay, s", "miss the goal first", "stand still at the end"]
    return text + markdown_table(names, failures) + NOTE


NOTE = """
* *people first touch*: median distance of the two people's middle from the door's
  centre at their first contact.
* *walls touched at the jambs / elsewhere*: share of all 0.1 s with a wall contact within 0.6 m of the
  door's centre, and farther away.
* *least speed within 2 m*: median over people of their least speed within 2 m of the door's centre, divided
  by the speed they like: 1 means that nobody slows down for anybody.
* *yield delay*: median time between the two crossing the wall's line, where both do.
* *miss the goal first*: share of people who come within 1 m of the goal and need more than 3 s from there.
* *stand still at the end*: share of people who moved less than 0.1 m in the last 5 s of their episode and
  are not at their goal.

What goes wrong: the forecasters have seen people who had settled their encounters seconds before, and never
their own mistakes.

1. They meet in the doorway, at less than a third of a metre from its centre: they slow down to two thirds or
   three quarters of their speed where one of the two would have to wait.
2. They slide along walls. The floor plan does not help at a narrow door, which outdoor recordings do not
   have: SGAN+goal+map touches walls in more episodes than SGAN+goal, nearly always at the jambs.
3. One in three (with the map one in five) misses the 0.3 m of the goal and comes back in a loop: that is why
   the median time is that much longer than ORCA's.
4. Without a goal, `sgan.zara1` and `constant_velocity` pass the door by chance and then walk into a wall.
"""


def analysis(result: Rollout, agent: Tensor, wall: Tensor) -> list[str]:
    """Return where people touch each other and walls, whether they slow down, and whether they get stuck."""
    centre = result.trace.mean(1).norm(dim=-1)
    first = result.agent_contact.any(1).int().argmax(1)
    where = centre.gather(1, first.unsqueeze(1))[agent, 0]
    away = result.trace.norm(dim=-1)
    at_walls = away[result.wall_contact]
    jamb = float((at_walls < 0.6).double().mean()) if len(at_walls) else math.nan
    moved = result.path.diff(dim=2).norm(dim=-1) / 0.1
    near = result.present & (away < 2.0)
    slowest = torch.where(near, moved, torch.inf).amin(2) / result.pref_speed
    slowest = slowest[slowest.isfinite()]
    assert result.gate is not None
    delay = yield_delay(passing_seconds(result.path, result.scored, result.gate))
    delay = delay[delay.isfinite()]
    close = result.present & ((result.trace - result.goal).norm(dim=-1) < 1.0)
    missed = close.any(2) & (result.present.sum(2) - close.int().argmax(2) > 30)
    late = ~arrived(result)
    last = result.present.sum(2).clamp_min(51) - 1
    end, before = (_at(result.trace, last - back) for back in (0, 50))
    stands = late & ((end - before).norm(dim=-1) < 0.1)
    return [
        median(where),
        percent(jamb),
        percent(1 - jamb),
        median(slowest),
        median(delay),
        share(missed),
        share(stands),
    ]


def _at(trace: Tensor, point: Tensor) -> Tensor:
    """Return everybody's position (E, A, 2) at a trace point (E, A) of their own."""
    return trace.gather(2, point.view(*point.shape, 1, 1).expand(-1, -1, 1, 2))[:, :, 0]


def least(result: Rollout) -> float:
    """Return the least distance of the two people, metres."""
    both = result.present.all(1)
    return float((result.trace[:, 0] - result.trace[:, 1]).norm(dim=-1)[both].min())


def passed(good: Tensor) -> str:
    """Return whether everybody arrived."""
    return "passes" if bool(good.all()) else "blocked"


if __name__ == "__main__":
    main()
