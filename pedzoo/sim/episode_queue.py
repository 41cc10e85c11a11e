"""Episodes that are made ahead, and scenes that begin the next ones."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import torch
from torch import Tensor

from pedzoo.core.randomness import Draws, signed
from pedzoo.maps.planning.guidance import Guidance
from pedzoo.sim.episodes import Episodes
from pedzoo.sim.kernel import Rules
from pedzoo.sim.state import State

_MADE, _AGENTS_MADE, _DEEPEST = 512, 2560, 128
"""Limits of what is begun together when scenes end one by one: episodes, agents, and episodes of one row."""


class Scenes(NamedTuple):
    """B scenes, and the planner's answer for them."""

    state: State
    guidance: Guidance

    def select(self, index: Tensor) -> Scenes:
        """Return some of the scenes."""
        guidance = Guidance(*(value.index_select(0, index) for value in self.guidance))
        return Scenes(self.state.select(index), guidance)


class EpisodeQueue:
    """Begins the episodes of a seed, those of B rows ``stride`` numbers apart.

    A warm start costs as much for one scene as for a hundred. So the episodes of all rows without one are
    made together as soon as one row needs its own. For few rows several of each are made.
    """

    def __init__(
        self,
        episodes: Episodes,
        rules: Rules,
        opened: Callable[[State], State],
        people: int,
        seed: int,
        rows: int,
        first: int,
        stride: int,
    ) -> None:
        """Take what makes episodes.

        Args:
            episodes: Makes first states.
            rules: Of the scenes.
            opened: Changes what environments change of them.
            people: A, agents in every scene.
            seed: Of all episodes.
            rows: B.
            first: Number of the first episode of row 0.
            stride: From an episode to the next one of its row.
        """
        self._episodes, self._rules, self._opened = episodes, rules, opened
        self._seed = torch.full((rows,), signed(seed % 2**64))
        self._number, self._stride = first + torch.arange(rows), torch.full((rows,), stride)
        made = min(_MADE, _AGENTS_MADE // people)
        self._depth = min(max(1, made // rows), _DEEPEST)
        self._taken = torch.full((rows,), self._depth)
        self._ahead: tuple[Tensor, ...] = ()
        self._same: tuple[Tensor | None, ...] = ()

    def choose(self, rows: Tensor, seed: Tensor, first: Tensor, stride: int) -> None:
        """Choose other episodes for some rows (N,) long: their seeds and first numbers (N,) long."""
        self._seed[rows], self._number[rows], self._stride[rows] = seed, first, stride
        self._taken[rows] = self._depth

    def begin_all(self) -> Scenes:
        """Return the next episode of every row."""
        rows = torch.arange(len(self._number))
        if self._same:
            return self._exchanged(self._same, rows, self._next(rows))
        begun = self._made(rows, 1)
        self._same = tuple(field if bool((field == field[:1]).all()) else None for field in begun)
        return _scenes(begun)

    def begin_some(self, scenes: Scenes, ended: Tensor) -> Scenes:
        """Return the scenes, with the next episode in the rows that have ended (B,) bool."""
        index = ended.nonzero().view(-1)
        return self._exchanged((*scenes.state, *scenes.guidance), index, self._next(index.cpu()))

    def _exchanged(self, fields: tuple[Tensor | None, ...], index: Tensor, place: Tensor) -> Scenes:
        """Return scenes whose rows at ``index`` are the ones made ahead at ``place``."""
        whole, new = len(index) == len(self._number), []
        for field, made, same in zip(fields, self._ahead, self._same, strict=True):
            if same is not None and (whole or field is same):
                new.append(same)  # no step has changed it, and all episodes begin with it
                continue
            chosen = made.index_select(0, place)
            new.append(chosen if field is None or whole else field.index_copy(0, index, chosen))
        return _scenes(new)

    def _next(self, rows: Tensor) -> Tensor:
        """Return where the next episodes of rows are among those made ahead, which are made if need be."""
        depth = self._depth
        if bool((self._taken[rows] >= depth).any()):
            empty = (self._taken >= depth).nonzero().view(-1)
            made = self._made(empty, depth)
            places = (empty.unsqueeze(1) * depth + torch.arange(depth)).view(-1).to(made[0].device)
            if self._ahead:
                for old, new in zip(self._ahead, made, strict=True):
                    old.index_copy_(0, places, new)
            else:
                self._ahead = made
            self._same = tuple(map(_still_same, self._same, made))
            self._taken.index_fill_(0, empty, 0)
        place = rows * depth + self._taken[rows]
        self._taken.index_add_(0, rows, torch.ones_like(rows))
        return place.to(self._ahead[0].device)

    def _made(self, rows: Tensor, episodes: int) -> tuple[Tensor, ...]:
        """Return all fields of the next ``episodes`` of some rows, those of a row one after the other."""
        number = self._number[rows].unsqueeze(1) + self._stride[rows].unsqueeze(1) * torch.arange(episodes)
        self._number.index_add_(0, rows, episodes * self._stride[rows])
        seed = self._seed[rows].repeat_interleave(episodes)
        state = self._episodes.begin(Draws.for_episodes(seed, number.view(-1)))
        return (*self._opened(state), *self._rules.guidance(state))


def _still_same(same: Tensor | None, made: Tensor) -> Tensor | None:
    """Return a field that is the same in all episodes, None where new ones differ."""
    return same if same is not None and bool((made == same[:1]).all()) else None


def _scenes(fields: tuple[Tensor, ...] | list[Tensor]) -> Scenes:
    """Return the fields of state and guidance as what they are."""
    count = len(State._fields)
    return Scenes(State(*fields[:count]), Guidance(*fields[count:]))
