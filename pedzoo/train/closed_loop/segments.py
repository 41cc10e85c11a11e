"""Differentiable pieces of episodes, and the environments of a training in the loop that they come from."""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import NamedTuple, cast

import torch
from tensordict import TensorDict, TensorDictBase
from torch import Tensor

from pedzoo.core.errors import UserError
from pedzoo.core.randomness import join, uniform
from pedzoo.maps.planning.planner import Planner, planner_class
from pedzoo.policies.walker import Walker
from pedzoo.sim.env import PedestrianEnv
from pedzoo.sim.make import make_env, make_scenario
from pedzoo.sim.state import CONTACT_COST

Policy = Callable[[TensorDictBase], TensorDictBase]
"""Writes each person's ``action`` (B, A, 2), m/s, into the observation."""


class Segment(NamedTuple):
    """T decisions in B scenes of A people, with S trace points each. Differentiable."""

    # positions (T, B, A, 1 + S, 2), metres: where people were at a decision, and every 0.1 s after
    trace: Tensor
    asked: Tensor  # velocities that the policy asked for (T, B, A, 2), m/s
    action: Tensor  # those that its safety layer left, if it has one (T, B, A, 2), m/s
    velocity: Tensor  # theirs when they decided (T, B, A, 2), m/s
    progress: Tensor  # way to the goal that was made (T, B, A), metres
    pref_speed: Tensor  # the speed that people like (T, B, A), m/s
    radius: Tensor  # radii of their bodies (T, B, A), metres
    goal: Tensor  # their short-term goals (T, B, A, 2), metres
    present: Tensor  # which people are present when a decision is made (T, B, A) bool
    moved: Tensor  # which people the policy moves then (T, B, A) bool
    agent_contact: Tensor  # which agents touch another in the step (T, B, A) bool
    wall_contact: Tensor  # which agents touch a wall in it (T, B, A) bool
    done: Tensor  # scenes that are over at the end (B,) bool
    map_id: Tensor  # floor plans (B,) long
    pose: Tensor  # scene poses (B, 4)


def unrolled(env: PedestrianEnv, policy: Policy, seen: TensorDictBase, steps: int) -> Segment:
    """Return the segment of T steps of a policy in an environment, with gradients.

    ``seen`` is the current observation, as `PedestrianEnv.reset` and `PedestrianEnv.cut` return it. In scenes
    that are over no agent moves.
    """
    result: list[tuple[Tensor, ...]] = []
    over = torch.zeros(env.batch_size[0], dtype=torch.bool, device=seen["map_id"].device)
    map_id, pose = seen["map_id"][:, 0], seen["scene_pose"]
    for _ in range(steps):
        agents = cast("TensorDict", seen["agents"])
        there = agents["mask"] & ~over.unsqueeze(1)
        before = agents["history"][:, :, -1:]
        after = env.step(policy(seen))["next"]
        info = after["agents", "info"]
        agent_contact, wall_contact = info["agent_contact"].any(-1), info["wall_contact"].any(-1)
        moved = there & agents["controlled"]
        reward = after["agents", "reward"][..., 0]
        progress = torch.where(moved, reward + CONTACT_COST * (agent_contact | wall_contact), 0.0)
        result.append(
            (
                torch.cat((before, info["trace"]), 2),
                agents.get("unconstrained_action", agents["action"]),
                agents["action"],
                agents["velocity"],
                progress,
                agents["pref_speed"][..., 0],
                agents["radius"][..., 0],
                agents["goal"],
                there,
                moved,
                agent_contact & moved,
                wall_contact & moved,
            )
        )
        over = over | after["done"][:, 0]
        seen = after
        if bool(over.all()):
            break
    stacked = [torch.stack(values) for values in zip(*result, strict=True)]
    return Segment(*stacked, done=over, map_id=map_id, pose=pose)


@dataclass(frozen=True)
class Course:
    """A scenario to train in.

    Attributes:
        scenario: With settings, as ``door:people=4``.
        scenes: That are walked at once.
        share: Of the updates, beside those of the other courses.
        planner: As of `pedzoo.make_env`.
    """

    scenario: str
    scenes: int = 64
    share: float = 1.0
    planner: str = Planner.name

    def __post_init__(self) -> None:
        """Check the numbers. Raises UserError: one of them gives no training."""
        if self.scenes < 1 or self.share <= 0:
            raise UserError(
                f"course {self.scenario!r}: scenes {self.scenes}, share {self.share}: expected at least 1 and"
                " above 0"
            )


@dataclass
class ActiveCourse:
    """A course with its environment and the age of each scene."""

    course: Course
    env: PedestrianEnv  # the environment, with physics that has gradients
    # segments since each scene began (B,) long; negative ones begin next time; none before the first
    age: Tensor = field(default_factory=lambda: torch.zeros(0))
    epoch: int | None = None  # in which its scenes began

    def walk(self, walker: Walker, steps: int, max_segments: int) -> tuple[Segment, Tensor | None]:
        """Return the next segment, and everybody's noise when it begins; see `begin` and `unrolled`."""
        seen = self.begin(max_segments)
        noise = walker.noise_of(seen)
        segment = unrolled(self.env, walker, seen, steps)
        self.end(segment.done)
        return segment, noise

    def begin(self, max_segments: int) -> TensorDict:
        """Return the observation at the beginning of the next segment.

        Scenes that are over, or have gone on for ``max_segments`` segments, are replaced by new ones. Others
        go on where they are: agents that are stuck have to find the way out.
        """
        if len(self.age) == 0:
            self.age = torch.zeros(self.env.batch_size[0], dtype=torch.long)
            return self.env.reset()
        seen, fresh = self.env.cut(), (self.age < 0) | (self.age >= max_segments)
        if bool(fresh.any()):
            flags = TensorDict({"_reset": fresh.unsqueeze(1)}, fresh.shape).to(self.env.device)
            seen = self.env.reset(flags)
            self.age = torch.where(fresh, 0, self.age)
        return seen

    def end(self, done: Tensor) -> None:
        """Take note of a segment, and of the scenes (B,) bool that were over at its end."""
        self.age = torch.where(done.cpu(), -1, self.age + 1)


class CourseSampler:
    """Draws the course of each update, and makes its environment when it is first needed.

    Which course an update gets, and all scenes of an epoch, depend on the seed and these numbers alone.
    """

    def __init__(self, courses: list[Course], seed: int) -> None:
        """Take the courses; ``seed`` is of their scenes. Raises UserError: none, or an unknown one."""
        if not courses:
            raise UserError("no courses: expected at least one scenario to train in")
        for course in courses:
            make_scenario(course.scenario)  # report a mistake before the training starts
            planner_class(course.planner)
        self.courses, self.seed = courses, seed
        self._active: dict[int, ActiveCourse] = {}
        self._shares = torch.tensor([course.share for course in courses]).cumsum(0)

    def at(self, update: int, epoch: int, device: torch.device | str = "cpu") -> ActiveCourse:
        """Return the course of an update, its scenes on a device; in a new epoch all scenes are new."""
        nothing = torch.zeros((), dtype=torch.long)
        lot = uniform(join(nothing, self.seed, "course", update)) * self._shares[-1]
        number = int((lot >= self._shares).sum().clamp_max(len(self.courses) - 1))
        if number not in self._active:
            course = self.courses[number]
            env = make_env(course.scenario, course.scenes, "compiled", planner=course.planner, device=device)
            env.policy_name = "the model in training"
            self._active[number] = ActiveCourse(course, env)
        active = self._active[number]
        if active.epoch != epoch:
            active.epoch, active.age = epoch, torch.zeros(0)
            active.env.set_seed(int(join(nothing, self.seed, "scenes", number, epoch)) & 0x7FFFFFFF)
        return active

    def close(self) -> None:
        """Let go of all environments."""
        for active in self._active.values():
            active.env.physics.close()
        self._active = {}
