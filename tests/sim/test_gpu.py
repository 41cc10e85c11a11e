"""People walk on a GPU as on the CPU: `PEDZOO_TEST_GPU=1 python -m pytest tests/sim/test_gpu.py`.

Without a GPU, as in CI, all of it is skipped.
"""

from typing import Any

import pytest
import torch
from torch import Tensor

from pedzoo.policies.load import load_policy
from pedzoo.sim.make import make_env

pytestmark = pytest.mark.skipif(not torch.cuda.is_available(), reason="torch finds no GPU, or tests hide it")

SCENES = {
    "planner and walls": "goals:map=apartment.7,people=5,goals=2,pool=6",
    "several maps": "door:people=4,width=[0.8,1.2]",
    "no walls": "circle:people=4",
    "people who wait": "waiting",
    "groups": "groups",
    "recorded people": "replay:fold=embedded",
}
POLICIES = (
    "go_to_goal:safety=true",
    "orca",
    "social_force",
    "approach_net_goal_map.indoor",
    "social_walker.styled",
)


@torch.no_grad()
def places(policy: str, scene: str, device: str) -> Tensor:
    """Return where all are after 5 decisions (B, A, 2), m."""
    env = make_env(scene, num_envs=4, device=device)
    decide = load_policy(policy).to(device)
    now: Any = env.reset(seed=0)
    for _ in range(5):
        now = env.step(decide(now))["next"]
    assert env.state.position.device.type == torch.device(device).type
    return env.state.position.cpu()


@pytest.mark.parametrize("scene", SCENES)
@pytest.mark.parametrize("policy", POLICIES)
def test_people_walk_there_as_on_the_cpu(policy: str, scene: str) -> None:
    """The same draws on both. Roundings grow where people meet, so few decisions and the median count."""
    there, here = (places(policy, SCENES[scene], device) for device in ("cuda", "cpu"))
    apart = (there - here).norm(dim=-1)
    assert torch.equal(there.isnan(), here.isnan())
    assert float(apart[~apart.isnan()].median()) < 1e-2
