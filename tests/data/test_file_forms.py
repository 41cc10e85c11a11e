"""Files of the field: every form of one crowd gives the same walks, and says what it was taken for."""

import sqlite3
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from pedzoo.core.errors import UserError
from pedzoo.data.recordings import OwnFiles
from pedzoo.data.text_format import is_recording
from pedzoo.data.tracks import Tracks

RATE = 12.5
"""Frames per second of the crowd: every fifth is on a step of 0.4 s."""

JPSCORE = (
    "#description: jpscore\n#framerate: 12.50\n#ID: the agent ID\n#FR: the current frame\n"
    "#X,Y,Z: the agents coordinates (in metres)\n\n#ID\tFR\tX\tY\tZ\tA\tB\tANGLE\tCOLOR\n"
)
PETRACK = "# PeTrack project: a.pet\n#framerate: 12,5 fps\n"
PEDPY = "# description: a hall\n# framerate: 12.50\n# geometry: hall.xml\n\n"


def crowd(people: int = 4, rows: int = 41, seed: int = 0) -> np.ndarray:
    """Return rows (N, 4) of frame, agent, x, y: people who walk on curves, from frame 25 on."""
    draws = np.random.default_rng(seed)
    parts = []
    for agent in range(people):
        frame = 25 + 7 * agent + np.arange(rows)
        heading = draws.uniform(0, 6) + draws.normal(0, 0.1, rows).cumsum()
        step = draws.uniform(0.8, 1.6) / RATE * np.stack((np.cos(heading), np.sin(heading)), 1)
        place = np.round(draws.uniform(-9, 9, 2) + step.cumsum(0), 4)
        parts.append(np.column_stack((frame, np.full(rows, agent + 3), place)))
    return np.concatenate(parts)


def lines(form: str, table: np.ndarray, by: float = 1.0, comma: bool = False) -> str:
    """Return a row of text for each row, with f, t (seconds), a, x and y (times ``by``) in ``form``."""
    texts = (
        form.format(
            f=int(f),
            t=f"{f / RATE:.6g}",
            ms=round(f * 1000 / RATE),
            a=int(a),
            x=f"{x * by:.6f}",
            y=f"{y * by:.6f}",
        )
        for f, a, x, y in table
    )
    return "".join((text.replace(".", ",") if comma else text) + "\n" for text in texts)


def vadere(table: np.ndarray) -> str:
    """Return footsteps of 1, 2 or 11 rows of the crowd, each with its begin and end."""
    rows = ["pedestrianId simTime endTime-PID1 startX-PID1 startY-PID1 endX-PID1 endY-PID1 targetId-PID2"]
    for agent in np.unique(table[:, 1]):
        mine = table[table[:, 1] == agent]
        mine = mine[mine[:, 0].argsort()]
        for before, after in pairwise(mine):
            times = f"{before[0] / RATE:.6f} {after[0] / RATE:.6f}"
            rows.append(f"{int(agent)} {times} {before[2]} {before[3]} {after[2]} {after[3]} 4")
    return "\n".join(rows) + "\n"


FORMS: dict[str, tuple[str, str, str]] = {
    "pedpy": ("PedPy text", PEDPY + "# id frame x/m y/m z/m\n", "{a}\t{f}\t{x}\t{y}\t1.8"),
    "pedpy_unnamed": ("PedPy text", PEDPY, "{a} {f} {x} {y} 1.8"),
    "pedpy_4": ("PedPy text", PEDPY, "{a} {f} {x} {y}"),
    "petrack_cm": ("PedPy text", PETRACK + "# id frame x/cm y/cm z/cm\n", "{a} {f} {x} {y} 180"),
    "cm_in_words": ("PedPy text", PEDPY + "# x, y and z in cm\n", "{a} {f} {x} {y} 180"),
    "jupedsim_text": ("PedPy text", JPSCORE, "{a}\t{f}\t{x}\t{y}\t0\t.3\t.2\t12\t7"),
    "time": ("CSV (time, agent_id, pos_x, pos_y)", "time,agent_id,pos_x,pos_y\n", "{t},{a},{x},{y}"),
    "timestamp_ms": ("timestamp", "timestamp;ped_id;x;y\n", "{ms};{a};{x};{y}"),
    "time_ms": ("time_ms", "ped_id time_ms x_m y_m\n", "{a} {ms} {x} {y}"),
    "nanoseconds": ("t [ns]", "t [ns],id,x [mm],y [mm]\n", "{ms}000000,{a},{x},{y}"),
    "semicolons": ("decimal commas", "time;id;x;y\n", "{t};{a};{x};{y}"),
    "tabs_and_commas": ("decimal commas", "time\tid\tpos x\tpos y\tnote\n", "{t}\t{a}\t{x}\t{y}\tat ease"),
    "spaces_and_commas": ("decimal commas", "time id x y\n", "{t} {a} {x} {y}"),
    "frame_and_time": ("", "frame,time,id,x,y\n", "{f},{t},{a},{x},{y}"),
    "crowdit": ("pedID", "pedID,time,posX,posY\n", "{a},{t},{x},{y}"),
    "feet": ("x_ft", "time,id,x_ft,y_ft\n", "{t},{a},{x},{y}"),
    "comments": ("CSV", "# mine\n\ntime,track_id,x,y,who\n# first\n", "{t},{a},{x},{y},#3"),
    "trailing": ("CSV", "time,id,x,y,\n", "{t},{a},{x},{y},"),
    "quoted": ("decimal commas", '"time";"id";"x";"y"\n', '"{t}";"{a}";"{x}";"{y}"'),
    "vadere": ("footsteps of Vadere", "", ""),
    "vadere_steps": ("PID", "simTime pedestrianId x-PID1 y-PID1 targetId-PID2\n", "{t} {a} {x} {y} 4"),
}
"""What a form is taken for, its lines before the first row, and its rows."""

UNITS = {"petrack_cm": 100, "cm_in_words": 100, "nanoseconds": 1000, "feet": 1 / 0.3048}


def written(form: str, table: np.ndarray) -> str:
    """Return the crowd of a table in a form."""
    said, begin, row = FORMS[form]
    return begin + lines(row, table, UNITS.get(form, 1), said == "decimal commas") if row else vadere(table)


def same(file: Path, table: np.ndarray, within: float = 1e-5, homography: str | None = None) -> None:
    """Assert that a file without a dt gives the walks of a table of the same crowd with one."""
    plain = file.with_name("plain.csv")
    plain.write_text("frame,agent,x,y\n" + lines("{f},{a},{x},{y}", table))
    (real,) = OwnFiles([str(plain)], 1 / RATE, "0,0,1").recordings("test")
    (read,) = OwnFiles([str(file)], None, "0,0,1", homography=homography).recordings("test")
    assert read.tracks.frame.tolist() == real.tracks.frame.tolist()
    assert read.tracks.agent.tolist() == real.tracks.agent.tolist()
    assert np.abs(read.tracks.xy - real.tracks.xy).max() < within


@pytest.mark.parametrize("form", FORMS)
def test_every_form_of_a_crowd_gives_its_walks_and_is_said(form, tmp_path, capsys):
    for seed, encoding in enumerate(("utf-8", "utf-8-sig", "utf-16")):
        table = np.random.default_rng(seed).permutation(crowd(seed=seed))
        file = tmp_path / f"{form}{seed}.txt"
        text = written(form, table)
        text += "# end\n" * (form == "comments")
        file.write_bytes((text.replace("\n", "\r\n") if seed == 1 else text).encode(encoding))
        same(file, table)
        (line,) = capsys.readouterr().err.splitlines()
        assert f"{file} read as " in line and FORMS[form][0] in line and line.endswith((" m", "metres")), line


def database(path: Path, table: np.ndarray, fps: object = RATE, column: str = "pos_x") -> Path:
    """Write what JuPedSim's SqliteTrajectoryWriter does."""
    connection = sqlite3.connect(path)
    connection.execute(
        f"CREATE TABLE trajectory_data (frame INTEGER NOT NULL, id INTEGER NOT NULL, {column} REAL NOT NULL, "
        "pos_y REAL NOT NULL, ori_x REAL NOT NULL, ori_y REAL NOT NULL)"
    )
    connection.execute("CREATE TABLE metadata(key TEXT NOT NULL UNIQUE PRIMARY KEY, value TEXT NOT NULL)")
    connection.executemany("INSERT INTO metadata VALUES(?, ?)", [("version", "2"), ("fps", fps)])
    connection.executemany("INSERT INTO trajectory_data VALUES(?, ?, ?, ?, 1, 0)", table.tolist())
    connection.commit()
    connection.close()
    return path


def test_sqlite_of_jupedsim(tmp_path, capsys):
    table = crowd()
    same(database(tmp_path / "jps.sqlite", table), table)
    assert "read as SQLite of JuPedSim: 0.08 s between frame numbers" in capsys.readouterr().err


def test_broken_databases_are_refused_in_words(tmp_path):
    table = crowd(2, 5)
    whole = database(tmp_path / "whole.sqlite", table).read_bytes()
    (tmp_path / "cut.sqlite").write_bytes(whole[: len(whole) // 2])
    (tmp_path / "garbage.sqlite").write_bytes(whole[:100] + b"\xff" * (len(whole) - 100))
    database(tmp_path / "column.sqlite", table, column="x_pos")
    database(tmp_path / "fps.sqlite", table, fps="fast")
    database(tmp_path / "twice.sqlite", np.concatenate((table, table[:1])))
    other = sqlite3.connect(tmp_path / "other.sqlite")
    other.execute("create view trajectory_data as select 1 as frame, 1 as id, 1 as pos_x, 1 as pos_y")
    other.close()
    for name, words in {
        "cut": "no SQLite file of JuPedSim",
        "garbage": "no SQLite file of JuPedSim",
        "column": "no such column: pos_x",
        "fps": "is no number",
        "twice": "row 11 .*agent 3 is twice in frame 25",
        "other": "no table trajectory_data",
    }.items():
        with pytest.raises(UserError, match=words):
            Tracks.read(tmp_path / f"{name}.sqlite")
    odd = sqlite3.connect(database(tmp_path / "text.sqlite", table))
    odd.execute("update trajectory_data set pos_y = 'north' where frame = 26")
    odd.commit()
    odd.close()
    with pytest.raises(UserError, match=r"is no number: .*north"):
        Tracks.read(tmp_path / "text.sqlite")


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("frame,agent,x,y\n0,1,1,5,2,5\n", "has 6 columns, but 4 are named"),
        ("frame,agent,x,y\n0,1,1,2\n1,1,1,5,2,5\n", "line 3: expected 4 columns"),
        ("frame ped x y\n1 0 1 0.5 2.0\n", "has 5 columns, but 4 are named"),  # row names of R
        ("frame;id;x;y\n0;1;1.234,5;0\n", "line 2: expected 4 columns with numbers"),
        ('frame,id,x,y\n0,1,"1,234",0\n', "line 2: expected 4 columns with numbers"),
        ("# frame walker x y\n0 1 0 0\n", "no column 'agent'"),
        ("time,id,lat,lon\n0.1,1,50.1,6.2\n", "no column 'x': .*project degrees to metres"),
        ("frame,id,x_cm,y_m\n0,1,0,0\n", "has cm and m: expected one unit"),
        ("time,id,x,y\n0.1,1,0,0\n0.1,1,1,1\n", "line 3 .*agent 1 is twice"),
        ("time,id,x,y\n0.1,1,0,0\nnan,1,1,1\n", "line 3 .*not finite"),
        ("frame,id,x,y,note\n0,1,0,0," + "a" * 200_000 + "\n", "a line of more than 131,072 letters"),
        ("frame,id,x,y,note\n0,1,0,0,a\n1,1,0,0," + "a" * 200_000 + "\n", "line 3 has a line of more than"),
        ("frame,id,x,y\n0,1,0,0\0\n", "bytes of zero"),
        ("pedestrianId simTime endTime startX startY endX endY\n1 0.5 0.1 0 0 1 1\n", "before it begins"),
        ("pedestrianId simTime endTime startX startY endX endY\n1 0.5 inf 0 0 1 1\n", "or never"),
        ("pedestrianId simTime endTime startX startY endX endY\n1 0 9e9 0 0 1 1\n", "at most 5,000,000"),
    ],
)
def test_files_that_would_be_half_read_are_refused(text, words, tmp_path):
    (tmp_path / "walks.csv").write_text(text)
    with pytest.raises(UserError, match=words) as refused:
        Tracks.read(tmp_path / "walks.csv")
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize(
    ("begin", "words"), [(b"\x1f\x8b\x08", "gzip"), (b"PK\x03\x04", "zip"), (b"BZh9", "bzip2")]
)
def test_archives_are_not_unpacked_but_named(begin, words, tmp_path):
    (tmp_path / "walks.csv.gz").write_bytes(begin + b"walks")
    assert is_recording("walks.csv.gz") and not is_recording("walks.gz")
    with pytest.raises(UserError, match=f"{words}.*: unpack"):
        Tracks.read(tmp_path / "walks.csv.gz")


def seconds(path: Path) -> float | None:
    return Tracks.read(path).source.seconds


def test_what_a_file_says_of_its_time(tmp_path):
    path, table = tmp_path / "walks.txt", crowd()
    for header, form, expected in (
        ("# framerate: 12.5\n", "{a} {f} {x} {y}", 0.08),
        ("# fps = 25\n# frame id x y\n", "{f} {a} {x} {y}", 0.04),
        ("", "{f} {a} {x} {y}", None),
        ("frame id x y\n", "{f} {a} {x} {y}", None),
        ("time id x y\n", "{t} {a} {x} {y}", 1e-6),
        ("time id x y\n", "{ms} {a} {x} {y}", 1e-3),
        ("timestamp id x y\n", "{ms}000 {a} {x} {y}", 1e-6),
        ("time_ns id x y\n", "{ms}000000 {a} {x} {y}", 1e-9),
        ("time id x y\n", "{f} {a} {x} {y}", None),  # whole numbers, one apart: frames
        ("frame time id x y\n", "{f} {t} {a} {x} {y}", 0.08),
        ("frame time id x y\n", "{f} {ms} {a} {x} {y}", 0.08),
        ("frame time id x y\n", "{f} 12:00 {a} {x} {y}", None),
        ("frame time id x y\n", "{f} 7 {a} {x} {y}", None),
    ):
        path.write_text(header + lines(form, table))
        assert seconds(path) == (expected and pytest.approx(expected)), header + form


def test_options_stand_above_what_a_file_says(tmp_path, capsys):
    path, table = tmp_path / "walks.txt", crowd()
    path.write_text(PEDPY + lines("{a} {f} {x} {y}", table))
    half = OwnFiles([str(path)], 0.04, "0,0,1").recordings("test")[0].tracks
    assert np.ptp(half.frame) == pytest.approx(np.ptp(table[:, 0]) * 0.04 / 0.4, abs=1)
    assert "0.04 s between frame numbers (--data.dt; it says 0.08)" in capsys.readouterr().err
    path.write_text("time,id,x,y\n" + lines("{t},{a},{x},{y}", table))
    read = [OwnFiles([str(path)], dt, "0,0,1").recordings("test")[0].tracks for dt in (None, 1.0, 0.08)]
    assert all(np.array_equal(one.xy, read[0].xy) for one in read)
    with pytest.raises(UserError, match=r"times in seconds, rows 0.08 s apart: leave out --data.dt 0.4"):
        OwnFiles([str(path)], 0.4, "0,0,1").recordings("test")
    path.write_text("frame,id,x,y\n" + lines("{f},{a},{x},{y}", table))
    with pytest.raises(UserError, match=r"--data.dt is None: give the seconds"):
        OwnFiles([str(path)], None, "0,0,1")


def test_a_homography_takes_the_numbers_of_the_file(tmp_path):
    table = crowd()
    for unit in ("cm", "px"):
        (tmp_path / f"{unit}.csv").write_text(
            f"time,id,x_{unit},y_{unit}\n" + lines("{t},{a},{x},{y}", table, 100)
        )
        np.savetxt(tmp_path / "H.txt", np.diag((0.01, 0.01, 1)))
        same(tmp_path / f"{unit}.csv", table, homography=str(tmp_path / "H.txt"))
    with pytest.raises(UserError, match=r"is in pixels: give --data.homography"):
        OwnFiles([str(tmp_path / "px.csv")], None, "0,0,1").recordings("test")


def test_footsteps_longer_than_a_step_are_walked_evenly(tmp_path):
    """A slow person of Vadere: one footstep of 1.6 s, a wait of 0.4 s, one of 2 s."""
    path = tmp_path / "postvis.traj"
    path.write_text(
        "pedestrianId simTime endTime-PID1 startX-PID1 startY-PID1 endX-PID1 endY-PID1\n"
        "7 0.0 1.6 0 0 0.8 0\n7 2.0 4.0 0.8 0 0.8 1.0\n"
    )
    tracks = OwnFiles([str(path)], None, "0,0,1").recordings("test")[0].tracks
    assert tracks.agent.tolist() == [7] * 11
    across, up = [0, 0.2, 0.4, 0.6, *[0.8] * 7], [*[0.0] * 6, 0.2, 0.4, 0.6, 0.8, 1.0]
    assert np.allclose(tracks.xy, np.stack((across, up), 1), atol=1e-6)
