"""Build docs/ and the Python API as a site: python tools/pages/site.

The pages are copied beside what they link to, as they lie in the checkout, so that every link holds on a
code host and on the site. Warnings are errors. The result is ``build/site/index.html``.
"""

import os
import shutil
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[3]
PAGES = ROOT / "build" / "site_pages"
COPIED = (
    *("docs", "checkpoints/results", "examples"),
    *("CONTRIBUTING.md", "CHANGELOG.md", "SECURITY.md", "CITATION.cff", "LICENSE", "tools/bench/README.md"),
    *("tools/pages/demo.png", "tools/pages/plans.png", "tools/pages/scenarios.png"),
)
"""What the pages are, show or link to."""

API = {
    "pedzoo": "pedzoo: models.zoo.loading.load models.zoo.loading.list_models policies.load.list_policies "
    "eval.rollout.rollout metrics.closed_loop.measure eval.evaluate.evaluate sim.make.make_env "
    "sim.robots.env.make_robot_env",
    "policies": "Controllers and policies: policies.controller.controller.Controller policies.policy.Policy "
    "policies.load.load_policy policies.walker.Walker policies.teams.Teams "
    "policies.robots._base.RobotPolicy",
    "sim": "Simulation: sim.scenario sim.env.PedestrianEnv sim.rollout.Rollout sim.kernel "
    "sim.rollout.RobotRollout sim.robots.sensors sim.robots.rewards",
    "models": "Models and data: core.batch models.base.Forecaster models.architectures.sgan.SGAN "
    "data.datamodule.TrajectoryDataModule data.recordings data.tracks.Tracks",
    "maps": "Maps: maps.plans maps.grid.OccupancyGrid maps.formats maps.planning.planner.Planner",
    "eval": "Metrics and evaluation: metrics.arrival metrics.contacts metrics.door metrics.smoothness "
    "metrics.forecast metrics.robots eval.suite eval.scoring.score",
}
"""Pages of the API by their names: title, and modules, classes and functions of pedzoo."""


def main() -> int:
    """Gather the pages and build them; returns the exit code."""
    shutil.rmtree(PAGES, ignore_errors=True)
    for name in COPIED:
        target = PAGES / name
        if (ROOT / name).is_dir():
            shutil.copytree(ROOT / name, target, ignore=shutil.ignore_patterns("__pycache__"))
        else:
            target.parent.mkdir(parents=True, exist_ok=True)
            shutil.copy(ROOT / name, target)
    (PAGES / "index.md").write_text((ROOT / "README.md").read_text())
    for page in (PAGES / "docs").glob("*.md"):
        page.write_text(page.read_text().replace("](../README.md", "](../index.md"))
    for name, line in API.items():
        title, _, objects = line.partition(": ")
        page = PAGES / "api" / f"{name}.md"
        page.parent.mkdir(exist_ok=True)
        page.write_text("\n\n".join([f"# {title}", *(f"::: pedzoo.{one}" for one in objects.split())]) + "\n")
    config = Path(__file__).with_name("mkdocs.yml")
    # not --quiet: warnings are only counted where they are shown
    words = [sys.executable, "-m", "mkdocs", "build", "--strict", "--config-file", str(config)]
    run = subprocess.run(
        words, check=False, env=os.environ | {"NO_MKDOCS_2_WARNING": "1"}, capture_output=True, text=True
    )
    said = "\n".join(line for line in run.stderr.splitlines() if not line.startswith("INFO"))
    print(said if run.returncode else "build/site/index.html", file=sys.stderr if said else sys.stdout)
    return run.returncode


if __name__ == "__main__":
    sys.exit(main())
