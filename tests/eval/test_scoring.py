"""`pedzoo score`: files and memory agree, real people are themselves, and likelihoods are as by hand."""

import json
import math
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
import torch

from pedzoo.cli.main import main
from pedzoo.core.errors import UserError
from pedzoo.data.tracks import Tracks
from pedzoo.eval.evaluate import evaluate
from pedzoo.eval.scoring import rows as score_rows
from pedzoo.eval.scoring.crowds import ScoredCrowd, blocks_of, file_crowd, recorded_crowd
from pedzoo.eval.scoring.likelihood import (
    STEPS,
    JointWindows,
    bins,
    likelihood,
    policy_windows,
    recorded_windows,
    windows_of,
)
from pedzoo.eval.scoring.rows import row
from pedzoo.eval.scoring.score import Reference, score
from pedzoo.eval.suite import OwnRecordings
from pedzoo.metrics.door import flow
from pedzoo.metrics.realism.crowds import ratios, spread
from pedzoo.metrics.realism.two_sample import TREES, auc
from pedzoo.metrics.realism.walks import ScoredSteps, columns, companions, through
from pedzoo.metrics.realism.wosac import (
    BINS,
    MEASURED,
    ROLLOUTS,
    composite,
    contact_likelihood,
    measured_likelihood,
)
from pedzoo.sim.recorded_people import without_goals
from pedzoo.sim.scenarios.replay import PreparedReplay


@pytest.fixture(autouse=True)
def few_trees(monkeypatch) -> None:
    monkeypatch.setitem(TREES, "max_iter", 20)


@pytest.fixture(scope="module")
def real() -> PreparedReplay:
    return Reference("embedded").prepared()


@pytest.fixture(scope="module")
def recorded(real: PreparedReplay) -> ScoredCrowd:
    return recorded_crowd(real)


@pytest.fixture(scope="module")
def windows(real: PreparedReplay) -> JointWindows:
    return windows_of(real)


def plaza() -> np.ndarray:
    file = Path(__file__).parents[2] / "pedzoo" / "data" / "embedded" / "plaza_test.csv"
    return np.loadtxt(file, delimiter=",", skiprows=1)


def written(path: Path, table: np.ndarray) -> str:
    rows = [f"{frame:.0f},{agent:.0f},{x:.6f},{y:.6f}" for frame, agent, x, y in table]
    path.write_text("\n".join(["frame,agent,x,y", *rows]))
    return str(path)


def still(agent: int, rows: int, speed: float = 0.0, first: int = 0) -> np.ndarray:
    frame = np.arange(rows)
    ends = np.full(rows, agent), frame * 0.4 * speed, np.full(rows, agent / 2)
    return np.column_stack((frame + first, *ends))


def test_a_file_of_the_recording_scores_as_the_recording(
    real: PreparedReplay, recorded: ScoredCrowd, tmp_path
) -> None:
    later = plaza()
    later[:, 0] += 1000  # another clock
    side = file_crowd(written(tmp_path / "mine.csv", later), real)
    assert side.twin.tolist() == list(range(len(real.persons.agent)))
    for name, samples in side.fine.crowd.samples.items():
        torch.testing.assert_close(samples.value, recorded.fine.crowd.samples[name].value, atol=1e-5, rtol=0)
    metrics = row(side, recorded, {})["metrics"]
    assert metrics["realism"] == pytest.approx(0, abs=1e-4)
    assert metrics["classifier_auc"] == pytest.approx(0.5, abs=0.02)
    assert metrics["closed_loop_ade_m"] == pytest.approx(0, abs=1e-5)
    assert metrics["crowdes_dtw"] == pytest.approx(0, abs=1e-5)
    assert metrics["crowdes_diversity"] == 1
    share = float(ratios(recorded.sums["standing_share"], torch.ones(1, 80)))
    assert metrics["standing_share"] == pytest.approx(share)


def auc_of(table: np.ndarray, path: Path, real: PreparedReplay, recorded: ScoredCrowd) -> float:
    """The AUC of a crowd whose people have other numbers than the recorded ones."""
    numbers = np.unique(table[:, 1])
    others = np.random.default_rng(5).permutation(numbers)
    table = np.column_stack((table[:, 0], others[np.searchsorted(numbers, table[:, 1])], table[:, 2:]))
    side = file_crowd(
        written(path / "other.csv", table[np.random.default_rng(6).permutation(len(table))]), real
    )
    assert (side.twin < 0).float().mean() > 0.9
    verdict = score_rows._verdict(side, recorded, side.fine.clips, recorded.fine.clips)
    once = (torch.ones(1, len(crowd.seen)) for crowd in (side, recorded))
    return float(auc(verdict, *once))


def test_people_who_are_known_keep_their_part(monkeypatch) -> None:
    monkeypatch.setattr(score_rows, "two_sample", lambda mine, theirs, own, split: (own, split))
    monkeypatch.setattr(
        score_rows, "nearest_parts", lambda mine, theirs, split, people: torch.full((people,), 9)
    )
    real, clips = cast("Any", SimpleNamespace(seen=torch.ones(9))), cast("Any", None)
    for twin, strangers in ([0, -1, 4], [1]), ([0, 5], []):
        side = cast("Any", SimpleNamespace(twin=torch.tensor(twin)))
        own, split = cast("Any", score_rows._verdict(side, real, clips, clips))
        assert own.tolist() == [9 if i in strangers else split[person] for i, person in enumerate(twin)]
        assert torch.bincount(split).tolist() == [3, 2, 2, 2]


def test_blocks_of_time_lie_within_a_recording() -> None:
    taken = torch.tensor([10, 84, 85, 160, 7, 7 + 3000])
    people = cast("Any", SimpleNamespace(handover=taken, recording=torch.tensor([0, 0, 0, 0, 1, 1])))
    # 75 steps are 30 s; the second recording has 20 blocks
    assert blocks_of(people)[0].tolist() == [0, 0, 1, 2, 3, 22] and blocks_of(people)[1] == 23


def test_blocks_of_known_people_are_those_of_the_recording() -> None:
    def people(*taken: int) -> Any:
        return SimpleNamespace(
            handover=torch.tensor(taken), recording=torch.zeros(len(taken), dtype=torch.long)
        )

    real = cast("Any", SimpleNamespace(people=people(0, 100, 200), seen=torch.ones(3)))
    for twin, expected in ([1, 0, -1], [1, 0, 2]), ([0, -1, 2], [0, 1, 2]), ([-1, -1, -1], [0, 1, 5]):
        side = SimpleNamespace(people=people(0, 100, 400), twin=torch.tensor(twin), seen=torch.ones(3))
        (mine, theirs), block, count = score_rows._drawn(cast("Any", side), real)
        assert block.tolist() == expected and count == max(expected) + 1
        assert theirs[0].tolist() == mine[0].tolist() == [1, 1, 1] and len(mine) == 501
        assert max(expected) > 2 or torch.equal(mine, theirs[:, expected])


def straightened(table: np.ndarray, agents: np.ndarray) -> np.ndarray:
    """The same with some people on straight lines, at constant speed."""
    table = table[np.lexsort((table[:, 0], table[:, 1]))]
    for agent in agents:
        mine = table[:, 1] == agent
        ends = table[mine][[0, -1], 2:]
        share = np.linspace(0, 1, mine.sum())[:, None]
        table[mine, 2:] = ends[0] * (1 - share) + ends[1] * share
    return table


@pytest.mark.parametrize("change", [[0, 0, 0, 0], [0, 0, 0.6, 0], [400, 0, 80, -0.6]])
def test_copies_cannot_be_told_apart(
    change: list[float], real: PreparedReplay, recorded: ScoredCrowd, tmp_path
) -> None:
    assert auc_of(plaza() + change, tmp_path, real, recorded) == pytest.approx(0.5, abs=0.03)


def test_the_copied_half_of_a_crowd_does_not_hide_the_other(
    real: PreparedReplay, recorded: ScoredCrowd, tmp_path
) -> None:
    """Straight walkers are found and copies count half: three quarters. Near straight ones they are more."""
    half = straightened(plaza(), np.unique(plaza()[:, 1])[::2])
    assert 0.7 < auc_of(half, tmp_path, real, recorded) < 0.95


def test_strangers_are_scored_wherever_they_stand(real: PreparedReplay, tmp_path) -> None:
    crowd = [still(500 + i, 40) for i in range(3)]
    side = file_crowd(written(tmp_path / "queue.csv", np.concatenate(crowd)), real)
    assert (side.twin == -1).all()
    assert float(ratios(side.sums["standing_share"], torch.ones(1, 3))) == 1
    for dt, said in ((-1.0, "--dt is -1.0"), (1e-9, r"lasts \d\S+ s at --dt 1e-09")):
        with pytest.raises(UserError, match=said):
            score([str(tmp_path / "queue.csv")], "embedded", dt=dt, likelihood=False)
    with pytest.raises(UserError, match="m/s"):
        file_crowd(written(tmp_path / "fast.csv", plaza() * [1, 1, 100, 100]), real)


DEGENERATE = {
    "all_stand": [still(i, 30) for i in range(3)],
    "one_stands": [still(1, 30)],
    "one_walks": [still(1, 30, 1.2)],
    "all_on_one_spot": [still(1, 30) * [1, i, 1, 1] for i in (1, 2)],
    "two_rows_each": [still(i, 2, 1.0) for i in range(4)],
    "nine_rows_each": [still(i, 9, 1.0) for i in range(4)],
    "one_frame": [still(i, 1) for i in range(4)],
    "never_together": [still(i, 20, 1.2, 50 * i) for i in range(3)],
}


def test_degenerate_crowds_keep_their_rows(tmp_path) -> None:
    some = written(tmp_path / "real.csv", plaza()[plaza()[:, 1] < 6])
    files = [written(tmp_path / f"{name}.csv", np.concatenate(rows)) for name, rows in DEGENERATE.items()]
    report = score([*files, "go_to_goal"], Reference(some, 0.4), dt=0.4, likelihood=False)
    json.dumps(report, allow_nan=False)
    rows = {Path(one["name"]).stem: one for one in report["rows"]}
    assert [Path(one["name"]).stem for one in report["rows"][2:]] == [*DEGENERATE, "go_to_goal"]
    standing = rows["all_stand"]["metrics"]
    assert standing["standing_share"] == 1 and standing["w1_speed"] > 0
    assert {name for name, one in rows.items() if not one["n"]} == {"two_rows_each", "one_frame"}
    for name in ("two_rows_each", "nine_rows_each", "one_frame", "one_walks"):
        assert any(name in note for note in report["notes"]), name
    bad = written(tmp_path / "bad.csv", np.concatenate([still(i, 30, 40.0) for i in range(3)]))
    with pytest.raises(UserError, match="m/s"):  # before the policy walks
        score(["go_to_goal", bad], Reference(some, 0.4), dt=0.4, progress=lambda *_: pytest.fail("walked"))


@pytest.mark.parametrize("rate", [10, 25])
def test_rows_of_a_video_are_not_taken_for_steps(rate: int, real: PreparedReplay, tmp_path) -> None:
    table = plaza()[plaza()[:, 1] < 20]
    walks = []
    for agent in np.unique(table[:, 1]):
        frame, _, x, y = table[table[:, 1] == agent].T
        now = np.arange(np.ceil(frame.min() * 0.4 * rate), frame.max() * 0.4 * rate)
        places = [np.interp(now / rate, np.sort(frame) * 0.4, value[frame.argsort()]) for value in (x, y)]
        walks.append(np.column_stack((now, np.full(len(now), agent), *places)))
    with pytest.raises(UserError, match=r"people walk at 0\.\d+ m/s, .* --dt, .*; \S+ is likely") as error:
        file_crowd(written(tmp_path / "video.csv", np.concatenate(walks)), real)
    assert float(str(error.value).split()[-3]) == pytest.approx(1 / rate, rel=0.3)


def test_what_a_score_needs_is_asked_for_by_its_own_options(tmp_path) -> None:
    mine = written(tmp_path / "mine.csv", plaza())
    with pytest.raises(UserError, match=r"--data.dt is None: .* of the file of --against"):
        score([mine], mine)
    with pytest.raises(UserError, match="rollouts 0: expected at least 1"):
        score(["orca"], "embedded", rollouts=0)


def test_one_recorded_person_is_too_few(tmp_path, recwarn) -> None:
    table = plaza()
    longest = np.bincount(table[:, 1].astype(int)).argmax()
    alone = written(tmp_path / "alone.csv", table[table[:, 1] == longest])
    with pytest.raises(UserError, match=r"alone.csv: 1 recorded person .* too few .* standard deviations"):
        score([alone], Reference(alone, 0.4), likelihood=False)
    samples = recorded_crowd(Reference(alone, 0.4).prepared()).fine.crowd.samples
    assert math.isnan(spread(samples["nearest_distance"])) and spread(samples["speed"]) > 0
    assert not recwarn.list


def test_a_constant_velocity_crowd_is_told_apart(
    real: PreparedReplay, recorded: ScoredCrowd, tmp_path
) -> None:
    table = straightened(plaza(), np.unique(plaza()[:, 1]))
    metrics = row(file_crowd(written(tmp_path / "straight.csv", table), real), recorded, {})["metrics"]
    assert metrics["classifier_auc"] > 0.95 and metrics["coarse_classifier_auc"] > 0.9
    assert metrics["closed_loop_ade_m"] > 0.1


def test_likelihoods_are_those_of_counted_bins() -> None:
    simulated = torch.tensor([0.05, 0.15, 0.15, math.nan]).view(1, 1, 1, 4)  # one rollout counts 32 times
    true = torch.tensor([0.15, 0.95, math.nan, math.nan]).view(1, 1, 4)
    total, count = measured_likelihood(simulated, true, (0.0, 1.0))
    whole = 3 * ROLLOUTS + 0.1 * BINS
    assert int(count) == 2
    assert float(total) == pytest.approx(
        math.log((2 * ROLLOUTS + 0.1) / whole) + math.log(0.1 / whole), rel=1e-6
    )
    both = measured_likelihood(simulated.expand(1, 1, 2, 4), true.expand(1, 2, 4), (0.0, 1.0))
    assert int(both[1]) == 4 and float(both[0]) == pytest.approx(2 * float(total))
    touched = torch.zeros(4, 1, 2, dtype=torch.bool)
    touched[:2, 0, 0] = True
    total, _ = contact_likelihood(touched, torch.tensor([[True, True]]), torch.tensor([[True, False]]))
    assert float(total) == pytest.approx(math.log(0.5))


def test_the_likelihood_is_a_weighted_mean_of_features() -> None:
    half, quarter = math.log(0.5), math.log(0.25)
    sums = {
        "agent_contact": (torch.tensor([2 * half, 4 * quarter]), torch.tensor([2.0, 4.0])),
        "speed": (torch.tensor([3 * half, 0.0]), torch.tensor([3.0, 0.0])),
        "turn_rate": (torch.zeros(2), torch.zeros(2)),  # nobody walks
    }
    sums = {name: (above.double(), below.double()) for name, (above, below) in sums.items()}
    result = composite(sums, torch.tensor([[1.0, 1.0], [1.0, 0.0]]).double())
    contact = math.exp((2 * half + 4 * quarter) / 6)
    assert result["likelihood_agent_contact"].tolist() == pytest.approx([contact, 0.5])
    assert result["likelihood_speed"].tolist() == pytest.approx([0.5, 0.5])
    assert result["likelihood_turn_rate"].isnan().all()
    expected = (0.25 * contact + 0.05 * 0.5) / 0.3
    assert result["likelihood"].tolist() == pytest.approx([expected, 0.5])


def test_windows_hold_everybody_with_a_history(real: PreparedReplay, windows: JointWindows) -> None:
    people = real.persons
    walked = recorded_windows(windows)
    assert walked.xy.shape[3] == STEPS
    there = (people.first.unsqueeze(0) <= windows.begin.unsqueeze(1) - 7) & (
        people.last.unsqueeze(0) > windows.begin.unsqueeze(1)
    )
    assert int(walked.people.sum()) <= int(there.sum())
    assert int(walked.people.sum()) > 0.8 * int(there.sum())  # the others are at their exit already


def test_the_recording_is_likelier_than_straight_walking(windows: JointWindows) -> None:
    true = recorded_windows(windows)
    own = likelihood(true, true, "embedded")
    straight = likelihood(policy_windows("go_to_goal", windows, 0, "compiled"), true, "embedded")
    assert float(own["ade_8s_m"][0]) == 0 < float(straight["ade_8s_m"][0])
    assert float(own["likelihood"][0]) > float(straight["likelihood"][0]) + 0.1
    assert set(bins("embedded")) == set(MEASURED) and bins("zara1") != bins("eth")


def test_columns_of_crowdes_by_hand() -> None:
    steps = torch.arange(4)
    line = torch.stack((steps.float(), torch.zeros(4)), 1)
    real = ScoredSteps(torch.zeros(4).long(), torch.zeros(4).long(), steps, line)
    moved = real._replace(xy=line + torch.tensor([0.0, 1.0]))
    result = columns(moved, real)
    assert result["crowdes_dtw"] == pytest.approx(2 * 0.4)  # root of four squares of 1 m, at 2.5 Hz
    assert result["crowdes_kinematics"] == pytest.approx(0, abs=1e-12)
    twice = ScoredSteps(*(torch.cat((value, value)) for value in real))
    twice = twice._replace(person=torch.tensor([0] * 4 + [1] * 4))
    result = columns(twice, real)
    assert result["crowdes_population"] == pytest.approx(1.0)  # two people where there is one
    assert result["crowdes_density"] == pytest.approx(0.01)
    assert result["crowdes_coverage"] == 0
    apart = columns(twice._replace(xy=torch.cat((line, line.flip(0)))), real)
    assert apart["crowdes_coverage"] == pytest.approx(0.01)  # in two squares where one is occupied
    assert result["crowdes_diversity"] == pytest.approx(0.75)  # one of the two is nobody's nearest


def test_flow_and_headways_say_how_many_got_through() -> None:
    steps = torch.arange(6)
    lines = [torch.stack((steps - start, torch.zeros(6)), 1) for start in (0.5, 2.5, 4.5, 9.0)]
    walks = ScoredSteps(
        torch.zeros(24).long(), torch.arange(4).repeat_interleave(6), steps.repeat(4), torch.cat(lines)
    )
    result = through(walks, torch.tensor([0.0, 0.0, 1.0, 0.0, 0.5]))
    assert result["opening_through_share"] == 0.75  # the last is still before it
    at_the_jamb = walks._replace(xy=walks.xy + torch.tensor([0.0, 0.25]))
    assert through(at_the_jamb, torch.tensor([0.0, 0.0, 1.0, 0.0, 0.5])) == result
    beyond = walks._replace(xy=walks.xy + torch.tensor([0.0, 0.26]))
    assert through(beyond, torch.tensor([0.0, 0.0, 1.0, 0.0, 0.5])) == {"opening_through_share": 0}
    assert result["opening_headway_p50_s"] == pytest.approx(0.8)
    gate = torch.tensor([[0.0, 0.0, 1.0, 0.0, 0.5]])
    people, room = flow(torch.tensor([[0.2, 1.0, 1.8, math.inf]]), gate)
    assert result["specific_flow_per_m_s"] == pytest.approx(3 / 1.6 / 0.5)  # N / (T w), as PedPy
    assert float(people / room) == pytest.approx(result["specific_flow_per_m_s"])  # as of rollouts


def test_companions_stay_together() -> None:
    steps = torch.arange(10)
    lines = [torch.stack((steps.float(), torch.full((10,), y)), 1) for y in (0.0, 1.0, 5.0)]
    walks = ScoredSteps(
        torch.zeros(30).long(), torch.arange(3).repeat_interleave(10), steps.repeat(3), torch.cat(lines)
    )
    assert companions(walks).tolist() == [[0, 1]]


def test_preferred_speeds_are_not_those_of_a_queue() -> None:
    frame = np.arange(20)
    free = [np.column_stack((frame, np.full(20, i), frame * 0.52, np.full(20, 10.0 * i))) for i in range(5)]
    queue = [
        np.column_stack((frame, np.full(20, 5 + i), frame * 0.1 + 0.6 * i, np.full(20, 100.0)))
        for i in range(2)
    ]
    tracks = Tracks.from_table("hall", np.concatenate((*free, *queue)))
    observed, estimated = (
        without_goals([tracks], speed=of)[0].pref_speed for of in ("observed", "estimated")
    )
    torch.testing.assert_close(observed[:5], torch.full((5,), 1.3))
    torch.testing.assert_close(estimated, torch.full((7,), 1.3))
    assert float(observed[5:].max()) == pytest.approx(0.3)  # the least that there is


def test_the_suite_replay_walks_own_files(tmp_path) -> None:
    own = OwnRecordings((written(tmp_path / "hall.csv", plaza()),), 0.4)
    report = evaluate(["go_to_goal"], ["replay"], quick=True, own=own)
    assert {row["case"]["fold"] for row in report["rows"]} == {"files"}
    assert {row["name"] for row in report["rows"]} == {"go_to_goal", "real", "real halves"}
    with pytest.raises(UserError, match="instead of"):
        evaluate(["go_to_goal"], ["replay"], folds=["zara1"], own=own)


def test_the_command_writes_one_json(tmp_path, capsys) -> None:
    mine, out = written(tmp_path / "mine.csv", plaza()[plaza()[:, 1] < 12]), tmp_path / "score.json"
    against = ["--against", mine, "--data.dt", "0.4", "--dt", "0.4", "--likelihood", "false"]
    assert main(["score", mine, *against, "--json", str(out)]) == 0
    report = json.loads(out.read_text())
    assert [one["name"] for one in report["rows"]] == ["real", "real halves", mine]
    assert report["protocol"]["version"] == 3
    assert "mine.csv" in capsys.readouterr().out
