"""Training a walker on whole recorded crowds, and beside them in scenarios."""

from collections.abc import Sequence
from typing import Any, cast

import torch
from lightning.pytorch.utilities.types import OptimizerLRScheduler
from tensordict import TensorDict
from torch import Tensor
from torch.optim import Optimizer

from pedzoo.core.errors import UserError, at_least_zero
from pedzoo.core.types import OBS_LEN
from pedzoo.maps.bank import MapBank
from pedzoo.maps.planning.planner import Planner
from pedzoo.metrics.realism.distances import wasserstein
from pedzoo.metrics.realism.features import FEATURES, Clips
from pedzoo.metrics.realism.two_sample import FOLDS, auc, two_sample
from pedzoo.models.base import Forecaster
from pedzoo.policies.walker import Walker
from pedzoo.sim.make import CLEARANCE
from pedzoo.sim.scenarios.replay import CELL
from pedzoo.train.closed_loop.loop_losses import LoopLosses
from pedzoo.train.closed_loop.segments import Course, CourseSampler
from pedzoo.train.crowds.comparison import CrowdFeatures, coarse, compared
from pedzoo.train.crowds.crowd_walk import CrowdWalk, Policy, recorded, walked_on
from pedzoo.train.crowds.excerpts import RecordedCrowd, excerpts
from pedzoo.train.crowds.realism_loss import CrowdLikeness
from pedzoo.train.module import ForecastModule

_PAIRS = 60.0
"""People who walk at once, in all excerpts of an update."""

_FEWEST = 2
"""People that an excerpt needs to be compared."""

_LEAST_SPREAD = 1e-3
"""Of recorded values, where all are equal."""


class CrowdModule(ForecastModule):
    """All people of an excerpt of a recording walk on, and are compared with those who really did."""

    in_scenes = True

    def __init__(
        self,
        generator: Forecaster,
        likeness: CrowdLikeness,
        courses: list[Course] | None = None,
        walking: LoopLosses | None = None,
        steps: int = 30,
        before: tuple[int, ...] = (0, 0, 20, 40),
        scenes: int = 3,
        samples_walked: int = 2,
        course_every: int = 2,
        course_steps: int = 14,
        max_segments: int = 6,
        course_weight: float = 1.0,
        safety: bool | None = None,
        judge_lr: float = 1e-3,
        annotation_noise: float = 0.0,
        weight_decay: float = 0.0,
        **options: Any,
    ) -> None:
        """Take a generator and what it is compared by.

        Args:
            generator: The model.
            likeness: The loss of crowds.
            courses: Scenarios to train in, too; none for recordings alone.
            walking: The loss there.
            steps: Of 0.4 s that are compared.
            before: Steps for which people may walk on before, without gradients: one of these is drawn.
            scenes: Excerpts in an update, fewer of crowded recordings.
            samples_walked: Walks of each excerpt.
            course_every: A scenario in every so many updates.
            course_steps: Steps of a segment there.
            max_segments: Segments after which an episode is given up.
            course_weight: Weight of the loss in scenarios.
            safety: Whether the safety layer is on in training; None: as the model says.
            judge_lr: Learning rate of the judges.
            annotation_noise: In half of the updates positions have white noise of a standard deviation of up
                to so many metres, as recordings have that were marked less exactly; 0 for never.
            weight_decay: Of AdamW (Loshchilov and Hutter, ICLR 2019): draws all layers towards 0.
                That is the walker before training.
            options: Of the optimisation and of validation; see `ForecastModule`.

        Raises:
            UserError: A number is out of range.
        """
        super().__init__(generator, **options)
        least = min(steps, scenes, samples_walked, course_every, course_steps, max_segments)
        if least < 1 or not before or min(before) < 0:
            raise UserError(
                f"steps {steps}, before {before}, scenes {scenes}, samples_walked {samples_walked}, "
                f"course_every {course_every}, course_steps {course_steps}, max_segments {max_segments}: "
                "expected at least 1, and before at least one number from 0"
            )
        at_least_zero(
            "--model.", annotation_noise=annotation_noise, weight_decay=weight_decay, judge_lr=judge_lr
        )
        self.automatic_optimization = False
        self.likeness, self.walking = likeness, walking or LoopLosses()
        self.steps, self.before, self.scenes, self.walks = steps, before, scenes, samples_walked
        self.course_every, self.course_steps = course_every, course_steps
        self.max_segments, self.course_weight, self.judge_lr = max_segments, course_weight, judge_lr
        self.annotation_noise, self.weight_decay = annotation_noise, weight_decay
        self._walker = (Walker(generator, safety=safety),)  # in a tuple: registered already
        self.courses = CourseSampler(courses, self.seed) if courses else None
        self._crowds: list[RecordedCrowd] = []
        self._unseen: list[RecordedCrowd] = []
        self._shares = torch.zeros(0)
        self._planner = Planner(MapBank([]))

    @property
    def walker(self) -> Walker:
        """The generator as a policy."""
        return self._walker[0]

    def setup(self, stage: str) -> None:
        """Read the training recordings on the true clock; see `ForecastModule.setup`.

        Raises:
            UserError: There are no people to compare with.
        """
        super().setup(stage)
        data: Any = getattr(self.trainer, "datamodule", None)
        if stage != "fit" or data is None:
            return
        planner = self._planner = Planner(data.bank, CLEARANCE, cell=CELL)
        crowds = [RecordedCrowd.of(tracks, at, planner) for tracks, at, _ in data.crowds("train")]
        self._crowds = [crowd for crowd in crowds if int(crowd.walks.sum()) >= _FEWEST]
        self._shares = torch.tensor([float(crowd.walks.sum()) ** 0.5 for crowd in self._crowds])
        unseen = [RecordedCrowd.of(tracks, at, planner) for tracks, at, _ in data.crowds("val")]
        self._unseen = [crowd for crowd in unseen if int(crowd.walks.sum()) >= _FEWEST]
        if not self._crowds:
            raise UserError(
                f"no recording of {data.fold!r} has {_FEWEST} people with more than {OBS_LEN} steps"
            )

    def configure_optimizers(self) -> OptimizerLRScheduler:
        """Return AdamW for the generator and, if there are judges, Adam for them."""
        # what is no layer's is a quantity, such as seconds of patience: 0 is not its neutral value
        quantities = dict(self.generator.named_parameters(recurse=False))
        layers = [value for name, value in self.generator.named_parameters() if name not in quantities]
        groups = [
            {"params": layers, "weight_decay": self.weight_decay},
            {"params": list(quantities.values()), "weight_decay": 0.0},
        ]
        result: list[Optimizer] = [torch.optim.AdamW(groups, self.lr)]
        if self.likeness.judges:
            result.append(torch.optim.Adam(self.likeness.parameters(), self.judge_lr, betas=(0.5, 0.9)))
        return cast("OptimizerLRScheduler", result)

    def training_step(self, batch: TensorDict, batch_idx: int) -> None:
        """Make one update: on recordings, or in a scenario."""
        optimizers = self.optimizers()
        first, *others = optimizers if isinstance(optimizers, list) else [optimizers]
        optimizer = cast("Optimizer", first)
        random = self.random()
        if self.courses is not None and int(self.iteration) % self.course_every == 0:
            terms = {name: self.course_weight * value for name, value in self._in_scenario().items()}
        else:
            terms = self._among_recorded(others[0] if others else None, random)
        loss = torch.stack(list(terms.values())).sum()
        optimizer.zero_grad()
        self.manual_backward(loss)
        norm = torch.nn.utils.clip_grad_norm_(self.generator.parameters(), self.clip or torch.inf)
        self.set_lr(optimizer, self.lr)
        if bool(norm.isfinite()):
            first.step()
        self.iteration += 1
        self.show("loss", loss)
        self.log_means({**terms, "loss": loss})

    def _among_recorded(self, judges: Any, random: torch.Generator) -> dict[str, Tensor]:
        """Return the terms of excerpts of one recording."""
        while True:
            crowd = self._crowds[int(torch.multinomial(self._shares, 1, generator=random))]
            if self.annotation_noise and float(torch.rand(1, generator=random)) < 0.5:
                crowd = self._annotated_anew(crowd, random)
            before = self.before[int(torch.randint(len(self.before), (1,), generator=random))]
            steps = before + self.steps
            people = float(crowd.there.sum()) / crowd.frames
            scenes = max(1, min(self.scenes, round(_PAIRS / (1.5 * people + 1))))
            latest = max(1, crowd.frames - OBS_LEN - steps)
            begin = torch.randint(latest, (scenes,), generator=random).tolist()
            mirrored = (torch.rand(scenes, generator=random) < 0.5).tolist()
            real = excerpts(crowd, begin, steps, mirrored)
            walking = real.walks & (real.taken < OBS_LEN + steps - 8) & (real.last > OBS_LEN + before)
            if int(walking.sum()) >= _FEWEST:
                break
        key = torch.randint(2**62, (self.walks * scenes,), generator=random).to(self.device)
        real = real.to(self.device)
        walk = walked_on(self.walker, real.repeated(self.walks), self._planner, key, before)
        return self.likeness(walk, real, self.walks, before, judges, random)

    def _annotated_anew(self, crowd: RecordedCrowd, random: torch.Generator) -> RecordedCrowd:
        """Return a crowd with noise, of one order of magnitude; people differ by a factor of 1.3 or so."""
        usual = self.annotation_noise * 10 ** -float(torch.rand(1, generator=random))
        of_person = (0.3 * torch.randn(len(crowd.first), generator=random)).exp()
        return crowd.annotated_anew(usual * of_person, random)

    def _in_scenario(self) -> dict[str, Tensor]:
        """Return the terms of a segment."""
        assert self.courses is not None
        active = self.courses.at(int(self.iteration), self.current_epoch, self.device)
        segment, noise = active.walk(self.walker, self.course_steps, self.max_segments)
        return self.walking(segment, active.env.bank, noise)

    def on_validation_epoch_end(self) -> None:
        """Log the errors of forecasts, and how unlike whole replays are, as ``val/unlike`` and so on."""
        super().on_validation_epoch_end()
        if not self.trainer.sanity_checking and self._unseen:
            for name, value in whole_replays(self.walker, self._unseen, self._planner, self.device).items():
                self.log(f"val/{name}", value, prog_bar=name == "unlike")

    def teardown(self, stage: str) -> None:
        """Close the environments."""
        if self.courses is not None:
            self.courses.close()


@torch.no_grad()
def whole_replays(
    policy: Policy,
    crowds: Sequence[RecordedCrowd],
    planner: Planner,
    device: torch.device | str = "cpu",
) -> dict[str, float]:
    """Return how unlike the crowds are in which a policy takes all people's places, from begin to end.

    ``realism``, ``auc`` and ``auc_coarse`` as in `pedzoo score`, people of all recordings together, and
    ``unlike``, their sum. The policy is on ``device``, and walks there.
    """
    made: dict[str, list[CrowdFeatures]] = {"auc": [], "auc_coarse": []}
    true: dict[str, list[CrowdFeatures]] = {"auc": [], "auc_coarse": []}
    for number, crowd in enumerate(crowds):
        real = excerpts(crowd, [1 - OBS_LEN], crowd.frames).to(device)
        walk = walked_on(policy, real, planner, torch.tensor([number], device=device))
        for into, one in ((made, _rounded(walk)), (true, _rounded(recorded(real)))):
            into["auc"].append(compared(one, real))
            into["auc_coarse"].append(compared(coarse(one), real))
    result = {name: _area(made[name], true[name]) for name in made}
    distances = [
        wasserstein(one, other) / other.std().clamp_min(_LEAST_SPREAD)
        for name in FEATURES
        for one, other in [[_all(side["auc"], name) for side in (made, true)]]
    ]
    result["realism"] = float(torch.stack(distances).mean())
    return result | {"unlike": result["realism"] + (result["auc"] + result["auc_coarse"]) / 2}


def _rounded(walk: CrowdWalk) -> CrowdWalk:
    """Return the crowd to the millimetre: the decimals of files would distinguish crowds."""
    return walk._replace(xy=(walk.xy.double() * 1000).round().div(1000).float())


def _area(made: list[CrowdFeatures], true: list[CrowdFeatures]) -> float:
    """Return the area under the classifier's ROC curve; no person is in training and test."""
    begin = torch.tensor([0, *(one.people for one in made)]).cumsum(0).tolist()
    people = begin[-1]
    part = torch.arange(people) * 2654435761 % 2**32 % FOLDS  # of Knuth: neighbours in different parts
    sides = [
        Clips(
            torch.cat([one.clips.flatten(1) for one in side]).cpu(),
            torch.cat([one.person + first for one, first in zip(side, begin, strict=False)]).cpu(),
        )
        for side in (made, true)
    ]
    each = torch.ones(1, people)
    return float(auc(two_sample(sides[0], sides[1], part, part), each, each))


def _all(side: list[CrowdFeatures], name: str) -> Tensor:
    return torch.cat([one.features[name] for one in side])
