"""``pedzoo rollout`` and ``view``: policies walk through scenes, and one can look at it."""

from typing import Literal

from pedzoo.cli.output import check_outputs, print_report, progress_bar, write_and_print
from pedzoo.cli.parsing import command
from pedzoo.core.errors import UserError, at_least_one, installed, need
from pedzoo.core.machine import usual_physics, versions
from pedzoo.core.registry import METRICS


@command("pedzoo rollout orca:radius=0.1 sgan_goal_map.zara1 --plot door.png --html door.html")
def rollout(
    policies: list[str],
    /,
    scenario: str = "door",
    physics: str | None = None,
    episodes: int = 20,
    seed: int = 0,
    deterministic: bool = False,
    warm_start: Literal["orca", "igibson", "static", "recorded"] = "orca",
    clearance: float = 0.25,
    planner: Literal["shortest", "astar"] = "shortest",
    decision_dt: float | None = None,
    device: str = "cpu",
    keep_episodes: int = 0,
    deadline: float | None = None,
    metrics: list[str] | None = None,
    json: str | None = None,
    plot: str | None = None,
    video: str | None = None,
    html: str | None = None,
    video_view: Literal["perspective", "top"] = "perspective",
    video_seconds: float | None = None,
    show: int = 0,
) -> int:
    """Policies walk through the same scenes: table, trajectories, video.

    Args:
        policies: orca:radius=0.3, go_to_goal, or any model, one row each; or mixed:
            orca:share=0.5+approach_net_goal.indoor.
        scenario: Its name, mine.yaml or file.py:Class, with settings: door:width=0.9,people=4,
            hallway:width=[1.5,2.5] (one per scene), goals:map=apartment.7 (or a file; if its path has commas,
            in quotes: "goals:map='/a,b/plan.yaml'"). pedzoo --help lists all.
        physics: ``compiled`` (the fastest), ``torch``, ``bullet`` or ``file.py:Class``; by default what
            the variable PEDZOO_PHYSICS says, or bullet, or compiled where there is no pybullet.
        episodes: Scenes per policy.
        seed: Of the scenes, the same for all policies.
        deterministic: Models walk with noise zero.
        warm_start: The first 2.8 s, which are not counted: ``igibson`` is its ORCA, in the physics asked for.
        clearance: Metres that planned ways keep from walls.
        planner: Ways that are as short as can be, or those of A* on the grid of open cells.
        decision_dt: Seconds; refused unless it is the policies' own.
        device: Where scenes and models are, such as ``cuda``.
        keep_episodes: So many episodes keep their positions in the report, for ``pedzoo report``.
        deadline: Seconds that people have for every goal; by default four times as many as their way takes
            freely, at least 20.
        metrics: Print these alone, as success,time_ratio; the report has all. Of your own, as mine.py:f: a
            function of a rollout that returns two sums per episode.
        json: Also write the report to this file.
        plot: Draw trajectories into this .png, .pdf or .svg.
        video: Film an episode into this .webm or .mp4.
        html: Replays of all episodes as a page: .html.
        video_view: Where the camera is; only bullet has a perspective.
        video_seconds: Film so many seconds at most.
        show: Number of the episode in plot and video.
    """
    check_outputs(json=json, plot=plot, video=video, html=html)
    for option, file in (("--plot", plot), ("--video", video)):
        if file:
            need("video", option)
    from pedzoo.eval.comparison import Comparison

    metrics = metrics or []
    only = [METRICS.get(name).__name__ for name in metrics]
    if not 0 <= show < max(episodes, 1):
        raise UserError(f"--show {show}: expected 0 to {episodes - 1}, see --episodes")
    if video_seconds is not None and not video_seconds > 0:
        raise UserError(f"--video_seconds {video_seconds}: expected a number > 0")
    walking = {"physics": physics, "episodes": episodes, "seed": seed, "deterministic": deterministic}
    walking |= {"warm_start": warm_start, "clearance": clearance, "decision_dt": decision_dt}
    walking |= {"planner": planner}
    walking |= {"device": device, "keep_episodes": keep_episodes, "deadline": deadline, "metrics": metrics}
    with Comparison(policies, scenario, **walking) as comparison:

        def tell(**more: bool) -> None:
            report = {"command": "rollout", **comparison.report(), "versions": versions(), **more}
            shown = None if comparison.refusal else only
            write_and_print(report, json, lambda: print_report(report, shown))

        try:
            with progress_bar() as progress:
                comparison.run(progress)
        except KeyboardInterrupt:
            if comparison.walked:
                print("interrupted: only what was over by then")
                tell(interrupted=True)
            raise
        tell()
        if plot:
            from pedzoo.viz.trajectories import plot_rollouts

            plot_rollouts(comparison.walked, plot, show)
            print(f"plot:  {plot}")
        if video:
            from pedzoo.viz.video import film

            with progress_bar() as progress:
                size = (640, 480) if len(policies) == 1 else (480, 360)
                film(comparison.walked, video, show, video_view, size, video_seconds, progress)
            print(f"video: {video}")
        if html:
            from pedzoo.viz.episodes import Replay

            Replay(comparison.walked, scenario, seed).save(html)
            print(f"page:  {html}")
        if comparison.refusal:
            raise comparison.refusal
    return 0


@command("pedzoo view door approach_net_goal_map.indoor --serve")
def view(
    scenario: str,
    policy: str,
    /,
    serve: bool = False,
    port: int = 8010,
    episodes: int | None = None,
    seed: int = 0,
    speed: float = 1.0,
    physics: str | None = None,
) -> int:
    """Watch people walk now: pybullet's window, or a page on this machine.

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
    from threading import Thread

    from pedzoo.viz.live import HOST, BulletWindow, Live, has_display

    if episodes is not None:
        at_least_one("--episodes", episodes)
    window = not serve and has_display() and installed("pybullet")
    if not window and not serve:
        why = "pybullet is not installed" if has_display() else "there is no display (DISPLAY is not set)"
        print(f"no window: {why}; here is the page instead (--serve)")
    live = Live(policy, scenario, physics or usual_physics(fast=True), seed, speed)
    if window:
        live.walk(episodes, BulletWindow(live.env, speed))
        return 0
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
