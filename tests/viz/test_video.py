"""Videos can be read frame by frame, and people who walk now can be watched on this machine."""

import json
import threading
import urllib.error
import urllib.request
from collections.abc import Iterator
from dataclasses import replace
from http.client import HTTPConnection
from pathlib import Path

import cv2
import numpy as np
import pytest
from PIL import Image as Pillow

import pedzoo
from pedzoo.cli.main import main
from pedzoo.core.errors import UserError
from pedzoo.eval.comparison import PolicyRollout
from pedzoo.eval.robots import robot_rollout
from pedzoo.eval.rollout import rollout
from pedzoo.sim.drawing import person_color
from pedzoo.viz.live import HOST, Live
from pedzoo.viz.video import GAP, HEADER, Image, film, film_robots, read_video, write_video

SIZE = (160, 120)


@pytest.fixture(scope="module")
def walked() -> PolicyRollout:
    return PolicyRollout("go_to_goal", *rollout("go_to_goal", "door", "compiled", 2))


def colors(count: int, size: tuple[int, int] = SIZE) -> Iterator[Image]:
    """Yield frames that become redder."""
    for i in range(count):
        yield np.full((size[1], size[0], 3), (20 * i, 40, 60), dtype=np.uint8)


def frames_of(path: Path) -> list[Image]:
    video, result = cv2.VideoCapture(str(path)), []
    while True:
        there, frame = video.read()
        if not there:
            return result
        result.append(frame[..., ::-1])


@pytest.mark.parametrize("suffix", [".mp4", ".WEBM"])
def test_round_trip(tmp_path, suffix: str, capfd) -> None:
    path = tmp_path / "new" / f"colors{suffix}"
    write_video(path, colors(9), 10)
    assert read_video(path) == (9, SIZE)
    assert cv2.VideoCapture(str(path)).get(cv2.CAP_PROP_FPS) == pytest.approx(10)
    for read, written in zip(frames_of(path), colors(9), strict=True):
        assert np.abs(read.astype(int) - written).mean() < 4  # RGB in, RGB out
    assert list(path.parent.iterdir()) == [path]
    assert capfd.readouterr().err == ""


def test_interrupted_or_failed_writing_leaves_the_old_file(tmp_path) -> None:
    path = tmp_path / "a.webm"
    write_video(path, colors(3), 10)
    before = path.read_bytes()

    def interrupted() -> Iterator[Image]:
        yield from colors(2)
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        write_video(path, interrupted(), 10)
    # OpenCV drops a frame of another size without a word
    with pytest.raises(UserError, match="4 frames of"):
        write_video(path, [*colors(3), *colors(1, (80, 60))], 10)
    with pytest.raises(UserError, match="at least one frame"):
        write_video(path, [], 10)
    assert path.read_bytes() == before and list(tmp_path.iterdir()) == [path]


def test_what_cannot_be_written_is_refused(walked: PolicyRollout, tmp_path) -> None:
    (tmp_path / "file").write_text("")
    for path, message in (("a.avi", r"\.webm or \.mp4"), ("file/a.webm", "cannot write")):
        with pytest.raises(UserError, match=message):
            write_video(tmp_path / path, colors(1), 10)
    with pytest.raises(UserError, match="episode 2: go_to_goal has walked 2, 0 to 1"):
        film([walked], tmp_path / "a.webm", 2)


def test_film_shows_every_tenth_of_a_second_until_the_end(walked: PolicyRollout, tmp_path) -> None:
    present, seen = walked.rollout.present.clone(), []
    present[:, :, 10:] = False
    shorter = PolicyRollout("half", replace(walked.rollout, present=present), walked.env)
    film([walked, shorter], tmp_path / "a.webm", 1, "top", SIZE, progress=lambda *step: seen.append(step))
    frames = frames_of(tmp_path / "a.webm")
    count = int(walked.rollout.length[1]) + 1
    assert len(frames) == count and seen[-1] == ("video", count, count)
    assert frames[0].shape == (SIZE[1] + HEADER, 2 * (SIZE[0] + GAP), 3)
    left, right = np.split(np.stack(frames).astype(int), 2, axis=2)
    assert np.abs(right[-1] - right[12]).mean() < 2 < np.abs(right[12] - right[0]).mean() + 2
    assert np.abs(left[-1] - left[12]).mean() > 1


def test_film_puts_people_where_they_are(walked: PolicyRollout, tmp_path) -> None:
    film([walked], tmp_path / "a.webm", 0, "top", (320, 240), seconds=1.0)
    frames = frames_of(tmp_path / "a.webm")
    assert len(frames) == 11
    for person, to_the_left in ((0, True), (1, False)):
        near = np.abs(frames[0][HEADER:, :320].astype(int) - person_color(person)).sum(-1) < 90
        assert near.any() and (np.nonzero(near)[1].mean() < 160) == to_the_left


def test_command_films_the_bullet_world(tmp_path, capfd) -> None:
    pytest.importorskip("pybullet")
    video, plot = tmp_path / "door.mp4", tmp_path / "door.png"
    words = "rollout go_to_goal --scenario door:speed=3,speed_std=0 --episodes 1"
    assert main([*words.split(), "--video", str(video), "--plot", str(plot)]) == 0
    printed = capfd.readouterr()
    assert str(video) in printed.out and str(plot) in printed.out
    # pybullet greets when it is first imported
    assert [line for line in printed.err.splitlines() if "pybullet build" not in line] == []
    count, size = read_video(video)
    assert 15 < count < 30 and size == (640 + GAP, 480 + HEADER)
    assert plot.read_bytes().startswith(b"\x89PNG")


def test_the_film_of_a_robot_is_in_real_time(tmp_path: Path) -> None:
    driven = robot_rollout("straight", "goals:map=flat,people=2,goals=1,pool=8", people="orca", episodes=1)
    film_robots(*driven, tmp_path / "a.gif", "straight", size=SIZE, seconds=1.0)
    with Pillow.open(tmp_path / "a.gif") as picture:
        assert (getattr(picture, "n_frames", 1), picture.size) == (11, (SIZE[0], SIZE[1] + HEADER))
        assert picture.info["duration"] == 100
    for name, episode, message in (("a.gif", 1, "walked 1, 0 to 0"), ("a.png", 0, "ends in")):
        with pytest.raises(UserError, match=message):
            film_robots(*driven, tmp_path / name, episode=episode)


# Watching people who walk now


def test_the_page_and_what_happens_are_served() -> None:
    live = Live("go_to_goal", "door", speed=1000.0)
    server = live.server(0)
    threading.Thread(target=server.serve_forever, daemon=True).start()
    host, port = server.server_address[:2]
    address = f"http://{HOST}:{port}"
    try:
        with pytest.raises(urllib.error.HTTPError, match="503"):
            urllib.request.urlopen(f"{address}/")
        live.walk(1)
        answer = json.load(urllib.request.urlopen(f"{address}/live"))
        assert answer["over"] and answer["episode"]["values"]["success"] == 1
        assert answer["episode"]["plan"] in answer["plans"]
        text = urllib.request.urlopen(f"{address}/").read().decode()
        assert "connect-src &#x27;self&#x27;" in text and '"live":"/live"' in text
        with pytest.raises(urllib.error.HTTPError, match="404"):
            urllib.request.urlopen(f"{address}/../etc/passwd")
        here = [f"127.0.0.1:{port}", f"LocalHost:{port}", "localhost:9000", "[::1]"]
        elsewhere = [f"evil.example:{port}", "", "localhost.evil.example", "127.0.0.1.nip.io"]
        elsewhere += ["evil.example#localhost", "localhost@evil.example", "0.0.0.0", "[::1"]
        asked = [([name], 200) for name in here] + [([name], 403) for name in elsewhere]
        for names, status in [*asked, ([], 403), (["localhost", "evil.example"], 403)]:
            for path in ("/", "/live"):
                connection = HTTPConnection(HOST, int(port))
                connection.putrequest("GET", path, skip_host=True)
                for name in names:
                    connection.putheader("Host", name)
                connection.endheaders()
                answer = connection.getresponse()
                assert answer.status == status, names
                assert (b"episode" in answer.read()) == (status == 200)
                connection.close()
        with pytest.raises(UserError, match="cannot serve on port"):
            live.server(int(port))
    finally:
        server.shutdown()
        server.server_close()
    assert host == "127.0.0.1"


def test_without_a_display_the_command_says_so(capsys, monkeypatch) -> None:
    monkeypatch.delenv("DISPLAY", raising=False)
    given = ["--port", "0", "--episodes", "1", "--speed", "1000"]
    assert main(["view", "door", "go_to_goal", *given]) == 0
    printed = capsys.readouterr().out.splitlines()
    assert printed[0].startswith("no window: there is no display") and "http://127.0.0.1:" in printed[1]
    assert main(["view", "door", "go_to_goal", "--speed", "0"]) == 2


def test_render_shows_people_and_goals_from_above() -> None:
    env = pedzoo.make_env("door", physics="compiled", num_envs=2)
    env.reset()
    picture = env.render(1, (320, 240))
    assert picture.shape == (240, 320, 3) and picture.dtype == np.uint8
    assert len(np.unique(picture.reshape(-1, 3), axis=0)) > 4  # floor, walls, two people
    with pytest.raises(UserError, match="scene 2: expected 0 to 1"):
        env.render(2)
    for size in ((0, 80), (80.5, 80), None):
        with pytest.raises(UserError, match="expected width and height in pixels, such as"):
            env.render(1, size)  # type: ignore[arg-type]
