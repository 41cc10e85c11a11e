"""``pedzoo view``: watch people walk, in a window or in a browser."""

HELP = "watch people walk now: pybullet's window, or a page on this machine"
EXAMPLE = "pedzoo view door sgan_goal_map.indoor --serve"


def run(
    scenario: str,
    policy: str,
    /,
    serve: bool = False,
    port: int = 8010,
    episodes: int | None = None,
    seed: int = 0,
    speed: float = 1.0,
    physics: str = "compiled",
) -> int:
    """Walk until it is interrupted.

    Args:
        scenario: Its name with settings: door:width=0.9.
        policy: orca:radius=0.3, or any model, or a mixed crowd.
        serve: Serve the page, even where there is a display.
        port: Of the page on 127.0.0.1; 0 for any.
        episodes: End after so many; by default go on.
        seed: Of the scenes.
        speed: Of time.
        physics: In which people walk.
    """
    from importlib.util import find_spec

    from pedzoo.core.errors import at_least_one
    from pedzoo.viz.live import HOST, BulletWindow, Live, has_display

    if episodes is not None:
        at_least_one("--episodes", episodes)
    window = not serve and has_display() and find_spec("pybullet") is not None
    if not window and not serve:
        why = "pybullet is not installed" if has_display() else "there is no display (DISPLAY is not set)"
        print(f"no window: {why}; here is the page instead (--serve)")
    live = Live(policy, scenario, physics, seed, speed)
    if window:
        live.walk(episodes, BulletWindow(live.env, speed))
        return 0

    from threading import Thread

    server = live.server(port)
    Thread(target=server.serve_forever, daemon=True).start()
    print(f"open http://{HOST}:{server.server_address[1]}/ in a browser; Ctrl-C ends it", flush=True)
    try:
        live.walk(episodes)
    finally:
        server.shutdown()
        server.server_close()
        live.env.physics.close()
    return 0
