"""Robots' policies by name: local planners, and weights of the zoo whose architecture is a robot's."""

from pathlib import Path
from typing import Any, cast

import torch
from tensordict import TensorDict
from torch import Tensor

from pedzoo.core.bodies import Fleet, RobotBody
from pedzoo.core.errors import UserError
from pedzoo.core.registry import ROBOT_POLICIES, names_code
from pedzoo.core.spec import make, name_of, parse
from pedzoo.models.zoo.card import config_in, opened
from pedzoo.models.zoo.loading import check_settings, check_shapes, check_tensors, read_checkpoint
from pedzoo.models.zoo.store import check_scheme, find, weights_of
from pedzoo.policies.robots._base import LocalPlanner, ObservedPeople, Robot, RobotPolicy

PREFIX = "mean.policy."
"""Of a policy's parameters in a checkpoint of its training."""


def load_robot_weights(name: str) -> RobotPolicy | None:
    """Return a trained robot in eval mode.

    Args:
        name: A zoo name, ``robot_ppo.circle``, a folder or address with its card, a ``.safetensors`` file or
            a checkpoint of ``pedzoo fit --config robot/ppo``.

    Returns:
        None for what is no file of weights, or is of a model of people.

    Raises:
        UserError: The weights cannot be read, or do not fit their architecture.
    """
    check_scheme(name)
    if names_code(name):
        return None
    if name.endswith(".ckpt"):
        checkpoint = read_checkpoint(name)
        config, state = checkpoint["pedzoo"], checkpoint["state_dict"]
        state = {key.removeprefix(PREFIX): state[key] for key in state if key.startswith(PREFIX)}
        return _filled(config, state, name)
    file = Path(name) if name.endswith(".safetensors") else None
    if file is None:
        entry = find(name)
        if entry is None or entry.card.architecture not in ROBOT_POLICIES.names():
            return None
        file = weights_of(entry)
    with opened(file, "pt") as weights:
        return _filled(
            config_in(weights, file), {key: weights.get_tensor(key) for key in weights.keys()}, name
        )


class LearnedPlanner:
    """A trained disc as a local planner, where there are no walls: all of its way is in sight."""

    def __init__(self, policy: RobotPolicy) -> None:
        """Take the policy."""
        self.policy, self.bodies = policy, Fleet.of([RobotBody()])

    def __call__(self, robot: Robot, people: ObservedPeople) -> Tensor:
        """Return the next velocities (B, 2), m/s; robots face along the x axis of the world."""
        shape = (len(robot.goal), 1)
        goal = robot.goal - robot.position
        place = people.position - robot.position.unsqueeze(1)
        rows = torch.cat((place, people.velocity, people.radius.unsqueeze(-1)), dim=-1)
        seen = {
            "goal": goal,
            "waypoint": goal,
            "velocity": robot.velocity,
            "remaining_path": torch.linalg.vector_norm(goal, dim=-1, keepdim=True),
            "radius": robot.radius.unsqueeze(1),
            "turn_rate": torch.zeros_like(goal[:, :1]),
            "heading": torch.zeros_like(goal[:, :1]),
            "people": torch.where(people.mask.unsqueeze(-1), rows, 0),
            "people_mask": people.mask,
        }
        bodies = self.bodies._replace(radius=robot.radius, top_speed=robot.v_pref, slowest=-robot.v_pref)
        body = {name: value.expand(shape[0]).unsqueeze(1) for name, value in bodies._asdict().items()}
        sensed = TensorDict({name: value.unsqueeze(1) for name, value in seen.items()}, shape)
        group = TensorDict({"observation": sensed, "body": TensorDict(body, shape)}, shape)
        return self.policy.action(TensorDict({"robots": group}, shape[:1]))[:, 0]


def load_planner(name: str, time_step: float) -> LocalPlanner:
    """Return a local planner by its name, or a trained robot as one.

    Args:
        name: As of `load_local_planner`, or weights: ``robot_ppo.circle``.
        time_step: Seconds between decisions.

    Raises:
        UserError: An unknown name or setting.
    """
    policy = None if name_of(name) in ROBOT_POLICIES.names() else load_robot_weights(name)
    return LearnedPlanner(policy) if policy else load_local_planner(name, time_step)


def _filled(config: dict[str, Any], state: dict[str, Tensor], name: str) -> RobotPolicy | None:
    if config["architecture"] not in ROBOT_POLICIES.names():
        return None
    check_tensors(state, name)
    cls = ROBOT_POLICIES.get(config["architecture"])
    check_settings(cls, config["init"])
    try:
        check_shapes(lambda: cls(**config["init"]), state)
        policy = cls(**config["init"])
        policy.load_state_dict(state)
    except (TypeError, RuntimeError) as error:
        line = str(error).strip().splitlines()[0]
        raise UserError(f"{name!r} holds weights of another architecture than it says: {line}") from error
    return policy.eval()


def load_local_planner(name: str, time_step: float) -> LocalPlanner:
    """Return a new local planner of a robot that decides every ``time_step`` seconds.

    The name may have settings, ``crowdnav_orca:safety_space=0.15``, or be ``path/to/file.py:Class``.

    Raises:
        UserError: Unknown name, setting or file, or a class whose objects cannot be called.
    """
    spec = parse(name)
    policy = make(ROBOT_POLICIES.get(spec.name), ROBOT_POLICIES.kind, spec, time_step=time_step)
    if not callable(policy):
        raise UserError(f"{name!r}: expected a class with __call__(robot, people) -> velocities (B, 2)")
    return cast("LocalPlanner", policy)
