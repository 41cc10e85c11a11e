"""``pedzoo score``: how near simulated crowds are to a recorded one."""

from pedzoo.cli.output import check_outputs, print_tables, write_and_print
from pedzoo.core.machine import versions

HELP = "how near any simulator's people are to recorded ones, one JSON"
EXAMPLE = "pedzoo score mine.csv sgan_goal_map.indoor --against zara1 --json score.json"


def run(
    crowds: list[str],
    /,
    *,
    against: str,
    data_dt: float | None = None,
    data_map: str | None = None,
    data_homography: str | None = None,
    data_root: str | None = None,
    rollouts: int = 3,
    seed: int = 0,
    dt: float | None = None,
    physics: str = "compiled",
    likelihood: bool = True,
    stops: bool = False,
    opening: list[float] | None = None,
    json: str | None = None,
) -> int:
    """Score, print the table and write the report.

    Args:
        crowds: Files of walks (.csv, .txt: frame, agent, x, y), and policies: orca:radius=0.3, or any model.
        against: The recorded crowd: zara1, another fold, or a file.
        data_dt: Seconds per frame number of that file.
        data_map: Its floor plan; by default no walls.
        data_homography: Its 3x3 matrix from positions to world metres.
        data_root: Recordings; by default PEDZOO_DATA.
        rollouts: Of policies with noise.
        seed: Of the policies' noise.
        dt: Seconds between consecutive frame numbers in the files of walks; by default what they say, or rows
            that are 0.4 s apart.
        physics: In which policies walk.
        likelihood: Also walk the joint rollouts of 8 s; see docs/score.md.
        stops: People whom policies move have the places where the recorded ones stood for 2 s or more as
            goals, and stay there as long. In the joint rollouts of 8 s they have their exits alone.
        opening: A door: x,y of its centre, x,y of its wall's normal, clear width, for flow and headways.
        json: Also write the report to this file.
    """
    from pedzoo.cli.progress import progress_bar
    from pedzoo.eval.scoring.score import Reference, pages, score

    check_outputs(json=json)
    recorded = Reference(against, data_dt, data_map, data_homography, data_root)
    settings = {"rollouts": rollouts, "seed": seed, "dt": dt, "physics": physics}
    settings |= {"likelihood": likelihood, "stops": stops, "opening": opening or ()}
    with progress_bar() as progress:
        report = score(crowds, recorded, progress=progress, **settings)
    report = {"command": "score", **report, "versions": versions()}

    def show() -> None:
        for note in report["notes"]:
            print(f"note: {note}")
        print_tables(pages(report))

    write_and_print(report, json, show)
    return 0
