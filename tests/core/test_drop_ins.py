"""One file each, from any folder: a robot with its scene, a physics backend, a loss, a reward."""

import json
import math
from pathlib import Path
from textwrap import dedent

import pytest
import torch
from helpers.loop_training import module, train

import pedzoo
from pedzoo.cli.main import main
from pedzoo.core.bodies import UNICYCLE
from pedzoo.core.errors import UserError
from pedzoo.eval.rollout import rollout
from pedzoo.sim.env import PedestrianEnv
from pedzoo.train.ppo.self_play import Rewards

ROBOT = '''
    """A unicycle that turns to its short-term goal, and drives there as fast as it looks that way."""

    import torch

    from pedzoo.core.batch import ROBOT, agents_of
    from pedzoo.core.geometry import heading_of
    from pedzoo.policies.policy import Policy
    from pedzoo.sim.scenarios.encounters import Circle
    from pedzoo.core.bodies import UNICYCLE


    class Drives(Policy):
        """Writes speed and turning rate."""

        def __init__(self, gain: float = 2.0) -> None:
            super().__init__(0.1)
            self.gain = gain

        def forward(self, tensordict):
            agents = agents_of(tensordict)
            ahead = heading_of(agents["goal"] - agents["history"][:, :, -1]) - agents["heading"][..., 0]
            ahead = torch.atan2(ahead.sin(), ahead.cos())
            speed = agents["pref_speed"][..., 0] * ahead.cos().clamp_min(0.0)
            agents["action"] = torch.stack((speed, self.gain * ahead), dim=-1)
            return tensordict


    class Robots(Circle):
        """A circle of robots that begin with their backs to their goals."""

        wheels = True

        def layout(self, prepared, draws):
            layout = super().layout(prepared, draws)
            nothing = torch.zeros_like(layout.pref_speed)
            away = heading_of(layout.start)
            kind = torch.full_like(layout.goal, ROBOT)
            limits = {"acceleration": nothing + 1.0, "turn_acceleration": nothing + 3.0}
            drive = torch.full_like(layout.goal, UNICYCLE)
            more = {"drive": drive, "kind": kind, "heading": away, "radius": nothing + 0.3}
            return layout._replace(**more, **limits)
'''

PHYSICS = '''
    """Robots are carts of this backend's own: whatever they are told, they roll at one speed."""

    import torch

    from pedzoo.core.batch import ROBOT
    from pedzoo.sim.state import OwnedMotion
    from pedzoo.sim.physics.compiled import Compiled
    from pedzoo.sim.physics.torch import Torch


    class Carts(Torch):
        """Moves robots by a rule of its own."""

        scenes_at_once = 2

        def __init__(self, bank, body_radius: float = 0.15, speed: float = 0.5) -> None:
            super().__init__(bank, body_radius)
            self.speed = speed

        def owned(self, state):
            return state.kind == ROBOT

        def move_owned(self, state, inputs):
            ticks, substeps = inputs.velocity.shape[1], inputs.substeps
            heading = state.heading + 0.1 * ticks * 0.2
            time = torch.arange(1, ticks * substeps + 1) * (0.1 / substeps)
            along = torch.stack((state.heading.cos(), state.heading.sin()), dim=-1)
            path = state.position[:, :, None] + self.speed * time[:, None] * along[:, :, None]
            return OwnedMotion(path.unflatten(2, (ticks, substeps)), heading, torch.full_like(heading, 0.2))


    class Sticky(Torch):
        """All that move touch a wall."""

        def contacts(self, path, people):
            found = super().contacts(path, people)
            return found._replace(wall=torch.ones_like(found.wall))


    class Glue(Compiled):
        """The same over compiled loops."""

        def contacts(self, path, people):
            found = super().contacts(path, people)
            return found._replace(wall=torch.ones_like(found.wall))
'''

LOSS = '''
    """People should not walk to the left of where they began."""

    def leftwards(segment, bank):
        return segment.trace[..., -1, 1].clamp_min(0.0)

    def scalar(segment, bank):
        return segment.trace.sum()
'''

REWARD = '''
    """Walking slowly is worth something."""

    from pedzoo.core.batch import agents_of

    def slow(before, after):
        return (agents_of(after)["velocity"].norm(dim=-1) < 0.8).float()

    def scalar(before, after):
        return slow(before, after).sum()
'''


@pytest.fixture
def folder(tmp_path) -> Path:
    for name, code in {"robot": ROBOT, "carts": PHYSICS, "loss": LOSS, "reward": REWARD}.items():
        (tmp_path / f"{name}.py").write_text(dedent(code))
    return tmp_path


def carts(folder: Path, speed: float) -> PedestrianEnv:
    """Return two robots of the scenario, moved by the backend."""
    scene = f"{folder / 'robot.py'}:Robots:people=2,radius=5,jitter=0,aside=0,speed_std=0"
    physics = f"{folder / 'carts.py'}:Carts:speed={speed}"
    return pedzoo.make_env(scene, physics=physics, warm_start="static")


@pytest.mark.parametrize("physics", ["compiled", "torch"])
def test_a_unicycle_robot(folder: Path, physics: str, capsys) -> None:
    file, report = folder / "robot.py", folder / "out.json"
    words = [f"{file}:Drives:gain=3", "--scenario", f"{file}:Robots:people=2,radius=5,jitter=0,aside=0"]
    words += ["--physics", physics, "--episodes", "3", "--json", str(report)]
    assert main(["rollout", *words]) == 0
    (row,) = json.loads(report.read_text())["rows"]
    assert row["metrics"]["success"] == 1 and capsys.readouterr().err == ""


def test_a_physics_backend_that_moves_robots_by_its_own_rule(folder: Path) -> None:
    env = carts(folder, 0.6)
    _, several = rollout("go_to_goal", "door:people=2", physics=f"{folder / 'carts.py'}:Carts", episodes=5)
    assert several.batch_size[0] == 2, "as many scenes at once as it says"
    now = env.reset()
    begun = env.state
    assert (begun.drive == UNICYCLE).all()
    now["agents", "action"] = torch.full((1, 2, 2), 9.0)  # to which carts do not listen
    after = env.step(now)["next"]
    trace = after["agents", "info", "trace"]
    along = torch.stack((begun.heading.cos(), begun.heading.sin()), dim=-1)
    expected = begun.position + 0.4 * 0.6 * along
    assert torch.allclose(trace[:, :, -1], expected, atol=1e-5)
    assert torch.allclose(env.state.heading, begun.heading + 0.08, atol=1e-6)
    assert torch.allclose(env.state.turn_rate, torch.tensor(0.2))
    assert torch.allclose(after["agents", "velocity"].norm(dim=-1), torch.tensor(0.6), atol=1e-4)


def test_what_a_backend_owns_touches_others_and_reaches_goals(folder: Path) -> None:
    """Two carts that face each other across 2 m, 0.3 m wide each, touch after 1.4 m, and pass their goals."""
    env = carts(folder, 1.0)
    now = env.reset()
    place = torch.tensor([[[0.0, 0.0], [2.0, 0.0]]])
    faces = torch.tensor([[0.0, math.pi]])
    past = place.unsqueeze(2).expand(-1, -1, 29, -1).clone()
    assert env._scenes is not None
    state = env.state._replace(past=past, heading=faces, goal_point=place.flip(1))
    env._scenes = env._scenes._replace(state=state)
    touched, reached = [], []
    for _ in range(5):
        now["agents", "action"] = torch.zeros(1, 2, 2)
        # the carts go straight on
        env._scenes = env._scenes._replace(state=env.state._replace(heading=faces, goal_point=place.flip(1)))
        info = env.step(now)["next", "agents", "info"]
        touched.append(info["agent_contact"][0, 0])
        reached.append(info["reached"][0, 0])
    hits = torch.cat(touched).nonzero()[:, 0]
    assert 7 <= int(hits[0]) + 1 <= 8  # each has made 0.7 m
    assert int(torch.cat(reached).nonzero()[0]) + 1 in (17, 18)  # 0.3 m before 2 m


def test_walks_have_the_contacts_of_an_own_backend(folder: Path) -> None:
    own = folder / "carts.py"
    cases = ("torch", False), (f"{own}:Sticky", True), ("compiled", False), (f"{own}:Glue", True)
    for physics, touch in cases:
        walked, _ = rollout("go_to_goal", "circle:people=2", physics=physics, episodes=1)
        assert bool(walked.wall_contact.any()) is touch


def test_a_loss(folder: Path) -> None:
    trainer = train(module(losses={f"{folder / 'loss.py'}:leftwards": 5.0}), 1)
    assert float(trainer.callback_metrics["train/leftwards"]) > 0
    with pytest.raises(UserError, match="did you mean 'leftwards'"):
        module(losses={f"{folder / 'loss.py'}:leftward": 1.0})
    with pytest.raises(UserError, match=r"expected what each decision costs, \(T, B, A\)"):
        train(module(losses={f"{folder / 'loss.py'}:scalar": 1.0}), 1)


def test_a_reward(folder: Path) -> None:
    """A function in a file adds its weight for each person who walks slower than 0.8 m/s."""
    env = pedzoo.make_env("door:people=4", physics="compiled")
    before = env.reset()
    before["agents", "action"] = torch.tensor([[[0.5, 0.0], [1.2, 0.0], [0.0, 0.1], [0.0, -1.0]]])
    after = env.step(before)["next"]
    terms = {f"{folder / 'reward.py'}:slow": 3.0}
    more = Rewards(terms=terms)(before, after) - Rewards()(before, after)
    speed = after["agents", "velocity"].norm(dim=-1)
    torch.testing.assert_close(more, torch.where(speed < 0.8, 3.0, 0.0))
    assert 0 < int((more > 0).sum()) < 4
    with pytest.raises(UserError, match="did you mean 'slow'"):
        Rewards(terms={f"{folder / 'reward.py'}:slwo": 1.0})(before, after)
    with pytest.raises(UserError, match=r"expected the reward of all agents \(1, 4\), not \(\)"):
        Rewards(terms={f"{folder / 'reward.py'}:scalar": 1.0})(before, after)


def test_what_is_no_physics_is_refused(folder: Path) -> None:
    robot = f"{folder / 'robot.py'}:Drives"
    for physics, message in ((robot, r"a subclass of pedzoo.*\.Physics"), ("compield", "mean 'compiled'")):
        with pytest.raises(UserError, match=message):
            pedzoo.make_env("door", physics=physics)
