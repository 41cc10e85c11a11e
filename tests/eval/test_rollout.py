"""Rollouts: only live episodes count; the command that prints them; and episodes that are kept."""

import json
import re
from contextlib import nullcontext
from dataclasses import fields, replace

import numpy as np
import pytest
import torch
from helpers.episodes import unpacked_plan, unpacked_tracks
from helpers.walks import BROKEN, made

import pedzoo
from pedzoo.cli.main import main
from pedzoo.core.errors import UserError
from pedzoo.core.geometry import move_to_map
from pedzoo.core.types import GOAL_RADIUS
from pedzoo.eval.comparison import Comparison, row
from pedzoo.eval.evaluate import evaluate
from pedzoo.eval.packed_episodes import packed_episode, packed_episodes, packed_plan
from pedzoo.eval.rollout import rollout
from pedzoo.maps.bank import MapBank
from pedzoo.maps.formats import write_ros
from pedzoo.maps.grid import OccupancyGrid
from pedzoo.maps.plans import load_plan
from pedzoo.sim.make import make_env
from pedzoo.sim.physics.compiled import Compiled
from pedzoo.sim.rollout import OVER_TIME, Rollout


def cut(walked: Rollout, episode: int) -> dict[str, torch.Tensor]:
    """Return all about one episode until it ends."""
    one = walked.episodes(slice(episode, episode + 1))
    length = int(one.length[0])
    values = {field.name: getattr(one, field.name) for field in fields(one)}
    tensors = {key: value for key, value in values.items() if isinstance(value, torch.Tensor)}
    return {key: v[:, :, :length] if key in OVER_TIME else v for key, v in tensors.items()}


def assert_same(first: Rollout, second: Rollout, tolerance: float = 1e-6) -> None:
    assert first.failed.shape == second.failed.shape
    for episode in range(len(first.failed)):
        mine, other = cut(first, episode), cut(second, episode)
        for key, value in mine.items():
            torch.testing.assert_close(value, other[key], atol=tolerance, rtol=0)


def test_paths_with_commas_are_written_in_quotes(tmp_path, refused) -> None:
    """Of a floor plan, alone and in a list; without quotes the error says how to write it."""
    file = tmp_path / "a,b" / "plan.yaml"
    file.parent.mkdir()
    write_ros(load_plan("flat"), file)
    how = ["go_to_goal", "--physics", "compiled", "--episodes", "1", "--scenario"]
    for plan in (f"'{file}'", f"['{file}',flat]"):
        assert main(["rollout", *how, f"goals:map={plan},people=2,goals=1,pool=4"]) == 0
    said = refused("rollout", *how, f"goals:map={file},people=2")
    assert f"a value with commas needs quotes: map='{file}'" in said


@pytest.mark.parametrize("scenario", ["door", "goals:people=3,goals=1,pool=8"])
def test_episodes_are_the_same_however_many_walk_together(scenario: str, monkeypatch) -> None:
    together, _ = rollout("orca:dt=0.4", scenario, "compiled", 3, seed=3)
    monkeypatch.setattr(Compiled, "scenes_at_once", 2)
    in_parts, env = rollout("orca:dt=0.4", scenario, "compiled", 3, seed=3)
    assert env.batch_size[0] == 2 and len(set(together.length.tolist())) > 1
    assert_same(together, in_parts, 1e-5)
    for episode, length in enumerate(together.length.tolist()):  # nothing changes after the end
        assert not together.present[episode, :, length:].any()
        assert not together.agent_contact[episode, :, length:].any()
        for value in (together.trace, together.goal, together.reached):
            after = value[episode, :, length - 1 :]
            assert torch.equal(after, after[:, :1].expand_as(after))


def test_trace_goes_on_from_the_warm_start_at_possible_speeds() -> None:
    seen = []
    walked, env = rollout("go_to_goal", "door", "compiled", 3, progress=lambda *step: seen.append(step))
    assert seen[-1] == ("go_to_goal", 3, 3)
    assert [step[1] for step in seen] == sorted(step[1] for step in seen)
    path = torch.cat((walked.past, walked.trace), dim=2)
    speed = path.diff(dim=2).norm(dim=-1) / 0.1
    assert (speed <= 1.3 * walked.pref_speed.unsqueeze(-1) + 1e-3).all()
    assert (walked.past[:, :, -1, 0].abs() >= 2.4).all()  # before the door when counting begins
    assert (walked.reached[:, :, 0] == 0).all() and walked.goals == env.scenario.goals == 1


def test_rollout_knows_who_moves_and_what_ways_were_planned() -> None:
    walked, _ = rollout("go_to_goal", "goals:people=3,goals=2,pool=8", "compiled", 3)
    assert not walked.replayed and walked.gate is None
    assert torch.equal(walked.scored, walked.present) and torch.equal(walked.continuous, walked.present)
    assert torch.equal(walked.path[:, :, 1:], walked.trace)
    torch.testing.assert_close(walked.planned[:, :, 0], (walked.first_path_length - GOAL_RADIUS).clamp_min(0))
    # another way is added when a goal is reached, and only then
    there = walked.present[..., 1:]
    more, hit = walked.planned.diff(dim=2)[there], walked.reached.diff(dim=2)[there]
    assert (more >= 0).all() and float(more.sum()) > 0
    assert abs(int((more > 0).sum()) - int(hit.sum())) <= walked.mask.sum()  # goals of the last decision


def test_a_lone_person_takes_as_long_as_the_planned_way() -> None:
    walked, _ = rollout("go_to_goal", "door:people=1", "compiled", 6)
    assert walked.gate is not None
    assert walked.gate.tolist() == [pytest.approx([0.0, 0.0, 1.0, 0.0, 0.85])] * 6
    metrics = row("go_to_goal", walked)["metrics"]
    assert metrics["path_ratio"] == pytest.approx(1.0, abs=0.03)
    assert metrics["time_ratio"] == pytest.approx(1.0, abs=0.03)
    assert metrics["spl"] > 0.97 and metrics["stl"] > 0.97
    assert "symmetry_index" not in metrics and "specific_flow_per_m_s" not in metrics


def test_a_failed_episode_ends_alone_and_counts_as_a_failure(tmp_path) -> None:
    (tmp_path / "broken.py").write_text(BROKEN)
    with pytest.warns(UserWarning, match=r"broken\.py:Broken gave the action .* agent 1 of scene 0"):
        broken, _ = rollout(f"{tmp_path}/broken.py:Broken", "door", "compiled", 3)
    whole, _ = rollout("go_to_goal", "door", "compiled", 3)
    assert broken.failed.tolist() == [True, False, False]
    assert broken.length[0] == 8  # two decisions; in the third none walked
    for episode in (1, 2):
        some = slice(episode, episode + 1)
        assert_same(broken.episodes(some), whole.episodes(some))
    metrics = row("broken", broken)["metrics"]
    assert metrics["failed"] == metrics["success"] / 2 == pytest.approx(1 / 3)


def test_noise_is_drawn_or_not() -> None:
    def traces(policy: str, deterministic: bool, seed: int = 0) -> torch.Tensor:
        return rollout(policy, "door:speed=2", "compiled", 1, seed, deterministic)[0].trace[:, :, :10]

    sampled, again = (traces("sgan_goal.zara1", False) for _ in range(2))
    assert torch.equal(sampled, again)
    assert not torch.equal(sampled, traces("sgan_goal.zara1", True))
    assert not torch.equal(sampled, traces("sgan_goal.zara1", False, seed=1))


def test_command_prints_what_it_writes(tmp_path, capsys) -> None:
    file = tmp_path / "out.json"
    policies = ["orca:radius=0.1,dt=0.4", "go_to_goal"]
    words = ["rollout", *policies, "--physics", "compiled", "--episodes", "3", "--seed", "2"]
    words += ["--json", str(file)]
    assert main([*words, "--warm-start", "static", "--deterministic"]) == 0
    printed = capsys.readouterr().out
    report = json.loads(file.read_text())
    assert report["command"] == "rollout" and report["seeds"] == [2] and "torch" in report["versions"]
    where = {"scenario": "door", "physics": "compiled", "episodes": 3}
    how = {"noise": "none", "device": "cpu", "warm_start": "static", "clearance": 0.25, "planner": "shortest"}
    assert report["protocol"] == where | how
    assert [result["name"] for result in report["rows"]] == policies
    shown = [cell.strip() for line in printed.splitlines() for cell in line.split("│")]
    for result in report["rows"]:
        assert result["n"] == 3 and len(result["per_agent"]) == 6
        for value in result["metrics"].values():
            assert f"{value:.3f}" in shown
        for key, (low, high) in result["ci95"].items():
            assert low <= result["metrics"][key] <= high
    walked, _ = rollout(policies[1], "door", "compiled", 3, 2, True, warm_start="static")
    again = json.loads(json.dumps(row(policies[1], walked)))
    assert again == report["rows"][1]


def test_interrupted_command_prints_what_is_over(tmp_path, monkeypatch, capsys) -> None:
    def interrupt(name: str, done: int, total: int) -> None:
        if name == "go_to_goal:dt=0.2" and done == 2:
            raise KeyboardInterrupt

    monkeypatch.setattr("pedzoo.cli.commands.walk.progress_bar", lambda: nullcontext(interrupt))
    monkeypatch.setattr(Compiled, "scenes_at_once", 1)
    file = tmp_path / "out.json"
    words = ["rollout", "go_to_goal", "go_to_goal:dt=0.2", "orca", "--physics", "compiled", "--episodes", "2"]
    assert main([*words, "--json", str(file)]) == 130
    report = json.loads(file.read_text())
    assert report["interrupted"] is True
    assert [(result["name"], result["n"]) for result in report["rows"]] == [
        ("go_to_goal", 2),
        ("go_to_goal:dt=0.2", 1),
    ]
    printed = capsys.readouterr()
    assert "interrupted: only what was over by then" in printed.out and "go_to_goal" in printed.out


def test_overview_names_scenarios_and_policies(capsys) -> None:
    assert main([]) == 0
    text = capsys.readouterr().out
    for name in ("door", "goals", "orca", "go_to_goal"):
        assert f"  {name}" in text.partition("policies (and every model):")[2]


def test_a_comparison_checks_names_and_closes_its_physics() -> None:
    with pytest.raises(UserError, match="orka"):  # before any has walked
        Comparison(["go_to_goal", "orka"], "door", "compiled", 1)
    with Comparison(["go_to_goal", "go_to_goal"], "door", "compiled", 1) as comparison:
        comparison.run()
        (walked,) = comparison.walked
        closed = []
        walked.env.physics.close = lambda: closed.append(True)
    assert closed == [True] and len(comparison.report()["rows"]) == 1  # the same policy twice is one row


def test_make_env_takes_what_a_rollout_passes_on() -> None:
    walked, env = rollout("go_to_goal", "door", "compiled", 1, body_radius=0.2, warm_start="static")
    assert env.physics.body_radius == 0.2 and make_env("door").physics.body_radius == 0.15
    assert torch.equal(walked.past, walked.past[:, :, :1].expand_as(walked.past))


def test_what_rollout_returns_is_measured_as_it_is() -> None:
    walked = pedzoo.rollout("go_to_goal", "circle:people=2", "compiled", 1)
    assert pedzoo.measure(walked) == pedzoo.measure(walked.rollout)
    with pytest.raises(UserError, match=r"policy \['orca'\]: expected one name; pedzoo\.evaluate takes"):
        pedzoo.rollout(["orca"], "circle")  # type: ignore[arg-type]


def test_models_have_a_short_repr() -> None:
    shown = repr(pedzoo.load("approach_net_goal_map.indoor"))
    assert re.fullmatch(r"SGAN\('approach_net_goal_map\.indoor', goal \w+, [\d,]+ weights\)", shown)


# Episodes that results keep


@pytest.fixture(scope="module")
def walked() -> tuple[Rollout, MapBank]:
    result, env = rollout("go_to_goal", "door", "compiled", 2)
    return result, env.bank


def test_positions_come_back_to_half_a_millimetre(walked: tuple[Rollout, MapBank]) -> None:
    result, bank = walked
    episodes, plans = packed_episodes(result, bank, 5, seed=3)
    assert [one["episode"] for one in episodes] == [0, 1] and {one["seed"] for one in episodes} == {3}
    path = move_to_map(result.path, result.pose)
    for number, packed in enumerate(json.loads(json.dumps(episodes))):
        assert packed["points"] == int(result.length[number])
        for person, track in zip(packed["people"], unpacked_tracks(packed), strict=True):
            first = person["first"]
            truth = path[number, person["slot"], first : first + len(track)].numpy()
            np.testing.assert_allclose(track, truth, atol=0.00051)
        x, y = move_to_map(result.goal, result.pose)[number, 0, 0].tolist()
        assert packed["people"][0]["goals"][0] == pytest.approx([0, x, y], abs=1e-3)
    grid = bank.grids[0]
    again = unpacked_plan(plans[str(grid.map_id)])
    assert (again.cells == grid.cells).all() and again.origin == pytest.approx(grid.origin)


def test_touches_are_runs_of_points(walked: tuple[Rollout, MapBank]) -> None:
    contact = torch.zeros_like(walked[0].agent_contact)
    contact[0, 1, [4, 5, 9]] = True  # the points of `path` are one later
    packed = packed_episode(replace(walked[0], agent_contact=contact), 0)
    assert [person["touch"] for person in packed["people"]] == [[], [[5, 6], [10, 10]]]
    assert packed["values"]["agent_contacts"] == 2


def test_fifty_people_for_a_minute_take_less_than_100_kb() -> None:
    people, points = 50, 600
    turns = 0.1 * torch.randn(1, people, points + 1).cumsum(2)
    crowd = made((0.13 * torch.stack((turns.cos(), turns.sin()), -1)).cumsum(2))
    packed = packed_episode(crowd, 0)
    assert len(packed["people"]) == people and packed["counts"] == [points + 1] * people
    assert len(json.dumps(packed)) < 100_000
    expected = move_to_map(crowd.path, crowd.pose)[0, 7]
    np.testing.assert_allclose(unpacked_tracks(packed)[7], expected, atol=6e-4)


def test_large_plans_are_kept_in_coarser_cells() -> None:
    cells = np.zeros((1300, 20), dtype=np.uint8)
    cells[650] = 1
    packed = packed_plan(OccupancyGrid(cells, 0.05))
    assert packed["rows"] == 434 and packed["cell"] == pytest.approx(0.15)
    assert (unpacked_plan(packed).cells == 1).any(1).sum() == 1


def test_evaluations_keep_what_is_asked_for() -> None:
    given = {"suites": ["door"], "episodes": 2, "physics": "compiled"}
    report = evaluate(["go_to_goal"], keep_episodes=1, **given)
    (row,) = report["rows"]
    assert len(row["episodes"]) == 1 and row["episodes"][0]["plan"] in report["plans"] and "plans" not in row
    assert "plans" not in evaluate(["go_to_goal"], **given)
