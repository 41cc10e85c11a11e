"""How robots drive, how near they come to people, and what they do to them: ratios of two sums over episodes.

E episodes of N people and R robots, T trace points; point t is the end of the t-th 0.1 s after the warm
start. Positions and paths are in metres, headings in radians. Numbers that count like others' are taken from
where others define them:

* CrowdNav: Chen et al., "Crowd-robot interaction", ICRA 2019; vita-epfl/CrowdNav ``explorer.py``.
* CrowdNav++: Liu et al., "Intention aware robot crowd navigation", ICRA 2023;
  Shuijing725/CrowdNav_Prediction_AttnGraph ``evaluation.py``.
* HuNav: Perez-Higueras et al., "HuNavSim", RA-L 2023; robotics-upo/hunav_sim ``hunav_metrics.py``.
* iGibson: social navigation; ``STL`` and personal space of 0.5 m.

Of HuNav's list these are left out: group intrusions; obstacle forces and social work, which depend on the
simulator's obstacle points; mean angular speed and acceleration with their sign, where left and right cancel
out; its jerk, which is acceleration by time. Its rule of who collided with whom swaps the arguments of
``atan2``: here it is who moves faster towards the other.

The effect on people is against the same scenes and noise without robots, which are taken out after the warm
start.
"""

import math
from collections.abc import Mapping
from typing import NamedTuple

import torch
from torch import Tensor

from pedzoo.core.types import TRACE_SECONDS
from pedzoo.metrics import arrival, contacts, smoothness
from pedzoo.metrics.ratios import Ratio, finite, mean, of_sums, ratio, share
from pedzoo.sim.rollout import RobotRollout, Rollout

STANDS, STANDS_TURN = 0.01, 0.02
"""m/s and rad/s: a robot that is slower in both does not move (HuNav's)."""

SPACES = {"intimate": (-torch.inf, 0.45), "personal": (0.45, 1.2), "social": (1.2, 3.6)}
"""Spaces of proxemics (Hall 1966), metres from the robot's body to people's centres, as in HuNav."""

DISCOMFORT = 0.2
"""Metres between bodies within which people feel uncomfortable (CrowdNav's)."""

FUTURE_STEPS, FUTURE_SECONDS = 5, 0.25
"""How far ahead people's ways are that robots should keep clear of (CrowdNav++'s)."""

SOCIAL_FACTOR, LAMBDA, GAMMA, ANGULAR, VELOCITY = 2.1, 2.0, 0.35, 2.0, 3.0
"""Parameters of the social force (HuNav's): its factor, lambda, gamma, n and n'."""

FROM_REST, LASTS = round(1.0 / TRACE_SECONDS), round(6.0 / TRACE_SECONDS)
"""Trace points in which robots set out, 1 s, which is no answer to people; and pass whom they meet, 6 s."""

ENCOUNTER, YIELDS = 3.0, 0.1
"""Seconds to a collision below which a robot and a person meet; m/s by which who yields changes at least."""

LEGEND: Mapping[str, str] = {
    "success": "share of robots that reach all goals in time, and touch nothing that ends the episode",
    "collision_person": "share of robots that touch a person",
    "collision_robot": "share of robots that touch another robot",
    "collision_wall": "share of robots that touch a wall",
    "timeout": "share of robots whose time is up: max(20 s, 4 x the way's time at top speed)",
    "failed": "share of robots whose episode ends because an action was no number",
    "robot_on_person": "share of robots that touch a person by moving faster towards it than it does",
    "person_on_robot": "share of robots that a person touches so",
    "spl": "success, weighted by the planned way divided by the driven one (Anderson et al. 2018)",
    "stl": "success, weighted by the time of the planned way at top speed by the time taken (iGibson)",
    "time_s": "until the goal, mean of robots that succeed (CrowdNav)",
    "duration_s": "of all episodes, however they end (HuNav)",
    "path_m": "way that robots drive, however the episode ends (CrowdNav++, HuNav)",
    "path_ratio": "way that all robots that succeed drive, divided by the planner's",
    "final_goal_distance_m": "distance to the goal where the episode ends (HuNav)",
    "least_goal_distance_m": "least distance to the goal (HuNav)",
    "standing_s": "time of an episode in which the robot neither drives nor turns (HuNav)",
    "heading_change_rad": "turning left and right, added up over an episode (HuNav)",
    "speed_m_per_s": "mean speed of robots while they are on their way (HuNav)",
    "acceleration_m_per_s2": "mean amount of acceleration, over 0.4 s",
    "jerk_m_per_s3": "mean amount of jerk, over 0.4 s",
    "personal_space": "share of the time in which no person is within 0.5 m, between centres (iGibson)",
    "discomfort": "share of the time in which a person's body is within 0.2 m of the robot's (CrowdNav)",
    "intrusion_ratio": "share of an episode in which the robot is where a person will be within 1.25 s, mean "
    "over episodes (CrowdNav++)",
    "intrusion_distance_m": "distance between centres in these intrusions (CrowdNav++)",
    "nearest_person_m": "mean distance between the robot's body and the nearest person's (HuNav)",
    "least_person_m": "least distance between the robot's body and a person's centre in an episode (HuNav)",
    "farthest_person_m": "largest such distance (HuNav)",
    "space_intimate": "share of the time in which the nearest person is within 0.45 m of the robot (HuNav)",
    "space_personal": "share in which it is farther, within 1.2 m (HuNav)",
    "space_social": "share in which it is farther, within 3.6 m (HuNav)",
    "social_force_m_per_s2": "social force between robot and people, mean over time (HuNav sums it)",
    "people_speed_m_per_s": "mean speed of people beside the robot (HuNav)",
    "delay_s": "how much later a person arrives because of the robot, against the same scene without it: "
    "mean over people",
    "delay_total_s": "likewise the sum over all people of an episode",
    "detour_m": "how much farther a person walks for the same progress because of the robot",
    "contacts_more_per_min": "touches of others, robot included, that people have more with the robot, by "
    "minutes that people walk",
    "wall_contacts_more_per_min": "touches of walls, likewise",
    "encounters_per_min": "people with whom the robot would collide in less than 3 s, by its minutes",
    "person_yields": "share of these encounters in which the person changes its velocity more than the robot",
}
"""What each metric is, in the order of tables."""


class _Agents(NamedTuple):
    """Paths of robots (E, R, 1 + T, 2) and of people (E, N, 1 + T, 2), or of one person who is never there.

    Robots are ``there`` on their way (E, R, T); people are ``present``, and were at the point before, and
    ``moved`` by a policy (E, N, T); ``radius`` of robots (E, R), ``reach``: sums of radii (E, R, N).
    """

    robots: Tensor
    people: Tensor
    there: Tensor
    present: Tensor
    moved: Tensor
    radius: Tensor
    reach: Tensor


def robot_metrics(rollout: RobotRollout) -> dict[str, Ratio]:
    """Return every metric of robots, by its name, in the order of `LEGEND`, which says what they are.

    Robots count from the beginning to the end of their own episode. What has no value (no robot
    succeeds, ...) is in neither sum of its ratio. What robots do to people is known of whom a policy moves.
    """
    walked, first = rollout.walked, rollout.walked.mask.shape[1] - rollout.robots
    values = (walked.path, walked.continuous, walked.scored, walked.radius)
    people, present, moved, sizes = (v[:, :first] if first else torch.zeros_like(v[:, :1]) for v in values)
    radius = walked.radius[:, first:]
    reach = radius.unsqueeze(2) + sizes.unsqueeze(1)
    agents = _Agents(walked.path[:, first:], people, rollout.there, present, moved, radius, reach)
    result = (
        _ends(rollout, agents) | _driving(rollout) | _near(agents) | _encounters(agents) | _effect(rollout)
    )
    return {name: result[name] for name in LEGEND}


def _ends(rollout: RobotRollout, agents: _Agents) -> dict[str, Ratio]:
    """Return how episodes end, and how long they take."""
    walked, there, last = rollout.walked, rollout.there, slice(-rollout.robots, None)
    reached, success, goals = walked.reached[:, last], rollout.success, rollout.goals
    every, touches = torch.ones_like(success), rollout.person_contact.any(-1)
    drives = _drives_into(rollout, agents)
    metres = arrival.walked_metres(walked.path[:, last], there, reached, goals)
    planned = arrival.planned_metres(walked.planned[:, last], reached, goals)
    seconds, needed = arrival.finish_seconds(reached, goals), planned / rollout.bodies.top_speed
    ends = {
        "success": success,
        "collision_person": touches,
        "collision_robot": rollout.robot_contact.any(-1),
        "collision_wall": rollout.wall_contact.any(-1),
        "timeout": rollout.timeout,
        "failed": rollout.failed,
        "robot_on_person": touches & drives,
        "person_on_robot": touches & ~drives,
    }
    return {name: share(flag, every) for name, flag in ends.items()} | {
        "spl": mean(arrival.weighted(success, planned, metres), every),
        "stl": mean(arrival.weighted(success, needed, seconds), every),
        "time_s": mean(seconds, success),
        "duration_s": mean(there.sum(-1) * TRACE_SECONDS, every),
        "path_m": mean(metres, every),
        "path_ratio": of_sums(metres, planned, success),
    }


def _drives_into(rollout: RobotRollout, agents: _Agents) -> Tensor:
    """Return which robots (E, R) bool move faster towards the person whom they touch first than it does.

    After SEAN 2.0's "robot on person collision" (Tsoi et al., RA-L 2022), which HuNav has, too.
    """
    e, r, n = (torch.arange(size) for size in agents.reach.shape)
    e, r, point = e[:, None, None], r[:, None], rollout.person_contact.long().argmax(-1).unsqueeze(2)
    before, after = (agents.people[e, n, point + step] for step in (0, 1))  # (E, R, N, 2)
    robot, moved = (agents.robots[e, r, point + step] for step in (0, 1))  # (E, R, 1, 2)
    gap = (after - moved).norm(dim=-1) - agents.reach
    nearest = gap.masked_fill(~agents.present[e, n, point], torch.inf).argmin(2, keepdim=True)
    closing = ((moved - robot) + (after - before)) * (before - robot)
    return (closing.sum(-1) >= 0).gather(2, nearest)[..., 0]


def _driving(rollout: RobotRollout) -> dict[str, Ratio]:
    """Return how robots move."""
    walked, there, last = rollout.walked, rollout.there, slice(-rollout.robots, None)
    path, every = walked.path[:, last], torch.ones_like(rollout.success)
    velocity, known = smoothness.velocities(path, there)
    away = (walked.trace[:, last] - walked.goal[:, last]).norm(dim=-1)
    end = (there.sum(-1, keepdim=True) - 1).clamp_min(0)
    speed, turned = path.diff(dim=2).norm(dim=-1) / TRACE_SECONDS, rollout.heading.diff(dim=-1)
    turned = torch.atan2(turned.sin(), turned.cos()).abs()
    stands = (speed < STANDS) & (turned < STANDS_TURN * TRACE_SECONDS) & there
    return {
        "final_goal_distance_m": mean(away.gather(-1, end).squeeze(-1), every),
        "least_goal_distance_m": finite(away.masked_fill(~there, torch.inf).amin(-1)),
        "standing_s": mean(stands.sum(-1) * TRACE_SECONDS, every),
        "heading_change_rad": mean(turned.where(there, 0.0).sum(-1), every),
        "speed_m_per_s": mean(speed, there),
        "acceleration_m_per_s2": mean(*smoothness.acceleration(velocity, known)),
        "jerk_m_per_s3": mean(*smoothness.jerk(velocity, known)),
    }


def _near(agents: _Agents) -> dict[str, Ratio]:
    """Return how near robots come to people."""
    robots, people, there = agents.robots[:, :, 1:], agents.people[:, :, 1:], agents.there
    both = there.unsqueeze(2) & agents.present.unsqueeze(1)
    away = people.unsqueeze(1) - robots.unsqueeze(2)
    apart = away.norm(dim=-1).masked_fill(~both, torch.inf)
    nearest, body = apart.amin(2), apart - agents.radius[..., None, None]
    gap, edge = (apart - agents.reach.unsqueeze(-1)).amin(2), body.amin(2)
    farthest = torch.where(body.isfinite(), body, -torch.inf).amax((2, 3))
    intruded, least = intrusions(robots, people, agents.present, agents.reach)
    intruded = intruded & there
    mine, theirs = (path.diff(dim=2) / TRACE_SECONDS for path in (agents.robots, agents.people))
    force = social_force(away, mine.unsqueeze(2) - theirs.unsqueeze(1))
    spaces = {name: (edge >= low) & (edge < high) for name, (low, high) in SPACES.items()}
    return {f"space_{name}": share(inside, there) for name, inside in spaces.items()} | {
        "personal_space": share((nearest >= contacts.PERSONAL_SPACE) & there, there),
        "discomfort": share((gap < DISCOMFORT) & there, there),
        "intrusion_ratio": mean(intruded.sum(-1) / there.sum(-1).clamp_min(1), there.any(-1)),
        "intrusion_distance_m": mean(least, intruded),
        "nearest_person_m": finite(gap),
        "least_person_m": finite(edge.amin(2)),
        "farthest_person_m": finite(farthest),
        "social_force_m_per_s2": mean(force.where(both, 0.0).sum(2), there),
        "people_speed_m_per_s": mean(theirs.norm(dim=-1), agents.present),
    }


def intrusions(robots: Tensor, people: Tensor, present: Tensor, reach: Tensor) -> tuple[Tensor, Tensor]:
    """Return when robots are where people are about to go (E, R, T) bool, and how near (E, R, T), metres.

    At point t a robot intrudes whose body touches a person's body of 0.25, 0.5, ... 1.25 s later. The
    distance is the least one between centres of those that touch, infinite for none. In CrowdNav++ people's
    future is simulated; here it is what they really did.
    """
    points, least = people.shape[2], torch.full(robots.shape[:3], torch.inf)
    for step in range(1, FUTURE_STEPS + 1):
        share, first = math.modf(step * FUTURE_SECONDS / TRACE_SECONDS)
        first, last = int(first), int(first) + (share > 0)
        if last >= points:
            break
        later = torch.lerp(people[:, :, first : points - last + first], people[:, :, last:], share)
        apart = (robots[:, :, : points - last].unsqueeze(2) - later.unsqueeze(1)).norm(dim=-1)
        there = present[:, :, last:].unsqueeze(1) & (apart < reach.unsqueeze(-1))
        nearest = apart.masked_fill(~there, torch.inf).amin(2)
        least[..., : points - last] = torch.minimum(least[..., : points - last], nearest)
    return least.isfinite(), least


def social_force(apart: Tensor, velocity: Tensor) -> Tensor:
    """Return the amounts of the social force between pairs (...), m/s^2: of either on the other.

    The model of Moussaid et al. (Proc. R. Soc. B 276, 2009) with the parameters of HuNav. ``d`` is the
    distance, ``e`` the direction, ``D = 2 v + e``, ``B = 0.35 |D|``, ``a`` the angle from e to D. The force
    is ``2.1 sqrt(exp(-d/B - (3 B a)^2)^2 + exp(-d/B - (2 B a)^2)^2)``, without the second term where a is 0.

    Args:
        apart: From one to the other (..., 2), metres.
        velocity: Of the one less that of the other (..., 2), m/s.
    """
    distance = apart.norm(dim=-1)
    toward = torch.nn.functional.normalize(apart, dim=-1)
    interaction = LAMBDA * velocity + toward
    reach = GAMMA * interaction.norm(dim=-1)
    cross = toward[..., 0] * interaction[..., 1] - toward[..., 1] * interaction[..., 0]
    angle = torch.atan2(cross, (toward * interaction).sum(-1))
    decay = -distance / reach.clamp_min(1e-9)
    ahead = (decay - (VELOCITY * reach * angle) ** 2).exp()
    aside = (decay - (ANGULAR * reach * angle) ** 2).exp().where(angle != 0, 0.0)
    return SOCIAL_FACTOR * torch.hypot(ahead, aside)


def _encounters(agents: _Agents) -> dict[str, Ratio]:
    """Return how often robots and people meet, and in which share of these encounters the person yields.

    An encounter of a pair begins where the time after which they would touch, if both kept their velocities,
    first falls below 3 s, but not in the first second, in which robots set out. It ends at the closest
    approach of the next 6 s. A change is the largest ``|v(t) - v(begin)|`` in between; one of at least 0.1
    m/s is yielding, and who changes more yields. A pair has one encounter in an episode, the first.
    """
    robots, people, there, _, moved, _, reach = agents
    mine, theirs = (path.diff(dim=2) / TRACE_SECONDS for path in (robots, people))
    apart = people[:, :, 1:].unsqueeze(1) - robots[:, :, 1:].unsqueeze(2)
    closing = theirs.unsqueeze(1) - mine.unsqueeze(2)
    both, point = there.unsqueeze(2) & moved.unsqueeze(1), torch.arange(there.shape[-1])
    seconds = contacts.collision_seconds(apart, closing, reach.unsqueeze(-1))
    near = (seconds < ENCOUNTER) & both & (point >= FROM_REST)
    begin = near.long().argmax(-1, keepdim=True)
    after = both & (point >= begin) & (point <= begin + LASTS)
    closest = apart.norm(dim=-1).masked_fill(~after, torch.inf).argmin(-1, keepdim=True)
    during = after & (point <= closest)
    changes: list[Tensor] = []
    for velocity in (mine.unsqueeze(2), theirs.unsqueeze(1)):
        velocity = velocity.expand(*near.shape, 2)
        first = torch.take_along_dim(velocity, begin.unsqueeze(-1), 3)
        changes.append((velocity - first).norm(dim=-1).where(during, 0.0).amax(-1))
    robot, person, met = *changes, near.any(-1)
    known = met & (torch.maximum(robot, person) >= YIELDS)
    return {
        "encounters_per_min": ratio(met.sum(2), contacts.person_minutes(there)),
        "person_yields": share(known & (person > robot), known),
    }


class WalkProgress(NamedTuple):
    """How far people had come when the robot's episode ended (E, N).

    Attributes:
        arrived: They had reached all their goals, bool.
        seconds: When they had, infinite for others.
        covered: Metres of the planner's ways that they had covered; all of them for people who arrived.
        walked: Metres that they walked until then.
    """

    arrived: Tensor
    seconds: Tensor
    covered: Tensor
    walked: Tensor


def delay(joined: WalkProgress, alone: WalkProgress, pref_speed: Tensor, ended: Tensor) -> Tensor:
    """Return how much later people arrive with the robot than without (E, N), seconds; below 0: earlier.

    Who had not arrived when the robot's episode ended would do so after what was left of the planned way, at
    the speed that they like. Of people who arrived in neither, the delay is the planned way that they covered
    less, by that speed.

    Args:
        joined: With the robot.
        alone: Without.
        pref_speed: The speed that people like (E, N), m/s.
        ended: When the robot's episode ended (E,), seconds.
    """
    whole = torch.where(joined.arrived, joined.covered, alone.covered)  # where neither arrived it cancels
    late, early = (
        one.seconds.where(one.arrived, ended.unsqueeze(1) + (whole - one.covered) / pref_speed)
        for one in (joined, alone)
    )
    return late - early


def detour(joined: WalkProgress, alone: WalkProgress) -> Tensor:
    """Return how much farther people walk for the same progress (E, N), metres; below 0: less far.

    What they walked less what they covered of the planner's paths, with the robot less without: a person who
    only waits has a delay, and no detour.
    """
    return (joined.walked - joined.covered) - (alone.walked - alone.covered)


def _effect(rollout: RobotRollout) -> dict[str, Ratio]:
    """Return what robots do to people, against the same scenes without them."""
    walked, alone = both = rollout.walked, rollout.alone
    people = slice(0, walked.mask.shape[1] - rollout.robots)

    def progress(one: Rollout, covered: Tensor) -> WalkProgress:
        reached, goals = one.reached[:, people], one.goals
        arrived = (reached[..., -1] >= goals) & one.mask[:, people]
        planned = arrival.planned_metres(one.planned[:, people], reached, goals)
        metres = arrival.walked_metres(one.path[:, people], one.scored[:, people], reached, goals)
        seconds = arrival.finish_seconds(reached, goals)
        return WalkProgress(arrived, seconds, torch.where(arrived, planned, covered[:, people]), metres)

    pair = progress(walked, rollout.progress), progress(alone, rollout.progress_alone)
    known = walked.controlled[:, people].any(-1) & ~(walked.failed | alone.failed).unsqueeze(1)
    later = delay(*pair, walked.pref_speed[:, people], rollout.seconds)
    result = {
        "delay_s": mean(later, known),
        "delay_total_s": ratio(later.where(known, 0.0), known.any(1)),
        "detour_m": mean(detour(*pair), known),
    }
    for name, contact in (("contacts", "agent_contact"), ("wall_contacts", "wall_contact")):
        touched = ((getattr(one, contact) & one.scored)[:, people] for one in both)
        more, less = (contacts.contact_events(one) for one in touched)
        result[f"{name}_more_per_min"] = ratio(more - less, contacts.person_minutes(walked.scored[:, people]))
    return result
