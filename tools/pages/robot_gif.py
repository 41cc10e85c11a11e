"""Draw the moving picture of a robot among people: python tools/pages/robot_gif.py [OUT.gif] [SETTING=...].

An apartment from above, five people, a robot and what its lidar sees. Of some episodes in which the robot
arrives, that in which it meets most people.
"""

from __future__ import annotations

import argparse

from pedzoo.eval.robots import robot_rollout
from pedzoo.metrics.robots.table import robot_metrics
from pedzoo.viz.robots import film_robots

MOST_SECONDS = 14.0
"""Of the episode that is shown, at most."""


def main() -> None:
    """Drive, choose an episode and draw it."""
    parser = argparse.ArgumentParser(description="Draw a robot among people.")
    parser.add_argument("out", nargs="?", default="docs/robot.gif")
    parser.add_argument("--policy", default="orca")
    parser.add_argument("--robot", default="turtlebot4:radius=0.25,top_speed=0.8")
    parser.add_argument("--people", default="sgan_goal_map.indoor")
    parser.add_argument("--scenario", default="goals:map=apartment.7,people=5,goals=1,pool=30")
    parser.add_argument("--episodes", type=int, default=40)
    options = parser.parse_args()
    both, env = robot_rollout(
        options.policy, options.scenario, options.robot, options.people, episodes=options.episodes
    )
    met = robot_metrics(both)["encounters_per_min"].above
    fits = both.success.all(1) & (both.seconds <= MOST_SECONDS)
    episode = int(met.where(fits, -1.0).argmax())
    title = f"{options.policy} among {options.people}"
    film_robots(both, env, options.out, title, episode, seconds=MOST_SECONDS)
    print(f"{options.out}: episode {episode}, {float(both.seconds[episode]):.1f} s, {int(met[episode])} met")


if __name__ == "__main__":
    main()
