"""``pedzoo view``: watch people walk, in a window or in a browser."""

HELP = "watch people walk now: pybullet's window, or a page on this machine"
EXAMPLE = "pedzoo view door sgan_goal_map.indoor --serve"


def run(argv: list[str]) -> int:
    """Walk until it is interrupted; returns the exit code."""
    from pedzoo.cli.arguments import Arguments

    parser = Arguments("view", HELP, EXAMPLE)
    parser.add_argument("scenario", help="its name with settings: door:width=0.9")
    parser.add_argument("policy", help="orca:radius=0.3, or any model, or a mixed crowd")
    parser.add_argument("--serve", action="store_true", help="serve the page, even where there is a display")
    parser.add_argument(
        "--port", type=int, default=8010, help="of the page on 127.0.0.1 (default: 8010; 0: any)"
    )
    parser.add_argument("--episodes", type=int, help="end after so many (default: go on)")
    parser.add_argument("--seed", type=int, default=0, help="of the scenes (default: 0)")
    parser.add_argument("--speed", type=float, default=1.0, help="of time (default: 1)")
    parser.add_argument("--physics", default="compiled", help="default: compiled")
    options = parser.parse_args(argv)

    from importlib.util import find_spec

    from pedzoo.core.errors import at_least_one
    from pedzoo.viz.live import HOST, BulletWindow, Live, has_display

    if options.episodes is not None:
        at_least_one("--episodes", options.episodes)
    window = not options.serve and has_display() and find_spec("pybullet") is not None
    if not window and not options.serve:
        why = "pybullet is not installed" if has_display() else "there is no display (DISPLAY is not set)"
        print(f"no window: {why}; here is the page instead (--serve)")
    live = Live(options.policy, options.scenario, options.physics, options.seed, options.speed)
    if window:
        live.walk(options.episodes, BulletWindow(live.env, options.speed))
        return 0

    from threading import Thread

    server = live.server(options.port)
    Thread(target=server.serve_forever, daemon=True).start()
    print(f"open http://{HOST}:{server.server_address[1]}/ in a browser; Ctrl-C ends it", flush=True)
    try:
        live.walk(options.episodes)
    finally:
        server.shutdown()
        server.server_close()
        live.env.physics.close()
    return 0
