"""What is compared of two crowds: the features of their steps, clips of their walks, and who they are.

The same numbers by which `pedzoo score` judges crowds, with gradients. B excerpts of A people and L frames, M
scored steps.
"""

from typing import NamedTuple

import torch
from torch import Tensor
from torch.nn import functional

from pedzoo.core.batch import in_company
from pedzoo.core.geometry import smooth_norm, unrotate
from pedzoo.core.types import BODY_RADIUS, STEP_SECONDS
from pedzoo.metrics.contacts import HORIZON, collision_seconds, touch_seconds
from pedzoo.metrics.realism.distances import wasserstein
from pedzoo.metrics.realism.features import CHANNELS, FAR, LENGTH, LINE, turns
from pedzoo.metrics.smoothness import STANDS
from pedzoo.models.blocks.people.style import STYLE_DIM, style_of
from pedzoo.train.crowds.crowd_walk import CrowdWalk
from pedzoo.train.crowds.excerpts import Excerpts

ABREAST, PARTED = 0.5, 2.0
"""Metres: the unit of distances between companions, and from where on they have lost each other."""

MANNER_DIM = 2 * STYLE_DIM + 1
"""M: numbers of how a person and the others began to walk."""


class CrowdFeatures(NamedTuple):
    """A crowd's walks as numbers.

    Attributes:
        features: Values of every feature of `pedzoo.metrics.realism.features.FEATURES`, each (N,).
        clips: As of `pedzoo.metrics.realism.features.clips` (W, 8, 14).
        person: Slot of the person of each clip (W,) long.
        people: A.
        manner: How these people, and all of their excerpt, began to walk (W, M): styles and preferred speed.
    """

    features: dict[str, Tensor]
    clips: Tensor
    person: Tensor
    people: int
    manner: Tensor


class _NearestTwo(NamedTuple):
    """The others around M people: places and velocities of the nearest two (M, 2, 2), and times."""

    place: Tensor
    velocity: Tensor
    absent: Tensor
    seconds: Tensor


def compared(walk: CrowdWalk, real: Excerpts) -> CrowdFeatures:
    """Return the numbers of a crowd that walks in the place of the people of ``real``."""
    where = walk.scored.nonzero(as_tuple=True)
    scene, slot, frame = where
    velocity = functional.pad(walk.xy.diff(dim=2) / STEP_SECONDS, (0, 0, 1, 0))
    now, before = velocity[where], velocity[scene, slot, frame - 1]
    change = (now - before) / STEP_SECONDS
    near = _nearest_two(walk, velocity, where)
    way = (real.exit - real.start)[scene, slot]
    length = way.norm(dim=1)
    has_line = length >= LINE
    offset = walk.xy[where] - real.start[scene, slot]
    across = way[:, 0] * offset[:, 1] - way[:, 1] * offset[:, 0]
    company = ~near.absent[:, 0]
    walks = (before.detach().norm(dim=1) > STANDS) & (now.detach().norm(dim=1) > STANDS)
    features = {
        "speed": smooth_norm(now),
        "acceleration": smooth_norm(change),
        "heading_rate": turns(before[walks], now[walks]) / STEP_SECONDS,
        "nearest_distance": smooth_norm(near.place[company, 0]),
        "time_to_collision": near.seconds[company],
        "lateral_deviation": across[has_line] / length[has_line],
    }
    away = real.exit[scene, slot] - walk.xy[where]
    ahead = functional.normalize(torch.where(has_line.unsqueeze(1), way, away), dim=1)
    far = way.new_tensor([FAR, 0.0])
    missing = near.absent.unsqueeze(2)
    frame_of = ahead.unsqueeze(1)
    place = torch.where(missing, far, unrotate(near.place, frame_of))
    relative = torch.where(missing, 0.0, unrotate(near.velocity, frame_of))
    vectors = torch.cat((unrotate(torch.stack((now, change), 1), frame_of), place, relative), 1)
    value = torch.cat((vectors.flatten(1), near.seconds.unsqueeze(1), smooth_norm(away).unsqueeze(1)), 1)
    steps = value.new_zeros(*walk.scored.shape, len(CHANNELS)).index_put(where, value)
    whole = walk.scored.unfold(2, LENGTH, 1).all(3)
    excerpt, person, _ = whole.nonzero(as_tuple=True)
    style = style_of(real.head)
    walks = real.walks.unsqueeze(2).to(style.dtype)
    crowd = ((style * walks).sum(1, keepdim=True) / walks.sum(1, keepdim=True).clamp_min(1)).expand_as(style)
    manner = torch.cat((style, crowd, real.pref_speed.unsqueeze(2)), 2)[excerpt, person]
    clips = steps.unfold(2, LENGTH, 1)[whole].transpose(1, 2)
    return CrowdFeatures(features, clips, person, whole.shape[1], manner)


def coarse(walk: CrowdWalk) -> CrowdWalk:
    """Return the crowd with positions averaged over three frames, see `pedzoo.metrics.realism.features`."""
    there = walk.there
    middle = there[:, :, :-2] & there[:, :, 1:-1] & there[:, :, 2:]
    has_mean = functional.pad(middle, (1, 1))
    mean = (walk.xy[:, :, :-2] + walk.xy[:, :, 1:-1] + walk.xy[:, :, 2:]) / 3
    mean = functional.pad(mean, (0, 0, 1, 1))
    both = functional.pad(has_mean[:, :, 1:] & has_mean[:, :, :-1], (1, 0))
    return walk._replace(xy=torch.where(has_mean.unsqueeze(3), mean, walk.xy), scored=walk.scored & both)


def summaries(walk: CrowdWalk, real: Excerpts) -> tuple[Tensor, Tensor]:
    """Return 7 numbers of each person's walk (B, A, 7), each of the order of 1, and which have them (B, A).

    Mean and spread of speed, of the logarithm of acceleration and of the place beside the line start-exit,
    and the share of steps that stand: two of a kind differ in them less than two people of a crowd.
    """
    scored = walk.scored.to(walk.xy.dtype)
    count = scored.sum(2).clamp_min(1)

    def both(values: Tensor, scale: float, spread: float) -> list[Tensor]:
        mean = (values * scored).sum(2) / count
        variance = ((values - mean.unsqueeze(2)).square() * scored).sum(2) / count
        return [mean / scale, (variance + 1e-4).sqrt() / spread]

    velocity = functional.pad(walk.xy.diff(dim=2) / STEP_SECONDS, (0, 0, 1, 0))
    speed = smooth_norm(velocity)
    change = (smooth_norm(functional.pad(velocity.diff(dim=2) / STEP_SECONDS, (0, 0, 1, 0))) + 0.02).log()
    line = functional.normalize(real.exit - real.start, dim=2).unsqueeze(2)
    offset = walk.xy - real.start.unsqueeze(2)
    aside = line[..., 0] * offset[..., 1] - line[..., 1] * offset[..., 0]
    stands = (((STANDS + 0.02 - speed) / 0.03).sigmoid() * scored).sum(2) / count
    parts = [*both(speed, 0.5, 0.2), *both(change, 0.8, 0.5), *both(aside, 0.6, 0.3), 2 * stands]
    return torch.stack(parts, 2), walk.scored.sum(2) >= LENGTH


def parted(walk: CrowdWalk, truth: CrowdWalk, real: Excerpts, once: Excerpts) -> Tensor:
    """Return how much farther from each other companions walk than the recorded ones, 0 for equal crowds.

    Of people's mean distances to their companions at each scored frame: the distance of the two distributions
    in units of 0.5 m, and the mean of the metres above 2 m, as far as recorded people have fewer.

    Args:
        walk: The crowd.
        truth: The recorded one.
        real: The excerpts of the crowd.
        once: Those of the recorded one.
    """
    made, true = _company_distance(walk, real), _company_distance(truth, once).detach()
    if not len(made) or not len(true):
        return walk.xy.sum() * 0
    far = [(values - PARTED).clamp_min(0).mean() for values in (made, true)]
    return wasserstein(made, true) / ABREAST + (far[0] - far[1]).clamp_min(0)


def _company_distance(walk: CrowdWalk, real: Excerpts) -> Tensor:
    """Return the mean distance of people to their companions (N,), metres, of steps that are scored."""
    scene, one, other = in_company(real.group, real.there.any(2)).nonzero(as_tuple=True)
    both = walk.scored[scene, one] & walk.there[scene, other]
    apart = torch.where(both, smooth_norm(walk.xy[scene, one] - walk.xy[scene, other]), 0.0)
    number = scene * walk.xy.shape[1] + one
    total = apart.new_zeros(walk.scored.flatten(0, 1).shape)
    count = total.index_add(0, number, both.to(apart.dtype))
    return total.index_add(0, number, apart)[count > 0] / count[count > 0]


def _nearest_two(walk: CrowdWalk, velocity: Tensor, where: tuple[Tensor, ...]) -> _NearestTwo:
    """Return the others around people; no gradient flows through the choice."""
    scene, slot, frame = where
    there = walk.there.transpose(1, 2)[scene, frame]
    away = walk.xy.transpose(1, 2)[scene, frame] - walk.xy[where].unsqueeze(1)
    moves = velocity.transpose(1, 2)[scene, frame] - velocity[where].unsqueeze(1)
    people = there.shape[1]
    with torch.no_grad():
        absent = ~there.scatter(1, slot.unsqueeze(1), False)
        apart = away.norm(dim=2).masked_fill(absent, torch.inf)
        apart = functional.pad(apart, (0, max(0, 2 - people)), value=torch.inf)
        distance, nearest = apart.topk(2, largest=False)
        reach = torch.full_like(away[..., 0], 2 * BODY_RADIUS)
        seconds = collision_seconds(away, moves, reach).masked_fill(absent, HORIZON)
        seconds, first = seconds.min(1)
    two = nearest.clamp_max(people - 1).unsqueeze(2).expand(-1, -1, 2)
    one = first.view(-1, 1, 1).expand(-1, 1, 2)
    place, moving = away.gather(1, one)[:, 0], moves.gather(1, one)[:, 0]
    meets = (seconds > 0) & (seconds < HORIZON)
    seconds = torch.where(meets, touch_seconds(place, moving, 2 * BODY_RADIUS).clamp(0, HORIZON), seconds)
    return _NearestTwo(away.gather(1, two), moves.gather(1, two), distance.isinf(), seconds)
