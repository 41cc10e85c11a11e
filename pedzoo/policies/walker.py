"""Any forecaster as a policy: asked for one next move at a time, it walks."""

from copy import copy
from typing import Self, cast, get_args

import torch
from tensordict import TensorDictBase
from torch import Tensor

from pedzoo.core import randomness
from pedzoo.core.adapters import copied
from pedzoo.core.batch import WAITING_SPEED_SHARE, agents_of, desired_speed_share, ids_of, is_walking
from pedzoo.core.errors import UserError, as_integer, unknown
from pedzoo.core.types import OBS_LEN, STEP_SECONDS, TRACE_SECONDS
from pedzoo.models.base import Forecaster, Noise
from pedzoo.models.blocks.timed_noise import timed_noise
from pedzoo.policies.clearance import SHOULDERS
from pedzoo.policies.memory import FirstSeenMemory
from pedzoo.policies.neighbours import separation_push
from pedzoo.policies.policy import NamedPolicy, deterministic
from pedzoo.policies.safety_layer import safe

AT_FIRST, _ROUNDING = 1.0, 1e-3
"""Seconds within which people set out, and by which a step is rounded."""


def stay_in_place(batch: TensorDictBase, step: Tensor) -> Tensor:
    """Return the ``step`` (B, A, 2), metres, of a model, in which people who hold a place go to it instead.

    People hold a place whose desired velocity is less than the speed that they like: it ends there in one
    step. No model has learned to stand for as long as it is asked to.
    """
    share = desired_speed_share(batch)
    if share is None:
        return step
    there = cast("Tensor", agents_of(batch)["desired_velocity"]) * STEP_SECONDS
    share = share.unsqueeze(-1)
    return torch.where(share < WAITING_SPEED_SHARE, torch.lerp(there, step, share.clamp_max(1)), step)


@torch.no_grad()
def with_walked_history(batch: TensorDictBase) -> TensorDictBase:
    """Return scenes in which people who stood when they were given their goal have walked until then.

    No model has learned to set out when it is asked to: most take a history on the spot for a standing
    person's. Places before that moment are on a straight line, at the desired velocity; later ones stay.
    ``agents/sets_out`` (B, A, 1) bool says who did it in the last second. Scenes without such people stay, as
    do those without ``agents/goal_since``.
    """
    agents = agents_of(batch)
    if "goal_since" not in agents.keys():
        return batch
    age = cast("Tensor", batch["time"]) - cast("Tensor", agents["goal_since"])[..., 0]
    new = age < (OBS_LEN - 1) * STEP_SECONDS - _ROUNDING
    if new.device.type == "cpu" and not bool(new.any()):
        return batch
    history = cast("Tensor", agents["history"])
    place = torch.arange(OBS_LEN, device=new.device)
    begin = (OBS_LEN - 1 - (age / STEP_SECONDS + _ROUNDING).clamp(0, OBS_LEN - 2).long()).unsqueeze(2)
    start, before = (history.gather(2, n[..., None].expand(-1, -1, -1, 2)) for n in (begin, begin - 1))
    way = cast("Tensor", agents["desired_velocity"]).unsqueeze(2) * STEP_SECONDS
    slow = (start - before).square().sum(-1) < (way / 2).square().sum(-1)
    stood = new & is_walking(batch) & slow[..., 0]
    if new.device.type == "cpu" and not bool(stood.any()):
        return batch
    line = start - way * (begin - place).unsqueeze(-1)
    result = copied(batch)
    seen = agents_of(result)
    seen["history"] = torch.where((stood.unsqueeze(2) & (place < begin)).unsqueeze(-1), line, history)
    seen["sets_out"] = (stood & (age < AT_FIRST)).unsqueeze(-1)
    return result


class Walker(NamedPolicy):
    """Predicts each person's future from a scene batch and walks its first step: displacement / 0.4 s.

    Under a deterministic exploration type of TorchRL the noise is zero. Else it is drawn by the scene's
    key: the same scene gets the same noise in every batch and on every worker.
    """

    decision_dt = STEP_SECONDS

    def __init__(
        self,
        model: Forecaster,
        noise: Noise | None = None,
        noise_seed: int = 0,
        safety: bool | None = None,
    ) -> None:
        """Take a forecaster.

        Args:
            model: The forecaster.
            noise: Drawn for each person once per ``episode``, at every ``step``, or once for all people of
                a ``scene`` (as Social GAN was trained); ``mixed``: the first half of its numbers as for
                ``episode``, what a person is like, the rest as for ``step``.
            noise_seed: Other seeds give other noise for the same scenes.
            safety: Whether steps are led off others and walls by `pedzoo.policies.safety_layer`; those before
                are then written, too, as ``unconstrained_action`` (B, A, 2), m/s. None: as the model says.

        Raises:
            UserError: A setting is out of range.
        """
        super().__init__()
        noise = noise or model.walking_noise
        if noise not in get_args(Noise):
            raise unknown("noise", noise, get_args(Noise))
        self.model, self.noise = model, noise
        self.name = model.name
        self.noise_seed = as_integer("noise_seed", noise_seed)
        self.safety = model.walking.safety if safety is None else safety
        self._remember_nothing()

    def _remember_nothing(self) -> None:
        # of the last scenes: keys of the agents (B, A), and their noise for the episode
        self._episode_noise: tuple[Tensor, Tensor] | None = None
        self._first_seen = FirstSeenMemory() if self.model.remembers else None

    def fresh(self) -> Self:
        """Return a walker with the same model and settings that has seen no scene yet."""
        result = copy(self)
        result._remember_nothing()
        return result

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Write each person's velocity (B, A, 2), m/s."""
        check_interval(tensordict, STEP_SECONDS, "a learned model")
        scenes = with_walked_history(tensordict)
        if self._first_seen is not None:
            scenes = self._first_seen.add(scenes)
        step, wish = self.model.step_and_wish(scenes, self.noise_of(tensordict))
        apart = separation_push(tensordict)
        step = stay_in_place(tensordict, step) + apart
        if self.model.keeps_distance:
            wish = stay_in_place(tensordict, wish) + apart
            tensordict["agents", "raw_action"] = wish / STEP_SECONDS
        else:
            wish = step
        if self._first_seen is not None:
            self._first_seen.remember(wish, step)
        if self.safety:
            tensordict["agents", "unconstrained_action"] = step / STEP_SECONDS
            step = safe(tensordict, step, 0.0 if self.model.keeps_distance else SHOULDERS)
        tensordict["agents", "action"] = step / STEP_SECONDS
        return tensordict

    def noise_of(self, tensordict: TensorDictBase) -> Tensor | None:
        """Return each person's noise (B, A, noise_dim) in scenes as they are now, None for none."""
        if not self.model.noise_dim or deterministic():
            return None
        scene_key, agent, time = tensordict["scene_key"], ids_of(tensordict), tensordict["time"]
        if self.model.noise_periods:
            key = randomness.join(scene_key, "noise", self.noise_seed)
            return timed_noise(key, agent, time, self.model.noise_periods)
        key = randomness.join(scene_key, "noise", torch.zeros_like(agent) if self.noise == "scene" else agent)
        key = randomness.join(key, self.noise_seed) if self.noise_seed else key
        changes, kept = self.noise in ("step", "mixed"), self._episode_noise
        keeps = not changes and key.device.type == "cpu"
        if keeps and kept and torch.equal(kept[0], key):
            return kept[1]
        with torch.inference_mode(False):  # the next call may ask for gradients
            drawn, dims = key.clone().unsqueeze(-1), torch.arange(self.model.noise_dim, device=agent.device)
            if changes:
                step = (time / STEP_SECONDS).round().long().unsqueeze(-1)
                lasts = dims < ((self.model.noise_dim + 1) // 2 if self.noise == "mixed" else 0)
                drawn = torch.where(lasts, drawn, randomness.join(drawn, step))
            noise = randomness.normal(randomness.join(drawn, dims))
        if keeps:
            self._episode_noise = key.clone(), noise
        return noise


def check_interval(scenes: TensorDictBase, decision_dt: float, what: str) -> None:
    """Raise a `UserError` for an environment that decides at another step than the policy ``what``."""
    trace = scenes.get(("agents", "info", "trace"), None)
    if trace is not None and trace.shape[2] != round(decision_dt / TRACE_SECONDS):
        raise UserError(
            f"{what} decides every {decision_dt:g} s, not every {trace.shape[2] * TRACE_SECONDS:g} s: "
            f"make_env(..., decision_dt={decision_dt:g})"
        )


def walkers(policy: NamedPolicy) -> list[Walker]:
    """Return the learned policies that are in a policy: itself, or those of its teams."""
    return [part for part in policy.modules() if isinstance(part, Walker)]


def has_noise(policy: NamedPolicy) -> bool:
    """Return whether the learned policies in a policy draw noise."""
    return any(walker.model.noise_dim > 0 for walker in walkers(policy))
