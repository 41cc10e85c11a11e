"""Downloads, from a server on this machine that breaks off, lies and dawdles."""

import hashlib
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest
from helpers.server import Page, Site, serving, without_patience

from pedzoo.core import fetch as fetching
from pedzoo.core.errors import UserError
from pedzoo.core.fetch import fetch
from pedzoo.core.paths import PARTS, atomic_write, write_atomically

CONTENT = bytes(range(256)) * 1000
SUM = hashlib.sha256(CONTENT).hexdigest()
REFUSED = "http://127.0.0.1:9/file.bin"


@pytest.fixture
def site(tmp_path, monkeypatch) -> Iterator[Site]:
    """A server, an empty cache, and a client without patience."""
    monkeypatch.setenv("PEDZOO_HOME", str(tmp_path / "cache"))
    without_patience(monkeypatch)
    with serving() as result:
        yield result


@pytest.fixture
def place(tmp_path) -> Path:
    return tmp_path / "cache" / "file.bin"


def part_of(place: Path) -> Path:
    return place.with_name(".file.bin.part")


def test_a_file_is_downloaded_once_and_again_where_it_is_damaged(site: Site, tmp_path) -> None:
    url = site.put("file.bin", CONTENT)
    for number, checksum in enumerate((SUM, None), start=1):
        path = fetch(url, checksum, f"models{number}/file.bin")
        assert path == tmp_path / "cache" / f"models{number}" / "file.bin"
        assert path.read_bytes() == CONTENT
        assert fetch(url, checksum, f"models{number}/file.bin") == path
        assert len(site.asked) == number and [file.name for file in path.parent.iterdir()] == ["file.bin"]
    path.write_bytes(b"damaged")
    assert fetch(url, SUM, "models2/file.bin", folder=tmp_path / "cache") == path
    assert path.read_bytes() == CONTENT


@pytest.mark.parametrize("content", [b"other", CONTENT[:-1] + b"\0"])
@pytest.mark.parametrize("size", [None, len(CONTENT)])
def test_a_wrong_file_leaves_nothing(site: Site, place: Path, content: bytes, size: int | None) -> None:
    url = site.put("file.bin", content)
    expected = "has 5 bytes, expected 256000" if size == 256000 and len(content) == 5 else "expected content"
    with pytest.raises(UserError, match=expected):
        fetch(url, SUM, "file.bin", size=size)
    assert not list(place.parent.glob("*file*"))
    assert len(site.asked) == 1, "the same wrong file would come again"
    endless = site.put("endless.bin", Page(CONTENT * 20, says_length=False))
    with pytest.raises(UserError, match="has more than 256000 bytes"):
        fetch(endless, SUM, "file.bin", size=len(CONTENT))
    assert not place.exists()


def test_errors_say_what_each_mirror_did_and_what_to_do(site: Site, place: Path) -> None:
    lying = site.put("lies.bin", b"other")
    with pytest.raises(UserError, match=r"cannot download file\.bin") as caught:
        fetch([f"{site.url}/none.bin", REFUSED, lying], SUM, "file.bin", "or give weights=...")
    said, digest = str(caught.value), hashlib.sha256(b"other").hexdigest()
    for part in (f"{site.url}/none.bin: 404 Not Found; ", "Connection refused; "):
        assert part in said
    assert f"{lying}: does not have the expected content: sha256 {digest}" in said
    assert said.endswith(f"save it as {place} or give weights=...") and not place.exists()
    assert [path for path, _ in site.asked] == ["none.bin", "lies.bin"], "a 404 is not asked for twice"


@pytest.mark.parametrize("page", [None, Page(b"wrong"), Page(CONTENT, statuses=[500] * 9)])
def test_the_next_mirror_serves(site: Site, page: Page | None) -> None:
    if page:
        site.put("dead.bin", page)
    urls = [f"{site.url}/dead.bin", site.put("file.bin", CONTENT)]
    assert fetch(urls, SUM, "file.bin", size=len(CONTENT)).read_bytes() == CONTENT


def test_a_broken_download_goes_on_where_it_was(site: Site) -> None:
    url = site.put("file.bin", Page(CONTENT, cuts=[81_920, 40_960, 8192]))
    assert fetch(url, SUM, "file.bin", size=len(CONTENT)).read_bytes() == CONTENT
    starts = [0, 81_920, 122_880, 131_072]
    assert site.ranges_asked() == [f"bytes={start}-" if start else None for start in starts]
    url = site.put("whole.bin", Page(CONTENT, cuts=[100_000, 100_000], ranges=False))
    assert fetch(url, SUM, "whole.bin", size=len(CONTENT)).read_bytes() == CONTENT
    assert len(site.asked) == 4 + 3, "it begins anew without ranges"


def test_what_one_mirror_began_another_ends(site: Site) -> None:
    first = site.put("first.bin", Page(CONTENT, cuts=[81_920] + [0] * 6))
    urls = [first, site.put("second.bin", CONTENT)]
    assert fetch(urls, SUM, "file.bin").read_bytes() == CONTENT
    assert site.asked[-1][0] == "second.bin"
    assert site.ranges_asked()[-1] == "bytes=81920-"


@pytest.mark.parametrize("left", [b"of another file", CONTENT + b"too long", CONTENT])
def test_what_an_earlier_call_left_is_used_or_thrown_away(site: Site, place: Path, left: bytes) -> None:
    place.parent.mkdir()
    part_of(place).write_bytes(left)
    assert fetch(site.put("file.bin", CONTENT), SUM, "file.bin").read_bytes() == CONTENT
    assert not part_of(place).exists()


def test_without_a_sum_nothing_is_pieced_together(site: Site, place: Path) -> None:
    place.parent.mkdir()
    part_of(place).write_bytes(b"of another version")
    url = site.put("file.bin", Page(CONTENT, cuts=[1000]))
    assert fetch(url, None, "file.bin").read_bytes() == CONTENT
    assert site.ranges_asked()[0] is None


def test_a_silent_server_is_given_up_and_a_slow_one_waited_for(site: Site) -> None:
    slow = site.put("slow.bin", Page(CONTENT, drops=4, drip=0.1))
    assert fetch(slow, SUM, "slow.bin").read_bytes() == CONTENT
    silent = site.put("silent.bin", Page(CONTENT, wait=0.5))
    assert fetch(silent, SUM, "again.bin").read_bytes() == CONTENT, "the second try is answered"


def test_redirections_lead_to_the_web_only(site: Site, tmp_path) -> None:
    secret = tmp_path / "secret.bin"
    secret.write_bytes(CONTENT)
    moved = Page(statuses=[302] * 9, headers={"Location": site.put("file.bin", CONTENT)})
    assert fetch(site.put("moved.bin", moved), SUM, "file.bin").read_bytes() == CONTENT
    for goal in (f"file://{secret}", "ftp://127.0.0.1/file.bin"):
        url = site.put("out.bin", Page(statuses=[302] * 9, headers={"Location": goal}))
        with pytest.raises(UserError, match="unsupported protocol"):
            fetch(url, None, "out.bin")


@pytest.mark.parametrize(
    "url", ["file:///etc/hosts", "http://[bad/x", "http://", "http://\n/x", "nonsense", ""]
)
def test_odd_addresses_are_refused(site: Site, url: str) -> None:
    with pytest.raises(UserError, match=r"cannot download out\.bin: "):
        fetch(url, None, "out.bin")


def test_a_token_stays_with_its_host(site: Site) -> None:
    with serving() as other:
        goal = other.put("file.bin", CONTENT).replace("127.0.0.1", "localhost")
        url = site.put("moved.bin", Page(statuses=[302], headers={"Location": goal}))
        fetch(url, SUM, "file.bin", token="secret")
        assert site.asked[0][1]["Authorization"] == "Bearer secret"
        assert "Authorization" not in other.asked[0][1]


@pytest.mark.parametrize(
    "name", ["../out.bin", "a/../../out.bin", "/etc/out.bin", "..\\out.bin", "C:\\out.bin", "", "..", "a\0b"]
)
def test_names_do_not_lead_out_of_the_cache(site: Site, name: str) -> None:
    with pytest.raises(UserError, match="may lead out of"):
        fetch(site.put("file.bin", CONTENT), SUM, name)
    assert not site.asked


def test_offline_nothing_is_asked(site: Site, place: Path, monkeypatch) -> None:
    url = site.put("file.bin", CONTENT)
    monkeypatch.setenv("PEDZOO_OFFLINE", "1")
    with pytest.raises(UserError, match="is not there, and PEDZOO_OFFLINE forbids the network") as caught:
        fetch(url, SUM, "file.bin", "or give weights=...")
    assert f"save it as {place} or give weights=... (from {url})" in str(caught.value)
    place.parent.mkdir(exist_ok=True)
    place.write_bytes(b"other")
    with pytest.raises(UserError, match="has other content than expected, and PEDZOO_OFFLINE"):
        fetch(url, SUM, "file.bin")
    place.write_bytes(CONTENT)
    assert fetch(url, SUM, "file.bin") == place
    assert not site.asked
    monkeypatch.setenv("PEDZOO_OFFLINE", "0")
    assert not fetching.offline()


def test_a_cache_that_cannot_be_written_is_named(site, tmp_path, monkeypatch):
    (tmp_path / "file").write_bytes(b"")
    monkeypatch.setenv("PEDZOO_HOME", str(tmp_path / "file"))
    with pytest.raises(UserError, match=r"cannot write .*file\.bin: "):
        fetch(site.put("file.bin", CONTENT), SUM, "file.bin")


def start_fetch(url: str) -> subprocess.Popen[str]:
    """Run `fetch` in a process of its own."""
    code = f"from pedzoo.core.fetch import fetch; print(fetch({url!r}, {SUM!r}, 'file.bin'))"
    return subprocess.Popen(
        [sys.executable, "-c", code], text=True, stdout=subprocess.PIPE, stderr=subprocess.PIPE
    )


def wait_until(happens: Callable[[], bool]) -> None:
    end = time.monotonic() + 20
    while not happens():
        assert time.monotonic() < end
        time.sleep(0.01)


def test_threads_and_processes_download_once(site: Site, place: Path) -> None:
    url = site.put("file.bin", Page(CONTENT, drops=8, drip=0.25))
    both = [start_fetch(url), start_fetch(url)]
    with ThreadPoolExecutor(3) as pool:
        assert list(pool.map(lambda _: fetch(url, SUM, "file.bin"), range(3))) == [place] * 3
    for process in both:
        out, err = process.communicate(timeout=30)
        assert process.returncode == 0 and out.strip() == str(place), err
    # what a slow machine missed is asked for as a range
    assert site.ranges_asked().count(None) == 1 and place.read_bytes() == CONTENT


def test_an_interrupted_download_is_continued_by_the_next(site: Site, place: Path) -> None:
    url = site.put("file.bin", page := Page(CONTENT, drops=2, drip=15))
    process = start_fetch(url)
    wait_until(lambda: part_of(place).exists() and part_of(place).stat().st_size > 0)
    os.kill(process.pid, signal.SIGINT)
    _, err = process.communicate(timeout=30)
    assert "KeyboardInterrupt" in err and not place.exists()
    stored = part_of(place).stat().st_size
    assert 0 < stored <= len(CONTENT) // 2
    page.drip = 0.0
    assert fetch(url, SUM, "file.bin").read_bytes() == CONTENT
    assert site.ranges_asked() == [None, f"bytes={stored}-"]


def test_servers_get_nothing_of_the_users(site, tmp_path, monkeypatch):
    """Not at the first address, not where it leads to, and with a token of another host neither."""
    netrc = tmp_path / "netrc"
    netrc.write_text("".join(f"machine {host} login me password p\n" for host in ("127.0.0.1", "localhost")))
    netrc.write_text(netrc.read_text() + "default login me password p\n")
    netrc.chmod(0o600)
    monkeypatch.setenv("NETRC", str(netrc))
    with serving() as other:
        for number, (start, goal) in enumerate(((site, site), (site, other), (other, site))):
            for host in ("127.0.0.1", "localhost"):
                goal_url = goal.put("file.bin", CONTENT).replace("127.0.0.1", host)
                moved = Page(statuses=[302], headers={"Location": goal_url, "Set-Cookie": "a=b"})
                url = start.put("moved.bin", moved)
                assert fetch(goal_url, SUM, f"{number}{host}.bin").read_bytes() == CONTENT
                assert fetch(url, SUM, f"{number}{host}-moved.bin").read_bytes() == CONTENT
        told = [name for one in (site, other) for _, headers in one.asked for name in headers]
        assert len(site.asked) + len(other.asked) == 18
    assert not {"authorization", "proxy-authorization"} & {name.lower() for name in told}


def test_links_of_others_are_not_followed(site: Site, tmp_path) -> None:
    """The names of unfinished downloads are known to all, those of unfinished files to nobody."""
    precious = tmp_path / "precious"
    folder = tmp_path / "cache"
    folder.mkdir()
    url = site.put("file.bin", Page(CONTENT, cuts=[1000]))
    for content in (b"mine", b""):
        precious.write_bytes(content)
        part_of(folder / "file.bin").symlink_to(precious)
        assert fetch(url, SUM, "file.bin").read_bytes() == CONTENT
        assert precious.read_bytes() == content and not (folder / "file.bin").is_symlink()
        (folder / "file.bin").unlink()
    names = set()
    for _ in range(20):
        with atomic_write(folder / "a.json") as part:
            assert part.is_file() and not part.is_symlink() and part.match(PARTS) and part.suffix == ".json"
            names.add(part.name)
            part.write_bytes(b"new")
        write_atomically(folder / "b.json", b"new")
    assert len(names) == 20 and str(os.getpid()) not in "".join(names)
    assert (folder / "a.json").stat().st_mode == (folder / "b.json").stat().st_mode
    (folder / "plain").write_bytes(b"")
    assert (folder / "a.json").stat().st_mode == (folder / "plain").stat().st_mode
    assert sorted(path.name for path in folder.iterdir() if path.name.startswith(".")) == []
