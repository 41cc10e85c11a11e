"""PPO in the loop: densities, values, advantages, who counts, what a training does and what it refuses."""

import itertools
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any, cast

import pytest
import torch
from helpers.training import LIGHTNING_MARKS, SHORT, assert_same_end, last, quiet_trainer
from tensordict import TensorDict
from torch import Tensor, nn
from torch.distributions import Normal
from torchrl.envs.utils import ExplorationType, set_exploration_type
from torchrl.modules import ProbabilisticActor

import pedzoo
from pedzoo.cli.main import main
from pedzoo.core.batch import agents_of
from pedzoo.core.errors import UserError
from pedzoo.core.geometry import rotate
from pedzoo.core.spec import build_ungrouped
from pedzoo.data.datamodule import Loading, TrajectoryDataModule
from pedzoo.models.architectures.sgan import SGAN
from pedzoo.policies.walker import Walker
from pedzoo.sim.make import make_env
from pedzoo.train.ppo.people import Collection, Critic, Mean, Optimisation, PPOModule, Reward, lived_through
from pedzoo.train.ppo.trainer import Gatherer, Objective, actor

CPU = torch.device("cpu")

pytestmark = LIGHTNING_MARKS


def small(**more: Any) -> SGAN:
    """Return an untrained generator whose output is not zero."""
    torch.manual_seed(0)
    model = SGAN.of(
        embedding_dim=4, encoder_dim=8, decoder_dim=8, mlp_dim=8, noise_dim=4, goal_dim=4, best_k=2,
        goal_protocol="window_end", frame="heading", residual="bent_line", **more,
    )  # fmt: skip
    nn.init.normal_(model.decoder.output.weight, std=0.02)
    return model


def acting(model: SGAN, std: float = 0.2) -> ProbabilisticActor:
    return actor(Mean(Walker(model), nn.Parameter(torch.tensor(std).log())), "agents", "action")


def gatherer(model: SGAN, scenario: str = "hallway", scenes: int = 3, steps: int = 5) -> Gatherer:
    return Gatherer(make_env(scenario, scenes), acting(model), steps)


def rated(lived: TensorDict, critic: Any, gamma: float, gae_lambda: float) -> Any:
    """Return decisions with advantages, in the shape that they have."""
    how = Optimisation(gamma=gamma, gae_lambda=gae_lambda)
    result = Objective(acting(small()), Critic(gamma), how, CPU).rated(lived_through(lived, Reward(), critic))
    return result.unflatten(0, lived.shape)


@pytest.fixture(scope="module")
def lived() -> TensorDict:
    """Two people at a door until some of them have left: (B, T) = (4, 24)."""
    model = small()
    nn.init.zeros_(model.decoder.output.weight)
    result = gatherer(model, "door:people=2", 4, 24).gather(1)
    gone = ~result["next", "agents", "controlled"] & result["agents", "controlled"]
    assert gone.any() and not gone.all()
    return result


def info_of(**info: Any) -> TensorDict:
    """Return one scene of two people who stand 0.5 m apart, as the environment tells of it."""
    trace = torch.tensor([[0.0, 0.0], [0.5, 0.0]]).view(1, 2, 1, 2).expand(1, 2, 4, 2)
    people = {
        "info": TensorDict({"trace": trace} | dict.fromkeys(CONTACTS, NONE) | info, (1, 2)),
        "reward": torch.tensor([[[0.4], [-0.6]]]),
        "velocity": torch.tensor([[[0.6, 0.8], [0.0, 2.0]]]),
        "pref_speed": torch.tensor([[[1.2], [1.5]]]),
        **dict.fromkeys(("mask", "controlled"), torch.ones(1, 2, dtype=torch.bool)),
    }
    return TensorDict({"agents": TensorDict(people, (1, 2)), "failed": torch.zeros(1, 1).bool()}, (1,))


CONTACTS, NONE = ("agent_contact", "wall_contact"), torch.zeros(1, 2, 4, dtype=torch.bool)


@pytest.mark.parametrize(
    ("weights", "more"),
    [
        ({}, (0.0, 0.0)),
        ({"person_cost": 2.0}, (-2.0, 0.0)),
        ({"walls": 3.0}, (0.0, -3.0)),
        # nearest other at 0.5 m: half of the way from 1 m to contact of centres
        ({"near": 4.0, "near_distance": 1.0}, (-2.0, -2.0)),
        ({"near": 4.0, "near_distance": 0.5}, (0.0, 0.0)),
        # from (1, 0) to (0.6, 0.8), and from (1, 0) to (0, 2)
        ({"effort": 0.1}, (-0.08, -0.5)),
        # 1 and 2 m/s, who like 1.2 and 1.5 m/s
        ({"overspeed": 2.0}, (0.0, -1.0)),
        ({"arrival": 5.0}, (0.0, 5.0)),
    ],
)
def test_reward_adds_weighted_terms_to_that_of_the_environment(
    weights: dict[str, Any], more: tuple[float, float]
) -> None:
    before = info_of()
    before["agents", "velocity"] = torch.tensor([[[1.0, 0.0], [1.0, 0.0]]])
    touches = (NONE.index_fill(1, torch.tensor([person]), True) for person in (0, 1))
    after = info_of(**dict(zip(CONTACTS, touches, strict=True)))
    after["agents", "controlled"] = torch.tensor([[True, False]])
    expected = torch.tensor([[0.4, -0.6]]) + torch.tensor([more])
    torch.testing.assert_close(Reward(**weights)(before, after), expected)


def test_untrained_critic_expects_what_a_person_alone_earns(lived: TensorDict) -> None:
    critic = Critic(0.9)
    # 6.5 steps of 0.52 m, each worth 0.9 of the one before
    way, speed = torch.tensor([[3 * 0.52]]), torch.tensor([[1.3]])
    assert critic.alone(way, speed).item() == pytest.approx(0.52 * (1 + 0.9 + 0.81), rel=1e-5)
    assert Critic(1.0).alone(way, speed).item() == pytest.approx(3 * 0.52)
    people = critic(make_env("door:people=2", 2).reset())["agents"]
    expected = critic.alone(people["info", "remaining_path"].unsqueeze(-1), people["pref_speed"])
    torch.testing.assert_close(people["value"], expected)


def trained_critic() -> Critic:
    torch.manual_seed(1)
    critic = Critic(0.9)
    for parameter in critic.parameters():
        nn.init.normal_(parameter, std=0.3)
    return critic


def test_critic_does_not_notice_turns_shifts_order_and_padding() -> None:
    critic, now = trained_critic(), cast("TensorDict", make_env("circle:people=4", 2).reset())

    def value(**changes: Tensor) -> Tensor:
        other = now.clone()
        for name, new in changes.items():
            other["agents", name] = new
        return critic(other)["agents", "value"]

    expected = value()
    assert expected.std() > 0.01
    angle, agents = torch.tensor(0.7), agents_of(now)
    direction = torch.stack((angle.cos(), angle.sin()))
    shifts = {"history": 3.0, "goal": 3.0, "velocity": 0.0, "desired_velocity": 0.0}
    turned = value(**{key: rotate(agents[key], direction) + shift for key, shift in shifts.items()})
    torch.testing.assert_close(turned, expected, rtol=1e-3, atol=1e-4)

    order, parts = torch.tensor([2, 0, 3, 1]), {}
    for name, chosen in (("shuffled", order), ("three", torch.arange(3))):
        other = now.clone()
        other["agents"] = agents[:, chosen]
        parts[name] = critic(other)["agents", "value"]
    torch.testing.assert_close(parts["shuffled"], expected[:, order])
    padded = value(mask=torch.tensor([[True, True, True, False]] * 2))
    torch.testing.assert_close(padded[:, :3], parts["three"])
    assert (padded[:, 3] == 0).all()


def test_likelihoods_of_updates_are_those_of_collecting() -> None:
    """The noise of the generator is the same again: nothing has changed, and every ratio is 1."""
    model = small()
    result = gatherer(model).gather(3)
    flat = cast("TensorDict", result.exclude("next").flatten(0, 1))
    action, stored = flat["agents", "action"].clone(), flat["agents", "log_prob"].clone()
    again = acting(model).get_dist(flat).log_prob(action)
    torch.testing.assert_close(again, stored)
    assert torch.equal(flat["agents", "action"], action)
    with torch.no_grad(), set_exploration_type(ExplorationType.RANDOM):
        loc = Walker(model)(flat.clone())["agents", "action"]
    torch.testing.assert_close(stored, Normal(loc, 0.2).log_prob(action).sum(-1))


def test_people_that_nothing_moves_have_a_fixed_distribution() -> None:
    model, env = small(), make_env("hallway", 2)
    now = cast("TensorDict", env.reset())
    now["agents", "controlled"][:, 0] = False
    given = torch.ones(2, 2, 2)
    one, two = (acting(model, std).get_dist(now.clone()).log_prob(given) for std in (0.2, 0.4))
    assert torch.equal(one[:, 0], two[:, 0]) and not torch.equal(one[:, 1], two[:, 1])
    assert one[0, 0].item() == pytest.approx(-1 - math.log(2 * math.pi), rel=1e-5)


def test_experience_depends_on_seed_and_weights_alone() -> None:
    model = small()
    first, second = gatherer(model), gatherer(model)

    def gathered(where: Gatherer, seed: int) -> TensorDict:
        torch.manual_seed(0)
        return where.gather(seed)

    one, two, again = gathered(first, 5), gathered(first, 6), gathered(second, 5)
    assert (one == again).all() and not torch.equal(one["agents", "history"], two["agents", "history"])
    assert (gathered(first, 5) == again).all()
    with torch.no_grad():
        model.decoder.output.weight += 0.05
    for seed, before in ((6, two), (5, one)):
        moved = gathered(second, seed)
        assert torch.equal(moved["scene_key"][:, 0], before["scene_key"][:, 0])
        assert not torch.equal(moved["agents", "action"], before["agents", "action"])


def test_advantages_are_those_of_each_agents_own_episode(lived: TensorDict) -> None:
    """An oracle with loops: rewards end when a person leaves or when a new episode begins."""
    gamma, lam, critic = 0.9, 0.8, trained_critic()
    people = agents_of(rated(lived.clone(), critic, gamma, lam))
    after, scored = cast("TensorDict", lived["next", "agents"]), people["scored"]
    assert torch.equal(scored, lived["agents", "controlled"]) and not scored.all()
    last = critic(lived["next"].clone().flatten(0, 1))["agents", "value"].detach().view(4, 24, 2)
    left, expected = ~after["controlled"], torch.zeros(4, 24, 2)
    over, terminal = (left | lived["next", name] for name in ("done", "terminated"))
    surprise = after["reward"][..., 0] + gamma * last.where(~terminal, 0.0) - people["value"][..., 0]
    for b, a in itertools.product(range(4), range(2)):
        ahead = 0.0
        for t in reversed(range(24)):
            ahead = float(surprise[b, t, a]) + (0.0 if over[b, t, a] else gamma * lam * ahead)
            ahead = ahead if scored[b, t, a] else 0.0
            expected[b, t, a] = ahead
    target, value = (people[key][..., 0][scored] for key in ("value_target", "value"))
    torch.testing.assert_close(target, expected[scored] + value, rtol=1e-4, atol=1e-4)
    known = expected[scored]
    normal = torch.where(scored, (expected - known.mean()) / known.std(correction=0), 0.0)
    torch.testing.assert_close(people["advantage"][..., 0], normal, rtol=1e-3, atol=1e-3)


def two_decisions(lived: TensorDict) -> Any:
    """Return two decisions of a scene of two people who stay."""
    data: Any = lived[:1, :2].clone()
    for where in (data, data["next"]):
        where["agents", "controlled"][:] = True
        where["failed"][:] = False
    for name in ("done", "terminated"):
        data["next", name][:] = False
    data["next", "agents", "reward"][:] = torch.tensor([1.0, 10.0]).view(1, 2, 1, 1)
    return data


def no_value(batch: TensorDict) -> TensorDict:
    """Stand for a critic that expects nothing."""
    batch["agents", "value"] = torch.zeros(*batch["agents", "mask"].shape, 1)
    return batch


def test_another_person_in_the_slot_ends_an_episode(lived: TensorDict) -> None:
    """What the next one earns is not the previous one's."""
    data = two_decisions(lived)
    data["next", "agents", "id"][0, 0, 0] = 7
    target = rated(data, no_value, 1.0, 1.0)["agents", "value_target"][0, 0, :, 0]
    assert target.tolist() == [1.0, 11.0]


def test_a_failed_scene_counts_nowhere(lived: TensorDict) -> None:
    data = two_decisions(lived)
    data["next", "failed"][0, 1] = True
    data["next", "agents", "reward"][0, 1] = torch.nan
    result = rated(data, no_value, 0.9, 0.9)
    assert result["agents", "scored"][0].all(-1).tolist() == [True, False]
    assert result["agents", "advantage"].isfinite().all()


@pytest.fixture
def frames(lived: TensorDict) -> tuple[Callable[[TensorDict], tuple[Tensor, list[Tensor]]], TensorDict]:
    """A loss with its gradients, as a function of decisions, and decisions."""
    policy, critic = acting(small()), trained_critic()
    loss = Objective(policy, critic, Optimisation(entropy=0.01), CPU).loss
    parameters = [*policy.parameters(), *critic.parameters()]

    def terms(decisions: TensorDict) -> tuple[Tensor, list[Tensor]]:
        result = loss(decisions.clone())
        value = torch.stack([result[f"loss_{key}"] for key in ("objective", "critic", "entropy")])
        return value.detach(), list(torch.autograd.grad(value.sum(), parameters, allow_unused=True))

    return terms, rated(lived.clone(), critic, 0.9, 0.9).flatten(0, 1)


def test_who_does_not_count_has_no_part_in_loss_and_gradient(frames: Any) -> None:
    terms, decisions = frames
    other = decisions.clone()
    idle = ~other["agents", "scored"]
    assert idle.any()
    for key, value in (("action", 50.0), ("advantage", 30.0), ("value_target", -20.0), ("log_prob", -1.0)):
        other["agents", key][idle] = value
    (one, slopes), (two, others) = terms(decisions), terms(other)
    assert torch.equal(one, two) and (one != 0).all()
    for slope, again in zip(slopes, others, strict=True):
        assert slope is again is None or torch.equal(slope, again)


def test_loss_is_a_mean_over_those_who_count(frames: Any) -> None:
    """Scenes without people who count change nothing: divided by people, not by slots."""
    terms, decisions = frames
    empty = decisions.clone()
    empty["agents", "scored"][:] = False
    both = cast("TensorDict", torch.cat((decisions, empty)))
    torch.testing.assert_close(terms(both)[0], terms(decisions)[0])
    entropy = 1 + math.log(2 * math.pi) + 2 * math.log(0.2)
    assert float(terms(decisions)[0][2]) == pytest.approx(-0.01 * entropy, rel=1e-4)


def slow(before: TensorDict, after: TensorDict) -> Tensor:
    """Return a reward that has no gradient: 1 for walking slower than 0.8 m/s."""
    return (torch.linalg.vector_norm(agents_of(after)["velocity"], dim=-1) < 0.8).float()


def broken(before: TensorDict, after: TensorDict) -> Tensor:
    """Return a reward that is no number."""
    return Reward()(before, after) * torch.nan


def module_of(
    reward: Any, envs: int, steps: int, how: Optimisation, std: float = 0.15, **more: Any
) -> PPOModule:
    return PPOModule(small(), ["hallway"], reward, Collection(envs=envs, steps=steps, std=std), how, **more)


def data() -> TrajectoryDataModule:
    return TrajectoryDataModule("embedded", goal="window_end", loading=Loading(batch_size=8))


def trained(module: PPOModule, iterations: int) -> dict[str, float]:
    """Train without a validation, and return what was logged last."""
    trainer = quiet_trainer(max_epochs=1, limit_train_batches=iterations, limit_val_batches=0)
    trainer.fit(module, data())
    return {key: float(value) for key, value in trainer.callback_metrics.items()}


def test_learns_from_a_reward_without_a_gradient() -> None:
    rates = {"lr": 1e-2, "warmup": 1, "final_lr": 1.0}
    module = module_of(slow, 16, 8, Optimisation(gamma=0.5), std=0.3, **rates)
    first = trained(module, 1)["train/reward"]
    trained(module, 14)
    last = trained(module, 1)["train/reward"]
    assert first < 0.3 and last > first + 0.3


def test_updates_that_are_no_numbers_are_skipped_and_counted() -> None:
    module = module_of(broken, 2, 4, Optimisation(passes=2, minibatches=3))
    before = {key: value.clone() for key, value in module.generator.state_dict().items()}
    result = trained(module, 2)
    assert int(module.skipped) == 2 * 2 * 3 and result["train/skipped"] > 0
    assert all(torch.equal(before[key], value) for key, value in module.generator.state_dict().items())


def test_recorded_scenes_are_learnt_beside_the_decisions() -> None:
    """The generator's own loss of the batch that the data give, per scene and weighed."""
    recorded, weights = data(), []
    recorded.setup("fit")
    batch = next(iter(recorded.train_dataloader()))
    for weight in (0.0, 20.0):
        module = module_of(Reward(), 2, 2, Optimisation(passes=1, minibatches=1, recorded=weight))
        random = module.random()
        torch.randperm(4, generator=random)
        expected = weight * module.generator.loss(batch, random).item() / 8
        result = trained(module, 1)
        assert result.get("train/recorded", 0.0) == pytest.approx(expected, rel=1e-4)
        weights.append(torch.cat([value.detach().flatten() for value in module.generator.parameters()]))
    assert not torch.equal(*weights)


FIT = """fit --data.fold embedded --data.loading.batch_size=8
--model.collection.envs=2 --model.collection.steps=3 --model.samples=2 --model.final_lr=1
--model.optimisation.passes=2 --model.optimisation.minibatches=2 --model.scenarios [hallway,circle:people=3]
--monitor=val/ade --monitor_mode=min --rollout.scenarios hallway --rollout.episodes=2""".split()
FIT += SHORT
CONFIG = str(Path(__file__).parents[2] / "configs" / "ppo" / "sgan_goal.yaml")


def test_command_line_fine_tunes_and_resumes(elsewhere) -> None:
    """A resumed run ends with the very weights of an uninterrupted one; both walk by their name."""
    start = [*FIT, "--config", CONFIG, "--weights", "sgan_goal.eth_ucy"]
    for runs, epochs in (("whole", 2), ("parts", 1)):
        assert main([*start, f"--trainer.max_epochs={epochs}", f"--runs={runs}"]) == 0
    (whole,), (parts,) = (list(Path(name).glob("*/*")) for name in ("whole", "parts"))
    assert main(["fit", "--resume", str(parts), "--trainer.max_epochs=2"]) == 0
    state = assert_same_end(last(whole), last(parts))["state_dict"]
    assert int(state["iteration"]) == 4 and "log_std" in state
    assert not any(key.startswith("_") for key in state)
    logged = (whole / "metrics.csv").read_text()
    assert "rollout/hallway/success" in logged and "train/reward" in logged and "nan" not in logged
    tuned, origin = pedzoo.load(str(last(whole))), pedzoo.load("sgan_goal.eth_ucy")
    assert not torch.equal(next(tuned.parameters()), next(origin.parameters()))


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"scenarios": []}, "at least one"),
        ({"scenarios": ["dor"]}, "door"),
        ({"envs": 0}, "--model.collection.envs 0"),
        ({"envs": 1, "steps": 2}, "--model.optimisation.minibatches 4"),
        ({"std": 0.0}, "--model.collection.std 0.0"),
        ({"clip_ratio": 1.0}, "--model.optimisation.clip_ratio 1.0"),
        ({"gamma": 1.5}, "--model.optimisation.gamma 1.5"),
    ],
)
def test_what_cannot_be_is_refused(options: dict[str, Any], said: str) -> None:
    with pytest.raises(UserError, match=said):
        build_ungrouped(
            PPOModule, {"generator": small(), "scenarios": ["hallway"], "reward": Reward()} | options
        )


def test_negative_weights_are_refused() -> None:
    with pytest.raises(UserError, match=r"person_cost -0\.5"):
        Reward(person_cost=-0.5)
    with pytest.raises(UserError, match="near_distance"):
        Reward(near_distance=0)
