"""The legend that every docstring uses, and the one scene batch that flows through pedzoo.

B scenes, A agents (padded), T steps, K samples; P people (all agents of a batch that are really there,
packed). World frame: x right, y up; metres, seconds, radians.

A scene batch is a TensorDict of batch size (B,). Recordings and the environment yield the same keys:

=====================  =====================  ==========================================================
key                    shape                  meaning
=====================  =====================  ==========================================================
agents/id              (B, A) long            who it is, for noise of their own; the slot where absent
agents/history         (B, A, 8, 2)           world positions, oldest first, every 0.4 s
agents/valid           (B, A, 8) bool         which of them are known
agents/velocity        (B, A, 2)              current velocity, m/s
agents/pref_speed      (B, A, 1)              the speed this person likes, m/s
agents/goal            (B, A, 2)              short-term goal; absent under the goal protocol ``none``
agents/desired_velocity(B, A, 2)              pref_speed towards the goal; absent with it
agents/mask            (B, A) bool            a person is here
agents/controlled      (B, A) bool            the policy moves this person
agents/future          (B, A, T, 2)           recordings only: the true continuation
agents/future_valid    (B, A, T) bool         which of it is known
map_id                 (B, 1) long            floor plan in the MapBank, -1 for none
scene_pose             (B, 4)                 rotation, mirror (+1 or -1) and shift of the scene against it
prediction             (B, K, A, T, 2)        a model's answer: displacements per step, metres
scene_key              (B, 1) long            environment only: names the scene, noise is drawn by it
time                   (B, 1)                 environment only: seconds since the warm start
agents/action          (B, A, 2)              a policy's answer: velocities, m/s
agents/reward          (B, A, 1)              environment only, with agents/info, failed, done, terminated
                                              and truncated: see `pedzoo.sim.env`
=====================  =====================  ==========================================================
"""

from __future__ import annotations

from typing import Literal

STEP_SECONDS = 0.4
"""Every network here predicts steps of 0.4 s (2.5 Hz), the annotation rate of ETH/UCY."""

OBS_LEN = 8
"""Observed steps: 3.2 s, as in Social GAN."""

GoalProtocol = Literal["none", "window_end", "destination", "random_future"]
"""Where a recorded person's ``goal`` comes from; it changes what a number means, so every row names it."""

Clock = Literal["benchmark", "true"]
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
"""Nobody walks faster than this many times the speed they like."""
