"""Many scenes at once as Gymnasium's vector environment."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from numpy.typing import ArrayLike, NDArray

from pedzoo.core.errors import UserError, as_integer, at_least_one, unknown
from pedzoo.core.spec import Spec
from pedzoo.sim.gym.batched import Batched, Observation, Step
from pedzoo.sim.gym.env import Infos, RobotGymEnv


class RobotVectorEnv(VectorEnv[Observation, ArrayLike, NDArray[Any]]):
    """B scenes with one robot each, stepped together: `gymnasium.make_vec` makes it.

    The batched environment itself, not copies. Scene i of a seed is that of `RobotGymEnv` with
    ``first_episode=i``. A scene that ends begins anew in the same step: ``final_obs`` and ``final_info`` then
    have what came of the last decision. Or it does so in the next step, whose action does not count, or when
    `reset` is called with a mask.

    Attributes:
        batched: The environment of TorchRL (``batched.env``) behind it.
        autoreset_mode: When scenes begin anew.
    """

    metadata: dict[str, Any] = RobotGymEnv.metadata | {"autoreset_mode": AutoresetMode.SAME_STEP}

    def __init__(
        self,
        scenario: str | Spec,
        num_envs: int = 1,
        render_mode: str | None = None,
        seed: int | None = None,
        render_size: tuple[int, int] = (640, 480),
        autoreset_mode: AutoresetMode | str = AutoresetMode.SAME_STEP,
        **settings: Any,
    ) -> None:
        """Make B scenes, ``num_envs``; other arguments are as of `pedzoo.sim.gym.env.OneScene`.

        Pictures are of all scenes, a window shows one. ``autoreset_mode`` says when scenes begin anew that
        have ended: ``SameStep``, ``NextStep`` or ``Disabled``.
        """
        modes = {mode.value: mode for mode in AutoresetMode}
        mode = autoreset_mode if isinstance(autoreset_mode, AutoresetMode) else modes.get(autoreset_mode)
        if mode is None:
            raise unknown("autoreset_mode", str(autoreset_mode), modes)
        num_envs = at_least_one("num_envs", num_envs)
        self.batched = Batched(scenario, render_mode, seed, render_size, settings | {"num_envs": num_envs})
        self.num_envs, self.render_mode, self.autoreset_mode = num_envs, render_mode, mode
        self.metadata = self.metadata | {"autoreset_mode": mode, "render_modes": self.batched.modes}
        self._over: NDArray[np.bool_] = np.zeros(num_envs, dtype=bool)
        self._seen: Observation = {}
        self.single_observation_space = self.batched.observations.space
        self.single_action_space = self.batched.actions[0]
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)

    def reset(
        self, *, seed: int | Sequence[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, Infos]:
        """Begin the first scenes of a seed, or else the next ones.

        Args:
            seed: Scene i is that of number i; of B seeds, each scene is the first one of its own, as that of
                `RobotGymEnv` is. None among them: by chance.
            options: ``reset_mask`` (B,) bool: scenes that begin, while others stay. Infos are of these alone.

        Raises:
            UserError: Not one seed nor B of them, or a mask of another shape, of other values or of no scene.
        """
        several = isinstance(seed, list | tuple) or (isinstance(seed, np.ndarray) and seed.ndim > 0)
        given: Any = seed if several else ()
        if several and len(given) != self.num_envs:
            raise UserError(f"seed of {len(given)} numbers: expected one, or {self.num_envs}, one of each")
        one = None if seed is None or several else as_integer("seed", seed)
        super().reset(seed=one)
        chance = self.np_random
        seeds = [int(chance.integers(2**31)) if it is None else as_integer("seed", it) for it in given]
        which = (options or {}).get("reset_mask", np.ones(self.num_envs, dtype=bool))
        shaped = isinstance(which, np.ndarray) and which.dtype == bool and which.shape == (self.num_envs,)
        if not shaped or not which.any():
            raise UserError(
                f"reset_mask {which!r:.100}: expected an array ({self.num_envs},) bool, not all false"
            )
        which = which if self._seen else np.ones_like(which)
        infos = self._take(self.batched.reset(seeds or one, chance, which), which)
        self._over = self._over & ~which
        return self._seen, infos | {name: which.copy() for name in infos if name.startswith("_")}

    def step(
        self, actions: ArrayLike
    ) -> tuple[Observation, NDArray[np.float64], NDArray[np.bool_], NDArray[np.bool_], Infos]:
        """Take a decision in every scene (B, 2), and begin those anew that have ended.

        Raises:
            UserError: An action has another shape, or a scene is over that `reset` should have begun.
        """
        begins, mode = self._over, self.autoreset_mode
        if begins.any():
            if mode is AutoresetMode.DISABLED:
                raise UserError(
                    f"scenes {begins.nonzero()[0].tolist()} are over: expected reset(options={{'reset_mask': "
                    "terminated | truncated}) before the next step"
                )
            actions = np.where(begins.reshape(-1, 1), 0.0, np.asarray(actions))
        step = self.batched.step(actions)
        infos, (_, rewards, ends, cuts, _) = self._take(step), step
        reward, terminated, truncated = rewards[:, 0], ends[:, 0], cuts[:, 0]
        if begins.any():
            infos = self._take(self.batched.restart(begins), begins, infos)
            reward[begins], terminated[begins], truncated[begins] = 0.0, False, False
        over = terminated | truncated
        if mode is not AutoresetMode.SAME_STEP:
            self._over = over
        elif over.any():
            last, finished = self._seen, infos
            infos = self._take(self.batched.restart(over), over, finished)
            finals = np.full(self.num_envs, None, dtype=object)
            for scene in over.nonzero()[0]:
                finals[scene] = {name: value[scene] for name, value in last.items()}
            flags = {name: over.copy() for name in finished if name.startswith("_")}
            infos |= {"final_obs": finals, "_final_obs": over}
            infos |= {"final_info": finished | flags, "_final_info": over.copy()}
        return self._seen, reward, terminated, truncated, infos

    def _take(self, step: Step, where: NDArray[np.bool_] | None = None, old: Infos | None = None) -> Infos:
        """Keep observations of scenes ``where`` (B,) bool, or all; return infos, those of others ``old``."""
        where = np.ones(self.num_envs, dtype=bool) if where is None else where

        def merged(new: Infos, before: Infos) -> Infos:
            rows = {name: where.reshape(-1, *[1] * (value.ndim - 1)) for name, value in new.items()}
            return {name: np.where(rows[name], value, before.get(name, value)) for name, value in new.items()}

        infos = {name: value[:, 0] for name, value in step[-1].items()}
        infos |= {f"_{name}": np.ones(self.num_envs, dtype=bool) for name in infos}
        self._seen = merged({name: value[:, 0] for name, value in step[0].items()}, self._seen)
        return merged(infos, old or {})

    def render(self) -> tuple[NDArray[np.uint8], ...] | None:
        """Return a picture (H, W, 3) of every scene in the mode ``rgb_array``."""
        pictures = self.batched.pictures()
        return tuple(pictures) if pictures else None

    def close_extras(self, **kwargs: Any) -> None:
        """Close the window and the physics."""
        self.batched.close()
