"""Whether and when people arrive: pure functions over the 0.1 s trace of closed-loop episodes.

E episodes of A people (padded), T trace points; point t is the end of the t-th 0.1 s after the warm start.
Functions take what `pedzoo.sim.rollout.Rollout` holds under the same names.
"""

import torch
from torch import Tensor

from pedzoo.core.types import TRACE_SECONDS

STILL_POINTS, STILL_METRES, AWAY = round(5.0 / TRACE_SECONDS), 0.1, 0.5
"""Trace points (5 s), metres in them, and metres to the goal: less movement, farther away, is a deadlock."""


def arrived_in_time(reached: Tensor, goals: int, late: Tensor, failed: Tensor, mask: Tensor) -> Tensor:
    """Return which people have reached all goals in time (E, A) bool; none in an episode that failed."""
    return (reached[..., -1] >= goals) & ~late & ~failed.unsqueeze(1) & mask


def finish_seconds(reached: Tensor, goals: int) -> Tensor:
    """Return when each person had reached all goals (E, A), seconds, infinite where they never had."""
    missing = (reached < goals).sum(-1)
    seconds = (missing + 1).double() * TRACE_SECONDS
    return torch.where(missing < reached.shape[-1], seconds, torch.inf)


def episode_seconds(seconds: Tensor, success: Tensor, mask: Tensor) -> Tensor:
    """Return when the last person had finished (E,), seconds; infinite unless all had in time."""
    all_in_time = (success | ~mask).all(1)
    last = seconds.masked_fill(~mask, 0.0).amax(1)
    return torch.where(all_in_time, last, torch.inf)


def seconds_per_goal(seconds: Tensor, reached: Tensor, mask: Tensor) -> tuple[Tensor, Tensor]:
    """Return the time that all people of an episode walked (E,), seconds, and the goals they reached (E,).

    0 and 0 unless all finished in time, after ``seconds`` (E,), see `episode_seconds`. People who finish
    early walk on to further goals: their time and those goals count.
    """
    known = seconds.isfinite()
    goals = reached[..., -1].where(mask, 0).sum(1)
    return (seconds * mask.sum(1)).where(known, 0.0), goals.where(known, 0)


def planned_metres(planned: Tensor, reached: Tensor, goals: int) -> Tensor:
    """Return the length of the planner's paths of all goals that each person had to reach (E, A), metres.

    ``planned`` (E, A, T): all until the one being walked to. People who never reached all goals have theirs
    until the goal they had at the end.
    """
    last = (reached < goals).sum(-1, keepdim=True).clamp_max(reached.shape[-1] - 1)
    return planned.gather(2, last).squeeze(2)


def walked_metres(path: Tensor, scored: Tensor, reached: Tensor, goals: int) -> Tensor:
    """Return how far each person walked until they had reached all goals (E, A), metres."""
    until = reached[..., :-1] < goals  # the step in which the last goal is reached counts
    counts = torch.cat((torch.ones_like(scored[..., :1]), until), dim=2) & scored
    return path.diff(dim=2).norm(dim=-1).where(counts, 0.0).sum(2)


def weighted(success: Tensor, least: Tensor, taken: Tensor) -> Tensor:
    """Return each person's success weighted by effort (E, A): ``S * least / max(least, taken)``.

    With lengths of the planned and of the walked path this is SPL (Anderson et al., "On evaluation of
    embodied navigation agents", 2018, arXiv 1807.06757). With times it is STL: iGibson takes ORCA's time as
    the least, pedzoo that of the planned path at the preferred speed.
    """
    most = torch.maximum(least, taken)
    return torch.where(most > 0, least / most, 1.0).where(success, 0.0)


def fewest_goals(reached: Tensor, mask: Tensor) -> Tensor:
    """Return how many goals the person with the fewest reached in each episode (E,) long."""
    last = reached[..., -1]
    return last.masked_fill(~mask, int(last.max())).amin(1)


def most_goals(reached: Tensor, mask: Tensor) -> Tensor:
    """Return how many goals the person with the most reached in each episode (E,) long."""
    return reached[..., -1].masked_fill(~mask, 0).amax(1)


def deadlocked(trace: Tensor, goal: Tensor, scored: Tensor) -> Tensor:
    """Return which people once stayed within 0.1 m for 5 s, more than 0.5 m from the goal (E, A) bool.

    They are ``scored`` all of the 5 s, and do not come back to a place within them. Current goals: (E, A, T,
    2), metres; people are away from theirs when the 5 s begin, too, so that waiting at a goal is no deadlock.
    """
    return stuck(trace, goal, scored).any(-1)


def stuck(trace: Tensor, goal: Tensor, scored: Tensor) -> Tensor:
    """Return at which points 5 s end that make a person `deadlocked` (E, A, T) bool; same arguments."""
    result = torch.zeros_like(scored)
    if trace.shape[2] <= STILL_POINTS:
        return result
    before, after = trace[:, :, :-STILL_POINTS], trace[:, :, STILL_POINTS:]
    still = (after - before).norm(dim=-1) < STILL_METRES
    away = (trace - goal).norm(dim=-1) > AWAY
    away = away[..., :-STILL_POINTS] & away[..., STILL_POINTS:]
    count = scored.cumsum(2)
    stayed = count[..., STILL_POINTS:] - count[..., :-STILL_POINTS] == STILL_POINTS
    result[:, :, STILL_POINTS:] = still & away & stayed
    episode, agent = result.any(-1).nonzero(as_tuple=True)
    if len(episode):  # few: the person may have been elsewhere between now and 5 s ago
        place = trace[episode, agent].transpose(1, 2)
        extent = _window_max(place, STILL_POINTS + 1) + _window_max(-place, STILL_POINTS + 1)
        result[episode, agent, STILL_POINTS:] &= extent.norm(dim=1) < STILL_METRES
    return result


def _window_max(values: Tensor, width: int) -> Tensor:
    """Return the largest of every ``width`` neighbours (..., T - width + 1) of values (..., T)."""
    size = 1
    while 2 * size <= width:
        values = torch.maximum(values[..., size:], values[..., :-size])
        size *= 2
    rest = width - size
    return torch.maximum(values[..., rest:], values[..., : values.shape[-1] - rest])
