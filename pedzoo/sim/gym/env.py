"""One robot among people as a Gymnasium environment."""

from typing import Any, ClassVar

import gymnasium
from numpy.typing import ArrayLike, NDArray

from pedzoo.core.errors import UserError, as_integer
from pedzoo.core.spec import Spec
from pedzoo.sim.gym.batched import FPS, MODES, Batched, Observation, Step

Infos = dict[str, Any]


class OneScene:
    """What environments of one scene have in common.

    Attributes:
        batched: The environment of TorchRL (``batched.env``) behind it.
        several: What there is for several scenes.
        several_robots: There may be more than one robot.
    """

    metadata: dict[str, Any] = {}  # noqa: RUF012
    several: ClassVar[str] = "gymnasium.make_vec(..., num_envs=8)"
    several_robots: ClassVar[bool] = False

    def __init__(
        self,
        scenario: str | Spec,
        render_mode: str | None = None,
        seed: int | None = None,
        render_size: tuple[int, int] = (640, 480),
        **settings: Any,
    ) -> None:
        """Make the scene.

        Args:
            scenario: As in `pedzoo.make_robot_env`.
            render_mode: ``rgb_array``, ``human`` for a window, or None.
            seed: Of the scenes; `reset` takes it, too. None: by chance.
            render_size: Width and height of pictures in pixels.
            settings: As of `pedzoo.make_robot_env`; ``first_episode=i`` begins with scene i of a seed.

        Raises:
            UserError: An unknown name or setting, too many robots, or no display for a window.
        """
        if "num_envs" in settings:
            raise UserError(f"num_envs {settings['num_envs']}: this environment has one; use {self.several}")
        self.batched = Batched(scenario, render_mode, seed, render_size, settings, self.several_robots)
        self.render_mode, self.metadata = render_mode, self.metadata | {"render_modes": self.batched.modes}

    def render(self) -> NDArray[Any] | None:
        """Return a picture (H, W, 3) uint8 from the top in the mode ``rgb_array``; else None."""
        pictures = self.batched.pictures()
        return pictures[0] if pictures else None

    def close(self) -> None:
        """Close the window and the physics."""
        self.batched.close()


class RobotGymEnv(OneScene, gymnasium.Env[Any, Any]):
    """One scene with one robot; `pedzoo.sim.gym.IDS` names some.

    Observations are a Dict. ``robot`` holds what the robot knows of itself, see `Observations.columns`; all
    is in its own frame, x ahead and y to the left. ``people`` (N, 5) are x, y, vx, vy, radius of the nearest
    ones, and ``mask`` (N,) says which rows are people. Other sensors add theirs: ``lidar``, ``map``, ...
    """

    metadata: ClassVar[dict[str, Any]] = {"render_modes": list(MODES), "render_fps": FPS}

    def __init__(self, scenario: str | Spec, render_mode: str | None = None, **settings: Any) -> None:
        """Make the scene; arguments as of `OneScene`."""
        super().__init__(scenario, render_mode, **settings)
        self.observation_space = self.batched.observations.space
        self.action_space = self.batched.actions[0]

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, Infos]:
        """Begin the first scene of a seed, or else the next one; there are no options."""
        seed = None if seed is None else as_integer("seed", seed)
        super().reset(seed=seed)
        observation, *_, info = robot_of(self.batched.reset(seed, self.np_random))
        return observation, info

    def step(self, action: ArrayLike) -> tuple[Observation, float, bool, bool, Infos]:
        """Take a decision; an action that is no number truncates the episode, as ``info["FAILED"]`` says."""
        return robot_of(self.batched.step(action))


def robot_of(step: Step, robot: int = 0) -> tuple[Observation, float, bool, bool, Infos]:
    """Return what came of a decision for one robot of the first scene."""
    observation, *_, info = step
    seen = {name: value[0, robot] for name, value in observation.items()}
    reward, terminated, truncated = (part[0, robot].item() for part in step[1:4])
    return seen, reward, terminated, truncated, {name: value[0, robot].item() for name, value in info.items()}
