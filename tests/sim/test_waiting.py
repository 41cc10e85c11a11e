"""People who wait, until their time is up or they are called, and people who walk together."""

from pathlib import Path
from typing import Any

import pytest
import torch
from helpers.scenes import Watch, prepared
from helpers.walks import as_desired, made
from torch import Tensor

from pedzoo.core.batch import companions_of
from pedzoo.core.randomness import Draws
from pedzoo.eval.evaluate import evaluate
from pedzoo.eval.rollout import rollout
from pedzoo.metrics.closed_loop import measure
from pedzoo.metrics.smoothness import standing_drift_m
from pedzoo.sim.make import make_env, make_scenario
from pedzoo.sim.recorded_people import companies
from pedzoo.sim.scenarios.replay import Replay

TWO = "waiting:people=3,waiting=2,stay=0,seconds=2.1,speed_std=0"


@pytest.mark.parametrize("physics", ["compiled", "torch", "bullet"])
def test_people_wait_and_set_out(physics: str) -> None:
    env = make_env(prepared(TWO), num_envs=2, physics=physics)
    seen, _ = as_desired(env, 8)
    env.physics.close()
    start = seen[0]["agents", "history"][:, :2, -1]
    for step, now in enumerate(seen[:-1]):
        agents = now["agents"]
        assert agents["controlled"].all()
        # 2.1 s: they take their next goal at the end of the decision at 2.4 s
        if step <= 5:
            for place in (agents["goal"][:, :2], agents["history"][:, :2, -1]):
                assert torch.allclose(place, start, atol=1e-5)
        speed = agents["desired_velocity"][:, :2].norm(dim=-1)
        assert torch.allclose(speed, torch.tensor(1.3 if step > 5 else 0.0), atol=0.01 if step > 5 else 1e-4)
    moved = (seen[8]["agents", "history"][:, :2, -1] - start).norm(dim=-1)
    assert torch.allclose(moved, torch.full_like(moved, 0.8 * 1.3), atol=0.05)


def test_the_policy_has_to_hold_them_and_is_shown_the_way_back() -> None:
    env = make_env(prepared(TWO), num_envs=2)
    seen, _ = as_desired(env, 4, drift=(0.0, 0.5))
    place, last = seen[0]["agents", "history"][:, :2, -1], seen[4]["agents"]
    off = last["history"][:, :2, -1] - place
    # 0.2 m per decision, and as far back in the next one
    assert torch.allclose(off[..., 1], torch.full((2, 2), 0.2), atol=0.01)
    assert torch.allclose(last["desired_velocity"][:, :2], -off / 0.4, atol=1e-3)
    assert torch.equal(last["info"]["reached"][:, :2, -1], torch.zeros(2, 2, dtype=torch.long))


def test_waiting_takes_no_time_from_the_way() -> None:
    env = make_env(prepared(TWO), num_envs=2)
    as_desired(env, 5)
    assert env.state.deadline[:, :2].isinf().all() and env.state.holds[:, :2].all()
    assert env.state.planned[:, :2].eq(0).all()
    as_desired(env, 6)
    way = env.state.remaining_path[:, :2]
    assert torch.allclose(env.state.deadline[:, :2], 2.4 + (4 * way / 1.3).clamp_min(20.0), atol=1e-3)
    assert torch.allclose(env.state.planned[:, :2], way - 0.3)
    assert not env.state.holds.any()


def test_to_set_out_is_no_progress_and_no_loss() -> None:
    env = make_env(prepared(TWO), num_envs=2)
    walk: Any = env.rollout(7, Watch(factor=0.0))
    assert walk["next", "agents", "reward"][:, :, :2].abs().max() < 1e-4


def test_people_who_stay_are_not_waited_for_nor_scored() -> None:
    result, _ = rollout("go_to_goal", "waiting:people=4,waiting=3,stay=1", "compiled", 6)
    metrics, _ = measure(result)
    assert metrics["success"] == metrics["episode_success"] == 1 and metrics["deadlock"] == 0
    assert result.trace.shape[2] < 200 and result.present[:, :3, 0].all()
    stays = (result.trace[:, :3] - result.trace[:, :3, :1]).norm(dim=-1)
    assert float(stays.max()) < 1e-4
    # the people who pass are those who arrive
    assert torch.equal(result.reached[:, 3, -1], torch.ones(6, dtype=torch.long))
    assert 0.9 < metrics["time_ratio"] < 1.1


def test_people_are_served_one_after_the_other() -> None:
    env = make_env("queue:people=5,coming=2,seconds=3,speed_std=0", num_envs=2)
    seen, states = as_desired(env, 60)
    taken = torch.stack([state.goal_index for state in states])
    # no person takes a place before the one ahead has left it
    assert (taken[..., :-1] >= taken[..., 1:] - 1).all()
    left = (taken > torch.arange(5)).int().argmax(0) * 0.4  # when each set out for an exit
    assert left[:, 0].tolist() == pytest.approx([3.2, 3.2])
    apart = left.diff(dim=1)
    # 0.8 m to the counter, as far as 0.3 m from it, and 3 s
    assert float(apart.min()) >= 3.0 + 0.5 / 1.3 - 1e-3 and float(apart.max()) <= 3.0 + 1.6
    goal = seen[1]["agents", "goal"]
    assert goal[0, 1].tolist() == pytest.approx([-0.8, 0.0], abs=0.03)


def test_people_join_the_line_at_its_present_end() -> None:
    env = make_env("queue:people=3,coming=1,seconds=1,speed_std=0", num_envs=1)
    _, states = as_desired(env, 6)
    assert float(states[0].remaining_path[0, 2]) > 1.5
    assert {round(float(state.goal_point[0, 2, 0]), 1) for state in states} == {-1.6, -0.8}
    assert float(env.state.position[0, 2, 0]) < -0.8


def test_drift_is_the_greatest_distance_while_waiting() -> None:
    """Of two who wait one drifts 0.3 m and back, then sets out; a third one walks."""
    path = torch.zeros(1, 3, 9, 2)
    path[0, 0, :, 0] = torch.tensor([0.0, 0.1, 0.3, 0.2, 0.1, 0.1, 1.0, 2.0, 3.0])
    path[0, 1, :, 1] = 5.0
    path[0, 2, :, 0] = torch.arange(9.0)
    goal = path[:, :, :1].expand(1, 3, 8, 2).clone()
    goal[0, 0, 5:] = 9.0
    goal[0, 2] = 8.0
    result = made(path, goal=goal, first_path_length=torch.tensor([[0.0, 0.0, 8.0]]))
    above, below = standing_drift_m(result)[:2]
    assert above.tolist() == pytest.approx([0.3]) and below.tolist() == [2]


def test_the_suite_has_a_table_of_each_scenario() -> None:
    report = evaluate(["go_to_goal"], ["indoor"], episodes=2)
    rows = {row["case"]["scenario"]: row["metrics"] for row in report["rows"] if "scenario" in row["case"]}
    assert set(rows) == {"waiting", "queue", "groups", "two_way"}
    assert rows["queue"]["success"] == 1 and rows["queue"]["standing_drift_m"] < 0.01
    assert -0.3 < rows["two_way"]["lane_order"] < 0.6
    assert rows["groups"]["company_share"] > 0.3


def test_groups_walk_side_by_side() -> None:
    env = make_env(prepared("groups"), num_envs=50)
    now: Any = env.reset()
    pairs, start = companions_of(now), env.prepared.layout(Draws.for_episodes(0, torch.arange(50))).start
    assert pairs[:, -2:].sum() == 0 and pairs.any(2).float().mean() > 0.8
    assert {1, 2, 3} <= set(pairs.sum(2)[:, :-2].unique().tolist()) <= {0, 1, 2, 3}
    apart = torch.cdist(start, start)[pairs]
    assert float(apart.max()) == pytest.approx(3 * 0.75) and float(apart.min()) > 0.74
    speed = now["agents", "pref_speed"].expand(-1, -1, pairs.shape[1])
    assert torch.equal(speed[pairs], speed.transpose(1, 2)[pairs])


def test_two_streams_have_the_density_that_is_asked_for() -> None:
    scenario = make_scenario("two_way:people=60,density=0.6,width=3")
    layout = scenario.prepare(0.25).layout(Draws.for_episodes(0, torch.arange(20)))
    left = layout.start[:, ::2]
    length = left[..., 0].amax(1) - left[..., 0].amin(1)
    # 30 people on 3 m x 33 m
    assert torch.allclose(30 / (3 * length), torch.tensor(0.3), rtol=0.06)
    assert float((torch.cdist(left, left) + 9 * torch.eye(30)).min()) >= 0.5 - 1e-4
    assert float(left[..., 1].abs().max()) > 1.1 and float(left[..., 1].mean().abs()) < 0.1


@pytest.mark.parametrize("scenario", ["queue", "waiting"])
def test_scenes_end_even_if_no_person_moves(scenario: str) -> None:
    env = make_env(scenario, num_envs=2)
    walk: Any = env.rollout(260, Watch(factor=0.0), break_when_any_done=False)
    assert walk["next", "truncated"].any(1).all() and not walk["next", "done"][:, :41].any()


# Companions, in recordings and as policies see them


FRAMES = 20


def tracks(*people: tuple[int, float, float, float]) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """Return rows of people: first frame, y, x at frame 0, metres per frame along x; 20 frames each."""
    rows = [[x + step * frame, y] for first, y, x, step in people for frame in range(first, first + FRAMES)]
    first = torch.tensor([one[0] for one in people])
    begin = FRAMES * torch.arange(len(people))
    return torch.tensor(rows), begin, first, first + FRAMES - 1


def test_companions_are_near_and_keep_their_places() -> None:
    rows = tracks(
        *((0, 0.0, 0.0, 0.5), (0, 0.8, 0.0, 0.5), (2, 1.6, 0.0, 0.5)),  # three abreast, one seen later
        (0, 9.0, 0.0, 0.5),  # alone
        (0, 10.6, 0.0, 0.5),  # 1.6 m beside
        (0, 9.5, 0.0, 0.6),  # 0.5 m beside, and 0.7 m ahead after 7 steps
    )
    group, shown = companies(*rows)
    assert len(group[:3].unique()) == 1 and (group[:3] >= 0).all()
    assert group[3:].tolist() == [-1, -1, -1]
    # when the first of two has been seen for 8 frames
    assert shown[:3].tolist() == [7, 7, 7]


@pytest.mark.parametrize(("later", "company"), [(4, True), (5, False)])
def test_companions_are_seen_together_in_four_frames(later: int, company: bool) -> None:
    group, _ = companies(*tracks((3, 0.0, 0.0, 0.5), (3 + later, 0.5, 0.0, 0.5)))
    assert (group >= 0).tolist() == [company] * 2


def test_less_time_together_allows_less_drift() -> None:
    """Over 3 steps 3/7 of 0.5 m: 0.214 m."""
    for drift, company in ((0.07, True), (0.073, False)):
        group, _ = companies(*tracks((0, 0.0, 0.0, 0.5), (4, 0.5, 0.0, 0.5 + drift)))
        assert bool((group >= 0).all()) == company


def test_nothing_later_is_looked_at() -> None:
    rows, begin, first, last = tracks((0, 0.0, 0.0, 0.5), (2, 0.8, 0.0, 0.5), (1, 3.0, 0.0, 0.5))
    expected, shown = companies(rows, begin, first, last)
    unseen = torch.cat(
        [torch.arange(int(b) + 8 - int(f), int(b) + FRAMES) for b, f in zip(begin, first, strict=True)]
    )
    rows[unseen] += 50 * torch.rand(len(unseen), 2)
    changed, again = companies(rows, begin, first, last)
    assert torch.equal(expected, changed) and torch.equal(shown, again)


def test_people_are_companions_in_any_order() -> None:
    people = [
        (0, 0.0, 0.0, 0.5),
        (2, 0.8, 0.0, 0.5),
        (1, 3.0, 0.0, 0.5),
        (0, 3.5, 0.0, 0.5),
        (9, 0.0, 0.0, 0.5),
    ]
    group, _ = companies(*tracks(*people))
    order = [3, 1, 4, 0, 2]
    other, _ = companies(*tracks(*(people[i] for i in order)))
    same = group[order].unsqueeze(1) == group[order]
    assert torch.equal(same, other.unsqueeze(1) == other)


def pairs_seen(folder: Path, decisions: int, *people: tuple[int, float, float, float]) -> list[list[Any]]:
    """Return the pairs of persons that a policy sees as companions before each decision of a replay."""
    xy, begin, first, _ = tracks(*people)
    rows = [
        (int(first[who]) + row, who, *xy[int(begin[who]) + row].tolist())
        for who in range(len(people))
        for row in range(FRAMES)
    ]
    file = folder / "rows.txt"
    file.write_text("".join(f"{f} {a} {x:.4f} {y:.4f}\n" for f, a, x, y in sorted(rows)))
    env = make_env(Replay(files=[str(file)], dt=0.4).prepare(0.25))
    result = []
    for now, state in zip(*as_desired(env, decisions - 1), strict=True):
        pairs = now["agents", "id"][0][companions_of(now)[0].nonzero()]
        result.append(sorted(pairs.tolist()))
        assert torch.equal(state.group[0] >= 0, torch.isin(state.person[0], pairs.flatten()))
    return result


def test_policies_see_companies_as_soon_as_these_show(tmp_path) -> None:
    """The clock begins in frame 7, in which who comes in frame 0 has been seen eight times."""
    alone = (0, 5.0, 12.0, -0.4)
    both = [[0, 1], [1, 0]]
    two = (0, 0.0, 0.0, 0.4), (3, 0.7, 0.0, 0.4)
    assert pairs_seen(tmp_path, 4, *two, alone) == [both] * 4
    later = (4, 0.0, 0.0, 0.4), (5, 0.7, 0.0, 0.4)
    assert pairs_seen(tmp_path, 6, *later, alone) == [[]] * 4 + [both] * 2
