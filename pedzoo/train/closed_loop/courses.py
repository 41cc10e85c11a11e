"""The courses of a training in the loop: environments, each with a share of the updates."""

from dataclasses import dataclass, field

import torch
from tensordict import TensorDict
from torch import Tensor

from pedzoo.core.errors import UserError
from pedzoo.core.randomness import join, uniform
from pedzoo.sim.env import PedestrianEnv
from pedzoo.sim.make import make_env, make_scenario


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
        age: Segments since each scene began (B,) long; negative ones begin next time.
    """

    course: Course
    env: PedestrianEnv
    age: Tensor = field(default_factory=lambda: torch.zeros(0))

    def begin(self, max_segments: int) -> TensorDict:
        """Return the observation at the beginning of the next segment.

        Scenes that are over, or have gone on for ``max_segments`` segments, are replaced by new ones. Others
        go on where they are: agents that are stuck have to find the way out.
        """
        fresh = (self.age < 0) | (self.age >= max_segments)
        if len(self.age) == 0:
            seen = self.env.reset()
            self.age = torch.zeros(self.env.batch_size[0], dtype=torch.long)
            return seen
        seen = self.env.cut()
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
