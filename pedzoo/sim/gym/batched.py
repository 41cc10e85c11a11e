"""The batched environment in NumPy, which the single, the vector and the parallel environment share."""

import os
import sys
from typing import Any, cast

import numpy as np
import torch
from gymnasium import spaces
from numpy.typing import ArrayLike, NDArray
from tensordict import TensorDict, TensorDictBase
from torch import Tensor

from pedzoo.core.batch import ROBOT, agents_of
from pedzoo.core.errors import UserError, installed
from pedzoo.core.geometry import direction_of
from pedzoo.core.types import TRACE_SECONDS
from pedzoo.sim.drawing import Camera, Canvas, check_size, person_color
from pedzoo.sim.physics._base import Bodies
from pedzoo.sim.robots.env import RobotEnv, make_robot_env

MODES = ("rgb_array", "human")
"""What ``render_mode`` may be, beside None."""

FPS = 5
"""Pictures a second at which videos run as fast as the world, where robots decide every 0.2 s."""

OWN = ("goal", "radius", "velocity", "heading", "turn_rate", "waypoint", "remaining_path")
"""Readings of which the vector ``robot`` is made, in this order; those that no sensor gives are left out."""

NAMES = {"people_mask": "mask", "patch": "map"}
"""What Gymnasium's users call readings; all others keep their names."""

PERSONAL_SPACE = 0.45
"""Metres between bodies of which people keep free what they can (Hall 1966; SocNavGym)."""

FLAGS = {
    "SUCCESS": "success",
    "COLLISION_HUMAN": "person_contact",
    "COLLISION_ROBOT": "robot_contact",
    "COLLISION_WALL": "wall_contact",
    "TIMEOUT": "timeout",
    "FAILED": "failed",
}
"""Flags of ``info`` under the names of CrowdNav and SocNavGym, and what `Outcome` calls them."""

Observation = dict[str, NDArray[Any]]

Step = tuple[Observation, NDArray[np.float64], NDArray[np.bool_], NDArray[np.bool_], dict[str, NDArray[Any]]]
"""Observations (B, R, ...), rewards, 0 after a reset, both kinds of ends, and info: `FLAGS` and `Totals`."""


class Observations:
    """Turns the readings of sensors into the Dict observation, and says what space it is in.

    Attributes:
        space: Of one robot.
        columns: Where each reading is in ``robot``.
    """

    def __init__(self, spec: Any) -> None:
        """Take what ``robots/observation`` is like, (B, R, ...)."""
        readings: dict[str, Any] = {name: _space(spec[name]) for name in spec.keys()}
        own = {name: readings.pop(name) for name in OWN if name in readings}
        ends = np.cumsum([0, *(box.low.size for box in own.values())]).tolist()
        self.columns = {name: slice(*ends[place : place + 2]) for place, name in enumerate(own)}
        self._others = {name: NAMES.get(name, name) for name in readings}
        entries = {self._others[name]: space for name, space in readings.items()}
        if own:
            low, high = (
                np.concatenate([getattr(box, end).ravel() for box in own.values()]) for end in ("low", "high")
            )
            entries = {"robot": spaces.Box(low, high, dtype=np.float32), **entries}
        self.space = spaces.Dict(entries)

    def __call__(self, seen: Any) -> Observation:
        """Return the observations (B, R, ...) of a batch; the arrays are the caller's own."""
        result: Observation = {}
        if self.columns:
            result["robot"] = torch.cat([seen[name].flatten(2) for name in self.columns], -1).cpu().numpy()
        for name, called in self._others.items():
            result[called] = seen[name].cpu().numpy().astype(self.space[called].dtype, copy=True)
        return result


def _space(spec: Any) -> spaces.Space[Any]:
    """Return the space of an entry (B, R, ...) of one robot."""
    if spec.dtype == torch.bool:
        shape = spec.shape[2:]
        return spaces.MultiBinary(shape[0] if len(shape) == 1 else list(shape))
    low, high = (side[0, 0].cpu().numpy() for side in (spec.space.low, spec.space.high))
    return spaces.Box(low, high, dtype=low.dtype.type)


class Totals:
    """Adds up what robots (B, R) have done since their episodes began, for ``info``."""

    def __init__(self, env: RobotEnv) -> None:
        """Take the environment, whose next observation is that of a reset."""
        self._env, self._last = env, slice(-env.robots, None)
        self._zero = torch.zeros(env.batch_size[0], env.robots, device=env.device)
        names = ("shortest", "gap", "seconds", "length", "personal")
        self._sums: dict[str, Tensor] = dict.fromkeys(names, self._zero)
        self._place = self._zero.unsqueeze(-1).expand(-1, -1, 2)

    def begin(self, seen: TensorDictBase, scenes: Tensor) -> None:
        """Begin anew in some ``scenes`` (B,) bool of which ``seen`` is the first observation."""
        agents, row = agents_of(seen), scenes.view(-1, 1)
        here = cast("Tensor", agents["history"])[:, self._last, -1]
        shortest = cast("Tensor", agents["info", "remaining_path"])[:, self._last]
        new = {"shortest": shortest, "gap": self._gap(seen, here.unsqueeze(2))}
        for name, total in self._sums.items():
            self._sums[name] = torch.where(row, new.get(name, self._zero), total)
        self._place = torch.where(row.unsqueeze(-1), here, self._place)

    def add(self, seen: TensorDictBase) -> None:
        """Add the decision of which ``seen`` is the observation; robots that had ended do not move."""
        sums, active = self._sums, cast("Tensor", seen["robots", "info", "active"])
        trace = cast("Tensor", agents_of(seen)["info", "trace"])[:, self._last]
        way = torch.cat((self._place.unsqueeze(2), trace), 2).diff(dim=2)
        seconds, gap = TRACE_SECONDS * trace.shape[2], self._gap(seen, trace)
        sums["seconds"] = sums["seconds"] + seconds * active
        sums["length"] = sums["length"] + active * torch.linalg.vector_norm(way, dim=-1).sum(-1)
        sums["personal"] = sums["personal"] + seconds * (active & (gap < PERSONAL_SPACE))
        sums["gap"] = torch.where(active, gap, sums["gap"])
        self._place = trace[:, :, -1]

    def info(self, seen: TensorDictBase) -> dict[str, NDArray[Any]]:
        """Return what ``info`` says (B, R)."""
        result = {name: cast("Tensor", seen["robots", "info", key]) for name, key in FLAGS.items()}
        success, (shortest, gap, seconds, length, personal) = result["SUCCESS"], self._sums.values()
        fastest = shortest / self._env.fleet.top_speed
        result |= {
            "COLLISION": result["COLLISION_HUMAN"] | result["COLLISION_ROBOT"] | result["COLLISION_WALL"],
            "is_success": success,
            "TIME_TO_REACH_GOAL": seconds,
            "PATH_LENGTH": length,
            "SPL": success * shortest / length.maximum(shortest).clamp_min(1e-6),
            "STL": success * fastest / seconds.maximum(fastest).clamp_min(1e-6),
            "MINIMUM_DISTANCE_TO_HUMAN": gap,
            "PERSONAL_SPACE_COMPLIANCE": 1 - personal / seconds.clamp_min(TRACE_SECONDS),
        }
        return {name: value.cpu().numpy().copy() for name, value in result.items()}

    def _gap(self, seen: TensorDictBase, mine: Tensor) -> Tensor:
        """Return how near people's bodies came (B, R) on robots' ways (B, R, S, 2), metres."""
        agents = agents_of(seen)
        radius = cast("Tensor", agents["radius"])[..., 0]
        person = agents["mask"] & (agents["kind"] != ROBOT)
        theirs = cast("Tensor", agents["info", "trace"])[:, :, -mine.shape[2] :]
        apart = torch.linalg.vector_norm(mine.unsqueeze(2) - theirs.unsqueeze(1), dim=-1)
        gap = apart - (radius[:, self._last].unsqueeze(2) + radius.unsqueeze(1)).unsqueeze(-1)
        return gap.masked_fill(~person[:, None, :, None], torch.inf).amin((2, 3))


class Batched:
    """Scenes with R robots each that Gymnasium's and PettingZoo's environments run.

    Attributes:
        env: The environment of TorchRL.
        observations: What robots observe, and its space.
        actions: The space of every robot's actions; the bounds are its limits.
        modes: What ``render_mode`` may be on this machine: a window needs a display.
    """

    def __init__(
        self,
        scenario: Any,
        render_mode: str | None,
        seed: int | None,
        size: tuple[int, int],
        settings: dict[str, Any],
        several_robots: bool = False,
    ) -> None:
        """Make the environment; arguments and errors as of `pedzoo.sim.gym.env.OneScene`."""
        if render_mode is not None and render_mode not in MODES:
            raise UserError(f"render_mode {render_mode!r}: expected one of {', '.join(MODES)}, or None")
        self.env: RobotEnv = make_robot_env(scenario, **settings)
        self.observations = Observations(self.env.observation_spec["robots", "observation"])
        limits = [np.array(body.limits, dtype=np.float32).T for body in self.env.scenes.bodies]
        self.actions = [spaces.Box(low, high, dtype=np.float32) for low, high in limits]
        self.modes = list(MODES if _has_display() else MODES[:1])
        self._seed, self._begun, self._totals = seed, False, Totals(self.env)
        check_size(size)
        self._mode, self._size, self._cameras = render_mode, size, dict[int, Camera]()
        self._window: Any = _window() if render_mode == "human" else None
        if self.env.robots > 1 and not several_robots:
            raise UserError(
                f"{self.env.robots} robots: Gymnasium's environments have one; several of them have "
                "pedzoo.sim.gym.parallel.parallel_env(...)"
            )

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
        begun, self._begun = self._begun, True
        which = scenes if begun and scenes is not None else np.ones(self.env.batch_size[0], dtype=bool)
        if seed is None and not begun:
            seed = int(chance.integers(2**31)) if self._seed is None else self._seed
        if seed is None:
            return self.restart(which)
        if not begun:
            self.env.set_seed(0 if isinstance(seed, list) else seed)
        if isinstance(seed, list) or begun:
            self.env.choose_scenes(torch.from_numpy(which), seed)
        return self.restart(None if which.all() else which)

    def restart(self, scenes: NDArray[np.bool_] | None = None) -> Step:
        """Begin the next episodes of some scenes (B,) bool, or all anew."""
        size, device = self.env.batch_size, self.env.device
        which = torch.ones(size, dtype=torch.bool) if scenes is None else torch.from_numpy(scenes)
        flags = TensorDict({"_reset": which.to(device).unsqueeze(-1)}, size, device=device)
        seen = self.env.reset(None if scenes is None else flags)
        self._totals.begin(seen, which.to(device))
        self._cameras.clear()  # they stand still until scenes end
        return self._step_of(seen)

    def step(self, action: ArrayLike) -> Step:
        """Take a decision of all robots (B, R, 2), or (B, 2) of one in each scene.

        Raises:
            UserError: The action has another shape.
        """
        given = torch.as_tensor(np.asarray(action, dtype=np.float32), device=self.env.device)
        scenes, robots = self.env.batch_size[0], self.env.robots
        # one scene, or one robot, needs no dimension of its own
        shapes = [(scenes, robots, 2)] + [(scenes, 2)] * (robots == 1)
        shapes += [shape[1:] for shape in shapes] * (scenes == 1)
        if tuple(given.shape) not in shapes:
            raise UserError(f"action of shape {tuple(given.shape)}: expected {(robots, 2)} per scene")
        group = TensorDict({"action": given.view(scenes, robots, 2)}, (scenes, robots))
        actions = TensorDict({"robots": group}, self.env.batch_size, device=self.env.device)
        seen = cast("TensorDictBase", self.env.step(actions)["next"])
        self._totals.add(seen)
        return self._step_of(seen)

    def _step_of(self, seen: TensorDictBase) -> Step:
        if self._window is not None:
            self._window.clear()
            self._window.set_axis_off()
            self._window.imshow(self._picture(0))
            self._window.figure.canvas.draw_idle()
            self._window.figure.canvas.flush_events()
        robots: Any = seen["robots"]
        reward = robots.get("reward", torch.zeros_like(robots["done"], dtype=torch.double))
        ends = [robots[name][..., 0].cpu().numpy().copy() for name in ("terminated", "truncated")]
        observation, reward = self.observations(robots["observation"]), reward[..., 0].double().cpu().numpy()
        return observation, reward, ends[0], ends[1], self._totals.info(seen)

    def pictures(self) -> list[NDArray[np.uint8]] | None:
        """Return a picture (H, W, 3) of every scene; None where they are shown in a window, or not at all."""
        scenes = self.env.batch_size[0]
        return [self._picture(scene) for scene in range(scenes)] if self._mode == "rgb_array" else None

    def close(self) -> None:
        """Close the window and what the physics holds outside of Python."""
        if self._window is not None:
            import matplotlib.pyplot as plt

            plt.close(self._window.figure)
            self._window = None
        self.env.physics.close()

    def _picture(self, scene: int) -> NDArray[np.uint8]:
        """Return a scene from the top (H, W, 3), with robots' headings and goals."""
        physics, state, size = self.env.physics, self.env.state, self._size
        bodies, there = Bodies.of(state), state.mask[scene]
        if scene not in self._cameras:
            seen = torch.cat((state.position[scene][there], state.goal_point[scene][there]))
            camera = Camera().around(seen, size) if int(state.map_id[scene]) < 0 else None
            self._cameras[scene] = physics.framed(bodies, scene, size, camera)
        camera = self._cameras[scene]
        canvas = Canvas(np.ascontiguousarray(physics.image(bodies, scene, size, camera)), camera)
        turn = torch.linspace(0, 2 * torch.pi, 33, device=state.heading.device)
        for slot in range(state.mask.shape[1] - self.env.robots, state.mask.shape[1]):
            if there[slot]:
                here, radius = state.position[scene, [slot]], state.radius[scene, slot]
                ring = here + radius * direction_of(state.heading[scene, slot] + turn)
                canvas.line(torch.cat((here, ring)), (0, 0, 0), 2)  # the front, and all around
                canvas.goal(state.goal_point[scene, slot], person_color(slot), 2)
        return canvas.image


def _has_display() -> bool:
    shown = sys.platform in ("darwin", "win32") or any(map(os.environ.get, ("DISPLAY", "WAYLAND_DISPLAY")))
    backend = os.environ.get("MPLBACKEND", "").lower()
    drawn = backend not in ("agg", "cairo", "pdf", "pgf", "ps", "svg", "template")
    return shown and drawn and installed("matplotlib")


def _window() -> Any:
    import matplotlib.pyplot as plt
    from matplotlib.backends.registry import BackendFilter, backend_registry

    backend = plt.get_backend()
    windows = [name.lower() for name in backend_registry.list_builtin(BackendFilter.INTERACTIVE)]
    if backend.lower() not in windows:
        raise UserError(
            f"render_mode 'human' needs a display, and matplotlib has none here (its backend is {backend}): "
            "use render_mode='rgb_array', or set DISPLAY"
        )
    plt.ion()
    return plt.figure("pedzoo").add_axes((0, 0, 1, 1))
