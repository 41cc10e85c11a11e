"""Many scenes at once as Gymnasium's vector environment: the batched environment itself, not copies."""

from __future__ import annotations

from typing import Any, ClassVar

import numpy as np
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from numpy.typing import ArrayLike, NDArray

from pedzoo.core.errors import UserError
from pedzoo.core.spec import Spec
from pedzoo.sim.gym.batched import Batched, Step
from pedzoo.sim.gym.env import FPS, check_one_robot
from pedzoo.sim.gym.render import MODES
from pedzoo.sim.gym.spaces import Observation

Infos = dict[str, Any]


class RobotVectorEnv(VectorEnv[Observation, ArrayLike, NDArray[Any]]):
    """B scenes with one robot each, stepped together: `gymnasium.make_vec` makes it.

    Scene i of a seed is that of `RobotGymEnv` with ``first_episode=i``. A scene that ends begins anew in the
    same step: ``final_obs`` and ``final_info`` then have what came of the last decision.

    Attributes:
        batched: The environment of TorchRL (``batched.env``) behind it.
    """

    metadata: ClassVar[dict[str, Any]] = {
        "render_modes": list(MODES),
        "render_fps": FPS,
        "autoreset_mode": AutoresetMode.SAME_STEP,
    }

    def __init__(
        self,
        scenario: str | Spec,
        num_envs: int = 1,
        render_mode: str | None = None,
        seed: int | None = None,
        render_size: tuple[int, int] = (640, 480),
        **settings: Any,
    ) -> None:
        """Make the scenes.

        Args:
            scenario: As in `pedzoo.make_robot_env`.
            num_envs: B.
            render_mode: ``rgb_array`` for pictures of all scenes, ``human`` for a window of one, or None.
            seed: Of the scenes; `reset` takes it, too. None: by chance.
            render_size: Width and height of pictures in pixels.
            settings: As of `pedzoo.make_robot_env`.

        Raises:
            UserError: An unknown name or setting, several robots, or no display for a window.
        """
        self.batched = Batched(scenario, render_mode, seed, render_size, settings | {"num_envs": num_envs})
        check_one_robot(self.batched)
        self.num_envs, self.render_mode = num_envs, render_mode
        self.single_observation_space = self.batched.observations.space
        self.single_action_space = self.batched.actions[0]
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, Infos]:
        """Begin the first scenes of a seed, or else the next ones; there are no options.

        Raises:
            UserError: A list of seeds: the scenes of one seed differ already.
        """
        if seed is not None and not isinstance(seed, int | np.integer):
            raise UserError(
                f"seed {seed!r}: expected one number; scene i of a seed is another one for every i"
            )
        super().reset(seed=seed)
        step = self.batched.reset(seed, self.np_random)
        return _observation(step), _infos(step)

    def step(
        self, actions: ArrayLike
    ) -> tuple[Observation, NDArray[np.float64], NDArray[np.bool_], NDArray[np.bool_], Infos]:
        """Take a decision in every scene (B, 2), and begin those anew that have ended."""
        step = self.batched.step(actions)
        observation, infos = _observation(step), _infos(step)
        terminated, truncated = step.terminated[:, 0], step.truncated[:, 0]
        over = terminated | truncated
        if over.any():
            new = self.batched.restart(over)
            last, finished = observation, infos
            observation, infos = _merged(_observation(new), last, over), _merged(_infos(new), finished, over)
            finals = np.full(self.num_envs, None, dtype=object)
            for scene in over.nonzero()[0]:
                finals[scene] = {name: value[scene] for name, value in last.items()}
            flags = {name: over & value for name, value in finished.items() if name.startswith("_")}
            infos |= {"final_obs": finals, "_final_obs": over}
            infos |= {"final_info": finished | flags, "_final_info": over.copy()}
        return observation, step.reward[:, 0], terminated, truncated, infos

    def render(self) -> tuple[NDArray[np.uint8], ...] | None:
        """Return a picture (H, W, 3) of every scene in the mode ``rgb_array``."""
        pictures = self.batched.picture()
        return tuple(pictures) if pictures else None

    def close_extras(self, **kwargs: Any) -> None:
        """Close the window and the physics."""
        self.batched.close()


def _observation(step: Step) -> Observation:
    return {name: value[:, 0] for name, value in step.observation.items()}


def _infos(step: Step) -> Infos:
    """Return the values (B,) of all scenes, each with the mask of scenes that have it: all."""
    infos: Infos = {}
    for name, value in step.info.items():
        infos |= {name: value[:, 0], f"_{name}": np.ones(len(value), dtype=bool)}
    return infos


def _merged(new: Infos, old: Infos, where: NDArray[np.bool_]) -> Infos:
    """Return values (B, ...) by name: the new ones of scenes ``where`` (B,), and the old ones of others."""
    return {
        name: np.where(where.reshape(-1, *[1] * (value.ndim - 1)), value, old[name])
        for name, value in new.items()
    }
