"""Differentiable pieces of episodes, and the environments of a training in the loop that they come from."""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import NamedTuple, cast

import torch
from tensordict import TensorDict, TensorDictBase
from torch import Tensor

from pedzoo.core.errors import UserError
from pedzoo.core.randomness import join, uniform
from pedzoo.policies.walker import Walker
from pedzoo.sim.env import PedestrianEnv
from pedzoo.sim.make import make_env, make_scenario
from pedzoo.sim.state import CONTACT_COST

Policy = Callable[[TensorDictBase], TensorDictBase]
"""Writes each person's ``action`` (B, A, 2), m/s, into the observation."""


class Segment(NamedTuple):
    """T decisions in B scenes of A people, with S trace points each. Differentiable.

    Attributes:
        trace: Positions (T, B, A, 1 + S, 2), metres: where people were at a decision, and every 0.1 s after.
        asked: Velocities that the policy asked for (T, B, A, 2), m/s.
        action: Those that its safety layer left, if it has one (T, B, A, 2), m/s.
        velocity: Theirs when they decided (T, B, A, 2), m/s.
        progress: Way to the goal that was made (T, B, A), metres.
        pref_speed: The speed that people like (T, B, A), m/s.
        radius: Radii of their bodies (T, B, A), metres.
        goal: Their short-term goals (T, B, A, 2), metres.
        present: Which people are present when a decision is made (T, B, A) bool.
        moved: Which people the policy moves then (T, B, A) bool.
        agent_contact: Which agents touch another in the step (T, B, A) bool.
        wall_contact: Which agents touch a wall in it (T, B, A) bool.
        done: Scenes that are over at the end (B,) bool.
        map_id: Floor plans (B,) long.
        pose: Scene poses (B, 4).
    """

    trace: Tensor
    asked: Tensor
    action: Tensor
    velocity: Tensor
    progress: Tensor
    pref_speed: Tensor
    radius: Tensor
    goal: Tensor
    present: Tensor
    moved: Tensor
    agent_contact: Tensor
    wall_contact: Tensor
    done: Tensor
    map_id: Tensor
    pose: Tensor


def unrolled(env: PedestrianEnv, policy: Policy, seen: TensorDictBase, steps: int) -> Segment:
    """Return the segment of T steps of a policy in an environment, with its observations, with gradients.

    ``seen`` is the current observation, as `PedestrianEnv.reset` and `PedestrianEnv.cut` return it. Scenes
    that are over, or were before, stay as they are; no agent moves in them.
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
    """

    scenario: str
    scenes: int = 64
    share: float = 1.0

    def __post_init__(self) -> None:
        """Check the numbers. Raises UserError: one of them gives no training."""
        if self.scenes < 1 or self.share <= 0:
            raise UserError(
                f"course {self.scenario!r}: scenes {self.scenes}, share {self.share}: expected at least 1 and"
                " above 0"
            )


@dataclass
class ActiveCourse:
    """A course with its environment and the age of each scene.

    Attributes:
        course: Which.
        env: The environment, with the default physics.
        age: Segments since each scene began (B,) long; negative ones begin next time; none before the first.
    """

    course: Course
    env: PedestrianEnv
    age: Tensor = field(default_factory=lambda: torch.zeros(0))

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

    Which course an update gets, and all scenes of an epoch, depend on the seed, the update's and the epoch's
    number alone: a run that goes on sees what an uninterrupted one would have.
    """

    def __init__(self, courses: list[Course], seed: int) -> None:
        """Take the courses; ``seed`` is of their scenes.

        Raises:
            UserError: There is none, or an unknown scenario or setting.
        """
        if not courses:
            raise UserError("no courses: expected at least one scenario to train in")
        for course in courses:
            make_scenario(course.scenario)  # report a mistake before the training starts
        self.courses, self.seed = courses, seed
        self._active: dict[int, ActiveCourse] = {}
        self._shares = torch.tensor([course.share for course in courses]).cumsum(0)
        self._epoch: int | None = None

    def at(self, update: int, epoch: int, device: torch.device | str = "cpu") -> ActiveCourse:
        """Return the course of an update, its scenes on a device; in a new epoch all scenes are new."""
        if epoch != self._epoch:
            self._epoch = epoch
            for number, active in self._active.items():
                self._restart(active, number, epoch)
        key = join(torch.zeros((), dtype=torch.long), self.seed, "course", update)
        lot = uniform(key) * self._shares[-1]
        number = int((lot >= self._shares).sum().clamp_max(len(self.courses) - 1))
        if number not in self._active:
            course = self.courses[number]
            active = ActiveCourse(course, make_env(course.scenario, course.scenes, device=device))
            active.env.policy_name = "the model in training"
            self._restart(active, number, epoch)
            self._active[number] = active
        return self._active[number]

    def _restart(self, active: ActiveCourse, number: int, epoch: int) -> None:
        seed = join(torch.zeros((), dtype=torch.long), self.seed, "scenes", number, epoch)
        active.env.set_seed(int(seed) & 0x7FFFFFFF)
        active.age = torch.zeros(0)

    def close(self) -> None:
        """Let go of all environments."""
        for active in self._active.values():
            active.env.physics.close()
        self._active = {}
