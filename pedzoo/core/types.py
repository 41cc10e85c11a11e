"""The constants that all parts share; `pedzoo.core.batch` describes the scene batch."""

from typing import Literal

STEP_SECONDS = 0.4
"""Every network here predicts steps of 0.4 s (2.5 Hz), the annotation rate of ETH/UCY."""

OBS_LEN = 8
"""Observed steps: 3.2 s, as in Social GAN."""

GoalProtocol = Literal["none", "window_end", "destination", "planner", "random_future"]
"""Where a recorded person's ``goal`` comes from; it changes what a number means, so every row names it."""

TimeBase = Literal["benchmark", "true"]
"""``benchmark``: every annotated step counts as 0.4 s; ``true``: resampled to a real 0.4 s."""

PRED_LEN = 8
"""Predicted steps that a short-term goal lies ahead in simulation."""

AHEAD_SECONDS = PRED_LEN * STEP_SECONDS
"""How far ahead that is: 3.2 s."""

TRACE_SECONDS = 0.1
"""Contacts, goals and closed-loop metrics are evaluated on positions this far apart."""

BODY_RADIUS = 0.15
"""Metres: people touch when their centres are closer than two of it, walls when closer than one."""

GOAL_RADIUS = 0.3
"""Metres: a goal is reached within it (iGibson's)."""

TOP_SPEED_RATIO = 1.3
"""No person walks faster than this many times the preferred speed."""

TIMED = frozenset({"window_end"})
"""Goal protocols whose goal is reached exactly at the last predicted step."""
