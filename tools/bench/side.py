"""One side of ``before_after.py``: pedzoo from one checkout, timed as a peer of `pedzoo bench`.

``before_after.py`` starts this script twice, with ``PYTHONPATH`` set to the checkout that is measured. It
works with the interface of both checkouts:

* where `make_env` has no ``physics``, the environment has one variant, ``grid``;
* where it has, every batched backend is a variant, and so is a plain loop over `kernel.step`;
* floor plans are bound to a policy where it has ``bind``.

A question's ``section`` says what is timed at a size (see `SECTIONS`); the answered ``note`` is the variant.
"""

from __future__ import annotations

import inspect
import sys
from collections.abc import Callable, Iterator, Sequence
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parent / "peers"))

import numpy as np
import torch
from answering import Step, TimedCase, serve  # pyright: ignore[reportMissingImports]

import pedzoo
from pedzoo.maps.grid import free_points
from pedzoo.sim.make import make_env

NAMED_PLANS = "pedzoo.maps.plans" if find_spec("pedzoo.maps.plans") else "pedzoo.maps.library"
load_plan = import_module(NAMED_PLANS).load_plan

SCENARIO = "goals:map=apartment.7,people={people}"
MODEL = "sgan_goal_map.indoor"
UNHELD = f"{MODEL}:safety=false"
BARE = "go_to_goal"
SECTIONS = {
    "environment": (BARE,),
    "policies": ("orca", "orca:dt=0.4", "social_force:preset=indoor", MODEL, UNHELD),
    "safety": (MODEL, UNHELD),
    "controller": (),
}
"""The policies that each section walks with; ``controller`` has the one of `MODEL`."""

PLANS = {200: "office.7"}
"""Floor plans of the controller, by the number of people."""

PLAN = "apartment.7"
DECISION = 0.4
WARM, TURN = 20.0, 10.0
"""Simulated seconds before the first turn, and in each turn at least: resets have their share."""

OBSERVED, CALLS = 8, 20
"""Calls that fill the controller's histories, and calls that are timed before people are put back."""

KERNELS = ("pedzoo.kernel", "pedzoo.sim.kernel")
POLICIES = ("pedzoo.policies.load", "pedzoo.sim.policy")
REGISTRIES = ("pedzoo.core.registry", "pedzoo.registry")
"""Where a module is in one checkout or the other."""

UNBATCHED = ("base", "bullet")


def cases(asked: list[dict[str, Any]], threads: int) -> list[TimedCase]:
    """Return what this checkout can do of the sections and sizes that are asked about."""
    torch.set_num_threads(threads)
    return [case for size in asked for case in section(size["section"], size["scenes"], size["people"])]


def section(name: str, scenes: int, people: int) -> Iterator[TimedCase]:
    """Give the cases of one section at one size."""
    for policy in SECTIONS[name]:
        dt = load_policy(policy).decision_dt
        for variant in variants() if name == "environment" else ("",):
            make = walking if variant != "kernel.step" else kernel_loop
            physics = "" if variant in ("grid", "kernel.step") else variant

            def build(
                make: Callable[..., Any] = make, policy: str = policy, physics: str = physics
            ) -> tuple[Step, Step | None]:
                return make(scenes, people, policy, physics)

            yield TimedCase(f"env {policy}", scenes, people, dt, variant, build, round(TURN / dt))
    if name == "controller":
        plan = PLANS.get(people, PLAN)
        name = f"controller in {plan}"
        yield TimedCase(name, 1, people, DECISION, "", lambda: steering(plan, people), CALLS)


def variants() -> tuple[str, ...]:
    """Return the physics that the bare environment is measured with in this checkout."""
    if "physics" not in inspect.signature(make_env).parameters:
        return ("grid",)
    registry = getattr(one_of(REGISTRIES), "PHYSICS", None)
    names = registry.names() if registry is not None else ("torch", "compiled")
    plain = ("kernel.step",) if kernel() else ()
    return (*(name for name in names if name not in UNBATCHED), *plain)


def kernel() -> Any:
    """Return the module of `kernel.step`; None where there is none."""
    return one_of(KERNELS)


def one_of(names: Sequence[str]) -> Any:
    """Return the first of these modules that this checkout has; None if it has none."""
    for name in names:
        try:
            return import_module(name)
        except ModuleNotFoundError:
            continue
    return None


load_policy = one_of(POLICIES).load_policy


class Walk:
    """People in the middle of their episodes, not all of which end in the same step."""

    def __init__(self, scenes: int, people: int, policy: str, physics: str) -> None:
        """Walk for `WARM` seconds."""
        self.policy = load_policy(policy)
        settings: dict[str, Any] = {"physics": physics} if physics else {}
        self.env: Any = make_env(
            SCENARIO.format(people=people), scenes, decision_dt=self.policy.decision_dt, **settings
        )
        bind = getattr(self.policy, "bind", None)
        if bind is not None:
            bind(self.env.bank)
        self.now = self.env.reset()
        for _ in range(round(WARM / self.policy.decision_dt)):
            self.step()

    @torch.no_grad()
    def step(self) -> None:
        """Let every person decide once and walk; scenes that end begin anew."""
        _, self.now = self.env.step_and_maybe_reset(self.policy(self.now))


def walking(scenes: int, people: int, policy: str, physics: str) -> tuple[Step, None]:
    """Return a step of the environment through EnvBase, resets included."""
    return Walk(scenes, people, policy, physics).step, None


def kernel_loop(scenes: int, people: int, policy: str, physics: str) -> tuple[Step, Step]:
    """Return a step of `kernel.step` alone, with the commands of one decision, and what puts people back."""
    walk, advance = Walk(scenes, people, policy, physics), kernel().step
    start, commands = walk.env.state, walk.policy(walk.now)["agents", "action"]
    state = start

    @torch.no_grad()
    def step() -> None:
        nonlocal state
        state = advance(state, commands, walk.env.physics, walk.env.rules)[0]

    def again() -> None:
        nonlocal state
        state = start

    return step, again


def steering(plan: str, people: int) -> tuple[Step, Step]:
    """Return a call of the stepping controller that decides for every person, and what puts people back."""
    controller = pedzoo.load(MODEL).controller(plan, dt=DECISION)
    free = free_points(load_plan(plan), "wall", 0.3)
    points = np.random.default_rng(0).choice(free, 2 * people, replace=False)
    goals, position = dict(enumerate(points[people:])), points[:people]

    def step() -> None:
        nonlocal position
        velocity = controller.step(dict(enumerate(position)), goals)
        position = position + DECISION * np.stack([velocity[person] for person in range(people)])

    def again() -> None:
        nonlocal position
        controller.reset(0)
        position = points[:people]
        for _ in range(OBSERVED):
            step()

    return step, again


if __name__ == "__main__":
    tree = str(Path(pedzoo.__file__).resolve().parents[1])
    serve("pedzoo", {"torch": torch.__version__, "tree": tree}, cases)
