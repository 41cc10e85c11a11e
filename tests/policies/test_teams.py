"""Mixed crowds: who moves whom, and when each team decides."""

import json
from pathlib import Path
from typing import Any, cast

import pytest
import torch
from tensordict import TensorDictBase
from torch import Tensor
from torchrl.envs.utils import ExplorationType, set_exploration_type

from pedzoo.cli.main import main
from pedzoo.core.batch import ROBOT, agents_of, ids_of, scene_batch
from pedzoo.core.errors import UserError
from pedzoo.core.geometry import blended, identity_pose
from pedzoo.eval.rollout import prepare, run
from pedzoo.eval.suite import EvaluationCase, WorkUnit
from pedzoo.eval.trained_on import for_fold, has_seen
from pedzoo.eval.work_units import digest
from pedzoo.maps.bank import MapBank
from pedzoo.policies.crowd_names import is_crowd, members, parts
from pedzoo.policies.load import load_policy, teams
from pedzoo.policies.policy import Policy
from pedzoo.policies.teams import Teams
from pedzoo.policies.walker import has_noise, walkers
from pedzoo.sim.make import make_env
from pedzoo.sim.rollout import Rollout


class Told(Policy):
    """Tells its agents one velocity, and notes when it was asked about which scenes, and for whom."""

    def __init__(self, dt: float = 0.4, x: float = 1.0, y: float = 0.0) -> None:
        """Say how often it decides, and the velocity, m/s."""
        super().__init__(dt)
        self.command, self.calls, self.moved = (x, y), [], []

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        agents = agents_of(tensordict)
        self.calls.append([round(float(time), 3) for time in tensordict["time"]])
        self.moved.append(agents["controlled"].clone())
        agents["action"] = torch.tensor(self.command).expand(*agents["mask"].shape, 2).clone()
        return tensordict


class Clock(Told):
    """Tells its agents a velocity that says when it was told: 1 + time along x, m/s."""

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        super().forward(tensordict)
        agents_of(tensordict)["action"][..., 0] = 1 + cast("Tensor", tensordict["time"])
        return tensordict


TOLD, CLOCK = f"{__file__}:Told", f"{__file__}:Clock"


def scene(time: Any = 0.0, keys: Any = (7, 8, 9), people: int = 4, **more: Any) -> TensorDictBase:
    """Return scenes of people who walk along x at 0.8 m/s."""
    size = (len(keys), people)
    velocity = torch.tensor([0.8, 0.0]).expand(*size, 2)
    history = torch.arange(people)[:, None, None] + torch.arange(8)[:, None] * 0.4 * velocity.unsqueeze(2)
    fields: dict[str, Any] = {
        "history": history,
        "velocity": velocity,
        "mask": torch.ones(size, dtype=torch.bool),
        "id": torch.arange(people).expand(size),
        "goal": history[:, :, -1] + 4.0,
        "desired_velocity": velocity,
    }
    return scene_batch(
        maps=MapBank(),
        map_id=torch.full((len(keys), 1), -1),
        pose=identity_pose(len(keys)),
        valid=torch.ones(*size, 8, dtype=torch.bool),
        pref_speed=torch.full((*size, 1), 1.3),
        key=torch.tensor(keys).unsqueeze(1),
        time=torch.as_tensor(time).float().expand(len(keys)).reshape(-1, 1),
        **fields | more,
    )


def calls_of(crowd: Any) -> list[list[list[float]]]:
    """Return when each team's policy was asked about each scene, call by call, seconds."""
    return [team.policy.calls for team in crowd.teams]


def answer(crowd: Any, batch: TensorDictBase) -> Tensor:
    """Return what a crowd tells scenes (B, A, 2)."""
    return crowd(batch)["agents", "action"].clone()


@pytest.mark.parametrize(
    ("text", "result"),
    [
        ("orca", ["orca"]),
        ("orca:share=0.5+go_to_goal", ["orca:share=0.5", "go_to_goal"]),
        ("orca + go_to_goal", ["orca", "go_to_goal"]),
        ("orca:time_horizon=1e+1+go_to_goal", ["orca:time_horizon=1e+1", "go_to_goal"]),
        ("orca+sgan_gaol.indoor", ["orca", "sgan_gaol.indoor"]),
        ("a:b=[x+orca]+orca", ["a:b=[x+orca]", "orca"]),
        ("hf://me/zoo@v1/sgan.mall+orca", ["hf://me/zoo@v1/sgan.mall", "orca"]),
        ("https://a.b/c+d/sgan.mall+orca", ["https://a.b/c+d/sgan.mall", "orca"]),
        ("https://a.b/c+orca/sgan.mall:share=.2+orca", ["https://a.b/c+orca/sgan.mall:share=.2", "orca"]),
        ("orca+https://a.b/sgan.x+hf://me/zoo", ["orca", "https://a.b/sgan.x", "hf://me/zoo"]),
        ("/not/here+x/mine.py:Mine+go_to_goal", ["/not/here+x/mine.py:Mine", "go_to_goal"]),
        ("/not/here/mine.py:Mine:a=1+orcaa", ["/not/here/mine.py:Mine:a=1", "orcaa"]),
        ("/not/here/mine.py:Mine+orcaa", ["/not/here/mine.py:Mine", "orcaa"]),
        ("/not/here/a.ckpt+sgan.mall", ["/not/here/a.ckpt", "sgan.mall"]),
    ],
)
def test_a_plus_joins_policies_outside_paths_and_numbers(text: str, result: list[str]) -> None:
    assert parts(text) == result
    assert is_crowd(text) == (len(result) > 1 or "share" in text)


def test_a_plus_in_the_name_of_an_existing_file_is_part_of_it(elsewhere) -> None:
    for name in ("a+orca", "deep"):
        (elsewhere / name).mkdir()
        (elsewhere / name / "my+file.py").write_text(Path(__file__).read_text())
    (elsewhere / "best+last.ckpt").touch()
    files = "best+last.ckpt", "a+orca/my+file.py:Told", "./deep/my+file.py:Told", str(elsewhere / "a+orca")
    for name in files:
        assert parts(f"{name}:share=0.5+orca+{name}") == [f"{name}:share=0.5", "orca", name]
    crowd: Any = load_policy("a+orca/my+file.py:Told:dt=0.1,share=0.5+orca")
    assert [type(team.policy).__name__ for team in crowd.teams] == ["Told", "Orca"]


@pytest.mark.parametrize(
    ("text", "shares"),
    [
        ("orca:share=0.5,radius=0.3+go_to_goal", {"orca:radius=0.3": 0.5, "go_to_goal": 0.5}),
        ("orca:share=1", {"orca": 1.0}),
        (
            "orca+go_to_goal+sgan_nopool.zara1",
            {"orca": 1 / 3, "go_to_goal": 1 / 3, "sgan_nopool.zara1": 1 / 3},
        ),
    ],
)
def test_teams_without_a_share_share_the_rest(text: str, shares: dict[str, float]) -> None:
    assert dict(members(text)) == pytest.approx(shares)


@pytest.mark.parametrize(
    ("crowd", "message"),
    [
        ("orca:share=0.8+go_to_goal:share=0.5", "the shares sum to 1.3: expected at most 1"),
        ("orca:share=0.3+go_to_goal:share=0.5", "sum to 0.8, and the rest has no policy: leave out one"),
        ("orca:share=1+go_to_goal", "nothing is left for 'go_to_goal'"),
        ("orca:share=0+go_to_goal", "share 0: expected a number above 0"),
        ("orca:share=-1+go_to_goal", "share -1: expected a number above 0"),
        ("orca:share=half+go_to_goal", "share half: expected a number above 0"),
        ("orca:share=nan+go_to_goal", "share nan: expected a number above 0"),
        ("orca+", "a policy is missing beside '\\+'"),
        ("orca+go_to_gaol", "unknown policy 'go_to_gaol': did you mean 'go_to_goal'"),
        ("orca:share=0.5+approach_net_goal.indor", "did you mean 'approach_net_goal.indoor'"),
        ("orca:share=0.5,raduis=1+go_to_goal", "did you mean 'radius'"),
        ("orca:dt=0.3+go_to_goal", "teams decide every 0.3, 0.4 s: expected multiples of the shortest"),
    ],
)
def test_what_cannot_be_is_refused(crowd: str, message: str) -> None:
    with pytest.raises(UserError, match=message):
        load_policy(crowd)


def test_shares_come_true_over_many_people() -> None:
    crowd = teams("orca:share=0.5+go_to_goal:share=0.2+social_force")
    theirs = crowd.assigned(scene(keys=range(4000), people=5))
    assert torch.equal(torch.stack(theirs).long().sum(0), torch.ones(4000, 5).long())
    for team, share in zip(theirs, (0.5, 0.2, 0.3), strict=True):
        four_deviations = 4 * (share * (1 - share) / 20000) ** 0.5
        assert team.float().mean().item() == pytest.approx(share, abs=four_deviations)
        assert team.float().var(0).min() > 0, "whatever the number of the person"


def test_a_person_has_a_team_whatever_the_batch_and_the_slot() -> None:
    crowd, order = teams("orca+go_to_goal"), torch.tensor([4, 2, 0, 5, 1, 3])
    whole = crowd.assigned(scene(keys=range(50), people=6))[0]
    alone = [crowd.assigned(scene(time=3.7, keys=[key], people=2))[0] for key in range(50)]
    assert torch.equal(torch.cat(alone), whole[:, :2])
    shuffled = crowd.assigned(scene(keys=range(50), people=6, id=order.expand(50, 6)))[0]
    assert torch.equal(shuffled, whole[:, order])


def test_each_agent_has_one_team_that_sees_all_others() -> None:
    crowd: Any = teams(f"{TOLD}:x=0.1,dt=0.1+{TOLD}:x=0.2,dt=0.1+{TOLD}:x=0.3,dt=0.1")
    controlled = torch.rand(20, 6, generator=torch.Generator().manual_seed(1)) < 0.8
    batch: Any = scene(keys=range(20), people=6, controlled=controlled)
    action = answer(crowd, batch)
    moved = torch.stack([team.policy.moved[0] for team in crowd.teams])
    assert torch.equal(moved.sum(0), controlled.long())
    wanted = (moved * torch.tensor([0.1, 0.2, 0.3]).view(3, 1, 1)).sum(0)
    assert torch.allclose(action[..., 0], wanted)
    assert torch.equal(batch["agents", "controlled"], controlled), "the batch stays as it was"


def test_robots_have_their_own_policy() -> None:
    crowd: Any = teams(people=f"{TOLD}:x=0.1,dt=0.1+{TOLD}:x=0.2,dt=0.1", robots=Told(0.1, x=9.0))
    kind = torch.tensor([0, ROBOT, 0, ROBOT]).expand(3, 4)
    assert torch.equal(answer(crowd, scene(kind=kind))[..., 0] == 9.0, kind == ROBOT)
    assert torch.equal(crowd.teams[2].policy.moved[0], kind == ROBOT)
    mixed = answer(teams(people=f"{TOLD}:x=0.1,dt=0.1"), scene(kind=kind))[..., 0]
    assert torch.allclose(mixed, torch.tensor(0.1)), "else robots are moved as people"


def test_each_team_decides_at_its_own_interval() -> None:
    """Asked twice, it says the same; a team without agents is not asked."""
    crowd = teams(people=f"{TOLD}:dt=0.4+{CLOCK}:dt=0.1+{TOLD}:dt=0.2", robots=Told(0.1))
    assert crowd.decision_dt == 0.1
    for step in range(9):
        batch = scene(time=0.1 * step, keys=range(30))
        assert torch.equal(answer(crowd, batch), answer(crowd, batch))
    slow, fast, middle, robots = ([calls[0] for calls in team] for team in calls_of(crowd))
    assert slow[::2] == slow[1::2] == [0.0, 0.4, 0.8]
    assert fast[::2] == fast[1::2] == [0.0, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8]
    assert middle[::2] == middle[1::2] == [0.0, 0.2, 0.4, 0.6, 0.8]
    assert robots == []


def test_newcomers_decide_at_once_and_then_with_their_team() -> None:
    crowd, person = teams(people=f"{CLOCK}:dt=0.4", robots=Told(0.1)), torch.tensor([[0, 1, 2]])
    some, velocities = torch.tensor([[True, True, False]]), []
    for step in range(5):
        more = {"controlled": some | (step >= 2), "id": torch.where(person == 0, 5 * (step >= 3), person)}
        now = scene(time=0.1 * step, keys=[7], people=3, **more)
        velocities.append(answer(crowd, now)[0, :, 0].tolist())
    assert [calls[0] for calls in calls_of(crowd)[0]] == [0.0, 0.2, 0.3, 0.4]

    def walked(decided: float, step: int) -> float:
        return blended(torch.tensor([0.8, 0.0]), torch.tensor([1 + decided, 0.0]), 4)[0, step].item()

    assert velocities[2] == pytest.approx([walked(0.0, 2), walked(0.0, 2), walked(0.2, 0)])
    # the first one is another person now
    assert velocities[3] == pytest.approx([walked(0.3, 0), walked(0.0, 3), walked(0.2, 1)])
    assert velocities[4] == pytest.approx([walked(0.4, 0)] * 3)


def test_scenes_in_which_no_person_decides_are_not_asked_about() -> None:
    crowd = teams(people=f"{TOLD}:dt=0.4", robots=Told(0.1))
    for step in range(6):
        answer(crowd, scene(time=[0.1 * step, 0.1 * step + 0.2, 0.1 * step + 4.0]))
    answer(crowd, scene(time=[0.6, 0.0, 4.6]))  # the second begins anew
    # the second scene is two steps ahead, but all begin with the first call
    assert calls_of(crowd)[0] == [[0.0, 0.2, 4.0], [0.4, 0.6, 4.4], [0.0]]


def test_other_batches_and_changed_slots_do_not_mix_plans() -> None:
    """What a scene is told does not depend on what else the crowd is asked about in between."""
    alone, crowd = (teams(f"{CLOCK}:dt=0.4+{CLOCK}:dt=0.2") for _ in range(2))
    order = torch.tensor([2, 0, 3, 1])
    for step in range(12):
        time = 0.1 * step
        wanted = answer(alone, scene(time=time, keys=range(6)))
        if step % 3 == 2:
            some = [answer(crowd, scene(time=time, keys=range(low, low + 2))) for low in (4, 0, 2)]
            result = torch.cat(some).roll(-2, 0)
        elif step % 3 == 1:
            result = answer(crowd, scene(time=time, keys=range(6), id=order.expand(6, 4)))[:, order.argsort()]
        else:
            result = answer(crowd, scene(time=time, keys=range(6)))
        answer(crowd, scene(time=time + 0.1, keys=range(20, 29), people=7))
        torch.testing.assert_close(result, wanted)


@pytest.mark.parametrize("fast", [0.1, 0.2])
def test_blending_leads_where_the_command_leads(fast: float) -> None:
    before, command = torch.tensor([0.8, 0.0]), torch.tensor([1.0, 0.6])
    crowd = teams(people=f"{TOLD}:dt=0.4,x=1.0,y=0.6", robots=Told(fast))
    moved = torch.zeros(2)
    for step in range(round(0.4 / fast)):
        velocity = answer(crowd, scene(time=fast * step))[0, 0]
        if step == 0:
            assert 0.4 < (velocity - before).norm() / (command - before).norm() < 1
        moved += fast * velocity
    torch.testing.assert_close(moved, 0.4 * command)


def test_the_commands_of_robots_are_held() -> None:
    """They may be the speeds of wheels, (v, omega), which are no velocity to blend."""
    crowd = teams(people=Told(0.1), robots=Told(0.4, x=0.5, y=-0.7))
    kind = torch.full((3, 4), ROBOT)
    for step in range(4):
        velocity = answer(crowd, scene(time=0.1 * step, kind=kind))
        assert torch.equal(velocity, torch.tensor([0.5, -0.7]).expand(3, 4, 2))


def walked(policy: str, scenario: str = "hallway", scenes: int = 3, **settings: Any) -> Rollout:
    """Return episodes of a policy."""
    made, env = prepare(policy, scenario, "compiled", scenes, **settings)
    with torch.no_grad(), set_exploration_type(ExplorationType.RANDOM):
        return run(made, env)


@pytest.mark.parametrize("policy", ["orca", "approach_net_goal_map.indoor", "sgan_goal.zara1:noise=step"])
def test_a_crowd_of_one_team_is_that_team(policy: str) -> None:
    setting = "," if "=" in policy else ":"
    one, crowd = (walked(name, "door", 2) for name in (policy, f"{policy}{setting}share=1"))
    assert torch.equal(one.trace, crowd.trace) and torch.equal(one.reached, crowd.reached)


def test_a_slow_team_among_fast_ones_walks_as_it_does_alone() -> None:
    """Between its decisions velocities blend as in the kernel; only goals are noticed earlier."""
    scenario = "intersection"
    alone, crowd = walked("go_to_goal", scenario), walked("go_to_goal+orca:share=1e-9", scenario)
    points = min(alone.trace.shape[2], crowd.trace.shape[2])
    before = (alone.reached[..., :points] == 0).all(1).sum(1).min().item() // 4 * 4
    assert before > 20
    torch.testing.assert_close(alone.trace[:, :, :before], crowd.trace[:, :, :before], atol=1e-4, rtol=0)


def test_an_episode_is_the_same_in_every_batch() -> None:
    crowd = "orca:share=0.4+social_force:preset=indoor+go_to_goal"
    whole = walked(crowd, "perpendicular:people=6", scenes=4)
    for first in (0, 3):
        alone = walked(crowd, "perpendicular:people=6", scenes=1, first_episode=first)
        points = min(alone.trace.shape[2], whole.trace.shape[2])
        there = alone.present[0, :, :points]
        torch.testing.assert_close(
            alone.trace[0, :, :points][there], whole.trace[first, :, :points][there], atol=1e-4, rtol=0
        )


def test_learned_people_walk_beside_orca_through_resets() -> None:
    crowd = load_policy("orca:share=0.5+approach_net_goal.indoor")
    assert crowd.decision_dt == pytest.approx(0.1) and has_noise(crowd) and len(walkers(crowd)) == 1
    env = make_env("hallway", num_envs=3, decision_dt=0.1)
    with torch.no_grad():
        steps: Any = env.rollout(150, crowd, break_when_any_done=False)
    assert steps["next", "done"].any() and not steps["next", "failed"].any()
    assert steps["agents", "action"].isfinite().all()


def test_an_environment_of_another_step_is_refused() -> None:
    crowd = load_policy("orca+approach_net_goal.indoor")
    with pytest.raises(UserError, match=r"this crowd decides every 0.1 s, not every 0.4 s.*decision_dt=0.1"):
        crowd(make_env("door").reset())
    with pytest.raises(UserError, match="its fastest team does"):
        prepare("orca+approach_net_goal.indoor", "door", "compiled", 1, decision_dt=0.4)


@pytest.mark.parametrize(("dt", "value"), [(0.1, ".nan"), (0.4, ".inf")])
def test_a_team_that_fails_ends_its_scenes_alone(dt: float, value: str) -> None:
    made, env = prepare(f"{TOLD}:share=0.15,dt={dt},x={value}+orca", "hallway", "compiled", 6)
    theirs = cast("Teams", made).assigned(env.reset())[0].any(1)
    assert 0 < theirs.sum() < 6
    with pytest.warns(UserWarning, match="gave the action"):
        broken = walked(f"{TOLD}:share=0.15,dt={dt},x={value}+orca", scenes=6)
    whole = walked(f"{TOLD}:share=0.15,dt={dt}+orca", scenes=6)
    assert torch.equal(broken.failed, theirs)
    points = min(broken.trace.shape[2], whole.trace.shape[2])
    assert torch.equal(broken.trace[~theirs, :, :points], whole.trace[~theirs, :, :points])


def test_a_teams_safety_layer_avoids_all_of_another_team() -> None:
    """Two people meet head-on, a little aside: only the first has the layer, the second keeps its course."""
    crowd = teams("go_to_goal:safety=true,share=0.5+go_to_goal:dt=0.1")
    theirs = crowd.assigned(scene(keys=range(40), people=2))[0].tolist()
    keys = [key for key in range(40) if theirs[key] == [True, False]]
    ahead = torch.tensor([[1.2, 0.0], [-1.2, 0.0]]).expand(len(keys), 2, 2)
    begin = torch.tensor([[-0.5, 0.0], [0.5, 0.1]]).expand(len(keys), 2, 2)
    way = {"history": begin.unsqueeze(2) + torch.arange(-7, 1).view(8, 1) * 0.4 * ahead.unsqueeze(2)}
    way |= {"velocity": ahead, "desired_velocity": ahead}
    moved = torch.zeros(len(keys), 2, 2)
    for step in range(4):
        moved += 0.1 * answer(crowd, scene(time=0.1 * step, keys=keys, people=2, **way))
    torch.testing.assert_close(moved[:, 1], 0.4 * ahead[:, 1])
    parts_of_step = torch.linspace(0, 1, 50).view(-1, 1, 1)
    apart = begin[:, 0] - begin[:, 1] + parts_of_step * (moved[:, 0] - moved[:, 1])
    assert keys and 0.3 < apart.norm(dim=-1).min() < 0.4


def test_recorded_people_stay_with_their_team() -> None:
    """In a replay slots are used again: teams are of persons."""
    env = make_env("replay:fold=embedded", decision_dt=0.1)
    crowd = cast("Teams", load_policy("orca:share=0.5+go_to_goal"))
    results: dict[int, set[bool]] = {}
    now = env.reset()
    for _ in range(120):
        team, person, there = crowd.assigned(now)[0][0], ids_of(now)[0], agents_of(now)["mask"][0]
        for slot in there.nonzero()[:, 0].tolist():
            results.setdefault(int(person[slot]), set()).add(bool(team[slot]))
        now = env.step_mdp(env.step(crowd(now)))
    assert all(len(teams) == 1 for teams in results.values())
    assert {team for teams in results.values() for team in teams} == {True, False}


def test_rollout_of_the_command_line(tmp_path, capsys) -> None:
    crowd, report = "orca:share=0.5+approach_net_goal_map.indoor", tmp_path / "report.json"
    command = ["rollout", crowd, "--scenario", "door", "--physics", "compiled", "--episodes", "3"]
    assert main([*command, "--json", str(report)]) == 0
    row = json.loads(report.read_text())["rows"][0]
    assert (row["name"], row["decision_dt_s"], row["n"]) == (crowd, 0.1, 3)
    assert crowd in capsys.readouterr().out


def test_weights_of_a_mixed_crowd_have_not_seen_the_fold() -> None:
    crowd = "orca:share=0.5+sgan_goal.zara1:noise=step"
    assert for_fold(crowd, "hotel") == "orca:share=0.5+sgan_goal.hotel:noise=step"
    assert has_seen(crowd, "hotel")
    assert not has_seen(crowd, "zara1") and not has_seen("orca+go_to_goal", "eth")


def test_a_unit_of_a_mixed_crowd_knows_its_weights(monkeypatch) -> None:
    case = EvaluationCase("door", "door", "door", "compiled", 1, {})
    units = [
        WorkUnit(crowd, crowd, case, (0,), False)
        for crowd in ("orca+sgan_goal.zara1", f"orca+{TOLD}", "orca:share=0.4+sgan_goal.zara1")
    ]
    before = [digest(unit) for unit in units]
    assert len(set(before)) == 3 and before == [digest(unit) for unit in units]
    monkeypatch.setattr("pedzoo.eval.work_units.code_sum", lambda content: "other code")
    assert digest(units[0]) == before[0] and digest(units[1]) != before[1]
