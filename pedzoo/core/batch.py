"""The scene batch of pedzoo: its legend, its only constructor, and its readers.

B scenes, A agents (padded), T steps, K samples; P people (all present agents of a batch, packed). World
frame: x right, y up; metres, seconds, radians.

A scene batch is a TensorDict of batch size (B,). Recordings, the environment, the stepping controller,
imitation and ONNX export make theirs with `scene_batch`, so all of them have the same keys:

=====================  =====================  ==========================================================
key                    shape                  meaning
=====================  =====================  ==========================================================
maps                   (no tensor)            the MapBank that ``map_id`` speaks of; read it by `maps_of`
agents/id              (B, A) long            number of the agent, for noise of its own; default: the slot
agents/history         (B, A, 8, 2)           world positions, oldest first, every 0.4 s
agents/valid           (B, A, 8) bool         which of them are known
agents/velocity        (B, A, 2)              current velocity, m/s
agents/heading         (B, A, 1)              direction in which the body faces, radians from the x axis
agents/pref_speed      (B, A, 1)              the speed this agent likes, m/s
agents/top_speed       (B, A, 1)              the speed to which its velocities are shortened, m/s
agents/radius          (B, A, 1)              radius of the body, metres
agents/kind            (B, A) long            `PERSON` or `ROBOT`
agents/group           (B, A) long            number of the company that the agent walks in, -1 for alone;
                                              only equality within a scene has a meaning
agents/goal            (B, A, 2)              short-term goal; absent under the goal protocol ``none``
agents/desired_velocity(B, A, 2)              pref_speed towards the goal; absent with it
agents/remaining_path  (B, A, 1)              simulated scenes only: length of the path to the goal, metres
agents/goal_since      (B, A, 1)              simulated scenes only: when the agent was given its goal, by
                                              ``time``; -inf where it was on its way, or goes as recorded
agents/mask            (B, A) bool            the agent is here
agents/controlled      (B, A) bool            the policy at hand moves this agent
agents/future          (B, A, T, 2)           recordings only: the true continuation
agents/future_valid    (B, A, T) bool         which of it is known
map_id                 (B, 1) long            floor plan in the MapBank, -1 for none
scene_pose             (B, 4)                 rotation, mirror (+1 or -1) and shift of the scene against it
prediction             (B, K, A, T, 2)        a model's answer: displacements per step, metres
scene_key              (B, 1) long            simulated scenes only: names the scene, noise is drawn by it
time                   (B, 1)                 simulated scenes only: seconds since the warm start
agents/action          (B, A, 2)              a policy's answer: velocities, m/s
agents/reward          (B, A, 1)              environment only, with agents/info, failed, done, terminated
                                              and truncated: see `pedzoo.sim.env`
=====================  =====================  ==========================================================
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Any, cast

import torch
from tensordict import NonTensorData, NonTensorStack, TensorDict, TensorDictBase
from torch import Tensor

from pedzoo.core.adapters import non_tensor_of, tensordict_of
from pedzoo.core.errors import UserError
from pedzoo.core.geometry import heading_of
from pedzoo.core.types import BODY_RADIUS, STEP_SECONDS, TOP_SPEED_RATIO

if TYPE_CHECKING:
    from pedzoo.maps.bank import MapBank

PERSON, ROBOT = 0, 1
"""Values of ``agents/kind``."""

WAITING_SPEED_SHARE = 0.99
"""An agent waits if its desired speed is below this share of its preferred speed; the rest is rounding."""


def is_person_sized(radius: Tensor) -> Tensor:
    """Return which bodies have a person's radius (...) bool, for radii (...) in metres."""
    return (radius - BODY_RADIUS).abs() < 1e-6


def other_agents(mask: Tensor, robots: int) -> Tensor:
    """Return for each of the last R agents every other present agent, (B, R, A) bool."""
    slots = torch.arange(mask.shape[1], device=mask.device)
    return mask.unsqueeze(1) & (slots != slots[-robots:].unsqueeze(1))


def scene_batch(
    *,
    maps: MapBank,
    map_id: Tensor,
    pose: Tensor,
    history: Tensor,
    valid: Tensor,
    mask: Tensor,
    pref_speed: Tensor,
    top_speed: Tensor | None = None,
    velocity: Tensor | None = None,
    heading: Tensor | None = None,
    radius: Tensor | None = None,
    kind: Tensor | None = None,
    group: Tensor | None = None,
    goal: Tensor | None = None,
    desired_velocity: Tensor | None = None,
    remaining_path: Tensor | None = None,
    goal_since: Tensor | None = None,
    controlled: Tensor | None = None,
    id: Tensor | None = None,
    key: Tensor | None = None,
    time: Tensor | None = None,
    future: Tensor | None = None,
    future_valid: Tensor | None = None,
) -> TensorDict:
    """Return a scene batch (B,) on the device of ``mask``; shapes and units as in the legend above.

    Arguments are the keys of the legend, ``pose`` is ``scene_pose`` and ``key`` is ``scene_key``. None stands
    for the velocity of the last observed step, the heading of the velocity, 1.3 times the preferred speed as
    top speed, the radius `BODY_RADIUS`, a person who walks alone, the number of the slot, and control of all
    that are here. All other keys are left out where they are None.
    """
    device, size = mask.device, mask.shape
    if velocity is None:
        velocity = (history[:, :, -1] - history[:, :, -2]) / STEP_SECONDS
    if radius is None:
        radius = torch.full((*size, 1), BODY_RADIUS, dtype=history.dtype, device=device)
    agents = {
        "id": torch.arange(size[1], device=device).expand(size) if id is None else id,
        "history": history,
        "valid": valid,
        "velocity": velocity,
        "heading": heading_of(velocity).unsqueeze(-1) if heading is None else heading,
        "pref_speed": pref_speed,
        "top_speed": TOP_SPEED_RATIO * pref_speed if top_speed is None else top_speed,
        "radius": radius,
        "kind": torch.zeros_like(mask, dtype=torch.long) if kind is None else kind,
        "group": torch.full_like(mask, -1, dtype=torch.long) if group is None else group,
        "goal": goal,
        "desired_velocity": desired_velocity,
        "remaining_path": remaining_path,
        "goal_since": goal_since,
        "mask": mask,
        "controlled": mask if controlled is None else controlled,
        "future": future,
        "future_valid": future_valid,
    }
    known = {name: value for name, value in agents.items() if value is not None}
    scenes: dict[str, Any] = {
        # with the device given, neither TensorDict nor TorchRL casts the tensors again
        "agents": tensordict_of(known, size, device),
        "map_id": map_id,
        "scene_pose": pose,
        "maps": non_tensor_of(maps, size[:1], device),
    }
    if key is not None:
        scenes["scene_key"] = key
    if time is not None:
        scenes["time"] = time
    return tensordict_of(scenes, size[:1], device)


def agents_of(batch: TensorDictBase) -> TensorDict:
    """Return the entries of a batch's agents."""
    return cast("TensorDict", batch["agents"])


def ids_of(batch: TensorDictBase) -> Tensor:
    """Return the number of every agent (B, A) long, for draws of its own."""
    return cast("Tensor", agents_of(batch)["id"])


def companions_of(batch: TensorDictBase) -> Tensor:
    """Return which present agents walk in company (B, A, A) bool, none with itself; without groups nobody."""
    agents = agents_of(batch)
    here = cast("Tensor", agents["mask"])
    return in_company(agents.get("group", torch.full_like(here, -1, dtype=torch.long)), here)


def in_company(group: Tensor, here: Tensor) -> Tensor:
    """Return which agents ``here`` (B, A) bool have the same ``group`` (B, A) long, as `companions_of`."""
    same = (group.unsqueeze(2) == group.unsqueeze(1)) & ((group >= 0) & here).unsqueeze(2)
    alone = torch.eye(group.shape[1], dtype=torch.bool, device=group.device)
    return same & here.unsqueeze(1) & ~alone


def goals_of(batch: TensorDictBase, who: str) -> tuple[Tensor, Tensor]:
    """Return goal and desired velocity (B, A, 2). Raises UserError: ``who`` needs them, there are none."""
    agents = agents_of(batch)
    if "goal" not in agents.keys():
        raise UserError(
            f"{who} needs a goal, but the data have none: "
            "set --data.goal to window_end, destination, planner or random_future"
        )
    return cast("Tensor", agents["goal"]), cast("Tensor", agents["desired_velocity"])


def desired_speed_share(batch: TensorDictBase) -> Tensor | None:
    """Return desired velocities as shares of preferred speeds (B, A); None where there are none."""
    agents = agents_of(batch)
    if "desired_velocity" not in agents.keys():
        return None
    desired, liked = (cast("Tensor", agents[key]) for key in ("desired_velocity", "pref_speed"))
    return desired.norm(dim=-1) / liked[..., 0]


def is_walking(batch: TensorDictBase) -> Tensor:
    """Return which agents the policy moves and that do not wait (B, A) bool: see `WAITING_SPEED_SHARE`."""
    controlled, share = cast("Tensor", agents_of(batch)["controlled"]), desired_speed_share(batch)
    return controlled if share is None else controlled & (share >= WAITING_SPEED_SHARE)


def actions_of(batch: TensorDictBase, group: str = "agents") -> Tensor:
    """Return the actions (B, A, 2) that a policy has written for a group of agents, in single precision.

    Raises UserError: they have another shape, and torch would stretch them silently.
    """
    action, expected = cast("Tensor", batch[group, "action"]), (*cast("Any", batch[group]).batch_size, 2)
    if tuple(action.shape) != expected:
        raise UserError(
            f"{group}/action of shape {tuple(action.shape)}: expected {expected}, two for each agent"
        )
    return action.float()


def maps_of(batch: TensorDictBase) -> MapBank:
    """Return the floor plans that the ``map_id`` of a batch speaks of, on the device of the batch.

    Batches that were stacked, joined or collected by TorchRL have many entries: equal ones count as one.
    Raises UserError: it has none, or its scenes are of different banks.
    """
    banks: list[MapBank] = []
    for bank in _banks(batch.get("maps", None)):
        if not any(bank is other or bank == other for other in banks):
            banks.append(bank)
    if not banks:
        raise UserError(
            "this batch does not say which floor plans its map_id speaks of: make it with "
            "pedzoo.core.batch.scene_batch(maps=...), with MapBank() for scenes without floor plans"
        )
    if len(banks) > 1:
        held = " and ".join(f"[{', '.join(bank.names[:3]) or 'no map'}]" for bank in banks[:3])
        raise UserError(
            f"scenes of {len(banks)} different banks of floor plans were combined: {held}. Combine scenes of "
            "one environment or datamodule, or make all of them with one MapBank that holds all floor plans"
        )
    return banks[0].to(cast("Tensor", batch["map_id"]).device)


def _banks(entry: Any) -> Iterator[MapBank]:
    """Yield the banks under ``maps``, which TensorDict may have wrapped."""
    if isinstance(entry, NonTensorStack | list | tuple):
        for part in entry.tensordicts if isinstance(entry, NonTensorStack) else entry:
            yield from _banks(part)
    elif isinstance(entry, NonTensorData):
        yield from _banks(entry.data)
    elif entry is not None:
        yield entry
