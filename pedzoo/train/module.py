"""Training of a forecaster: schedule, seeds, scores, checkpoints, and a try of models that are a user's."""

import inspect
import math
import sys
import traceback
from collections.abc import Callable, Mapping, Set
from copy import deepcopy
from pathlib import Path
from typing import Any, ClassVar

import lightning as L
import torch
from lightning.pytorch.utilities import rank_zero_warn
from lightning.pytorch.utilities.types import OptimizerLRScheduler
from tensordict import TensorDict
from torch import Tensor, nn
from torch.optim import Optimizer

from pedzoo.core.batch import agents_of
from pedzoo.core.errors import UserError, at_least_zero
from pedzoo.core.spec import setting_groups, setting_types
from pedzoo.metrics.forecast import ForecastScore
from pedzoo.metrics.inputs import input_use
from pedzoo.models.base import Forecaster
from pedzoo.models.blocks.recurrent import DisplacementEncoder
from pedzoo.models.zoo.loading import architecture_in, config_of, read_checkpoint

SAMPLES = 2  # K of the tried futures

DEAD = 1e-4
"""Metres: forecasts that move by less without an input do not use it."""


class ForecastModule(L.LightningModule):
    """Trains a forecaster; subclasses say with which losses.

    All random numbers of a step are drawn from a generator seeded by the run's seed and the step's number,
    and the learning rate is a function of that number. So a resumed run ends where an uninterrupted one
    does. The command line's learning rate wins over a checkpoint's.

    Attributes:
        by_loss: The model's own loss is what trains it.
        in_scenes: It walks in scenes, which are in single precision.
    """

    by_loss: ClassVar[bool] = False
    in_scenes: ClassVar[bool] = False
    iteration: Tensor

    def __init__(
        self,
        generator: Forecaster,
        lr: float = 1e-3,
        warmup: int = 50,
        final_lr: float = 0.01,
        clip: float = 2.0,
        samples: int = 20,
    ) -> None:
        """Take a model and its optimisation.

        Args:
            generator: The model.
            lr: Learning rate of Adam at its peak.
            warmup: Iterations of linear warm-up.
            final_lr: Share of ``lr`` left at the end of the cosine; 1 keeps it constant.
            clip: Largest norm of the generator's gradient; 0 for any.
            samples: K of the best-of-K errors in validation and test.

        Raises:
            UserError: A number is out of range.
        """
        super().__init__()
        at_least_zero("--model.", lr=lr, warmup=warmup, final_lr=final_lr, clip=clip, samples=samples)
        self.generator = generator
        self.lr, self.warmup, self.final_lr, self.clip = lr, warmup, final_lr, clip
        self.seed = torch.initial_seed() % 2**31
        self.register_buffer("iteration", torch.zeros((), dtype=torch.long))
        self.score = ForecastScore(samples)
        self._shifts: dict[str, float] = {}  # the largest so far without each input, metres

    def setup(self, stage: str) -> None:
        """Check the goal protocol of the data."""
        data: Any = getattr(self.trainer, "datamodule", None)
        if data is None or stage != "fit" or "goal" not in self.generator.needs:
            return
        asked, own, cls = data.goal, self.generator.goal_protocol, type(self.generator)
        if asked in (own, "random_future") or (own is None and asked != "none"):  # for None any will do
            return
        if "goal_protocol" not in setting_types(cls):
            raise UserError(
                f"the data give goals by {asked!r}, and {cls.__name__} needs them by {own or 'any'!r}: set "
                f"--data.goal {own or 'window_end'}, or goal_protocol in the class"
            )
        group = "architecture." * ("architecture" in setting_groups(cls))
        raise UserError(
            f"the data give goals by {asked!r}, but the model is built for {own!r}: "
            f"set both, --data.goal {asked} --model.generator.{group}goal_protocol {asked}"
        )

    def on_fit_start(self) -> None:
        """Prepare the model, and try one of the user's. Raises UserError: as of `check_model`."""
        data: Any = getattr(self.trainer, "datamodule", None)
        if data is None or int(self.iteration):
            return
        self.generator.prepare((batch.to(self.device) for batch in data.recorded("train")), self.seed)
        if is_own(self.generator):
            config_of(self.generator)  # it can be saved
            check_model(self.generator, next(iter(data.recorded("train"))).to(self.device), self.by_loss)

    @property
    def precisions(self) -> list[str]:
        """Those of the trainer in which this trains: floor plans are single, LSTMs of one call not mixed."""
        if self.in_scenes:
            return ["32-true"]
        mixes = not any(isinstance(part, DisplacementEncoder) for part in self.modules())
        return ["32-true", *["64-true"] * ("map" not in self.generator.needs), *["bf16-mixed"] * mixes]

    @property
    def step_seed(self) -> int:
        """The seed of everything random in this iteration."""
        return self.seed * 1_000_003 + int(self.iteration)

    def random(self) -> torch.Generator:
        """Return a source of random numbers for this iteration."""
        return torch.Generator().manual_seed(self.step_seed)

    def on_train_batch_start(self, *_: Any) -> None:
        """Seed torch's own generator too: dropout and users' models draw from that."""
        torch.manual_seed(self.step_seed)

    def iterations(self) -> float:
        """Return how many iterations the whole training will have; infinite where nothing ends it.

        Counted here because ``trainer.max_steps`` counts steps of all optimizers.
        """
        epochs = self.trainer.max_epochs
        by_epochs = math.inf if epochs in (None, -1) else self.trainer.num_training_batches * max(epochs, 1)
        steps = self.trainer.max_steps
        by_steps = math.inf if steps < 0 else math.ceil(steps / self.steps_per_iteration())
        return max(min(by_epochs, by_steps), 1)

    def steps_per_iteration(self) -> float:
        """Return how many optimizer steps one iteration makes."""
        return 1 / self.trainer.accumulate_grad_batches

    def set_lr(self, optimizer: Optimizer, lr: float, done: int | None = None) -> None:
        """Set the learning rate after ``done`` iterations (``iteration`` if None): warm-up, then cosine."""
        done = int(self.iteration) if done is None else done
        share = min(done / self.iterations(), 1.0)
        cosine = self.final_lr + (1 - self.final_lr) * 0.5 * (1 + math.cos(math.pi * share))
        for group in optimizer.param_groups:
            group["lr"] = lr * cosine * min(1.0, (done + 1) / max(self.warmup, 1))

    def show(self, name: str, value: Tensor) -> None:
        """Show the value of this batch in the progress bar, where it moves with every batch."""
        self.log(
            name, value.detach(), prog_bar=True, logger=False, on_step=True, on_epoch=False, batch_size=1
        )

    def log_means(self, values: Mapping[str, Tensor], batch_size: int = 1, sync_dist: bool = False) -> None:
        """Log the means over an epoch as ``train/...``, with ``sync_dist`` those over all processes."""
        named = {f"train/{name}": value.detach() for name, value in values.items()}
        self.log_dict(named, on_step=False, on_epoch=True, batch_size=batch_size, sync_dist=sync_dist)

    def validation_step(self, batch: TensorDict, batch_idx: int) -> None:
        """Add a batch to the scores, with the same noise in every epoch."""
        self.score.update(self.generator, batch, torch.Generator().manual_seed(batch_idx))
        if not batch_idx and not self.trainer.testing:
            self.check_inputs(batch)

    test_step = validation_step

    def check_inputs(self, batch: TensorDict) -> None:
        """Log how far forecasts move without each input, and warn of an input that training has killed."""
        for case, (shift, _) in input_use(self.generator, batch, control=False).items():
            if not shift.numel():
                continue
            now, before = float(shift.mean()), self._shifts.get(case, 0.0)
            self._shifts[case] = max(now, before)
            self.log(f"val/shift_without_{case.replace(' ', '_')}", now, batch_size=1, sync_dist=True)
            if now < DEAD <= before:
                rank_zero_warn(
                    f"the model no longer uses {case}: without this input forecasts move by {now:.1e} m, "
                    f"before by {before:.1e} m. A lower --model.lr or --model.clip may keep it alive"
                )

    def on_validation_epoch_end(self, split: str = "val") -> None:
        """Log the scores as ``val/ade`` and so on."""
        for metric, value in self.score.compute().items():
            name = metric.removesuffix("_m")
            self.log(f"{split}/{name}", value, prog_bar=name in ("ade", "fde"), sync_dist=True)
        self.score.reset()

    def on_test_epoch_end(self) -> None:
        """Log the scores as ``test/ade`` and so on."""
        self.on_validation_epoch_end("test")

    def on_save_checkpoint(self, checkpoint: dict[str, Any]) -> None:
        """Write down which model this is, so that `pedzoo.load` can build it."""
        data: Any = getattr(self.trainer, "datamodule", None)
        checkpoint["pedzoo"] = config_of(self.generator, protocol=data.protocol if data else {})

    def on_load_checkpoint(self, checkpoint: dict[str, Any]) -> None:
        """Check that a checkpoint is of this training. Raises UserError: it is of another one."""
        theirs, ours = checkpoint.get("pedzoo"), config_of(self.generator)
        if theirs is None:
            raise UserError("this checkpoint was not written by pedzoo fit")
        if changed := differences(theirs, ours):
            raise UserError(
                f"the checkpoint is of another architecture ({'; '.join(changed)}); use its own --config"
            )
        check_state(self, checkpoint)


class PlainModule(ForecastModule):
    """Minimises ``generator.loss(batch)``: squared errors, variety losses, evidence bounds."""

    by_loss = True

    @property
    def networks(self) -> list[nn.Module]:
        """What is trained; each has the norm of its gradient clipped on its own."""
        return [self.generator]

    def configure_optimizers(self) -> OptimizerLRScheduler:
        """Return Adam; `set_lr` sets its learning rate at every iteration."""
        return torch.optim.Adam([p for network in self.networks for p in network.parameters()], self.lr)

    def training_step(self, batch: TensorDict, batch_idx: int) -> Tensor:
        """Return the loss of a batch, summed over its scenes."""
        loss = self.generator.loss(batch, self.random())
        per_scene = loss.detach() / len(batch)
        self.log_means({"loss": per_scene}, len(batch), sync_dist=True)
        self.show("loss", per_scene)
        return loss

    def on_after_backward(self) -> None:
        """Count the iteration: not at its very end, where checkpoints may have been written already."""
        self.iteration += 1

    def on_before_optimizer_step(self, optimizer: Optimizer) -> None:
        """Clip the gradients and set the learning rate."""
        for network in self.networks if self.clip else ():
            torch.nn.utils.clip_grad_norm_(list(network.parameters()), self.clip)
        self.set_lr(optimizer, self.lr, int(self.iteration) - 1)


def check_state(module: nn.Module, checkpoint: Mapping[str, Any]) -> None:
    """Check that a checkpoint has the tensors of a training. Raises UserError: others, or other shapes."""
    shapes, own = (
        {key: tuple(getattr(value, "shape", "?")) for key, value in state.items()}
        for state in (checkpoint["state_dict"], module.state_dict())
    )
    if different := sorted(key for key in shapes | own if shapes.get(key) != own.get(key)):
        more = f" and {len(different) - 3} more" if len(different) > 3 else ""
        raise UserError(
            f"the checkpoint is of another training than {type(module).__name__} as configured: "
            f"{', '.join(different[:3])}{more} differ; use its own --config"
        )


def read_progress(file: str) -> dict[str, Any]:
    """Return a checkpoint to go on with. Raises UserError: it cannot be read, or has weights alone."""
    checkpoint = read_checkpoint(file)
    if lacks := [key for key in ("loops", "optimizer_states") if not checkpoint.get(key)]:
        raise UserError(f"checkpoint {file!r} has no {lacks[0]} to go on with: is it damaged?")
    return checkpoint


def differences(theirs: dict[str, Any], ours: dict[str, Any], free: Set[str] = frozenset()) -> list[str]:
    """Return the differences of two models' architectures but for ``free`` settings, as readable texts."""
    names = theirs["architecture"], ours["architecture"]
    if names[0] != names[1]:
        return [f"architecture: {names[0]} there, {names[1]} here"]
    given, wanted = architecture_in(theirs), architecture_in(ours)
    return [
        f"{key}: {given.get(key)} there, {wanted.get(key)} here"
        for key in given | wanted
        if key not in free and given.get(key) != wanted.get(key)
    ]


def is_own(model: Forecaster) -> bool:
    """Return whether a model's class is not pedzoo's: the tests hold those."""
    return not type(model).__module__.startswith("pedzoo.")


def check_model(model: Forecaster, batch: TensorDict, by_loss: bool) -> None:
    """Let a copy of an untrained model predict recorded scenes and, ``by_loss`` of its own, learn once.

    No random number is taken from torch's.

    Raises:
        UserError: It takes other arguments or fails, its futures have another shape or are no numbers, its
            loss is no finite number, or nothing of it gets a gradient. The message says what to change.
    """
    tried, name = deepcopy(model), type(model).__name__
    devices = [batch.device] if batch.device is not None and batch.device.type == "cuda" else []
    with torch.random.fork_rng(devices), torch.enable_grad():
        _check_futures(tried, name, batch)
        if by_loss:
            _check_loss(tried, name, batch)


def _check_futures(model: Forecaster, name: str, batch: TensorDict) -> None:
    agents = agents_of(batch)
    scenes, people, steps, _ = agents["future"].shape
    usage = f"{name}.sample(batch, samples, steps, generator=None)"
    future = _called(model.sample, usage, batch, SAMPLES, steps)
    expected = scenes, SAMPLES, people, steps, 2
    if not isinstance(future, Tensor) or future.shape != expected:
        raise UserError(
            f"{name}.sample returned {_shown(future)}: expected displacements (B, K, A, T, 2), here "
            f"{expected}; pedzoo.models.base.for_all_samples makes them from one path (B, A, T, 2)"
        )
    here = agents["mask"][:, None, :, None, None].expand_as(future)
    if not bool(future[here].isfinite().all()):
        raise UserError(
            f"{name}.sample returned numbers that are not finite: divide by nothing that may be 0, and read "
            "no position of the history where agents/valid is false"
        )


def _check_loss(model: Forecaster, name: str, batch: TensorDict) -> None:
    loss = _called(model.loss, f"{name}.loss(batch, generator=None)", batch)
    if not isinstance(loss, Tensor) or loss.shape != ():
        raise UserError(
            f"{name}.loss returned {_shown(loss)}: expected one number, the sum over scenes: add .sum()"
        )
    if not bool(loss.isfinite()):
        raise UserError(
            f"{name}.loss is {loss.item()} on the first batch: leave out unknown steps (agents/future_valid) "
            "and padding (agents/mask) by torch.where, as products keep NaN"
        )
    learned = {key: value for key, value in model.named_parameters() if value.requires_grad}
    if not learned:
        raise UserError(f"{name} has no parameters to train: assign its networks to self in __init__")
    if not loss.requires_grad:
        raise UserError(
            f"no gradient of {name}.loss reaches its parameters: compute it from what they give, without "
            "detach(), item() or torch.no_grad()"
        )
    loss.backward()
    gradients = {key: value.grad for key, value in learned.items() if value.grad is not None}
    if wrong := [key for key, value in gradients.items() if not bool(value.isfinite().all())]:
        raise UserError(
            f"the gradient of {name}.loss with respect to {wrong[0]} is not finite on the first batch: "
            "sqrt() has no slope at 0, add a small number below the root; take padding out before it is used"
        )
    if left := [key for key in learned if key not in gradients]:
        print(f"note: {', '.join(left[:3])} of {name} get no gradient from its loss", file=sys.stderr)


def _shown(value: Any) -> str:
    return str(tuple(value.shape)) if isinstance(value, Tensor) else repr(value)[:60]


def _called(function: Callable[..., Any], usage: str, *given: Any) -> Any:
    """Return what a method of a model returns; mistakes in calls and keys become one line."""
    random = torch.Generator().manual_seed(0)
    try:
        inspect.signature(function).bind(*given, random)
    except TypeError as error:
        raise UserError(f"expected {usage}: {error}") from error
    try:
        return function(*given, random)
    except NotImplementedError as error:
        raise UserError(f"no {usage}: it returns displacements (B, K, A, T, 2) in metres") from error
    except KeyError as error:
        raise UserError(
            f"{usage} reads what the batch has not: {' '.join(str(error.args[0]).split())}; of a model with "
            "goals the class says needs = frozenset({'goal'}), and --data.goal gives them"
        ) from error
    except UserError:
        raise
    except Exception as error:  # a user's code may fail in any way
        frames = traceback.extract_tb(error.__traceback__)
        own = [frame for frame in frames if "site-packages" not in frame.filename]
        place = f"{Path((own or frames)[-1].filename).name}:{(own or frames)[-1].lineno}"
        said = " ".join(str(error).split())
        keys = agents_of(given[0]).items(True, True)
        shapes = ", ".join(f"{key} {tuple(value.shape)}" for key, value in keys)
        raise UserError(
            f"{usage} failed at {place}: {type(error).__name__}: {said}; agents: {shapes}"
        ) from error
