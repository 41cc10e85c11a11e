"""Training: resumed runs, learning rates, who gets which gradient, records, and what is refused."""

import math
from dataclasses import replace
from pathlib import Path
from typing import Any, cast

import lightning as L
import pytest
import torch
from helpers.batches import changed, make_batch, random_weights
from helpers.training import LIGHTNING_MARKS, SHORT, assert_same_end, quiet_trainer
from lightning.pytorch.callbacks import Callback, LambdaCallback, ModelCheckpoint
from torch import Tensor
from torch.optim import Optimizer

import pedzoo
from pedzoo.cli.main import main
from pedzoo.core.batch import agents_of
from pedzoo.core.errors import UserError
from pedzoo.data.datamodule import Loading, TrajectoryDataModule
from pedzoo.models.architectures.sgan import SGAN
from pedzoo.models.base import Forecaster
from pedzoo.models.blocks.variety import Discriminator
from pedzoo.train.gan import GANModule
from pedzoo.train.module import ForecastModule, PlainModule
from pedzoo.train.run import rows_of

pytestmark = [pytest.mark.usefixtures("elsewhere"), *LIGHTNING_MARKS]

QUICK = [*SHORT, "--data.fold=embedded", "--data.loading.batch_size=8", "--model.samples=2"]
QUICK += ["--model.generator.losses.best_k=3", "--trainer.limit_train_batches=3"]
CONSTANT = ["--model.warmup", "1", "--model.final_lr", "1"]


def make_module(kind: str, **options: Any) -> ForecastModule:
    """Return a small training of ``kind`` gan, global or plain, always the same."""
    torch.manual_seed(0)
    model = SGAN.of(best_k=3, bottleneck_dim=8)
    options = {"warmup": 2, "samples": 2} | options
    if kind == "plain":
        return PlainModule(model, **options)
    return GANModule(model, Discriminator("global" if kind == "global" else "local"), **options)


def test_training_warns_of_an_input_that_it_has_killed(recwarn):
    """Social pooling dies silently: forecasts stay good where goals tell the answer."""
    module: Any = make_module("plain")
    module.log = lambda *_, **__: None
    batch = make_batch((4, 3))
    batch = changed(batch, history=agents_of(batch)["history"] / 10)  # people near each other
    module.check_inputs(batch)
    assert not recwarn.list
    with torch.no_grad():
        module.generator.to_decoder[0].weight[:, -8:] = 0
    with pytest.warns(UserWarning, match="no longer uses others: .* move by 0.0e\\+00 m, before by .* m"):
        module.check_inputs(batch)


def make_data(**options: Any) -> TrajectoryDataModule:
    return TrajectoryDataModule(loading=Loading(batch_size=8, rotate=True, mirror=True), **options)


def make_trainer(*callbacks: Callback, **options: Any) -> L.Trainer:
    limits = {"limit_train_batches": 3, "limit_val_batches": 1, "max_epochs": 2, "num_sanity_val_steps": 0}
    return quiet_trainer(*callbacks, **limits | options)


class PowerCutError(Exception):
    """The run ends in the middle."""


def cut(trainer: L.Trainer, module: L.LightningModule, batch: Any, batch_idx: int) -> None:
    """End a run in the middle of the third epoch."""
    if trainer.current_epoch == 2 and batch_idx == 1:
        raise PowerCutError


@pytest.mark.parametrize("kind", ["global", "plain"])
def test_a_cut_run_ends_as_an_uninterrupted_one(kind, tmp_path):
    def run(folder: str, *more: Callback, resume: Path | None = None) -> Path:
        saver = ModelCheckpoint(
            tmp_path / folder, "last", save_on_train_epoch_end=True, enable_version_counter=False
        )
        trainer = make_trainer(saver, *more, max_epochs=4)
        trainer.fit(make_module(kind), make_data(), ckpt_path=resume)
        return tmp_path / folder / "last.ckpt"

    whole = run("whole")
    with pytest.raises(PowerCutError):
        run("cut", LambdaCallback(on_train_batch_start=cut))
    torch.manual_seed(99)  # another process, another state of everything global
    resumed = run("cut", resume=tmp_path / "cut" / "last.ckpt")
    state = assert_same_end(resumed, whole)["state_dict"]
    assert state["iteration"] == 12
    assert any(not torch.equal(state[key], value) for key, value in make_module(kind).state_dict().items())


def test_fit_twice_two_epochs_is_fit_four(tmp_path):
    fit = ["fit", "--config", "sgan_nopool", *QUICK, *CONSTANT, "--trainer.max_epochs"]
    assert main([*fit, "4", "--runs", "whole"]) == 0
    assert main([*fit, "2", "--runs", "halves"]) == 0
    whole, halves = (next(tmp_path.glob(f"{name}/*/*/checkpoints/last.ckpt")) for name in ("whole", "halves"))
    assert main(["fit", "--resume", str(halves.parent.parent), "--trainer.max_epochs", "4"]) == 0
    assert_same_end(whole, halves)
    rows = rows_of(whole.parent.parent / "metrics.csv")
    wanted = {"val/ade", "val/fde", "val/next_step", "val/min_ade_2_scene", "val/min_fde_2_agent"}
    wanted |= {"train/variety", "train/adversarial", "train/discriminator"}
    for name in wanted:
        values = [float(row[name]) for row in rows if name in row]
        assert len(values) == 4 and all(math.isfinite(value) and value > 0 for value in values), name
    assert len({row["val/ade"] for row in rows if "val/ade" in row}) == 4
    result = pedzoo.load(str(whole))
    assert isinstance(result, SGAN) and result.losses.best_k == 3


def test_options_win_over_checkpoints_and_strangers_are_refused(tmp_path, refused):
    assert main(["fit", "--config", "sgan_nopool", *QUICK, *CONSTANT, "--trainer.max_epochs", "1"]) == 0
    last = next(tmp_path.glob("runs/*/*/checkpoints/last.ckpt"))
    run = last.parent.parent
    assert _rates(last) == [1e-3, 1e-3]
    rates = ["--model.lr", "5e-4", "--model.lr_discriminator", "2e-4"]
    assert main(["fit", "--resume", str(run), *rates, "--trainer.max_epochs", "2"]) == 0
    assert _rates(last) == [5e-4, 2e-4]
    before = {path: path.read_bytes() for path in run.rglob("*") if path.is_file()}
    for options, message in (
        (["--model.generator.architecture.encoder_dim", "48"], "(encoder_dim: 32 there, 48 here)"),
        (["--model.generator.architecture.noise", "agent"], "noise: scene there, agent here"),
        (["--model.discriminator.kind", "global"], "of another training than GANModule as configured"),
        (["--model.discriminator.hidden_dim", "32"], "discriminator.classifier.0.weight"),
    ):
        error = refused("fit", "--resume", str(run), *options, "--trainer.max_epochs", "3")
        assert message in error and "use its own --config" in error
        assert {path: path.read_bytes() for path in run.rglob("*") if path.is_file()} == before
    sgan = "{class_path: pedzoo.models.architectures.sgan.SGAN}"
    module = f"{{class_path: pedzoo.train.module.PlainModule, init_args: {{generator: {sgan}}}}}"
    Path("plain.yaml").write_text(f"model: {module}\n")
    error = refused("fit", "--config", "plain.yaml", *QUICK, "--ckpt_path", str(last))
    assert "of another training than PlainModule" in error
    assert len(list(tmp_path.glob("runs/*/*"))) == 1


def _rates(checkpoint: Path) -> list[float]:
    states = torch.load(checkpoint, weights_only=True)["optimizer_states"]
    return [state["param_groups"][0]["lr"] for state in states]


def test_losses_may_change_when_a_run_goes_on(tmp_path):
    saver = ModelCheckpoint(tmp_path, "last", save_on_train_epoch_end=True)
    make_trainer(saver, max_epochs=1).fit(make_module("gan"), make_data())
    module = make_module("gan", adversarial_weight=0.0)
    generator = cast("SGAN", module.generator)
    generator.config["best_k"], generator.losses = 2, replace(generator.losses, best_k=2)
    make_trainer(max_epochs=2).fit(module, make_data(), ckpt_path=tmp_path / "last.ckpt")
    assert int(module.iteration) == 6


def test_weight_zero_leaves_the_discriminator_alone(monkeypatch):
    module = cast("GANModule", make_module("global", adversarial_weight=0.0))
    before = {key: value.clone() for key, value in module.state_dict().items()}

    def forbidden(*_: Any) -> Tensor:
        raise AssertionError("the discriminator was called")

    monkeypatch.setattr(Discriminator, "forward", forbidden)
    trainer = make_trainer()
    trainer.fit(module, make_data())
    same = {key for key, value in module.state_dict().items() if torch.equal(value, before[key])}
    assert same == {key for key in before if key.startswith("discriminator.")}
    assert not trainer.optimizers[1].state and trainer.global_step == 6
    assert set(trainer.logged_metrics) >= {"train/variety", "val/ade"}
    assert "train/discriminator" not in trainer.logged_metrics


@pytest.mark.parametrize("kind", ["gan", "global"])
def test_each_step_has_gradients_for_its_own_network_only(kind):
    module = cast("GANModule", make_module(kind))
    stored: dict[str, Tensor] = {}

    def watch(trainer: L.Trainer, _: L.LightningModule, optimizer: Optimizer) -> None:
        judge = dict(module.discriminator.named_parameters())
        if optimizer is trainer.optimizers[1]:
            assert all(p.grad is None for p in module.generator.parameters())
            assert not any(p.requires_grad for p in module.generator.parameters())
            stored.update({key: cast("Tensor", p.grad).clone() for key, p in judge.items()})
        else:
            assert all(p.grad is not None and p.requires_grad for p in module.generator.parameters())
            assert not any(p.requires_grad for p in judge.values())
            assert stored and all(
                torch.equal(cast("Tensor", judge[key].grad), g) for key, g in stored.items()
            )

    callback = LambdaCallback(on_before_optimizer_step=watch)
    trainer = make_trainer(callback, max_epochs=1, limit_train_batches=1)
    trainer.fit(module, make_data())
    assert trainer.global_step == 2
    assert all(p.requires_grad for p in module.parameters())


def test_the_adversarial_loss_reaches_the_generator():
    """With the same noise and discriminator, its weight changes the generator's step."""
    ends = []
    for weight in (1e-9, 5.0):
        module = cast("GANModule", make_module("gan", adversarial_weight=weight))
        # a score under zero has no slope: the published network may start there for all people
        torch.nn.init.ones_(cast("torch.nn.Linear", module.discriminator.classifier[2]).bias)
        make_trainer(max_epochs=1, limit_train_batches=1).fit(module, make_data())
        ends.append(torch.cat([p.detach().flatten() for p in module.generator.parameters()]))
    assert not torch.equal(*ends)


SCHEDULES = [
    ("gan", {}, {"max_epochs": 3}, 9),
    ("gan", {}, {"max_steps": 14, "max_epochs": -1}, 7),
    ("gan", {}, {"max_steps": 8, "max_epochs": 3}, 4),
    ("gan", {"adversarial_weight": 0.0}, {"max_steps": 7, "max_epochs": -1}, 7),
    ("plain", {}, {"max_epochs": 3}, 9),
    ("plain", {}, {"max_steps": 7, "max_epochs": -1}, 7),
    ("plain", {}, {"max_epochs": 3, "limit_train_batches": 4, "accumulate_grad_batches": 2}, 12),
]


@pytest.mark.parametrize(("kind", "options", "limits", "iterations"), SCHEDULES, ids=str)
def test_the_learning_rate_ends_with_the_training(kind, options, limits, iterations):
    rates: dict[int, list[float]] = {}  # of all optimizers, by step

    def note(trainer: L.Trainer, *_: Any) -> None:
        if trainer.global_step:
            own = [optimizer.param_groups[0]["lr"] for optimizer in trainer.optimizers]
            rates.setdefault(trainer.global_step, own)

    module = make_module(kind, lr=1e-3, warmup=2, final_lr=0.1, **options)
    watch = LambdaCallback(on_train_batch_end=note)
    make_trainer(watch, limit_val_batches=0, **{"limit_train_batches": 3} | limits).fit(module, make_data())
    assert int(module.iteration) == iterations
    every = limits.get("accumulate_grad_batches", 1)
    wanted = []
    for done in range(every - 1, iterations, every):
        cosine = 0.1 + 0.9 * 0.5 * (1 + math.cos(math.pi * done / iterations))
        wanted.append(1e-3 * cosine * min(1.0, (done + 1) / 2))
    assert wanted[-1] < 0.3e-3
    assert [rate[0] for rate in rates.values()] == pytest.approx(wanted)
    assert all(rate[1:] in ([], [1e-3]) for rate in rates.values())


def test_a_training_without_an_end_has_a_constant_rate():
    def stop(trainer: L.Trainer, *_: Any) -> None:
        trainer.should_stop = trainer.global_step >= 8

    for kind in ("gan", "plain"):
        enough = LambdaCallback(on_train_batch_end=stop)
        trainer = make_trainer(enough, max_epochs=-1, limit_val_batches=0)
        trainer.fit(make_module(kind, lr=2e-3), make_data())
        assert trainer.optimizers[0].param_groups[0]["lr"] == 2e-3


@pytest.mark.parametrize("kind", ["gan", "plain"])
def test_checkpoints_within_an_epoch_count_their_iteration(kind, tmp_path):
    saver = ModelCheckpoint(tmp_path, "{step}", every_n_train_steps=2 if kind == "gan" else 1, save_top_k=-1)
    make_trainer(saver, max_epochs=1).fit(make_module(kind), make_data())
    result = {}
    for path in tmp_path.glob("*.ckpt"):
        checkpoint = torch.load(path, weights_only=True)
        result[checkpoint["global_step"]] = int(checkpoint["state_dict"]["iteration"])
    per_iteration = 2 if kind == "gan" else 1
    assert len(result) == 3 and all(step == per_iteration * done for step, done in result.items())


def test_another_goal_protocol_than_the_models_is_refused(refused):
    module = make_module("plain")
    module.generator = SGAN.of(goal_dim=4, goal_protocol="window_end")
    for goal in ("destination", "none"):
        with pytest.raises(UserError, match=f"goals by '{goal}', but the model is built for 'window_end'"):
            make_trainer().fit(module, make_data(goal=goal))
    error = refused("fit", "--config", "sgan_goal", *QUICK, "--data.goal", "destination")
    assert "--model.generator.architecture.goal_protocol destination" in error
    make_trainer(max_epochs=1, limit_train_batches=1).fit(module, make_data(goal="random_future"))


def test_batches_bring_the_floor_plans_of_the_data():
    module, seen = make_module("gan"), []
    module.generator = SGAN.of(map="patch", best_k=2)
    assert module.generator.map is not None
    module.generator.map.register_forward_pre_hook(lambda part, given: seen.append(given[0].bank))
    data = make_data()
    make_trainer(max_epochs=1, limit_train_batches=1).fit(module, data)
    assert seen and all(bank is data.bank for bank in seen)


def test_a_model_without_variety_loss_is_for_the_other_module():
    with pytest.raises(UserError, match="has no variety loss: train it with PlainModule"):
        GANModule(cast("SGAN", Forecaster()), Discriminator())


def test_no_person_is_judged_by_positions_that_were_not_seen():
    module = cast("GANModule", make_module("gan"))
    random_weights(cast("Forecaster", module.discriminator))
    batch = make_batch((2, 3), goal=False, partly=True)
    agents = agents_of(batch)
    unknown = ~agents["future_valid"] & agents["mask"][..., None]
    elsewhere = changed(batch, future=agents["future"] + 5.0 * unknown.unsqueeze(-1))
    losses = [
        module.discriminator_loss(data, torch.Generator().manual_seed(0)) for data in (batch, elsewhere)
    ]
    assert losses[0].isfinite() and losses[0] > 0 and torch.equal(*losses)
    without_future = changed(batch, future_valid=torch.zeros_like(agents["future_valid"]))
    assert module.discriminator_loss(without_future, torch.Generator()).item() == 0.0


@pytest.mark.parametrize("kind", ["global", "plain"])
def test_partly_present_people_train(kind):
    module = make_module(kind)
    make_trainer().fit(module, make_data(keep_people="present", min_people=1))
    assert all(value.isfinite().all() for value in module.parameters())
