"""Training in the loop: the network walks through scenes, and the walk is differentiated.

Full backpropagation through time over the environment, observations included, beside the forecasting loss on
recordings and their imitation step by step.
"""

from typing import Any, cast

import torch
from tensordict import TensorDict
from torch import Tensor

from pedzoo.core.batch import agents_of
from pedzoo.core.errors import UserError, at_least_one
from pedzoo.core.registry import function_in_file
from pedzoo.models.base import Forecaster
from pedzoo.policies.walker import Walker
from pedzoo.train.closed_loop.imitation import Imitation
from pedzoo.train.closed_loop.loop_losses import LoopLosses, mean_cost
from pedzoo.train.closed_loop.segments import Course, CourseSampler
from pedzoo.train.module import PlainModule


class LoopModule(PlainModule):
    """A segment of an environment and a batch of recordings in every update.

    An update whose gradient is not finite is skipped, and counted as ``train/skipped``.
    """

    by_loss, in_scenes = False, True
    skipped: Tensor

    def __init__(
        self,
        generator: Forecaster,
        courses: list[Course],
        walking: LoopLosses,
        imitation: Imitation,
        steps: int = 25,
        max_segments: int = 3,
        forecast_weight: float = 1.0,
        losses: dict[str, float] | None = None,
        **options: Any,
    ) -> None:
        """Take a generator and where it walks.

        Args:
            generator: The model.
            courses: Scenarios to train in.
            walking: Loss of walking.
            imitation: Loss of walking differently from recorded people.
            steps: Of 0.4 s in a segment.
            max_segments: Segments after which an episode is given up.
            forecast_weight: Weight of the generator's own loss on recordings, per person.
            losses: Terms of one's own and their weights, as ``{"path/to/file.py:crowding": 2.0}``. They are
                functions of a `Segment` and the floor plans (a `MapBank`), and return costs of decisions
                (T, B, A). Means over the people that the policy moves are logged as ``train/crowding``.
            options: Of the optimisation and of validation; see `ForecastModule`.

        Raises:
            UserError: A number is out of range.
        """
        super().__init__(generator, **options)
        at_least_one("steps", steps)
        at_least_one("max_segments", max_segments)
        self.walking, self.imitation = walking, imitation
        self.steps, self.max_segments = steps, max_segments
        self.forecast_weight = forecast_weight
        self.losses = {name: (function_in_file(name), weight) for name, weight in (losses or {}).items()}
        self._walker = (Walker(generator),)  # in a tuple: its parameters are registered already
        self.courses = CourseSampler(courses, self.seed)
        self.register_buffer("skipped", torch.zeros((), dtype=torch.long))

    @property
    def walker(self) -> Walker:
        """The generator as a policy."""
        return self._walker[0]

    def setup(self, stage: str) -> None:
        """Check the data. Raises UserError: as `ForecastModule.setup`, or there are no windows to imitate."""
        super().setup(stage)
        data: Any = getattr(self.trainer, "datamodule", None)
        if stage == "fit" and data is not None and not data.imitated.steps:
            raise UserError(
                "training in the loop imitates recorded walks: set --data.imitated.steps, such as 12"
            )

    def training_step(self, batch: dict[str, TensorDict], batch_idx: int) -> Tensor:
        """Return the loss of a segment and of two batches of recordings."""
        terms = self._walk()
        if self.forecast_weight:
            people = agents_of(batch["forecast"])["mask"].sum()
            loss = self.generator.loss(batch["forecast"], self.random())
            terms["forecast"] = self.forecast_weight * loss / people
        imitated = self.imitation(self.walker, batch["unrolled"], self.random())
        terms["imitation"] = imitated.pop("loss")
        self.log_means(terms | {f"imitation/{name}": value for name, value in imitated.items()})
        loss = torch.stack(list(terms.values())).sum()
        self.show("loss", loss)
        return loss

    def _walk(self) -> dict[str, Tensor]:
        """Return the terms of a segment."""
        active = self.courses.at(int(self.iteration), self.current_epoch, self.device)
        segment, noise = active.walk(self.walker, self.steps, self.max_segments)
        for name in ("agent_contact", "wall_contact"):
            self.log_means({name: getattr(segment, name).any(0).any(1).float().mean()})
        terms = self.walking(segment, active.env.bank, noise)
        for name, (function, weight) in self.losses.items():
            cost = function(segment, active.env.bank)
            if cost.shape != segment.moved.shape:
                raise UserError(
                    f"loss {name}: returned {tuple(cost.shape)}, expected what each decision costs, "
                    f"(T, B, A) = {tuple(segment.moved.shape)}"
                )
            terms[function.__name__] = weight * mean_cost(cost, segment.moved)
        return terms

    def on_after_backward(self) -> None:
        """Count the iteration, and skip gradients that are not finite."""
        super().on_after_backward()
        trained = [p for p in self.generator.parameters() if p.grad is not None]
        if not all(bool(cast("Tensor", p.grad).isfinite().all()) for p in trained):
            self.skipped += 1
            for parameter in trained:
                parameter.grad = None  # which Adam passes over
        self.log_means({"skipped": self.skipped.float()})

    def teardown(self, stage: str) -> None:
        """Close the environments."""
        self.courses.close()
