"""The examples are short and do what they say; the ROS 2 node answers HuNav's requests, ROS is faked."""

import json
import math
import runpy
import sys
from collections.abc import Callable
from importlib.util import find_spec
from itertools import pairwise
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import pytest

EXAMPLES = Path(__file__).parents[2] / "examples"


def run(name: str, **settings: Any) -> Any:
    return runpy.run_path(str(EXAMPLES / name))["main"](**settings)


@pytest.mark.parametrize("path", sorted(EXAMPLES.glob("*.py")), ids=lambda path: path.name)
def test_examples_are_shorter_than_60_lines(path: Path) -> None:
    assert len(path.read_text().splitlines()) < 60


def test_robots_in_gymnasium(capsys) -> None:
    run("robot_gym.py", decisions=70)
    first, second = capsys.readouterr().out.splitlines()
    assert "'SUCCESS': True" in first and "'COLLISION_HUMAN': False" in first
    arrived, ended = (int(word) for word in second.split() if word.isdigit())
    assert 0 < arrived <= ended


def test_robots_in_torchrl(capsys) -> None:
    run("robot_torchrl.py", scenes=4, decisions=60)
    straight, untrained = capsys.readouterr().out.splitlines()
    assert straight.startswith("straight: ") and untrained.startswith("untrained: ")
    assert int(straight.split()[1]) > int(untrained.split()[1])


def test_people_walk_around_a_robot_of_ones_own(capsys) -> None:
    assert run("people_around_a_robot.py", seconds=6.0) > 0.15  # a body's radius: no touch
    assert capsys.readouterr().out.startswith(" 0.0 s: robot (6.")


def test_policies_are_compared(tmp_path) -> None:
    results = run("compare_policies.py", episodes=2, out=str(tmp_path / "door.png"))
    assert results["approach_net_goal_map.indoor"]["clean"] == 1.0 > results["go_to_goal"]["clean"]
    assert (tmp_path / "door.png").read_bytes().startswith(b"\x89PNG")


def test_the_notebook(monkeypatch) -> None:
    monkeypatch.setenv("MPLBACKEND", "agg")
    cells = json.loads((EXAMPLES / "first_steps.ipynb").read_text())["cells"]
    scope: dict[str, Any] = {}
    for cell in cells:
        if cell["cell_type"] == "code":
            assert cell["outputs"] == []
            exec(compile("".join(cell["source"]), "first_steps.ipynb", "exec"), scope)
    assert scope["values"]["success"] == 1.0 and len(scope["axes"].lines) == 2
    assert scope["people"]["anna"][0] > 6.0


@pytest.mark.skipif(find_spec("pybullet") is None, reason="needs pybullet")
def test_people_walk_around_a_husky(capfd) -> None:
    """They meet it head-on: the middle one has to leave the straight line, and none touches it."""
    assert run("husky_pybullet.py", seconds=10.0) > 0
    driven = float(capfd.readouterr().out.split("drove ")[1].split()[0])
    assert 5 < driven < 8


# The ROS 2 node


Services = dict[str, Callable[..., Any]]

NODE = Path(__file__).parents[2] / "examples" / "ros2" / "people_node.py"


def pose(x: float, y: float) -> SimpleNamespace:
    return SimpleNamespace(
        position=SimpleNamespace(x=x, y=y, z=0.0), orientation=SimpleNamespace(x=0.0, y=0.0, z=0.0, w=1.0)
    )


def agent(number: int, x: float, y: float, goals: list[tuple[float, float]], **more: Any) -> SimpleNamespace:
    zero = {"x": 0.0, "y": 0.0, "z": 0.0}
    still = SimpleNamespace(linear=SimpleNamespace(**zero), angular=SimpleNamespace(**zero))
    known: dict[str, Any] = {"id": number, "name": f"agent{number}", "position": pose(x, y)}
    known |= {"velocity": still, "goals": [pose(*goal) for goal in goals], "cyclic_goals": False}
    known |= {"type": 1, "skin": 0, "behavior": 1, "behavior_state": 0, "group_id": -1, "yaw": 0.0}
    known |= {"desired_velocity": 1.2, "radius": 0.2, "goal_radius": 0.2}
    known |= {"linear_vel": 0.0, "angular_vel": 0.0, "closest_obs": []}
    return SimpleNamespace(**known | more)


def request(seconds: float, agents: list[SimpleNamespace], robot: SimpleNamespace) -> SimpleNamespace:
    stamp = SimpleNamespace(sec=int(seconds), nanosec=round(seconds % 1 * 1e9))
    current = SimpleNamespace(header=SimpleNamespace(stamp=stamp, frame_id="map"), agents=agents)
    return SimpleNamespace(current_agents=current, robot=robot)


@pytest.fixture
def services(monkeypatch) -> Services:
    """What the node serves, once ROS spins."""
    served: Services = {}

    class Node:
        def declare_parameter(self, name: str, value: Any) -> SimpleNamespace:
            return SimpleNamespace(value=value)

        def create_service(self, kind: str, name: str, call: Callable[..., Any]) -> None:
            served[name] = call

    rclpy, messages = ModuleType("rclpy"), ModuleType("hunav_msgs.srv")
    vars(rclpy).update(init=lambda: None, create_node=lambda name: Node(), spin=lambda node: None)
    vars(messages).update(ComputeAgents="ComputeAgents", ResetAgents="ResetAgents")
    monkeypatch.setitem(sys.modules, "rclpy", rclpy)
    monkeypatch.setitem(sys.modules, "hunav_msgs", ModuleType("hunav_msgs"))
    monkeypatch.setitem(sys.modules, "hunav_msgs.srv", messages)
    runpy.run_path(str(NODE))["main"]()
    return served


def walked(
    services: Services, people: list[SimpleNamespace], robot: SimpleNamespace, calls: int
) -> list[list[SimpleNamespace]]:
    said = []
    for call in range(calls):
        response = services["compute_agents"](request(10 + 0.1 * call, people, robot), SimpleNamespace())
        people = response.updated_agents.agents
        said.append(people)
    return said


def test_people_walk_to_their_goals_in_turn_and_past_the_robot(services: Services) -> None:
    robot = agent(0, 0.0, 0.0, [], radius=0.3)
    people = [
        agent(1, -3.0, 0.05, [(3.0, 0.05), (3.0, 1.0)], yaw=0.0),
        agent(2, 3.0, -1.0, [(-3.0, -1.0)]),
        agent(3, 4.0, 0.5, []),
    ]
    said = walked(services, people, robot, 120)
    assert [one.position.position.x for one in said[0]] == [-3.0, 3.0, 4.0]
    paths = [[(row[i].position.position.x, row[i].position.position.y) for row in said] for i in range(3)]
    assert math.dist(paths[0][-1], (3.0, 1.0)) < 0.5 and math.dist(paths[1][-1], (-3.0, -1.0)) < 0.5
    assert min(math.dist(place, (3.0, 0.05)) for place in paths[0]) <= 0.3
    assert min(math.dist(place, (0.0, 0.0)) for place in paths[0]) > 0.5
    assert max(math.dist(place, (4.0, 0.5)) for place in paths[2]) == 0
    for before, after in pairwise(said):
        one, two = before[0], after[0]
        step = two.position.position.x - one.position.position.x
        assert step == pytest.approx(0.1 * two.velocity.linear.x, abs=1e-6)
        assert two.linear_vel == pytest.approx(math.hypot(two.velocity.linear.x, two.velocity.linear.y))
        assert two.position.orientation.z == pytest.approx(math.sin(two.yaw / 2))
    assert said[20][1].yaw == pytest.approx(math.pi, abs=0.6) or said[20][1].yaw < -2.5
    assert said[-1][0].name == "agent1"


def test_goals_go_round_and_services_begin_anew(services: Services) -> None:
    robot = agent(0, 8.0, 2.0, [], radius=0.3)
    person = agent(1, -1.0, 0.0, [(1.0, 0.0), (-1.5, 0.0)], cyclic_goals=True)
    x = [row[0].position.position.x for row in walked(services, [person], robot, 100)]
    turns = sum((b - a) * (c - b) < 0 for a, b, c in zip(x[:-2], x[1:-1], x[2:], strict=True))
    assert turns >= 3
    assert services["reset_agents"](request(0, [], robot), SimpleNamespace()).ok
    back = services["compute_agents"](request(2.0, [person], robot), SimpleNamespace())
    assert back.updated_agents.agents[0].position.position.x == -1.0
