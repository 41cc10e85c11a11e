"""The batched environment in NumPy: what the single, the vector and the parallel environment share."""

from __future__ import annotations

from typing import Any, NamedTuple, cast

import numpy as np
import torch
from numpy.typing import ArrayLike, NDArray
from tensordict import TensorDict, TensorDictBase

from pedzoo.core.errors import UserError
from pedzoo.sim.gym.info import Info, RobotTotals
from pedzoo.sim.gym.render import MODES, Pictures
from pedzoo.sim.gym.spaces import Observation, Observations, action_space
from pedzoo.sim.robot_parts.env import RobotEnv
from pedzoo.sim.robot_parts.make import make_robot_env


class Step(NamedTuple):
    """What came of a decision, or of a reset; all (B, R, ...).

    Attributes:
        observation: See `Observations`.
        reward: Of the robots; 0 after a reset.
        terminated: They arrived, or touched something that ends their episode.
        truncated: Their time is up, or an action was no number.
        info: See `pedzoo.sim.gym.info`.
    """

    observation: Observation
    reward: NDArray[np.float64]
    terminated: NDArray[np.bool_]
    truncated: NDArray[np.bool_]
    info: Info


class Batched:
    """Scenes with R robots each that Gymnasium's and PettingZoo's environments run.

    Attributes:
        env: The environment of TorchRL.
        observations: What robots observe, and its space.
        actions: The space of every robot's actions.
    """

    def __init__(
        self,
        scenario: Any,
        render_mode: str | None,
        seed: int | None,
        size: tuple[int, int],
        settings: dict[str, Any],
    ) -> None:
        """Make the environment; ``settings`` are those of `pedzoo.make_robot_env`.

        Raises:
            UserError: An unknown name or setting, or a scene that cannot be.
        """
        if render_mode is not None and render_mode not in MODES:
            raise UserError(f"render_mode {render_mode!r}: expected one of {', '.join(MODES)}, or None")
        self.env: RobotEnv = make_robot_env(scenario, **settings)
        self.observations = Observations(cast("Any", self.env.observation_spec["robots", "observation"]))
        self.actions = [action_space(body) for body in self.env.scenes.bodies]
        self._seed, self._begun = seed, False
        self._totals = RobotTotals(self.env)
        self._pictures = Pictures(self.env, render_mode, size)

    def reset(
        self,
        seed: int | list[int] | None,
        chance: np.random.Generator,
        scenes: NDArray[np.bool_] | None = None,
    ) -> Step:
        """Begin ``scenes`` (B,) bool, or all: those of a seed, the first of B seeds, or those that follow.

        The first time all scenes begin. A seed that is not given is that of the settings then, or one by
        ``chance``.
        """
        everything = np.ones(self.env.batch_size[0], dtype=bool)
        begun, self._begun = self._begun, True
        which = everything if scenes is None or not begun else scenes
        if seed is None:
            if begun:
                return self.restart(which)
            seed = int(chance.integers(2**31)) if self._seed is None else self._seed
        if not begun:
            self.env.set_seed(0 if isinstance(seed, list) else seed)
        if isinstance(seed, list) or begun:
            self.env.choose_scenes(torch.from_numpy(which), seed)
        return (
            self._begun_with(self.env.reset(), torch.from_numpy(which))
            if which.all()
            else self.restart(which)
        )

    def restart(self, scenes: NDArray[np.bool_]) -> Step:
        """Begin the next episodes of some scenes (B,) bool."""
        which = torch.from_numpy(scenes).to(self.env.device)
        asked = TensorDict({"_reset": which.unsqueeze(-1)}, self.env.batch_size, device=self.env.device)
        return self._begun_with(self.env.reset(asked), which)

    def step(self, action: ArrayLike) -> Step:
        """Take a decision of all robots (B, R, 2), or (B, 2) of one in each scene.

        Raises:
            UserError: The action has another shape.
        """
        given = torch.as_tensor(np.asarray(action, dtype=np.float32), device=self.env.device)
        shape = (*self.env.batch_size, self.env.robots, 2)
        scenes, robots = shape[:2]
        # one scene, or one robot, needs no dimension of its own
        alike = {shape, *([shape[1:]] if scenes == 1 else []), *([(scenes, 2)] if robots == 1 else [])}
        if scenes == robots == 1:
            alike.add((2,))
        if tuple(given.shape) not in alike:
            raise UserError(f"action of shape {tuple(given.shape)}: expected {shape[1:]} per scene")
        decided = TensorDict({"action": given.view(shape)}, shape[:2], device=self.env.device)
        asked = TensorDict({"robots": decided}, self.env.batch_size, device=self.env.device)
        seen = cast("TensorDictBase", self.env.step(asked)["next"])
        self._totals.add(seen)
        self._pictures.show()
        return self._said(seen)

    def picture(self) -> list[NDArray[np.uint8]] | None:
        """Return a picture (H, W, 3) of every scene; None where they are shown in a window, or not at all."""
        return self._pictures.taken()

    def close(self) -> None:
        """Close the window and what the physics holds outside of Python."""
        self._pictures.close()
        self.env.physics.close()

    def _begun_with(self, seen: TensorDictBase, which: torch.Tensor) -> Step:
        self._totals.begin(seen, which.to(self.env.device))
        self._pictures.begin()
        return self._said(seen)

    def _said(self, seen: TensorDictBase) -> Step:
        robots = cast("TensorDictBase", seen["robots"])
        reward = robots.get("reward", None)
        terminated, truncated = (
            cast("torch.Tensor", robots[name])[..., 0].cpu().numpy().copy()
            for name in ("terminated", "truncated")
        )
        shape = (self.env.batch_size[0], self.env.robots)
        return Step(
            self.observations(cast("TensorDictBase", robots["observation"])),
            np.zeros(shape) if reward is None else reward[..., 0].double().cpu().numpy(),
            terminated,
            truncated,
            self._totals.info(seen),
        )
