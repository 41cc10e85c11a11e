"""Recordings in which nobody moves as people do are refused, and the message names what is likely right."""

import re
from pathlib import Path

import numpy as np
import pytest
import yaml

from pedzoo.core.errors import UserError
from pedzoo.data.datamodule import TrajectoryDataModule
from pedzoo.data.own_files import OwnFiles
from pedzoo.data.tracks import Tracks, doubts
from pedzoo.eval.scoring.score import Reference, score
from pedzoo.sim.scenarios.replay import Replay


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


def save(path: Path, table: np.ndarray) -> str:
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
        file, right = save(tmp_path / "walks.txt", crowd(rate, by, seed=seed)), 1 / (rate * by)
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
        assert words in refusal(save(tmp_path / "walks.txt", table), 1 / rate)


def test_agents_and_frames_that_changed_places_are_named(tmp_path):
    table = crowd(25, people=40)[:, [1, 0, 2, 3]]
    assert "they look like agent, frame, x, y" in refusal(save(tmp_path / "walks.txt", table), 0.04)


@pytest.mark.parametrize("command", ["forecast", "fit", "replay", "score"])
def test_every_command_refuses_in_the_same_words(command, tmp_path):
    for table, dt, words in (
        (crowd(10, scale=50), 0.1, "people move at .* m/s"),
        (crowd(2.5, by=10), 0.4, "10 frame numbers apart, 4 s .* --data.dt 0.04 is likely"),
    ):
        file = save(tmp_path / "walks.txt", table)
        with pytest.raises(UserError, match=words):
            if command == "score":
                score(["orca"], Reference(file, dt))
            elif command == "replay":  # of rollout and evaluate
                Replay(files=[file], dt=dt).prepare(0.3)
            else:
                TrajectoryDataModule(files=[file], dt=dt).setup("test" if command == "forecast" else "fit")


def test_a_dataset_of_ones_own_is_looked_at_too(tmp_path):
    file = save(tmp_path / "walks.txt", crowd(2.5, scale=50))
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
        OwnFiles([save(tmp_path / f"{len(notes)}.txt", table)], dt, "0,0,1").recordings("test")
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
