"""Training in the loop: what it learns, what an update does, how runs go on, and what is refused."""

import math
from pathlib import Path
from typing import Any, cast

import numpy as np
import pytest
import torch
import yaml
from helpers.loop_training import MEETING, module, small, train
from helpers.training import LIGHTNING_MARKS, SHORT, assert_same_end, fitted, last
from lightning.pytorch.callbacks import LambdaCallback
from torch import Tensor, nn

import pedzoo
from pedzoo.cli.main import main
from pedzoo.core.errors import UserError
from pedzoo.core.spec import grouped
from pedzoo.models.architectures.sgan import SGAN
from pedzoo.policies.walker import Walker
from pedzoo.sim.make import make_env
from pedzoo.train.closed_loop.in_the_loop import LoopModule
from pedzoo.train.closed_loop.loop_losses import LoopLosses
from pedzoo.train.closed_loop.segments import Course, Segment, unrolled
from pedzoo.train.run import rows_of

CONFIG = "closed_loop/approach_net_goal_map"
COURSES = '[{"scenario": "door:width=0.9", "scenes": 3}, {"scenario": "circle:people=2", "scenes": 2}]'
QUICK = [*SHORT, "--trainer.limit_train_batches=3", "--model.courses", COURSES, "--model.steps=3"]
QUICK += ["--model.samples=2", "--data.loading.batch_size=4", "--data.imitated.batch_size=4"]
QUICK += ["--data.imitated.steps=5"]
EMBEDDED = ["--data.fold", "embedded"]
STILL = ["--rollout.scenarios", "null", "--monitor", "val/ade", "--monitor_mode", "min"]

pytestmark = [pytest.mark.usefixtures("elsewhere"), *LIGHTNING_MARKS]


def fit(weights: str, *options: str, epochs: int = 1) -> Path:
    """Train in the loop from weights, and return the new run folder."""
    words = ["--config", CONFIG, "--weights", weights, *EMBEDDED, *QUICK, "--trainer.max_epochs", str(epochs)]
    return fitted(*words, *options)


def walked(model: SGAN) -> tuple[Segment, Tensor]:
    """Return what a model does in scenes of a seed of its own, and its cost but for forecasts."""
    env = make_env(MEETING, 16, seed=77)
    with torch.no_grad():
        segment = unrolled(env, Walker(model), env.reset(), 14)
        return segment, torch.stack(list(LoopLosses()(segment, env.bank).values())).sum()


def test_people_learn_to_keep_clear_of_each_other():
    """Those who met head-on touched each other in all scenes; a few updates later, in hardly any."""
    model = small()
    before, cost = walked(model)
    train(module(model, lr=5e-3), 15, scenes=2)
    after, less = walked(model)
    touched = [segment.agent_contact.any(0).any(1).float().mean() for segment in (before, after)]
    assert touched[0] > 0.9 and touched[1] < 0.3
    assert less < 0.7 * cost
    assert after.progress.sum() > 0.8 * before.progress.sum()  # and they still walk


class Broken(LoopLosses):
    """Costs nan in the second update, with gradients that are nan, too."""

    calls = 0

    def __call__(self, *arguments: Any) -> dict[str, Tensor]:
        self.calls += 1
        terms = super().__call__(*arguments)
        return {key: value * math.nan if self.calls == 2 else value for key, value in terms.items()}


def test_an_update_without_a_finite_gradient_is_skipped():
    trained = module(walking=Broken(), steps=3)
    weights: list[Tensor] = []

    def note(*_: Any) -> None:
        weights.append(nn.utils.parameters_to_vector(trained.parameters()).detach().clone())

    trainer = train(trained, 3, LambdaCallback(on_train_batch_start=note, on_train_batch_end=note))
    first, second, third = (weights[i : i + 2] for i in (0, 2, 4))
    assert torch.equal(*second) and not torch.equal(*first) and not torch.equal(*third)
    assert bool(torch.stack(weights).isfinite().all())
    assert int(trained.skipped) == 1 and trainer.callback_metrics["train/skipped"] > 0
    assert int(trained.iteration) == 3


def test_every_tensor_is_registered_once():
    trained = module()
    places = [value.data_ptr() for value in trained.state_dict().values()]
    assert len(places) == len(set(places))
    trained.double()
    assert next(trained.walker.model.parameters()).dtype == torch.float64


@pytest.mark.parametrize("named", [True, False])
def test_a_run_saves_the_dropout_that_it_ran_with(named, monkeypatch):
    """The config decides, not the weights, also where the weights name their config themselves."""
    weights = "sgan_goal_map.zara1" if named else "approach_net_goal_map.indoor"
    assert pedzoo.load(weights).config["map_dropout"] == 0.5
    ran: list[float] = []

    def step(self: LoopModule, *_: Any) -> Tensor:
        ran.extend(part.p for part in self.modules() if isinstance(part, nn.Dropout))
        return torch.stack([parameter.sum() for parameter in self.generator.parameters()]).sum()

    monkeypatch.setattr(LoopModule, "training_step", step)
    config = ["--config", CONFIG] if named else []
    assert main(["fit", *config, "--weights", weights, *EMBEDDED, *QUICK, *STILL]) == 0
    (run,) = Path().glob("runs/*/*")
    saved = yaml.safe_load((run / "config.yaml").read_text())["model"]["init_args"]["generator"]["init_args"]
    stored = pedzoo.load(str(last(run)))
    assert {saved["losses"]["map_dropout"], stored.config["map_dropout"], *ran} == {0.0}


def test_fit_twice_one_epoch_is_fit_two():
    """Environments, noise and optimizer too: bit-equal weights and optimizer states."""
    options = ["--model.final_lr", "1", *STILL]
    whole = fit("sgan_goal.zara1", *options, epochs=2)
    halves = fit("sgan_goal.zara1", *options, epochs=1)
    assert main(["fit", "--resume", str(halves), "--trainer.max_epochs", "2"]) == 0
    assert assert_same_end(last(whole), last(halves))["epoch"] == 1


def test_a_controller_of_your_own_recordings(refused):
    """As docs/extending.md has it: the files are named in both halves; without them the fold is none."""
    folder = Path(pedzoo.__file__).parent / "data" / "embedded"
    tracks = np.loadtxt(folder / "plaza_test.csv", delimiter=",", skiprows=1)
    tracks[:, 0] *= 4  # recorded at 0.1 s
    np.savetxt("a.csv", tracks, "%g", ",", header="frame,agent,x,y", comments="")
    files = ["--data.files", "a.csv", "--data.dt", "0.1", "--data.map", str(folder / "plaza.yaml")]
    assert main(["fit", "--config", "open_loop/approach_net_goal_map", *files, *SHORT, *STILL]) == 0
    weights = "runs/open_loop.approach_net_goal_map/a-seed0/checkpoints/best.ckpt"
    onwards = ["fit", "--config", CONFIG, "--weights", weights]
    assert "--data.files a.csv,b.csv" in refused(*onwards, *SHORT)
    assert main([*onwards, *files, *QUICK, *STILL]) == 0
    after = pedzoo.load("runs/closed_loop.approach_net_goal_map/a-seed0/checkpoints/best.ckpt")
    assert after.walking.safety and after.needs == {"goal", "map"}


@pytest.mark.parametrize("weights", ["sgan_goal.zara1", "social_vrnn.zara1"])
def test_any_generator_goes_into_the_loop(weights, capsys):
    """Its architecture and data win over the config's; checkpoints are chosen by all scenarios together."""
    walks = ["--rollout.scenarios", '["circle:people=2", "hallway"]', "--rollout.episodes", "2"]
    run = fit(weights, *walks, "--monitor", "rollout/clean", "--monitor_mode", "max")
    assert run == Path("runs/closed_loop.approach_net_goal_map/embedded-seed0")
    config = yaml.safe_load((run / "config.yaml").read_text())
    before, after = pedzoo.load(weights), pedzoo.load(str(run / "checkpoints" / "best.ckpt"))
    generator = config["model"]["init_args"]["generator"]
    held = {"safety": True, "map_dropout": 0.0}
    held = {key: value for key, value in held.items() if key in before.config}
    assert generator["init_args"] == grouped(type(before), before.config | held)
    assert before.config | held == after.config
    assert after.walking.safety is ("safety" in held)
    assert not before.walking.safety
    assert config["weights"] == weights and config["model"]["init_args"]["lr"] == pytest.approx(7e-4)
    pairs = zip(before.parameters(), after.parameters(), strict=True)
    assert any(not torch.equal(a, b) for a, b in pairs)
    (row,) = (row for row in rows_of(run / "metrics.csv") if "rollout/clean" in row)
    each = [float(row[f"rollout/{name}/clean"]) for name in ("circle:people=2", "hallway")]
    assert float(row["rollout/clean"]) == pytest.approx(sum(each) / 2)
    next_step = capsys.readouterr().out.partition("next: pedzoo forecast")[2]
    assert "embedded" in next_step and "unroll" not in next_step


def test_a_course_says_what_is_wrong_with_it():
    with pytest.raises(UserError, match="'door': scenes 4, share -1: expected at least 1 and above 0"):
        Course("door", 4, -1)
    with pytest.raises(UserError, match="max_segments 0"):
        module(cast("SGAN", small()), max_segments=0)
