"""Watching people who walk now: the served page follows them, and only this machine sees it."""

import json
import threading
import urllib.error
import urllib.request
from http.client import HTTPConnection

import numpy as np
import pytest

import pedzoo
from pedzoo.cli.main import main
from pedzoo.core.errors import UserError
from pedzoo.viz.live import HOST, Live


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


def test_without_a_display_the_command_says_so(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
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
