"""Metrics as a reader of tables takes them: which come first, and whether more of them is better."""

import re

HIGHER = re.compile(
    r"success|clean|contact_free|s[pt]l|goals_p.*|personal_space.*|(all_)?through|specific_flow.*|.*steps_per_s"
    r"|episode_success|person_yields"
)
LOWER = re.compile(
    r"(?!contact_free).*contact.*|collision.*|deadlock|failed|timeout|time_ratio.*|path_ratio|time_s|delay.*"
    r"|detour.*|intrusion_ratio|discomfort|realism|w1_.*|(.*_)?[af]de(_.*)?|dtw_m|.*rmse.*|next_step.*|nll.*"
    r"|intervention_.*|outcome_(blocked|lost|through)|step_s|.*_ms"
)

FIRST = (
    *("success", "episode_success", "realism", "clean", "collision_person", "collision_wall", "timeout"),
    *("agent_contacts_per_min", "wall_contacts_per_min", "time_ratio", "time_ratio_median", "deadlock"),
    *("path_ratio", "stl", "time_s", "delay_s", "intrusion_ratio", "least_distance_m", "closed_loop_ade_m"),
    *("density_speed_rmse_m_per_s", "agent_contact_excess", "ade_m", "fde_m", "min_ade_20_scene_m"),
)
"""Columns that are shown at once, in this order; the others with a click."""


AT_ONCE = 8
"""Columns at most: so many fit a page of usual width."""


def better(metric: str) -> int:
    """Return 1 where more of a metric is better, -1 where less is, 0 where neither is."""
    if HIGHER.fullmatch(metric):
        return 1
    return -1 if LOWER.fullmatch(metric) else 0


def ordered(metrics: list[str]) -> list[tuple[str, bool]]:
    """Return metrics with whether they are shown at once: all of them where none is known."""
    first = [name for name in FIRST if name in metrics][:AT_ONCE]
    return [(name, True) for name in first] + [(name, not first) for name in metrics if name not in first]
