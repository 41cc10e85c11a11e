"""Training of a walker: recorded states, what likelihood and self-play teach, what is refused."""

from pathlib import Path
from typing import Any, cast

import numpy as np
import pytest
import torch
from helpers.training import LIGHTNING_MARKS, SHORT, quiet_trainer
from tensordict import TensorDict
from torch import Tensor, nn

from pedzoo.cli.main import main
from pedzoo.core.batch import agents_of
from pedzoo.core.types import OBS_LEN
from pedzoo.data.datamodule import Loading, TrajectoryDataModule
from pedzoo.data.tracks import Tracks
from pedzoo.maps.bank import MapBank
from pedzoo.maps.planning.planner import Planner
from pedzoo.models.architectures.mdn_walker import Architecture, MdnWalker
from pedzoo.sim.make import make_env
from pedzoo.train.closed_loop.segments import Course
from pedzoo.train.ppo.self_play import NextVelocity, Rewards, Seeing, SelfPlayModule, seen_in
from pedzoo.train.walker import RecordedStates, WalkerModule

pytestmark = LIGHTNING_MARKS

FRAMES = 30
SMALL = Architecture(width=16, near_dim=8, components=3, dropout=0.0)


def recording() -> RecordedStates:
    """Return people who walk along x at 1 m/s; number 1 turns left in frame 15, number 2 comes in frame 5."""
    rows = []
    for frame in range(FRAMES):
        rows.append((frame, 0, 0.4 * frame, 0.0))
        rows.append((frame, 1, 0.4 * min(frame, 15), 3.0 + 0.4 * max(frame - 15, 0)))
        if frame >= 5:
            rows.append((frame, 2, 0.4 * frame, 6.0))
    tracks = Tracks.from_table("walks", np.array(rows))
    return RecordedStates(tracks, -1, 1.0, Planner(MapBank()))


def walker(seed: int = 0) -> MdnWalker:
    torch.manual_seed(seed)
    return MdnWalker(SMALL)


def data(**more: Any) -> TrajectoryDataModule:
    return TrajectoryDataModule(goal="destination", loading=Loading(batch_size=8), **more)


def test_states_are_those_of_people_who_can_be_moved():
    one = recording()
    assert one.frames.tolist() == list(range(OBS_LEN - 1, FRAMES - 1))
    scenes = one.scenes(torch.tensor([7, 12, 15]))
    assert scenes.mine.sum(1).tolist() == [2, 3, 3]
    assert one.states == 2 * (FRAMES - OBS_LEN) + FRAMES - 5 - OBS_LEN
    change = (scenes.following - scenes.velocity)[scenes.mine]
    turns = change.norm(dim=-1) > 1e-4
    assert turns.tolist() == [False] * 2 + [False] * 3 + [False, True, False]
    torch.testing.assert_close(change[turns], torch.tensor([[-1.0, 1.0]]), atol=1e-4, rtol=0)
    torch.testing.assert_close(agents_of(scenes.batch)["first_history"][0, 0, :, 0], 0.4 * torch.arange(8.0))


def test_a_policy_in_a_replay_sees_the_same():
    one, model = recording(), walker()
    begin = torch.tensor([9, 20])
    env = make_env(one.excerpts(begin, 6), 2, "compiled")
    reset = Seeing(model)(env.reset())
    scenes = one.scenes(begin)
    # in a replay nobody has seen more of them than their last steps
    scenes.batch["agents", "first_history"] = agents_of(scenes.batch)["history"]
    there = agents_of(scenes.batch)["mask"]
    for mine, theirs in zip(model.features(model.view(scenes.batch)), seen_in(reset), strict=True):
        torch.testing.assert_close(mine[there], theirs[there], equal_nan=True)


def test_targets_are_turned_to_the_way_and_exactly_held():
    module = WalkerModule(walker())
    targets = module.targets(recording(), torch.tensor([15]), 4)
    assert targets.held.tolist() == [True, False, True] and targets.recording.tolist() == [4, 4, 4]
    assert (targets.change[[0, 2]] == 0).all()
    # its way leads to where it is last seen: straight to the left
    torch.testing.assert_close(targets.change[1], torch.tensor([1.0, 1.0]), atol=1e-3, rtol=0)


def test_training_makes_recorded_steps_likelier():
    module = WalkerModule(walker(), states=2000, states_per_step=64, lr=3e-3, warmup=1, samples=0)
    trainer = quiet_trainer(max_epochs=1, limit_train_batches=60, limit_val_batches=1)
    before = []
    module.on_train_batch_start = lambda *_: before.append(float(module.surprise(module.random()).detach()))  # type: ignore[method-assign]
    trainer.fit(module, data())
    assert sum(before[-10:]) / 10 < sum(before[:10]) / 10 - 0.5
    assert float(trainer.callback_metrics["val/nll"]) < before[0]


def test_draws_of_next_velocities_have_the_likelihood_of_changes():
    change = walker().change(WalkerModule(walker()).targets(recording(), torch.tensor([12])).seen)
    ahead = nn.functional.normalize(torch.randn(3, 2), dim=-1)
    before = torch.randn(3, 2)
    hold = change._replace(hold=torch.tensor([50.0, -50.0, 0.0]))
    one = NextVelocity(*hold, ahead, before)
    drawn = one.sample()
    likely = one.log_prob(drawn)
    assert float(likely[0].detach()) == pytest.approx(0.0, abs=1e-6)
    assert likely.isfinite().all() and one.entropy().shape == (3,)
    held = torch.tensor([True, False, False])
    same = hold.log_prob(_turned_back(drawn, ahead) - before, held)
    # a density near a narrow Gaussian turns rounding of a velocity into nats
    assert float(likely[1].detach()) == pytest.approx(float(same[1].detach()), abs=1e-2)


def _turned_back(velocity: torch.Tensor, ahead: torch.Tensor) -> torch.Tensor:
    left = torch.stack((-ahead[:, 1], ahead[:, 0]), -1)
    return torch.stack(((velocity * ahead).sum(-1), (velocity * left).sum(-1)), -1)


def trained(steps: int = 4, **more: Any) -> tuple[SelfPlayModule, Any]:
    torch.manual_seed(0)
    module = SelfPlayModule(MdnWalker(SMALL), steps=steps, states=500, samples=0, people=12, **more)
    trainer = quiet_trainer(max_epochs=1, limit_train_batches=2, limit_val_batches=1)
    trainer.fit(module, data())
    return module, trainer


def test_self_play_moves_all_networks_in_a_crowd():
    module, trainer = trained()
    torch.manual_seed(0)
    start = MdnWalker(SMALL)
    assert (module.walker.head.weight - start.head.weight).abs().max() > 0
    assert module.critic.head.weight.abs().max() > 0 and module.judge.head.weight.abs().max() > 0
    assert 0 <= float(trainer.callback_metrics["train/told_apart"]) <= 1
    assert int(module.iteration) == 2


def test_self_play_in_courses_needs_no_judge():
    module, trainer = trained(courses=[Course("door:people=2", scenes=4)], crowds=0.0)
    assert (module.judge.head.weight == 0).all()
    assert "train/told_apart" not in trainer.callback_metrics


def test_rewards_are_those_that_the_weights_say():
    rewards = Rewards(progress=2.0, touch=3.0, wall=5.0, overspeed=7.0, time=0.25, likely=0.0, real=0.0)
    module, _ = trained(courses=[Course("door:people=2,width=0.6", scenes=6)], crowds=0.0, rewards=rewards)
    gatherer = module._gatherer(0, -1, module.random())
    seen = gatherer.gather(3)
    lived, _ = module.lived_through(seen, -1, module.random(), None)
    info = cast("TensorDict", seen["next", "agents", "info"])
    touched, hit = (cast("Tensor", info[key]).any(-1).float() for key in ("agent_contact", "wall_contact"))
    progress = seen["next", "agents", "reward"][..., 0] + ((touched + hit) > 0).float()
    after = cast("TensorDict", seen["next", "agents"])
    speed = cast("Tensor", after["velocity"]).norm(dim=-1)
    fast = (speed - after["pref_speed"][..., 0]).clamp_min(0)
    wanted = 2 * progress - 3 * touched - 5 * hit - 7 * fast - 0.25
    scored = lived["agents", "scored"]
    got = lived["next", "agents", "reward"][..., 0]
    torch.testing.assert_close(got[scored], wanted[scored])
    assert (got[~scored] == 0).all()


def test_command_line_trains_both_stages(elsewhere: Path):
    small = [f"--model.generator.architecture.{key}=8" for key in ("width", "near_dim")]
    options = ["--data.fold=embedded", *SHORT, "--model.states=400"]
    assert main(["fit", "--config", "open_loop/mdn_walker", *options, *small]) == 0
    first = "runs/open_loop.mdn_walker/embedded-seed0/checkpoints/last.ckpt"
    course = "--model.courses=[{scenario: hallway, scenes: 4}]"
    more = ["--data.fold=embedded", "--rollout.scenarios=null", "--monitor=val/nll", "--monitor_mode=min"]
    assert main(["fit", "--config", "closed_loop/mdn_walker", "--weights", first, course, *more, *SHORT]) == 0
    assert Path("runs/closed_loop.mdn_walker/embedded-seed0/checkpoints/last.ckpt").is_file()


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["open_loop/mdn_walker", "--model.states=0"], "expected at least 1"),
        (["open_loop/mdn_walker", "--model.jitter=-1"], "jitter"),
    ],
)
def test_what_cannot_be_is_refused(options: list[str], said: str, refused, elsewhere: Path):
    assert said in refused("fit", "--config", *options, "--data.fold=embedded", *SHORT)
