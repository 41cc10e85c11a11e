"""Imitation: recorded people walk on by a policy as they would in the environment, and are compared."""

from pathlib import Path
from typing import Any, cast

import numpy as np
import pytest
import torch
from tensordict import TensorDict
from torch import Tensor
from torchrl.envs.utils import step_mdp

from pedzoo.core.batch import agents_of
from pedzoo.core.errors import UserError
from pedzoo.data.datamodule import ImitationWindows, Loading, TrajectoryDataModule
from pedzoo.data.recordings import OwnFiles
from pedzoo.data.scenes import SceneSet
from pedzoo.maps.bank import MapBank
from pedzoo.metrics.realism import features as realism_features
from pedzoo.models.architectures.constant_velocity import ConstantVelocity
from pedzoo.models.architectures.sgan import SGAN
from pedzoo.models.base import true_displacements
from pedzoo.policies.walker import Walker
from pedzoo.sim.make import make_env
from pedzoo.sim.scenarios.replay import Replay
from pedzoo.train.closed_loop.imitation import (
    SPREADS,
    Imitation,
    Unrolled,
    features,
    recorded,
    tail,
    unroll,
)

FAST, SLOW, STANDS, LEAVES, TURNS = 1, 2, 3, 4, 5


def straight(agent: int, count: int, start: tuple, step: tuple, after: float = 1.0) -> list[tuple]:
    """Return rows of a person who walks ``step`` per frame, and ``after`` times that from the 8th row on."""
    way = np.concatenate((np.arange(8), 7 + after * np.arange(1, count - 7)))[:count]
    return [(i, agent, start[0] + w * step[0], start[1] + w * step[1]) for i, w in enumerate(way)]


ROWS = [
    *straight(FAST, 30, (0, 0), (0.5, 0), after=0.4),  # at a constant speed they arrive in half the time
    *straight(SLOW, 30, (9, 1), (-0.3, -0.05)),
    *straight(STANDS, 30, (3, 2), (0.01, 0), after=0.0),  # at the destination from the beginning
    *straight(LEAVES, 14, (5, -3), (0.1, 0.3)),
    *[(i, TURNS, 4 + 0.3 * np.cos(i / 4) * i / 4, 3 - 0.2 * i) for i in range(30)],
]


@pytest.fixture(scope="module")
def recording(tmp_path_factory):
    path = tmp_path_factory.mktemp("recording") / "crossing.txt"
    path.write_text("".join(f"{f} {a} {x:.4f} {y:.4f}\n" for f, a, x, y in sorted(ROWS)))
    return path


@pytest.fixture(scope="module")
def windows(recording):
    parts = OwnFiles([str(recording)], 0.4, "0,0,1").recordings("test")
    return SceneSet(parts, [-1], MapBank(), 8, 12, "present", 1)


@pytest.fixture
def batch(windows):
    return windows.batch(torch.arange(len(windows)), "destination")


def toward(seen: TensorDict, key: str = "desired_velocity") -> Tensor:
    """Return the displacements of a velocity that is seen."""
    return 0.4 * cast("Tensor", seen["agents", key])


def plain_sgan(**settings: Any) -> SGAN:
    torch.manual_seed(0)
    return SGAN.of(goal_dim=8, goal_protocol="destination", frame="heading", **settings)


def stirred(model: SGAN) -> SGAN:
    """Return a model far from the line that it begins as."""
    for parameter in model.parameters():
        torch.nn.init.normal_(parameter, std=0.1)
    return model


# -- windows


def test_training_has_unrolled_windows_beside_the_others(capsys):
    plain = TrajectoryDataModule()
    data = TrajectoryDataModule(
        goal="window_end", loading=Loading(rotate=True), imitated=ImitationWindows(steps=12, batch_size=16)
    )
    data.setup("fit")
    assert "train, unrolled for 12 steps" in capsys.readouterr().out
    loaders = data.train_dataloader()
    forecast, unrolled = (next(iter(loaders[name])) for name in ("forecast", "unrolled"))
    assert agents_of(forecast)["future"].shape[2] == 8
    assert agents_of(unrolled)["future"].shape[2] == 12
    assert len(unrolled) <= 16
    assert not torch.equal(unrolled["scene_pose"][:, 0], torch.zeros(len(unrolled)))
    assert data.unrolled is not None
    assert int(data.unrolled.sizes.min()) == 1  # lone people, too
    assert not data.unrolled.rows.ge(0).all()  # and those who come or leave meanwhile
    # a part of a window is none: validation and test know nothing of it
    assert agents_of(next(iter(data.val_dataloader())))["future"].shape[2] == 8
    plain.setup("fit")
    assert isinstance(plain.train_dataloader(), torch.utils.data.DataLoader)
    assert torch.equal(data.sets["train"].rows, plain.sets["train"].rows)


def own_windows(shared: Path, **options: Any) -> tuple[TrajectoryDataModule, SceneSet]:
    data = TrajectoryDataModule("zara1", str(shared / "data"), **options)
    data.setup("fit")
    assert data.unrolled is not None
    return data, data.unrolled


def test_unrolled_windows_of_a_batch_may_be_of_one_recording(shared):
    imitated = ImitationWindows(steps=6, one_recording_per_batch=True)
    data, unrolled = own_windows(shared, clock="true", imitated=imitated)
    names = [name for name, counts in unrolled.counts if counts.windows]
    assert len(unrolled.recording.unique()) == len(names) > 1
    for draw in data.train_dataloader()["unrolled"].sampler:
        assert len(unrolled.recording[draw.scenes].unique()) == 1


def test_unrolled_windows_keep_to_their_split(tmp_path):
    """One person walks 1 m per step through the whole recording: where they are says when."""
    path = tmp_path / "long.txt"
    path.write_text("".join(f"{i} 1 {i} 0\n" for i in range(100)))
    options: dict[str, Any] = {"files": [str(path)], "dt": 0.4, "min_people": 1, "split": "0.5,0.25,0.25"}
    data = TrajectoryDataModule(**options, imitated=ImitationWindows(steps=20))
    data.setup("fit")
    batches = list(data.train_dataloader()["unrolled"])
    last = max(float(agents_of(b)[key][..., 0].max()) for b in batches for key in ("future", "goal"))
    assert last == 49.0
    assert sum(len(b) for b in batches) == 50 - 28 + 1


def test_unrolled_windows_are_on_the_true_clock(shared):
    """biwi_eth's steps are really 0.667 s: by the benchmark's clock its people would run."""
    one, two = (
        own_windows(shared, clock=clock, imitated=ImitationWindows(20))[1].speeds()
        for clock in ("benchmark", "true")
    )
    assert torch.equal(one, two)


# -- walking


@pytest.mark.parametrize("who", ["sgan", "go_to_goal"])
def test_people_see_and_do_what_they_would_in_the_environment(recording, windows, who):
    """The same people in the scenario replay, until the first of them really leaves."""
    batch = windows.batch(torch.tensor([0]), "destination")
    model = stirred(plain_sgan(residual="bent_line", bottleneck_dim=8))
    walker = Walker(model, "episode")

    def walk(seen: TensorDict) -> Tensor:
        if who == "sgan":
            return 0.4 * cast("Tensor", walker(seen.clone())["agents", "action"])
        return toward(seen)

    views: list[TensorDict] = []

    def watched(seen: TensorDict) -> Tensor:
        views.append(seen)
        return walk(seen)

    env = make_env(Replay(files=[str(recording)], dt=0.4), 1)
    now = env.reset()
    with torch.no_grad():
        walked = unroll(watched, batch, 12, now["scene_key"][:, 0])
    gone = 6  # steps after which a person's recording ends
    for step in range(gone):
        mine, theirs = agents_of(views[step]), agents_of(cast("TensorDict", now))
        assert torch.equal(mine["mask"], theirs["mask"]), step
        assert torch.equal(mine["controlled"], theirs["controlled"]), step
        there, moved = mine["mask"], mine["controlled"]
        assert torch.equal(mine["valid"][there], theirs["valid"][there])
        for key in ("history", "velocity", "pref_speed"):
            torch.testing.assert_close(mine[key][there], theirs[key][there], atol=2e-5, rtol=0)
        for key in ("goal", "desired_velocity"):
            torch.testing.assert_close(mine[key][moved], theirs[key][moved], atol=1e-4, rtol=0)
        assert torch.equal(mine["id"][there], theirs["id"][there])
        torch.testing.assert_close(views[step]["time"], now["time"])
        now["agents", "action"] = walk(cast("TensorDict", now)) / 0.4
        now = step_mdp(env.step(now))
    assert walked.walked[0].sum(1).tolist()[STANDS - 1] == 0


def test_who_arrives_or_really_leaves_is_gone(windows):
    batch = windows.batch(torch.tensor([0]), "destination")
    masks: list[Tensor] = []

    def walk(seen: TensorDict) -> Tensor:
        masks.append(agents_of(seen)["mask"])
        return toward(seen)

    walked = unroll(walk, batch, 12)
    # 8.9 m at 0.5 m per step would be 18 steps; the recording slows to 0.2 m per step: 22 x 0.2 - 0.3 m
    assert walked.present[0, FAST - 1].tolist() == [True] * 9 + [False] * 3
    assert walked.walked[0, FAST - 1].sum() == 9
    # rows until frame 13: 6 steps after the 8th row
    assert walked.present[0, LEAVES - 1].sum() <= 6
    assert walked.present[0, STANDS - 1].all()
    assert not walked.walked[0, STANDS - 1].any()
    torch.testing.assert_close(walked.xy[0, STANDS - 1], agents_of(batch)["future"][0, STANDS - 1])
    assert torch.equal(masks[0], agents_of(batch)["mask"])


def test_no_person_walks_faster_than_they_can(windows):
    batch = windows.batch(torch.tensor([0]), "destination")
    walked = unroll(lambda seen: 5 * toward(seen), batch, 1)
    moved = (walked.xy[0, :, 0] - agents_of(batch)["history"][0, :, -1]).norm(dim=-1)
    # the first tenth of a second lies half-way between their velocity and the top speed
    before = float(agents_of(batch)["velocity"][0, FAST - 1].norm())
    top = 1.3 * 1.4  # they began at 1.25 m/s
    assert float(moved[FAST - 1]) == pytest.approx(0.4 * top - 0.05 * (top - before), abs=1e-3)


def test_gradients_reach_back_through_what_others_see(windows):
    """Where one is in the end depends on what another did in the first step, and on nothing later."""
    batch = windows.batch(torch.tensor([0]), "destination")
    batch["agents", "pref_speed"] += 2.0  # no person is at the limit
    pushes = torch.zeros(4, 1, 5, 2, requires_grad=True)
    steps = iter(pushes)

    def walk(seen: TensorDict) -> Tensor:
        agents = agents_of(seen)
        here = agents["history"][:, :, -1]
        others = (here * agents["mask"].unsqueeze(2)).sum(1, keepdim=True) - here
        return 0.05 * others.tanh() + 0.4 * agents["velocity"] + next(steps)

    end = unroll(walk, batch, 4).xy[0, SLOW - 1, -1].sum()
    (gradient,) = torch.autograd.grad(end, pushes)
    of_other = gradient[:, 0, TURNS - 1].abs().sum(-1)
    assert (of_other[:3] > 0).all()
    assert of_other[3] == 0


# -- likeness


def test_the_true_walk_costs_nothing(batch):
    true = iter(true_displacements(batch).unbind(2))
    batch["agents", "pref_speed"] = torch.full_like(batch["agents", "pref_speed"], 3.0)
    walked = unroll(lambda _: next(true), batch, 12)
    terms = Imitation().terms(walked, batch)
    assert terms.keys() == {"loss", "displacement", "distribution", *SPREADS}
    for name, value in terms.items():
        # real people stand about where they have arrived, and are met there
        assert value.item() == pytest.approx(0, abs=1e-2 if "distance" in name else 1e-3), name


def test_features_are_those_of_the_replay(batch):
    """Against the metrics' own functions, on the same steps."""
    agents = agents_of(batch)
    walk = recorded(batch, 12)
    scenes, people = agents["mask"].shape
    begin = agents["history"][:, :, -2:]
    begin[:, :, 0] = begin[:, :, 1] - 0.4 * agents["velocity"]
    xy = torch.cat((begin, walk.xy), 2)
    number = torch.arange(scenes * people).view(scenes, people, 1)
    there = torch.cat((agents["mask"].unsqueeze(2).expand(-1, -1, 2), walk.present), 2)
    scored = torch.cat((torch.zeros(scenes, people, 2, dtype=torch.bool), walk.walked), 2)
    velocity = torch.zeros_like(xy)
    velocity[:, :, 1:] = xy.diff(dim=2) / 0.4
    person = torch.where(there, number, -1)
    known = there & torch.cat((torch.zeros_like(there[..., :1]), there[..., :-1]), 2)
    steps = realism_features.SampledRollout(xy, person, velocity, known, scored, agents["radius"][..., 0])
    around = realism_features.surroundings(steps)
    expected = realism_features.features(
        steps, around, begin[:, :, 1].flatten(0, 1), agents["goal"].flatten(0, 1)
    )
    assert SPREADS.keys() == realism_features.FEATURES.keys()
    for name, value in features(walk, batch).items():
        theirs = expected[name].value
        assert len(theirs) > 100
        torch.testing.assert_close(value.sort().values, theirs.sort().values, atol=2e-3, rtol=1e-3, msg=name)


def test_displacement_by_hand():
    """One of two people keeps 1 m beside the true way, the other is exact until they leave after two."""
    xy = torch.zeros(1, 2, 4, 2)
    real = Unrolled(xy, torch.tensor([[[1, 1, 1, 1], [1, 1, 0, 0]]]).bool(), torch.ones(1, 2, 4).bool())
    made = xy.clone()
    made[0, 0] += torch.tensor([0.6, 0.8])
    made[0, 1, 2:] += 100.0
    walked = Unrolled(made, torch.ones(1, 2, 4).bool(), real.present)
    assert float(Imitation()._displacement(walked, real)) == pytest.approx(4 / 6)


def test_the_energy_score_does_not_punish_walks_that_differ():
    """Two walks 1 m to either side of the truth: 1 m off, 2 m apart."""
    xy = torch.zeros(1, 1, 3, 2)
    yes = torch.ones(1, 1, 3).bool()
    aside = torch.tensor([0.0, 1.0])
    both = Unrolled(torch.cat((xy + aside, xy - aside)), yes.repeat(2, 1, 1), yes.repeat(2, 1, 1))
    for spread, expected in ((0.0, 1.0), (0.5, 0.0)):
        imitation = Imitation(samples=2, spread=spread)
        cost = imitation._displacement(both, Unrolled(xy, yes, yes))
        assert float(cost) == pytest.approx(expected, abs=1e-4)


@pytest.mark.parametrize("term", ["displacement", "distribution", "tail"])
def test_training_on_a_term_lowers_it(batch, term):
    """A few steps of Adam from people who walk any way, with the noise of a walker."""
    batch, model = batch[::4], stirred(plain_sgan(residual="bent_line"))
    weights: dict[str, Any] = {"displacement": 0.0, "distribution": 0.0, term: 1.0}
    imitation = Imitation(**weights)
    walker = Walker(model, "episode")
    optimizer, result = torch.optim.Adam(model.parameters(), 2e-3), []
    for _ in range(6):
        terms = imitation(walker, batch, torch.Generator().manual_seed(0))
        optimizer.zero_grad()
        terms["loss"].backward()
        torch.nn.utils.clip_grad_norm_(model.parameters(), 1.0, error_if_nonfinite=True)
        optimizer.step()
        result.append(terms[term].item())
        assert terms["loss"].item() == result[-1]
    assert min(result[3:]) < 0.9 * result[0]


class Chases(ConstantVelocity):
    """People walk to the nearest person, 0.3 m in a step."""

    def next_steps(self, batch: TensorDict, noise: Tensor | None, steps: int, horizon: int) -> Tensor:
        agents = agents_of(batch)
        position = agents["history"][:, :, -1].where(agents["mask"].unsqueeze(-1), 1e4)
        away = torch.cdist(position, position) + 1e6 * torch.eye(position.shape[1])
        nearest = position.gather(1, away.argmin(2, keepdim=True).expand_as(position))
        return 0.3 * torch.nn.functional.normalize(nearest - position, dim=-1).unsqueeze(2)


def test_what_a_safety_layer_changes_is_part_of_the_walk(batch):
    """Of people who run into each other many touch; with the layer under them, none do."""

    def touching(safety: bool) -> int:
        """Return how many pairs touch at the end of steps in which both walk."""
        walker = Walker(Chases(), safety=safety)
        walk = Imitation().walk(walker, batch, torch.Generator().manual_seed(0))
        apart = (walk.xy.unsqueeze(1) - walk.xy.unsqueeze(2)).norm(dim=-1)
        both = walk.walked.unsqueeze(1) & walk.walked.unsqueeze(2)
        itself = torch.eye(walk.xy.shape[1], dtype=torch.bool).unsqueeze(-1)
        return int(((apart < 0.299) & both & ~itself).sum())

    assert touching(False) > 100 and touching(True) == 0


def test_models_without_noise_or_weights_walk_too(batch):
    terms = Imitation(distribution=0.0)(Walker(ConstantVelocity()), batch, torch.Generator())
    walked = unroll(lambda seen: toward(seen, "velocity"), batch, 12)
    assert terms.keys() == {"loss", "displacement"}
    expected = float(Imitation()._displacement(walked, recorded(batch, 12)))
    assert float(terms["loss"]) == pytest.approx(expected, rel=1e-5)


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"features": {"accelerations": 2.0}}, "acceleration"),
        ({"features": dict.fromkeys(SPREADS, 0.0)}, "one above it"),
        ({"samples": 0}, "samples 0"),
    ],
)
def test_weights_are_checked(options, said):
    with pytest.raises(UserError, match=said):
        Imitation(**options)


def test_tails_by_hand():
    """Every person accelerates 1.5 times as much: so do the largest accelerations."""
    true = torch.rand(501)
    assert float(tail(1.5 * true, true)) == pytest.approx(0.5, rel=1e-5)
    made = torch.linspace(0, 1, 101, requires_grad=True)  # whose quantiles are the values themselves
    result = tail(made, torch.full((7,), 2.0))
    assert result.item() == pytest.approx((2 - 0.945) / 2, rel=1e-5)
    result.backward()
    assert made.grad is not None and (made.grad[90:100] < 0).all() and not made.grad[:90].any()


# -- with Lightning
