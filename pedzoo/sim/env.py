"""The scene as a TorchRL environment: people walk through a building, B scenes at once."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from tensordict import TensorDict, TensorDictBase
from torch import Tensor
from torchrl.data import Composite
from torchrl.envs import EnvBase

from pedzoo.core.adapters import copied, put, tensordict_of, worker_number
from pedzoo.core.batch import actions_of, agents_of
from pedzoo.core.errors import UserError, as_integer, at_least_one
from pedzoo.core.machine import usable
from pedzoo.core.randomness import signed
from pedzoo.core.types import BODY_RADIUS, STEP_SECONDS, TRACE_SECONDS
from pedzoo.maps.bank import MapBank
from pedzoo.maps.planning.guidance import Guidance
from pedzoo.sim import kernel
from pedzoo.sim.drawing import check_size
from pedzoo.sim.dynamics import substeps
from pedzoo.sim.episodes import EpisodeQueue, Episodes, Scenes, WarmStart
from pedzoo.sim.observation import done_spec, observation_spec, observed, real
from pedzoo.sim.physics._base import Physics
from pedzoo.sim.scenario import WARM_SECONDS, PreparedScenario, Scenario, rules_of
from pedzoo.sim.state import TRACE_PER_STEP, Events, State


class PedestrianEnv(EnvBase):
    """A policy decides all velocities, agents move, and physics finds their contacts.

    Keys as in `pedzoo.core.batch`, with ``action`` (m/s) and ``reward`` under ``agents``. Closed-loop
    metrics read ``agents/info``. Its ``trace``, ``agent_contact``, ``wall_contact`` and ``reached`` are
    those of every 0.1 s since the last decision (`Events`), ``overdue`` and ``remaining_path`` of `State`.

    The reward is the path that got shorter, in metres, less `CONTACT_COST` for a contact.
    Noise is drawn by `scene_key`, which names the scene in any row.

    Attributes:
        group: Key under which actions and rewards stand.
        policy_name: Name of the policy in warnings.
        prepared: The scenario, with its floor plans and paths; ``seed`` is that of its scenes.
    """

    group = "agents"
    policy_name = "the policy"

    def __init__(
        self,
        prepared: PreparedScenario,
        physics: Physics,
        num_envs: int = 1,
        seed: int | None = None,
        decision_dt: float = STEP_SECONDS,
        warm_start: WarmStart = "orca",
        first_episode: int = 0,
        stride: int | None = None,
        body_radius: float = BODY_RADIUS,
        device: torch.device | str = "cpu",
        deadline: float | None = None,
    ) -> None:
        """Take a prepared scenario and the physics that moves its people; `pedzoo.make_env` does both.

        Args:
            prepared: The result of `Scenario.prepare`.
            physics: Moves agents, and finds contacts.
            num_envs: B.
            seed: Of all scenes; scene i of a seed is the same however many are run at once. None: 0, and in
                processes that Python has started, such as a collector's workers, the number of the process.
            decision_dt: Seconds between two decisions, a multiple of 0.1.
            warm_start: Where the first 8 observed steps come from: ``orca``, ``igibson`` (its ORCA, in this
                physics), ``static``, or ``recorded``.
            first_episode: Number of the first scene.
            stride: A scene that ends is followed by the one this many numbers on: ``num_envs`` by default,
                and ``num_envs`` times the number of workers where several share a seed.
            body_radius: Of a person, metres.
            device: Where scenes are, and everything that they are looked up in.
            deadline: Seconds that people have for every goal; see `pedzoo.make_env`.

        Raises:
            UserError: A setting is out of range.
        """
        trace_points = round(decision_dt / TRACE_SECONDS) if 0 < decision_dt <= WARM_SECONDS + 1e-6 else 0
        if trace_points < 1 or abs(trace_points * TRACE_SECONDS - decision_dt) > 1e-6:
            most = f"{TRACE_SECONDS:g} s up to {WARM_SECONDS:g} s"
            raise UserError(f"decision_dt {decision_dt}: expected a multiple of {most}")
        if prepared.script is not None and TRACE_PER_STEP % trace_points:
            raise UserError(
                f"decision_dt {decision_dt}: people of recordings come and are handed over every "
                f"{STEP_SECONDS} s, so a decision takes 0.1, 0.2 or 0.4 s"
            )
        num_envs = at_least_one("num_envs", num_envs)
        super().__init__(device=usable(device), batch_size=torch.Size([num_envs]))
        agents = prepared.people
        self.prepared, self.physics, self.decision_dt = prepared, physics, decision_dt
        self.group_map = {"agents": [f"person_{slot}" for slot in range(agents)]}
        smallest = min(body_radius, self.scenario.smallest_radius or body_radius)
        fine = substeps(prepared.fastest_agent, smallest)
        self.rules = rules_of(prepared, trace_points, fine, self.device, deadline)
        self._episodes = Episodes(prepared, warm_start, physics, self.rules, self.device)
        self._first = as_integer("first_episode", first_episode)
        self._stride = at_least_one("stride", num_envs if stride is None else stride)
        self._scenes: Scenes | None = None
        self._set_seed(seed)
        self.observation_spec = observation_spec(num_envs, agents, trace_points, self.bank).to(self.device)
        shape = num_envs, agents
        people = {"action": real(*shape, 2), "reward": real(*shape, 1)}
        self.action_spec, self.reward_spec = (
            Composite(agents=Composite({name: spec}, shape=shape), shape=shape[:1]).to(self.device)
            for name, spec in people.items()
        )
        self.done_spec = done_spec(num_envs).to(self.device)

    def __repr__(self) -> str:
        scenes = f"{self.batch_size[0]} scenes of {self.prepared.people} people"
        name, physics = type(self.scenario).__name__, type(self.physics).__name__
        return f"{type(self).__name__}({name}, {scenes}, {physics}, decides every {self.decision_dt:g} s)"

    @property
    def scenario(self) -> Scenario:
        """The settings of the scenes."""
        return self.prepared.scenario

    @property
    def bank(self) -> MapBank:
        """The floor plans, for models and policies that look at them."""
        return self.prepared.bank.to(self.device)

    @property
    def state(self) -> State:
        """All that is known about the scenes now; an error before the first `reset`."""
        if self._scenes is None:
            raise UserError("the environment has no scenes yet: call reset() first")
        return self._scenes.state

    def cut(self) -> TensorDict:
        """Return what all agents see now, as given: gradients go back no farther than to here."""
        state, guidance = self.state, self._scenes.guidance if self._scenes else ()
        self._scenes = Scenes.of(value.detach() for value in (*state, *guidance))
        return self._observation(*self._scenes)

    def step_and_maybe_reset(self, tensordict: TensorDictBase) -> tuple[TensorDictBase, TensorDictBase]:
        """Take a step from an observation with actions, and begin the scenes that have ended anew.

        This is `EnvBase.step_and_maybe_reset` without its general search for keys, which takes longer than a
        step of few scenes. It returns the observation with the key ``next``, and the new one. Keys that a
        policy has added stand in both.
        """
        if "next" in tensordict.keys() or "_step" in tensordict.keys():
            return super().step_and_maybe_reset(tensordict)
        if tensordict.device != self.device:
            tensordict = tensordict.to(self.device)
        after = self._step(tensordict)
        ended = after["done"]
        if bool(ended.any()):
            now = self._reset(tensordict_of({"_reset": ended}, self.batch_size, ended.device))
        else:
            now = copied(after)
            del now[self.group, "reward"]
        groups: Any = tensordict[self.group], now[self.group]
        for old, new in ((tensordict, now), groups):
            for name in set(old.keys()).difference(new.keys(), ("reward",)):
                value = old.get(name)
                new.set(name, copied(value) if isinstance(value, TensorDictBase) else value)
        tensordict.set("next", after)
        return tensordict, now

    def reset(self, tensordict: TensorDictBase | None = None, **settings: Any) -> Any:
        """Begin scenes anew, and return the observation of all agents.

        This is `EnvBase.reset`, but all rows are taken as `_reset` returns them; TorchRL would pick those
        that begin anew, key by key. ``tensordict`` says under ``_reset`` which scenes (B, 1) bool.
        """
        if tensordict is None or "_reset" not in tensordict.keys():
            return super().reset(tensordict, **settings)
        return tensordict.update(self._reset(tensordict)).exclude("_reset", inplace=True)

    def render(self, scene: int = 0, size: tuple[int, int] = (640, 480)) -> NDArray[np.uint8]:
        """Return a picture (H, W, 3) uint8 RGB of a scene from above: floor plan, people and their goals.

        ``size`` is width and height in pixels.

        Raises:
            UserError: No such row or size, or `reset` was never called.
        """
        scene = as_integer("scene", scene)
        check_size(size)
        if not 0 <= scene < self.batch_size[0]:
            raise UserError(f"scene {scene}: expected 0 to {self.batch_size[0] - 1}")
        return self.physics.picture(self.state, scene, size)

    def set_seed(self, seed: int | None = None, static_seed: bool = False) -> int | None:
        """Choose the scenes of any whole number, as `EnvBase.set_seed`, which takes no negative ones."""
        return super().set_seed(None if seed is None else as_integer("seed", seed) % 2**64, static_seed)

    def choose_scenes(self, which: Tensor, seeds: Sequence[int] | int) -> None:
        """Choose what begins next in some rows (B,) bool: scenes of one seed, or the first of B seeds."""
        rows, several = which.nonzero().view(-1).cpu(), isinstance(seeds, Sequence)
        given = seeds if isinstance(seeds, Sequence) else [seeds]
        numbers = torch.tensor([signed(as_integer("seed", seed) % 2**64) for seed in given])
        first, stride = (self._first + 0 * rows, 1) if several else (self._first + rows, self._stride)
        self._queue.choose(rows, numbers[rows * several], first, stride)

    def _set_seed(self, seed: int | None) -> None:
        self.seed = worker_number() if seed is None else as_integer("seed", seed)
        (rows,), people = self.batch_size, self.prepared.people
        self._queue = EpisodeQueue(
            self._episodes, self.rules, self._opened, people, self.seed, rows, self._first, self._stride
        )

    def _opened(self, state: State) -> State:
        """Return the first state of episodes as this environment begins them."""
        return state

    def _reset(self, tensordict: TensorDictBase | None = None, **kwargs: Any) -> TensorDictBase:
        flags = None if tensordict is None else tensordict.get("_reset", None)
        if flags is None or self._scenes is None:
            self._scenes = self._queue.begin_all()
        elif bool(flags.any()):
            self._scenes = self._queue.begin_some(self._scenes, flags.view(-1))
        observation = self._observation(*self._scenes)
        never = torch.zeros(3, *self.batch_size, 1, dtype=torch.bool, device=self.device)
        put(observation, dict(zip(("done", "terminated", "truncated"), never.unbind(), strict=True)))
        return observation

    def _step(self, tensordict: TensorDictBase) -> TensorDictBase:
        before = self.state
        action = actions_of(tensordict)
        after, guidance, outcome = kernel.step(before, action, self.physics, self.rules)
        if bool((after.failed & ~before.failed).any()):
            self._warn(action, before, after)
        self._scenes = Scenes(after, guidance)
        result = self._observation(after, guidance, outcome)
        put(agents_of(result), {"reward": outcome.reward.unsqueeze(-1)})
        terminated, truncated = outcome.terminated.unsqueeze(1), outcome.truncated.unsqueeze(1)
        put(result, {"terminated": terminated, "truncated": truncated, "done": terminated | truncated})
        return result

    def _warn(self, action: Tensor, before: State, after: State) -> None:
        scene = int((after.failed & ~before.failed).nonzero()[0])
        agent = int((~action[scene].isfinite().all(-1) & before.controlled[scene]).nonzero()[0])
        warnings.warn(
            f"{self.policy_name} gave the action {action[scene, agent].tolist()} for agent {agent} of scene "
            f"{scene}: the scene ends as failed, others go on",
            stacklevel=2,
        )

    def _observation(self, state: State, guidance: Guidance, outcome: Events | None = None) -> TensorDict:
        if outcome is None:
            points = round(self.decision_dt / TRACE_SECONDS)
            nothing = torch.zeros(*state.mask.shape, points, dtype=torch.bool, device=self.device)
            reached = state.reached.unsqueeze(-1).expand(-1, -1, points).contiguous()
            happened = state.past[:, :, -points:], nothing, nothing, reached
        else:
            happened = outcome[:4]
        info = dict(zip(Events._fields, happened, strict=False))
        info |= {"overdue": state.overdue, "remaining_path": state.remaining_path}
        batch = observed(state, guidance, self.bank)
        put(agents_of(batch), {"info": tensordict_of(info, state.mask.shape, state.mask.device)})
        put(batch, {"failed": state.failed.unsqueeze(1)})
        return batch
