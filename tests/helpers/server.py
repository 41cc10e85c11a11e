"""A web server on this machine that misbehaves on request: what downloads are tested against."""

import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from types import SimpleNamespace

import pytest
from huggingface_hub import constants, file_download


@dataclass
class Page:
    """What lies at an address, and how it is given.

    Attributes:
        content: The file.
        statuses: Answers of the first requests, before the file is given: ``[503, 503]``.
        headers: Sent with every answer.
        ranges: Whether parts are given to who asks for them.
        cuts: Bytes sent in answer to the first requests before the connection is closed on them.
        says_length: Whether the answer has a Content-Length.
        wait: Seconds before the first answer.
        drops: In how many pieces the file is sent.
        drip: Seconds after each of them.
    """

    content: bytes = b""
    statuses: list[int] = field(default_factory=list)
    headers: dict[str, str] = field(default_factory=dict)
    ranges: bool = True
    cuts: list[int] = field(default_factory=list)
    says_length: bool = True
    wait: float = 0.0
    drops: int = 1
    drip: float = 0.0


@dataclass
class Site:
    """A running server: its address, its pages by path, and what it was asked for."""

    url: str
    pages: dict[str, Page] = field(default_factory=dict)
    asked: list[tuple[str, dict[str, str]]] = field(default_factory=list)

    def put(self, path: str, page: Page | bytes) -> str:
        """Lay a file at a path; returns its whole address."""
        self.pages[path] = Page(page) if isinstance(page, bytes) else page
        return f"{self.url}/{path}"

    def ranges_asked(self) -> list[str | None]:
        """Return the Range header of every request so far."""
        return [headers.get("Range") for _, headers in self.asked]


def without_patience(patch: pytest.MonkeyPatch) -> None:
    """Let the client of downloads try again at once, and give up soon."""
    patch.setattr(file_download, "time", SimpleNamespace(sleep=lambda seconds: None))
    patch.setattr(constants, "HF_HUB_DOWNLOAD_TIMEOUT", 0.25)
    patch.setenv("NO_PROXY", "127.0.0.1")
    patch.delenv("PEDZOO_OFFLINE", raising=False)


@contextmanager
def serving() -> Iterator[Site]:
    """Run a server without pages on a free port of 127.0.0.1 while the block runs."""
    site = Site("")

    class Handler(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            path = self.path.lstrip("/").partition("?")[0]
            site.asked.append((path, dict(self.headers)))
            if path not in site.pages:
                self.send_error(404)
            else:
                _answer(self, site.pages[path])

        def log_message(self, format: str, *args: object) -> None:
            """Say nothing."""

    with ThreadingHTTPServer(("127.0.0.1", 0), Handler) as server:
        server.daemon_threads = True  # a slow answer need not be waited for
        site.url = f"http://127.0.0.1:{server.server_port}"
        thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.01})
        thread.start()
        try:
            yield site
        finally:
            server.shutdown()
            thread.join()


def _answer(handler: BaseHTTPRequestHandler, page: Page) -> None:
    time.sleep(page.wait)
    page.wait = 0.0
    if page.statuses:
        status, start = page.statuses.pop(0), 0
        body = b"" if status in (301, 302) else b"not now"
    else:
        wanted = handler.headers.get("Range", "") if page.ranges else ""
        start = int(wanted.removeprefix("bytes=").rstrip("-") or 0)
        status, body = (206 if wanted else 200), page.content[start:]
        if start >= len(page.content) and wanted:
            status, body = 416, b""
    handler.send_response(status)
    if status == 206:
        handler.send_header("Content-Range", f"bytes {start}-{len(page.content) - 1}/{len(page.content)}")
    if status == 416:
        handler.send_header("Content-Range", f"bytes */{len(page.content)}")
    if page.says_length:
        handler.send_header("Content-Length", str(len(body)))
    for name, value in page.headers.items():
        handler.send_header(name, value)
    handler.end_headers()
    if status in (200, 206) and page.cuts:
        body = body[: page.cuts.pop(0)]
    side = -(-len(body) // page.drops) or 1
    try:
        for first in range(0, len(body), side):
            handler.wfile.write(body[first : first + side])
            handler.wfile.flush()
            time.sleep(page.drip)
    except (BrokenPipeError, ConnectionResetError):
        pass  # the client has gone
