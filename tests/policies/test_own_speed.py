"""People walk at the speed that they are said to like where nobody is in their way."""

import math

import numpy as np
import pytest
import torch
from helpers.walks import hosted

from pedzoo.models.architectures.sgan import at_own_speed
from pedzoo.policies.controller.controller import Controller
from pedzoo.policies.load import load_policy
from pedzoo.policies.walker import Walker
from pedzoo.sim.make import make_env
from pedzoo.sim.scenarios.custom import Custom

DEFAULT = "approach_net_goal_map.indoor"


@pytest.mark.parametrize("name", ["go_to_goal", "orca", "social_force", DEFAULT])
@pytest.mark.parametrize("speed", [0.5, 1.0, 1.7])
def test_a_host_gets_the_speed_that_it_asks_for(name: str, speed: float) -> None:
    """Within 3 %, in any direction, whatever the noise, by way and by path."""
    policy = load_policy(name)
    dt, seed = policy.decision_dt, round(10 * speed)
    controller = Controller(policy, dt=dt, pref_speed=speed, seed=seed)
    here = np.array([[0.2, -0.1]])
    goal = here[0] + 90.0 * np.array([math.cos(seed), math.sin(seed)])
    track, _ = hosted(controller, here, {0: {0: goal}}, 12.0)
    path = np.diff(track[round(6.0 / dt) :, 0], axis=0)
    assert np.linalg.norm(path, axis=1).mean() / dt == pytest.approx(speed, rel=0.03)
    assert np.linalg.norm(path.mean(0)) / dt == pytest.approx(speed, rel=0.03)


@pytest.mark.parametrize("speed", [0.6, 0.8, 1.4])
def test_the_environment_gets_it_too(speed: float) -> None:
    """Of 24 people alone in their scenes, each with noise of their own."""
    alone = Custom([{"from": [0.0, 0.0], "to": [50.0, 20.0]}], speed=speed, speed_std=0.0)
    env = make_env(alone, 24, "compiled")
    with torch.no_grad():
        walk = env.rollout(22, load_policy(DEFAULT), auto_reset=True)
    here = walk["agents", "history"][:, :, 0, -1]
    walked = (here[:, -1] - here[:, 10]).norm(dim=-1) / (11 * 0.4)
    assert (walked / speed - 1).abs().max() < 0.03


def test_people_alone_walk_at_their_speed_others_at_its_share() -> None:
    """The way leads along x at 0.4 m a step; alone the model walks 0.5 m, and so did people before."""
    alone, last, wanted = (torch.tensor([[x, 0.0]]).repeat(5, 1) for x in (0.5, 0.5, 0.4))
    step = torch.tensor([[0.5, 0.0], [0.25, 0.1], [0.0, 0.0], [-0.1, 0.0], [0.6, 0.0]])
    result = at_own_speed(step, alone, last, wanted)
    # halfway from 0.5 to 0.4 m: 0.45
    expected = torch.tensor([[0.45, 0.0], [0.225, 0.1], [0.0, 0.0], [-0.1, 0.0], [0.55, 0.0]])
    torch.testing.assert_close(result, expected)
    turned = torch.tensor([[-0.2, 0.1], [0.1, 0.4]])
    torch.testing.assert_close(at_own_speed(turned, turned, turned, wanted[:2]), turned)


def test_others_slow_people_down() -> None:
    """A row of people who stand across the way stops the default, at any speed."""
    start = np.array([(0.0, 0.0), *((4.0, 0.45 * number - 2.7) for number in range(1, 12))])
    goals = {0: {0: (12.0, 0.0), **dict.fromkeys(range(1, 12))}}
    for speed in (0.8, 1.4):
        policy = load_policy(DEFAULT)
        assert isinstance(policy, Walker)
        path, _ = hosted(Controller(policy, pref_speed=speed), start, goals, 8.0)
        assert path[-1, 0, 0] < 4.0
