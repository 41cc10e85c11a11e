"""Compare policies at a door, and draw where their people walk.

pip install '.[video]'; python examples/compare_policies.py
"""

from __future__ import annotations

import pedzoo
from pedzoo.viz.trajectories import PolicyRollout, plot_rollouts

POLICIES = ("approach_net_goal_map.indoor", "orca:radius=0.3", "social_force:preset=indoor", "go_to_goal")
SHOWN = ("success", "agent_contacts_per_min", "time_ratio", "yield_delay_s")


def main(episodes: int = 20, out: str = "door.png") -> dict[str, dict[str, float]]:
    """Walk the same scenes by every policy, and return all metrics by policy."""
    results, walked = {}, []
    for policy in POLICIES:
        rollout, env = pedzoo.rollout(policy, "door:people=4", "compiled", episodes)
        results[policy], _ = pedzoo.measure(rollout)
        walked.append(PolicyRollout(policy, rollout, env))
        print(f"{policy:28}", *(f"{name} {results[policy].get(name, float('nan')):.2f}  " for name in SHOWN))
    plot_rollouts(walked, out)
    return results


if __name__ == "__main__":
    main()
