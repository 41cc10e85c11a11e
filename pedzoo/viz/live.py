"""People who walk now: in pybullet's window, or on a page that this machine serves to itself."""

from __future__ import annotations

import json
import os
import re
import sys
import time
from collections.abc import Callable
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from itertools import count, islice
from typing import Any

import numpy as np
import torch
from torchrl.envs.utils import step_mdp

from pedzoo.core.batch import ROBOT
from pedzoo.core.errors import UserError
from pedzoo.core.types import TRACE_SECONDS
from pedzoo.eval.packed_episodes import packed_episodes
from pedzoo.eval.rollout import Recorder, prepare
from pedzoo.maps.grid import boxes
from pedzoo.sim.drawing import as_array, headings_along, moved, scene_to_grid
from pedzoo.sim.env import PedestrianEnv
from pedzoo.sim.physics._pybullet import BulletLooks, Figure, disconnect
from pedzoo.viz.report import empty_content, page

HOST, HERE = "127.0.0.1", re.compile(r"(127\.0\.0\.1|\[::1\]|localhost)(:\d+)?", re.IGNORECASE)
"""Only this machine can ask: the address, and its names in requests, at any port, which may be a tunnel's."""

FINEST = 50
"""Pictures per second of the window, at most."""


def has_display() -> bool:
    """Return whether a window can be opened here."""
    return sys.platform in ("darwin", "win32") or bool(os.environ.get("DISPLAY"))


class Live:
    """One scene after the other, in real time; ``answer`` is the present episode as JSON."""

    def __init__(
        self, policy: str, scenario: str, physics: str = "compiled", seed: int = 0, speed: float = 1.0
    ) -> None:
        """Build policy and environment; errors as of `pedzoo.rollout`."""
        if not speed > 0:
            raise UserError(f"speed {speed}: expected more than 0, such as 1 for real time")
        self._policy, self.env = prepare(policy, scenario, physics, 1, seed)
        self.name, self.scenario, self._seed, self._speed = policy, scenario, seed, speed
        self.answer = b""

    @torch.no_grad()
    def walk(self, episodes: int | None = None, shown: Callable[[Recorder], None] | None = None) -> None:
        """Walk so many episodes, None for without end; ``shown`` is called after each decision."""
        for number in islice(count(), episodes):
            now = self.env.reset()
            recorder, due = Recorder(self.env), time.monotonic()
            while recorder.alive.any():
                result = self.env.step(self._policy(now))
                recorder.add(result["next"])
                due = max(due + self.env.decision_dt / self._speed, time.monotonic())
                if shown:
                    shown(recorder)
                else:
                    packed, plans = packed_episodes(recorder.rollout(), self.env.bank, 1, self._seed)
                    content = {"episode": packed[0] | {"episode": number}, "plans": plans, "over": False}
                    self.answer = json.dumps(content).encode()
                time.sleep(max(0.0, due - time.monotonic()))
                now = step_mdp(result)
        if not shown:
            self.answer = json.dumps(json.loads(self.answer) | {"over": True}).encode()

    def page(self) -> str:
        """Return the page that follows what happens."""
        first = json.loads(self.answer)
        case = {"name": self.scenario, "policies": [{"name": self.name, "episodes": [first["episode"]]}]}
        content = {"cases": [case], "plans": first["plans"], "about": f"live, seed {self._seed}"}
        return page(empty_content() | content, f"{self.name} in {self.scenario}", "/live")

    def server(self, port: int) -> ThreadingHTTPServer:
        """Return a server on this machine alone; 0 is any free port, `UserError` one that is taken."""
        live = self

        class Handler(BaseHTTPRequestHandler):
            def do_GET(self) -> None:
                kind, body, status, answer = "text/plain", b"not here", 404, live.answer
                if not all(HERE.fullmatch(host.strip()) for host in self.headers.get_all("Host", [""])):
                    # a page of another site, whose name leads to this machine
                    body, status = b"open the address that pedzoo view has printed", 403
                elif not answer:
                    body, status = b"the first people are about to start: load this again", 503
                elif self.path == "/":
                    kind, body, status = "text/html", live.page().encode(), 200
                elif self.path == "/live":
                    kind, body, status = "application/json", answer, 200
                self.send_response(status)
                self.send_header("Content-Type", f"{kind}; charset=utf-8")
                self.send_header("Content-Length", str(len(body)))
                self.send_header("Cache-Control", "no-store")
                self.end_headers()
                self.wfile.write(body)

            def log_message(self, format: str, *args: Any) -> None:
                return

        try:
            return ThreadingHTTPServer((HOST, port), Handler)
        except (OSError, OverflowError) as error:
            said = f"cannot serve on port {port}: {error}; take another one, --port 0 for any"
            raise UserError(said) from error


class BulletWindow:
    """pybullet's window of one floor plan; call it after every decision."""

    def __init__(self, env: PedestrianEnv, speed: float) -> None:
        """Open it when the first scene is there; errors as of `pedzoo.sim.physics.bullet`."""
        self._env, self._speed, self._plan = env, speed, -2
        self._looks: BulletLooks | None = None

    def __call__(self, recorder: Recorder) -> None:
        """Show the last decision in its own time."""
        state = self._env.state
        if (plan := int(state.map_id[0])) != self._plan:
            self._plan = plan
            self._open()
        assert self._looks is not None
        points = round(self._env.decision_dt / TRACE_SECONDS)
        frame = scene_to_grid(state.pose[0], self._env.bank.grid(plan))
        path = torch.from_numpy(moved(frame, as_array(state.past[0])))
        heading = headings_along(path)
        for at in range(-points, 0):
            figures = {
                agent: Figure(
                    *path[agent, at].tolist(),
                    radius=float(state.radius[0, agent]),
                    heading=float(heading[agent, at]),
                    robot=int(state.kind[0, agent]) == ROBOT,
                )
                for agent in state.mask[0].nonzero()[:, 0].tolist()
            }
            self._looks.place(figures)
            time.sleep(max(TRACE_SECONDS / self._speed, 1 / FINEST) if at < -1 else 0)

    def _open(self) -> None:
        """Open the window of another floor plan: it shows all of it, or all people where there is none."""
        if self._looks is not None:
            disconnect(self._looks.client)
        grid, state = self._env.bank.grid(self._plan), self._env.state
        walls = boxes(grid, self._env.scenario.unknown) if grid else np.zeros((0, 4))
        self._looks = BulletLooks(walls, window=True)
        corners = walls if len(walls) else as_array(state.past[0, state.mask[0]])
        corners = corners.reshape(-1, 2)
        self._looks.look_at(corners.min(0).tolist(), corners.max(0).tolist())
