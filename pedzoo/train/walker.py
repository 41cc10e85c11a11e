"""Training of a walker by the likelihood of what recorded people did next."""

from __future__ import annotations

import dataclasses
from typing import Any, NamedTuple, cast

import torch
from lightning.pytorch.utilities.types import OptimizerLRScheduler
from tensordict import TensorDict
from torch import Tensor

from pedzoo.core.errors import UserError, at_least_one, at_least_zero
from pedzoo.core.geometry import unrotate
from pedzoo.core.randomness import Draws
from pedzoo.core.types import OBS_LEN, STEP_SECONDS
from pedzoo.data.tracks import Tracks
from pedzoo.maps.planning.planner import Planner
from pedzoo.models.architectures.mdn_walker import Features, MdnWalker
from pedzoo.models.blocks.held_mixture import HELD
from pedzoo.sim.dynamics import substeps
from pedzoo.sim.episodes import Episodes
from pedzoo.sim.make import CLEARANCE
from pedzoo.sim.observation import observed
from pedzoo.sim.physics.compiled import Compiled
from pedzoo.sim.recorded_people import people_of
from pedzoo.sim.scenario import rules_of
from pedzoo.sim.scenarios.replay import CELL, PreparedReplay, Replay
from pedzoo.sim.script import Script, ScriptScenes
from pedzoo.sim.state import TRACE_PER_STEP
from pedzoo.train.module import ForecastModule

Crowd = tuple[Tracks, int, float]
"""As of `TrajectoryDataModule.crowds`."""

NEVER = 1000.0
"""The spread of a feature that never varied: divided by it, it hardly counts."""

AT_ONCE = 48
"""Scenes whose people are looked at together."""


class RecordedScenes(NamedTuple):
    """B scenes at one moment of a recording, and how their people went on."""

    batch: TensorDict  # the scene batch (B,)
    mine: Tensor  # which people a policy moves, of whom the steps before and after are known (B, A) bool
    velocity: Tensor  # recorded velocities (B, A, 2), m/s: in the last step ...
    following: Tensor  # ... and in the next one


class RecordedStates:
    """One recording, at any frame of which scenes can begin."""

    def __init__(self, tracks: Tracks, map_id: int, weight: float, planner: Planner) -> None:
        """Take tracks at 0.4 s in the frame of their floor plan, -1 for none, and how much they count."""
        tables = torch.tensor([map_id])
        people, xy = people_of([tracks], planner.bank.index(tables).tolist(), planner)
        self.weight = weight
        self._script, self._physics = Script.of_recordings(people, xy), Compiled(planner.bank)
        self._whole = PreparedReplay(
            scenario=Replay(), planner=planner, tables=tables, script=self._script, home=torch.zeros(1, 2)
        )
        frame = torch.arange(int(people.last.max()))
        moved = people.controlled.unsqueeze(1) & (people.handover.unsqueeze(1) <= frame)
        count = (moved & (people.last.unsqueeze(1) > frame)).sum(0)
        self.frames = frame[count > 0]
        """Frames in which somebody can be moved (F,) long."""
        self.states = int(count.sum())
        """States of people in them."""

    def excerpts(self, begin: Tensor, steps: int) -> PreparedReplay:
        """Return a replay of scenes that begin at frames (B,) long and last for so many steps."""
        scenes = ScriptScenes.of_excerpts(torch.zeros_like(begin), begin, steps)
        script = Script(self._script.people, self._script.xy, self._script.occupants, scenes)
        return dataclasses.replace(self._whole, script=script)

    def scenes(self, begin: Tensor) -> RecordedScenes:
        """Return the scenes at frames ``begin`` (B,) long."""
        prepared = self.excerpts(begin, 1)
        script, people = prepared.script, prepared.persons
        rules = rules_of(prepared, TRACE_PER_STEP, substeps(prepared.fastest_agent))
        episodes = Episodes(prepared, "recorded", self._physics, rules)
        state = episodes.begin(Draws.for_episodes(0, torch.arange(len(begin))))
        person, now = state.person, begin.unsqueeze(1).expand_as(state.person)
        batch = observed(state, rules.guidance(state), prepared.bank)
        first = people.first[person].unsqueeze(2) + torch.arange(OBS_LEN)
        batch["agents", "first_history"] = script.places(person.unsqueeze(2).expand_as(first), first)
        mine = state.decides & (person >= 0) & (people.first[person] < now) & (people.last[person] > now)
        before, here, after = (script.places(person, now + more) for more in (-1, 0, 1))
        return RecordedScenes(batch, mine, (here - before) / STEP_SECONDS, (after - here) / STEP_SECONDS)


class Targets(NamedTuple):
    """N states of people, and what they did next."""

    seen: Features
    change: Tensor  # of velocity (N, 2), m/s, in the frame of the way; 0 where held
    held: Tensor  # whether it was held (N,) bool
    recording: Tensor  # number of the recording (N,) long


class WalkerModule(ForecastModule):
    """Maximises the likelihood of recorded changes of velocity, in states drawn from all recordings.

    A recording counts by its weight and the root of its states.
    """

    in_scenes = True

    def __init__(
        self,
        generator: MdnWalker,
        states: int = 120_000,
        states_per_step: int = 512,
        epochs_per_draw: int = 5,
        jitter: float = 0.02,
        forget: float = 0.15,
        weight_decay: float = 0.02,
        **options: Any,
    ) -> None:
        """Take a walker.

        Args:
            generator: The model.
            states: Drawn from the recordings at a time.
            states_per_step: Of an update.
            epochs_per_draw: Epochs after which others are drawn.
            jitter: Standard deviation of the noise on features, in units of theirs.
            forget: Share of states in which styles are not known.
            weight_decay: Of AdamW.
            options: Of the optimisation and of validation; see `ForecastModule`.

        Raises:
            UserError: A number is out of range.
        """
        super().__init__(generator, **options)
        at_least_zero("--model.", jitter=jitter, forget=forget, weight_decay=weight_decay)
        self.automatic_optimization = False
        self.states = at_least_one("--model.states", states)
        self.states_per_step = at_least_one("--model.states_per_step", states_per_step)
        self.epochs_per_draw = at_least_one("--model.epochs_per_draw", epochs_per_draw)
        self.jitter, self.forget, self.weight_decay = jitter, forget, weight_decay
        self._recordings: list[RecordedStates] = []
        self._unseen: list[RecordedStates] = []
        self._pool: Targets | None = None
        self._drawn = -1

    @property
    def walker(self) -> MdnWalker:
        """The model."""
        return cast("MdnWalker", self.generator)

    def setup(self, stage: str) -> None:
        """Read the recordings on the true clock. Raises UserError: nobody in them can be moved."""
        super().setup(stage)
        data: Any = getattr(self.trainer, "datamodule", None)
        if stage != "fit" or data is None:
            return
        planner = Planner(data.bank, CLEARANCE, cell=CELL)
        for split, into in (("train", self._recordings), ("val", self._unseen)):
            every = [RecordedStates(*crowd, planner) for crowd in cast("list[Crowd]", data.crowds(split))]
            into[:] = [one for one in every if one.states]
        if not self._recordings:
            raise UserError(f"no recording of {data.fold!r} has people who can be moved")
        self.shares = torch.tensor([one.weight * one.states**0.5 for one in self._recordings])
        """How much each recording counts (R,)."""

    def configure_optimizers(self) -> OptimizerLRScheduler:
        """Return AdamW."""
        return torch.optim.AdamW(self.generator.parameters(), self.lr, weight_decay=self.weight_decay)

    @torch.no_grad()
    def on_train_epoch_start(self) -> None:
        """Draw other states, where it is time; the first ones say how features are scaled."""
        draw = self.current_epoch // self.epochs_per_draw
        if draw == self._drawn:
            return
        self._drawn, random = draw, torch.Generator().manual_seed(self.seed * 7919 + draw)
        self._pool = self._states(random)
        if not int(self.iteration):
            self.scale(self._pool.seen.own)

    def scale(self, own: Tensor) -> None:
        """Scale features by those of people (N, D). What never varies there means nothing: it is not seen."""
        centre = own.nanmean(0)
        self.walker.reader.get_buffer("centre").copy_(centre)
        spread = (own - centre).square().nanmean(0).sqrt()
        spread = torch.where(spread > 1e-5, spread.clamp_min(1e-3), NEVER)
        self.walker.reader.get_buffer("spread").copy_(spread)

    def _states(self, random: torch.Generator) -> Targets:
        """Return states of all recordings."""
        parts: list[Targets] = []
        wanted = (self.states * self.shares / self.shares.sum()).tolist()
        for number, (one, count) in enumerate(zip(self._recordings, wanted, strict=True)):
            scenes = max(1, round(count * len(one.frames) / one.states))
            begin = one.frames[torch.randperm(len(one.frames), generator=random)[:scenes]]
            parts += [self.targets(one, some, number) for some in begin.split(AT_ONCE)]
        seen = (torch.cat(column) for column in zip(*(part.seen for part in parts), strict=True))
        rest = (torch.cat(column) for column in zip(*(part[1:] for part in parts), strict=True))
        return Targets(Features(*seen), *rest)

    def targets(self, one: RecordedStates, begin: Tensor, number: int = 0) -> Targets:
        """Return the states of people at frames ``begin`` (B,) long of recording ``number``."""
        scenes = one.scenes(begin)
        now = self.walker.view(scenes.batch)
        change = scenes.following - scenes.velocity
        held = change.norm(dim=-1) < HELD
        change = torch.where(held.unsqueeze(-1), 0.0, unrotate(change, now.ahead))[scenes.mine]
        seen = Features(*(value[scenes.mine] for value in self.walker.features(now)))
        return Targets(seen, change, held[scenes.mine], torch.full((len(change),), number))

    def training_step(self, batch: TensorDict, batch_idx: int) -> None:
        """Make one update on states of the pool; the batch of windows is for validation alone."""
        loss = self.surprise(self.random())
        optimizer = cast("Any", self.optimizers())
        optimizer.zero_grad()
        self.manual_backward(loss)
        norm = torch.nn.utils.clip_grad_norm_(self.generator.parameters(), self.clip or torch.inf)
        self.set_lr(optimizer, self.lr)
        if bool(norm.isfinite()):
            optimizer.step()
        self.iteration += 1
        self.show("loss", loss)
        self.log_means({"loss": loss})

    def surprise(self, random: torch.Generator) -> Tensor:
        """Return minus the mean log likelihood of some states of the pool, nats."""
        pool, reader = cast("Targets", self._pool), self.walker.reader
        some = torch.randint(len(pool.held), (self.states_per_step,), generator=random)
        own = pool.seen.own[some]
        forgets = torch.rand(len(some), 1, generator=random) < self.forget
        own[:, reader.style] = own[:, reader.style].where(~forgets, torch.nan)
        spread = reader.get_buffer("spread")
        spread = spread.where(spread < NEVER, 0.0)
        own = own + self.jitter * spread * torch.randn(own.shape, generator=random)
        seen = Features(own, pool.seen.near[some], pool.seen.absent[some])
        return -self.walker.change(seen).log_prob(pool.change[some], pool.held[some]).mean()

    @torch.no_grad()
    def on_validation_epoch_end(self, split: str = "val") -> None:
        """Log the errors of forecasts, and ``val/nll`` of recordings that are not trained on, in nats."""
        super().on_validation_epoch_end(split)
        if self.trainer.sanity_checking or not self._unseen:
            return
        nats = []
        for one in self._unseen:
            begin = one.frames[:: max(1, len(one.frames) // 96)]
            parts = [self.targets(one, some) for some in begin.split(AT_ONCE)]
            values = [-self.walker.change(part.seen).log_prob(part.change, part.held) for part in parts]
            nats.append(torch.cat(values).mean())
        self.log(f"{split}/nll", torch.stack(nats).mean(), prog_bar=True)
