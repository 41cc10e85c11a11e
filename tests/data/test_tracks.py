"""Reading and resampling recordings, and refusing what cannot be right."""

import re
from pathlib import Path

import numpy as np
import pytest
import yaml

from pedzoo.core.errors import UserError
from pedzoo.data.datamodule import TrajectoryDataModule
from pedzoo.data.datasets.eth_ucy import EthUcy
from pedzoo.data.recordings import OwnFiles
from pedzoo.data.tracks import Tracks, doubts
from pedzoo.eval.scoring.score import Reference, score
from pedzoo.sim.scenarios.replay import Replay

ROWS = [(0, 1, 0.0, 5.0), (10, 1, 0.5, 5.5), (0, 2, -1.0, 2.25), (10, 2, -1.5, 2e-3)]
TABLE = np.array(ROWS)


def text(rows: list[tuple[float, ...]], separator: str = "\t") -> str:
    return "".join(separator.join(f"{value}" for value in row) + "\n" for row in rows)


def save(folder: Path, content: str, name: str = "walk.txt") -> Path:
    (folder / name).write_text(content)
    return folder / name


def assert_same(tracks: Tracks, other: Tracks) -> None:
    for mine, theirs in ((tracks.frame, other.frame), (tracks.agent, other.agent), (tracks.xy, other.xy)):
        assert mine.tolist() == theirs.tolist()


@pytest.mark.parametrize(
    "content",
    [
        text(ROWS),
        text(ROWS, " "),
        text(ROWS, ","),
        "0.0   1.0 0 5\n\n10 1 .5 5.5\n0 2 -1 2.25\n1e1 2 -1.5 2e-3\n",
        "frame,agent,x,y\n" + text(ROWS, ","),
        "frame ped x y\n" + text(ROWS, " "),
        "# frame ped x y\n" + text(ROWS, " "),
        "y,note,Agent,x,frame\n" + "".join(f"{y},#a b,{a},{x},{f}\n" for f, a, x, y in ROWS),
        '"frame", "track_id", "x", "y", "who"\n'
        + "".join(f'"{f}", {a}, "{x}", {y}, "a, b"\n' for f, a, x, y in ROWS),
        ",frame_id,id,x,y\n" + "".join(f"{i},{','.join(map(str, row))}\n" for i, row in enumerate(ROWS)),
    ],
    ids=["sgan", "spaces", "commas", "forms", "csv", "header", "savetxt", "any_order", "quoted", "index"],
)
def test_all_forms_give_the_same_tracks(tmp_path, content):
    tracks = Tracks.read(save(tmp_path, content))
    assert_same(tracks, Tracks.from_table("walk", TABLE))
    assert tracks.name == "walk"
    assert (len(tracks), tracks.people) == (4, 2)


def test_rows_in_any_order_give_the_same_tracks():
    shuffled = np.random.default_rng(0).permutation(TABLE)
    assert_same(Tracks.from_table("a", shuffled), Tracks.from_table("a", TABLE))
    assert Tracks.from_table("a", shuffled).agent.tolist() == [1, 1, 2, 2]


@pytest.mark.parametrize(
    ("content", "words"),
    [
        ("", ["walk.txt", "empty", "frame, agent, x, y"]),
        ("frame,agent,x,y\n", ["walk.txt", "empty"]),
        ("0 1 0 0\n\n10 1 abc 0\n", ["walk.txt", "line 3", "10 1 abc 0"]),
        ("frame,agent,x,y\n0,1,,3\n", ["line 2", "0,1,,3"]),
        ("0 1 0 0\n10 1 nan 0\n", ["line 2", "not finite"]),
        ("frame,agent,x,y\n0,1,0,0\n10,1,0,inf\n", ["line 3", "not finite"]),
        ("0 1 0 0\n10 1 0 0\n10 1 2 2\n", ["line 3", "agent 1 is twice in frame 10"]),
        ("0.4 1 0 0\n", ["line 1", "whole numbers", "round(time / dt)"]),
        ("1e300 1 0 0\n", ["line 1", "whole numbers"]),
        ("frame,person,x,y\n0,1,0,0\n", ["no column 'agent'", "frame,person,x,y"]),
        ("frame|agent|x|y\n0|1|0|0\n", ["no column 'frame'", "frame|agent|x|y"]),
        ("0 1 0\n", ["3 columns", "frame, agent, x, y"]),
        ("0 1 0 0\n10 1 0\n", ["line 2", "10 1 0"]),
    ],
)
def test_bad_files_are_refused_by_name_and_line(tmp_path, content, words):
    path = save(tmp_path, content)
    with pytest.raises(UserError) as refused:
        Tracks.read(path)
    for word in words:
        assert word in str(refused.value)
    assert "\n" not in str(refused.value)


def test_missing_and_binary_files_are_refused(tmp_path):
    with pytest.raises(UserError, match=r"no recording at '.*nowhere\.csv'"):
        Tracks.read(tmp_path / "nowhere.csv")
    (tmp_path / "a.parquet").write_bytes(b"PAR1\xff\xfe\x00\x01")
    with pytest.raises(UserError, match=r"a\.parquet' is not a text file"):
        Tracks.read(tmp_path / "a.parquet")


def test_homography_maps_pixels_to_metres():
    pixels = Tracks.from_table("a", np.array([[0, 1, 100.0, 50.0], [1, 1, 200.0, 50.0]]))
    matrix = np.array([[0.02, 0, -1], [0, -0.02, 3], [0, 0.01, 0.5]])  # divides by 0.01 * 50 + 0.5 = 1
    assert pixels.through(matrix).xy.tolist() == [[1.0, 2.0], [3.0, 2.0]]
    assert np.allclose(pixels.through(7 * matrix).xy, pixels.through(matrix).xy)  # known only up to scale
    with pytest.raises(UserError, match=r"maps \(100, 50\) of recording 'a' to infinity"):
        pixels.through(np.array([[1, 0, 0], [0, 1, 0], [0, 0.01, -0.5]]))


def test_folds_are_rounded_as_in_social_gan(tmp_path):
    for split in ("train", "val", "test"):
        (tmp_path / "zara1" / split).mkdir(parents=True)
        save(tmp_path / "zara1" / split, "0 1 1.23456 -0.00004\n", "crowds_zara01.txt")
    (recording,) = EthUcy("zara1", str(tmp_path)).recordings("test")
    assert recording.tracks.xy.tolist() == [[1.2346, 0.0]]
    assert recording.plan is None


def walk(frames: np.ndarray, agent: int, start: tuple[float, float], step: tuple[float, float]) -> np.ndarray:
    """Rows of a straight walk: at frame 0 ``start``, ``step`` per frame."""
    xy = np.array(start) + frames[:, None] * np.array(step)
    return np.column_stack((frames, np.full(len(frames), agent), xy))


def test_a_straight_walk_at_25_hz_is_the_exact_line():
    """Two people; the second comes at frame 7 = 0.28 s, between two steps."""
    rows = [walk(np.arange(0, 105), 1, (2, 1), (0.05, 0.02)), walk(np.arange(7, 98), 2, (0, 0), (-0.04, 0))]
    tracks = Tracks.from_table("a", np.concatenate(rows)).resampled(0.04)
    first, second = tracks.agent == 1, tracks.agent == 2
    assert tracks.frame[first].tolist() == list(range(11))  # 0 .. 4.16 s
    assert tracks.frame[second].tolist() == list(range(1, 10))  # 0.28 .. 3.88 s
    steps = np.arange(11)[:, None]
    assert np.allclose(tracks.xy[first], (2, 1) + steps * (0.5, 0.2), atol=1e-9)
    assert np.allclose(tracks.xy[second], steps[1:10] * (-0.4, 0), atol=1e-9)


@pytest.mark.parametrize("seconds", [0.3, 0.6, 0.8])
def test_other_rates_are_interpolated(seconds):
    """0.8 s divides evenly into steps, too, and still every second position has to be made."""
    tracks = Tracks.from_table("a", walk(np.arange(20), 1, (0, 0), (seconds, 0))).resampled(seconds)
    assert tracks.frame.tolist() == list(range(round(19 * seconds // 0.4) + 1))
    assert np.allclose(tracks.xy[:, 0], tracks.frame * 0.4)


def test_rows_already_at_04_s_are_kept_to_the_last_bit():
    xy = np.random.default_rng(0).normal(size=(30, 2))
    # from frame 783, with a hole in which no person is seen: 15 rows of one person, 15 of the next
    frames = np.concatenate((783 + 10 * np.arange(15), 1083 + 10 * np.arange(15)))
    table = np.column_stack((frames, np.repeat((4, 9), 15), xy))
    tracks = Tracks.from_table("a", table).resampled(0.04)
    assert (tracks.xy == xy).all()
    assert tracks.frame.tolist() == [*range(15), *range(30, 45)]


def test_holes_split_a_track_and_everything_stays_sorted():
    """Agent 1 is not seen for 2 s; one lost row (0.4 s at 5 Hz) is no hole."""
    seen = np.concatenate((np.arange(0, 21), np.arange(31, 52)))
    seen = seen[seen != 10]
    rows = [walk(seen, 1, (0, 0), (0.2, 0)), walk(np.arange(52), 2, (0, 3), (0.2, 0))]
    tracks = Tracks.from_table("a", np.concatenate(rows)).resampled(0.2)
    assert sorted(set(tracks.agent.tolist())) == [1, 2, 3]
    assert tracks.frame[tracks.agent == 1].tolist() == list(range(0, 11))
    assert tracks.frame[tracks.agent == 3].tolist() == list(range(16, 26))  # from 6.2 s on
    assert np.allclose(tracks.xy[tracks.agent == 1, 0], 0.4 * np.arange(11))
    order = np.lexsort((tracks.frame, tracks.agent))
    assert order.tolist() == list(range(len(tracks)))  # what cutting windows relies on


def test_who_is_never_seen_for_a_step_is_left_out():
    rows = [walk(np.arange(0, 11), 1, (0, 0), (0.1, 0)), walk(np.arange(1, 4), 2, (0, 3), (0.1, 0))]
    assert set(Tracks.from_table("a", np.concatenate(rows)).resampled(0.1).agent.tolist()) == {1}


@pytest.mark.parametrize("fold", ["hotel", "zara1"])
def test_the_true_clock_leaves_the_others_as_they_are(shared, fold):
    (plain,) = EthUcy(fold, str(shared / "data"), "benchmark").recordings("test")
    (true,) = EthUcy(fold, str(shared / "data"), "true").recordings("test")
    assert (plain.tracks.xy == true.tracks.xy).all()
    assert (plain.tracks.agent == true.tracks.agent).all()
    assert (np.diff(plain.tracks.frame) == 10 * np.diff(true.tracks.frame)).all()


# Recordings in which nobody moves as people do


def crowd(
    rate: float, by: int = 1, scale: float = 1.0, people: int = 6, seed: int = 0, speed: float = 1.3
) -> np.ndarray:
    """Return rows of people who walk for 8 s, some of whom stop: frames by ``by``, places times ``scale``."""
    draws, rows = np.random.default_rng(seed), round(8 * rate)
    parts = []
    for agent in range(people):
        heading = draws.uniform(0, 6) + draws.normal(0, 0.3 / np.sqrt(rate), rows).cumsum()
        walks = np.where((agent % 3 == 0) & (np.arange(rows) > 4 * rate), 0, speed * draws.uniform(0.8, 1.2))
        step = (walks / rate)[:, None] * np.stack((np.cos(heading), np.sin(heading)), 1)
        place = draws.uniform(-8, 8, 2) + step.cumsum(0) + draws.normal(0, 0.003, (rows, 2))
        parts.append(np.column_stack((by * np.arange(rows), np.full(rows, agent), scale * place)))
    return np.concatenate(parts)


def write_rows(path: Path, table: np.ndarray) -> str:
    np.savetxt(path, table, fmt=["%d", "%d", "%.7g", "%.7g"], header="frame ped x y", comments="")
    return str(path)


def refusal(file: str, dt: float) -> str:
    with pytest.raises(UserError) as refused:
        OwnFiles([file], dt, "0,0,1").recordings("test")
    assert "\n" not in str(refused.value)
    return str(refused.value)


def named_dt(message: str) -> float:
    (found,) = re.findall(r"--data\.dt ([\d.e-]+)(?: is likely|, or)", message)
    return float(found)


@pytest.mark.parametrize("seed", range(4))
def test_a_wrong_dt_is_refused_and_the_right_one_named(seed, tmp_path):
    """Rows too far apart, or people too fast; the same file with the dt that is named passes."""
    draws = np.random.default_rng(seed)
    for _ in range(12):
        rate, by = draws.choice([2.5, 5, 10, 12.5, 16, 25, 30]), int(draws.choice([1, 2, 6, 10]))
        file, right = write_rows(tmp_path / "walks.txt", crowd(rate, by, seed=seed)), 1 / (rate * by)
        wrong = right * draws.choice([1 / 12, 1 / 8, 0.85 * rate + 0.3])
        if not 0.25 / 8 < wrong / right < 4.9 / right or 0.25 < wrong / right < 1.05 * 0.8 * rate:
            continue
        message = refusal(file, wrong)
        assert named_dt(message) == pytest.approx(right, rel=0.45), message
        OwnFiles([file], named_dt(message), "0,0,1").recordings("test")
        OwnFiles([file], right, "0,0,1").recordings("test")


@pytest.mark.parametrize(
    ("scale", "words"),
    [
        (100, "centimetres (name the columns x_cm and y_cm, a factor of 0.01)"),
        (1000, "x_mm"),
        (1 / 0.3048, "feet (name the columns x_ft and y_ft, a factor of 0.3048)"),
        (50, "a homography from pixels to metres"),  # pixels
        (30, "a homography from pixels to metres"),
        (9e-6, "degrees"),
        (1e-3, "kilometres"),
    ],
)
@pytest.mark.parametrize("rate", [2.5, 12.5, 30])
def test_other_units_are_refused_and_named(scale, words, rate, tmp_path):
    for people in (1, 2, 40):
        table = crowd(rate, scale=scale, people=people, speed=1.7, seed=people)
        if scale == 1e-3 and people == 40:
            table = table[table[:, 1] < 10]  # a few people within 10 cm
        assert words in refusal(write_rows(tmp_path / "walks.txt", table), 1 / rate)


def test_agents_and_frames_that_changed_places_are_named(tmp_path):
    table = crowd(25, people=40)[:, [1, 0, 2, 3]]
    assert "they look like agent, frame, x, y" in refusal(write_rows(tmp_path / "walks.txt", table), 0.04)


@pytest.mark.parametrize("command", ["forecast", "fit", "replay", "score"])
def test_every_command_refuses_in_the_same_words(command, tmp_path):
    for table, dt, words in (
        (crowd(10, scale=50), 0.1, "people move at .* m/s"),
        (crowd(2.5, by=10), 0.4, "10 frame numbers apart, 4 s .* --data.dt 0.04 is likely"),
    ):
        file = write_rows(tmp_path / "walks.txt", table)
        with pytest.raises(UserError, match=words):
            if command == "score":
                score(["orca"], Reference(file, dt))
            elif command == "replay":  # of rollout and evaluate
                Replay(files=[file], dt=dt).prepare(0.3)
            else:
                TrajectoryDataModule(files=[file], dt=dt).setup("test" if command == "forecast" else "fit")


def test_a_dataset_of_ones_own_is_looked_at_too(tmp_path):
    file = write_rows(tmp_path / "walks.txt", crowd(2.5, scale=50))
    code = tmp_path / "mine.py"
    code.write_text(
        "from pedzoo.data.recordings import Dataset, Recording\nfrom pedzoo.data.tracks import Tracks\n"
        f"class Mine(Dataset):\n    FOLDS = {{'a': ['walks']}}\n    def recordings(self, split):\n"
        f"        return [Recording(Tracks.read({file!r}), plan=None)]\n"
    )
    with pytest.raises(UserError, match="people move at"):
        TrajectoryDataModule(f"{code}:Mine:a").setup("test")


def test_single_fast_ones_and_slow_crowds_get_a_note_and_pass(tmp_path, capsys):
    def note(table: np.ndarray, dt: float) -> str:
        OwnFiles([write_rows(tmp_path / f"{len(notes)}.txt", table)], dt, "0,0,1").recordings("test")
        notes.append(capsys.readouterr().err)
        return notes[-1]

    notes: list[str] = []
    walkers = crowd(10)
    cyclist = crowd(10, people=1, speed=6) + np.array((0, 99, 0, 0))
    assert "faster than 4 m/s" in note(np.concatenate((walkers, cyclist)), 0.1)
    jump = walkers.copy()
    jump[37, 2] += 30  # one number for two people
    assert re.search(r"[1-9] of \d+ steps are faster than 4 m/s", note(jump, 0.1))
    assert "is it 0.0333?" in note(crowd(30), 0.4)
    assert "people move at 2.8 m/s" in note(crowd(10, speed=2.6, seed=3), 0.1)
    standing = crowd(10, speed=0)
    for quiet in (walkers, standing, walkers[walkers[:, 1] == 1], standing[:40], standing[:1]):
        tracks = Tracks.from_table("a", quiet)
        assert not doubts(tracks, 0.1, "dt")
        tracks.resampled(0.1)
    assert len(note(walkers, 0.1).splitlines()) == 1


def test_real_recordings_pass(shared):
    noted = []
    for one in yaml.safe_load((shared / "data" / "people" / "index.yaml").read_text()):
        tracks = Tracks.read(shared / "data" / "people" / f"{one['name']}.csv")
        tracks.resampled(one["dt"])
        noted += [one["name"]] * bool(doubts(tracks, one["dt"], "dt"))
    for file in (shared / "data" / "eth_ucy" / "raw").glob("*.txt"):
        tracks, dt = Tracks.read(file), 2 / 30 if file.stem == "biwi_eth" else 0.04
        tracks.resampled(dt)
        noted += [file.stem] * bool(doubts(tracks, dt, "dt"))
    assert all(name.startswith("gc_") for name in noted)  # whose annotations jump, up to 39 m/s
