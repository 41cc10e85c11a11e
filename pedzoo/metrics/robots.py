"""All metrics of robots among people, each as a ratio of two sums over episodes.

E episodes of N people and R robots, T trace points; point t is the end of the t-th 0.1 s after the warm
start. Numbers that count like others' are taken from where others define them:

* CrowdNav: Chen et al., "Crowd-robot interaction", ICRA 2019; vita-epfl/CrowdNav ``explorer.py``.
* CrowdNav++: Liu et al., "Intention aware robot crowd navigation", ICRA 2023;
  Shuijing725/CrowdNav_Prediction_AttnGraph ``evaluation.py``.
* HuNav: Perez-Higueras et al., "HuNavSim", RA-L 2023; robotics-upo/hunav_sim ``hunav_metrics.py``.
* iGibson: social navigation; ``STL`` and personal space of 0.5 m.

Of HuNav's list these are left out: group intrusions (people of pedzoo have no groups); obstacle forces and
social work (they sum over obstacle points that each simulator chooses by itself); mean angular speed and mean
acceleration with their sign (left and right cancel out: amounts are here instead); its jerk, which is
acceleration by time. Its rule of which of two collided with the other swaps the arguments of ``atan2``;
`pedzoo.metrics.robot_functions.drives_into` says what is used instead. Its social forces on the robot and on
people are the same number: each pair's have the same amount.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import torch
from torch import Tensor

from pedzoo.core.types import TRACE_SECONDS
from pedzoo.metrics import arrival, contacts, smoothness
from pedzoo.metrics import robot_functions as of_robots
from pedzoo.metrics.ratios import Ratio, finite, mean, of_sums, ratio, share
from pedzoo.sim.robots.rollout import RobotRollout
from pedzoo.sim.rollout import Rollout

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


def robot_metrics(rollout: RobotRollout) -> dict[str, Ratio]:
    """Return every metric of robots, by its name, in the order of `LEGEND`, which says what they are.

    Robots count from the beginning to the end of their own episode. What has no value (no robot succeeds, no
    person meets it, ...) is in neither sum of its ratio. What robots do to people is known of people whom a
    policy moves: those who are played back do not react.
    """
    agents = _Agents.of(rollout)
    result = _ends(rollout) | _touches(rollout, agents) | _driving(rollout)
    result |= _near(agents) | _encounters(agents) | _effect(rollout)
    return {name: result[name] for name in LEGEND}


class _Agents(NamedTuple):
    """Robots and people apart; where there are no people, one who is never there.

    Attributes:
        robots: Paths (E, R, 1 + T, 2), metres.
        people: Paths (E, N, 1 + T, 2), metres.
        there: Robots are on their way (E, R, T) bool.
        present: People are there, and were at the point before (E, N, T) bool.
        moved: A policy moves them (E, N, T) bool.
        radius: Of robots (E, R), metres.
        reach: Sums of radii (E, R, N), metres.
    """

    robots: Tensor
    people: Tensor
    there: Tensor
    present: Tensor
    moved: Tensor
    radius: Tensor
    reach: Tensor

    @classmethod
    def of(cls, rollout: RobotRollout) -> _Agents:
        """Return the agents of a rollout."""
        walked, first = rollout.walked, rollout.walked.mask.shape[1] - rollout.robots
        people, present, moved, sizes = (
            value[:, :first] if first else torch.zeros_like(value[:, :1])
            for value in (walked.path, walked.continuous, walked.scored, walked.radius)
        )
        radius = walked.radius[:, first:]
        reach = radius.unsqueeze(2) + sizes.unsqueeze(1)
        return cls(walked.path[:, first:], people, rollout.there, present, moved, radius, reach)


def _ends(rollout: RobotRollout) -> dict[str, Ratio]:
    """Return how episodes end, and how long they take."""
    walked, there, last = rollout.walked, rollout.there, slice(-rollout.robots, None)
    reached, success, goals = walked.reached[:, last], rollout.success, rollout.goals
    every = torch.ones_like(success)
    metres = arrival.walked_metres(walked.path[:, last], there, reached, goals)
    planned = arrival.planned_metres(walked.planned[:, last], reached, goals)
    seconds, needed = arrival.finish_seconds(reached, goals), planned / rollout.bodies.top_speed
    return {
        "success": share(success, every),
        "collision_person": share(rollout.person_contact.any(-1), every),
        "collision_robot": share(rollout.robot_contact.any(-1), every),
        "collision_wall": share(rollout.wall_contact.any(-1), every),
        "timeout": share(rollout.timeout, every),
        "failed": share(rollout.failed, every),
        "spl": mean(arrival.weighted(success, planned, metres), every),
        "stl": mean(arrival.weighted(success, needed, seconds), every),
        "time_s": mean(seconds, success),
        "duration_s": mean(there.sum(-1) * TRACE_SECONDS, every),
        "path_m": mean(metres, every),
        "path_ratio": of_sums(metres, planned, success),
    }


def _touches(rollout: RobotRollout, agents: _Agents) -> dict[str, Ratio]:
    """Return whether the robot or the person causes the first touch of a person."""
    contact = rollout.person_contact
    point = contact.long().argmax(-1)
    place, there = point[:, :, None, None], agents.present.unsqueeze(1)
    before, after = (_at(agents.people.unsqueeze(1), place + step) for step in (0, 1))
    robot, moved = (_at(agents.robots.unsqueeze(2), place + step) for step in (0, 1))
    there = there.expand(-1, contact.shape[1], -1, -1).gather(3, place.expand(*after.shape[:3], 1))[..., 0]
    gap = (after - moved).norm(dim=-1) - agents.reach
    nearest = gap.masked_fill(~there, torch.inf).argmin(2, keepdim=True)
    drives = of_robots.drives_into(before - robot, moved - robot, after - before).gather(2, nearest)[..., 0]
    touches, every = contact.any(-1), torch.ones_like(drives)
    return {
        "robot_on_person": share(touches & drives, every),
        "person_on_robot": share(touches & ~drives, every),
    }


def _at(path: Tensor, point: Tensor) -> Tensor:
    """Return where paths (E, ..., 1 + T, 2) are at points (E, R, 1, 1) long: (E, R, N, 2), metres."""
    shape = torch.broadcast_shapes(path.shape[:3], point.shape[:3])
    index = point.unsqueeze(-1).expand(*shape, 1, 2)
    return path.expand(*shape, -1, -1).gather(3, index).squeeze(3)


def _driving(rollout: RobotRollout) -> dict[str, Ratio]:
    """Return how robots move."""
    walked, there, last = rollout.walked, rollout.there, slice(-rollout.robots, None)
    path, every = walked.path[:, last], torch.ones_like(rollout.success)
    velocity, known = smoothness.velocities(path, there)
    least, final = of_robots.goal_distances(walked.trace[:, last], walked.goal[:, last], there)
    return {
        "final_goal_distance_m": mean(final, every),
        "least_goal_distance_m": finite(least),
        "standing_s": mean(of_robots.seconds_standing(path, rollout.heading, there), every),
        "heading_change_rad": mean(of_robots.heading_changes(rollout.heading, there), every),
        "speed_m_per_s": mean(path.diff(dim=2).norm(dim=-1) / TRACE_SECONDS, there),
        "acceleration_m_per_s2": mean(*smoothness.acceleration(velocity, known)),
        "jerk_m_per_s3": mean(*smoothness.jerk(velocity, known)),
    }


def _near(agents: _Agents) -> dict[str, Ratio]:
    """Return how near robots come to people."""
    robots, people = agents.robots[:, :, 1:], agents.people[:, :, 1:]
    there, present = agents.there, agents.present
    apart = of_robots.distances(robots, people, there, present)
    gap, body = (apart - agents.reach.unsqueeze(-1)).amin(2), apart - agents.radius[..., None, None]
    farthest = torch.where(body.isfinite(), body, -torch.inf).amax((2, 3))
    intruded, least = of_robots.intrusions(robots, people, present, agents.reach)
    intruded = intruded & there
    mine, theirs = (path.diff(dim=2) / TRACE_SECONDS for path in (agents.robots, agents.people))
    closing = mine.unsqueeze(2) - theirs.unsqueeze(1)
    force = of_robots.social_force(people.unsqueeze(1) - robots.unsqueeze(2), closing)
    inside = {name: of_robots.in_space(apart, agents.radius, name) for name in of_robots.SPACES}
    return {f"space_{name}": share(when, there) for name, when in inside.items()} | {
        "personal_space": share(contacts.keeps_distance(apart.amin(2), there), there),
        "discomfort": share((gap < of_robots.DISCOMFORT) & there, there),
        "intrusion_ratio": mean(intruded.sum(-1) / there.sum(-1).clamp_min(1), there.any(-1)),
        "intrusion_distance_m": mean(least, intruded),
        "nearest_person_m": finite(gap),
        "least_person_m": finite(body.amin((2, 3))),
        "farthest_person_m": finite(farthest),
        "social_force_m_per_s2": mean(force.where(apart.isfinite(), 0.0).sum(2), there),
        "people_speed_m_per_s": mean(theirs.norm(dim=-1), present),
    }


def _encounters(agents: _Agents) -> dict[str, Ratio]:
    """Return how often the robot and the person yield."""
    met = of_robots.encounters(agents.robots, agents.people, agents.there, agents.moved, agents.reach)
    return {
        "encounters_per_min": ratio(met.met.sum(2), contacts.person_minutes(agents.there)),
        "person_yields": share(met.person_yields, met.known),
    }


def _effect(rollout: RobotRollout) -> dict[str, Ratio]:
    """Return what robots do to people, against the same scenes without them."""
    people = slice(0, rollout.walked.mask.shape[1] - rollout.robots)
    both = rollout.walked, rollout.alone
    joined, alone = (
        _walk(one, progress, people)
        for one, progress in zip(both, (rollout.progress, rollout.progress_alone), strict=True)
    )
    known = rollout.walked.controlled[:, people].any(-1) & ~(both[0].failed | both[1].failed).unsqueeze(1)
    later = of_robots.delay(joined, alone, both[0].pref_speed[:, people], rollout.seconds)
    result = {
        "delay_s": mean(later, known),
        "delay_total_s": ratio(later.where(known, 0.0), known.any(1)),
        "detour_m": mean(of_robots.detour(joined, alone), known),
    }
    minutes = contacts.person_minutes(both[0].scored[:, people])
    for name in ("agent_contact", "wall_contact"):
        events = [contacts.contact_events((getattr(one, name) & one.scored)[:, people]) for one in both]
        key = {"agent_contact": "contacts_more_per_min", "wall_contact": "wall_contacts_more_per_min"}[name]
        result[key] = ratio(events[0] - events[1], minutes)
    return result


def _walk(rollout: Rollout, progress: Tensor, people: slice) -> of_robots.WalkProgress:
    """Return how far people had come at the end."""
    reached, goals = rollout.reached[:, people], rollout.goals
    arrived = (reached[..., -1] >= goals) & rollout.mask[:, people]
    planned = arrival.planned_metres(rollout.planned[:, people], reached, goals)
    return of_robots.WalkProgress(
        arrived=arrived,
        seconds=arrival.finish_seconds(reached, goals),
        covered=torch.where(arrived, planned, progress[:, people]),
        walked=arrival.walked_metres(rollout.path[:, people], rollout.scored[:, people], reached, goals),
    )
