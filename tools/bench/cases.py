"""What pedzoo is timed at: a program of `pedzoo bench` that also runs with other commits.

It asks only for names that `pedzoo` exports, so that a commit and the working tree do the same work.
"""

import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parent / "peers"))

import numpy as np
import torch
from answering import Sizes, Step, TimedCase, serve  # pyright: ignore[reportMissingImports]

import pedzoo
from pedzoo.core.errors import installed

MODEL = "approach_net_goal_map.indoor"
PLAN, CROWDED = "apartment.7", "office.7"
POLICIES = (
    "orca",
    "orca:dt=0.4",
    "social_force:preset=indoor",
    f"{MODEL}:safety=true",
    f"{MODEL}:safety=false",
    "social_walker.styled:safety=true",
)
WARM, TURN = 20.0, 10.0
"""Simulated seconds before the first turn, and between two looks at the clock: resets have their share."""

OBSERVED, CALLS = 8, 8
"""Calls that fill a controller's histories, and calls that are timed before people are put back."""

EPOCH = (
    *("fit", "--config", "sgan_goal", "--data.fold", "embedded", "--trainer.max_epochs", "1"),
    *("--trainer.enable_progress_bar", "false"),
)
STARTS: dict[str, tuple[str, ...]] = {
    "import pedzoo": ("-c", "import pedzoo"),
    "load a model": ("-c", f"import pedzoo; pedzoo.load('{MODEL}')"),
    "pedzoo --help": ("-m", "pedzoo", "--help"),
    "a misspelt policy": ("-m", "pedzoo", "rollout", "ocra"),
    "a misspelt option": ("-m", "pedzoo", "fit", "--config", "sgan_goal", "--model.lrr", "1"),
    "fit, one epoch": ("-m", "pedzoo", *EPOCH),
    "evaluate --quick": ("-m", "pedzoo", "evaluate", "orca:dt=0.4", "--suite", "door", "--quick"),
}
"""Words behind the interpreter of each process that a person waits for."""


def cases(asked: Sizes) -> list[TimedCase]:
    """Return all cases of the sections and sizes that are asked about."""
    torch.set_num_threads(1)
    sizes = [(SECTIONS[section], *size) for section, each in asked.items() for size in each]
    return [case for make, scenes, people in sizes for case in make(scenes, people)]


def starts(scenes: int, people: int) -> Iterator[TimedCase]:
    """Give whole processes; a misspelt name is refused with code 2."""

    def run(words: tuple[str, ...]) -> None:
        with tempfile.TemporaryDirectory() as folder:  # runs are written there
            done = subprocess.run([sys.executable, *words], capture_output=True, cwd=folder)
        assert done.returncode in (0, 2), done.stderr[-300:]

    for name, words in STARTS.items():
        yield TimedCase("start", name, partial(partial, run, words))


def environments(scenes: int, people: int) -> Iterator[TimedCase]:
    """Give the bare environment with each physics; pybullet where it is, for as many as walks run at once."""
    bullet = ["bullet"] * (scenes <= 64 and installed("pybullet"))
    for physics in ("compiled", "torch", *bullet):
        yield walk("environment", "go_to_goal", scenes, people, physics)


def policies(scenes: int, people: int) -> Iterator[TimedCase]:
    """Give the environment with each policy."""
    for policy in POLICIES:
        yield walk("policies", policy, scenes, people, "compiled")


def walk(section: str, policy: str, scenes: int, people: int, physics: str) -> TimedCase:
    """Return the case of an environment's steps, with resets and new goals."""
    decides: Any = pedzoo.load(policy)
    dt = float(decides.decision_dt)

    def build() -> Step:
        scenario = f"goals:map={PLAN},people={people}"
        return stepping(pedzoo.make_env(scenario, scenes, physics, decision_dt=dt), decides, round(WARM / dt))

    name = f"{policy}, {physics}" if section == "environment" else policy
    return TimedCase(section, name, build, scenes, people, f"a decision every {dt:g} s", round(TURN / dt))


def robots(scenes: int, people: int) -> Iterator[TimedCase]:
    """Give robots that drive straight among people, with a lidar of 64 beams."""
    from pedzoo.policies.load import load_robot_policy

    def build(walkers: str) -> Step:
        sensors = ["goal", "odometry", "people", "lidar:beams=64"]
        scenario = f"goals:map={PLAN},people={people}"
        env = pedzoo.make_robot_env(scenario, "disc", walkers, scenes, sensors)
        return stepping(env, load_robot_policy("straight"), round(WARM / env.decision_dt))

    note = "a robot's decision, 0.2 s"
    for walkers in ("orca", MODEL):
        made = partial(build, walkers)
        yield TimedCase("robots", f"people {walkers}", made, scenes, people, note, 50)


def stepping(env: Any, policy: Any, warm: int) -> Step:
    """Return a step of all scenes, some steps after the start; scenes that end begin anew."""
    now = env.reset()

    @torch.no_grad()
    def step() -> None:
        nonlocal now
        _, now = env.step_and_maybe_reset(policy(now))

    for _ in range(warm):
        step()
    return step


def controllers(scenes: int, people: int) -> Iterator[TimedCase]:
    """Give calls of a controller for people who walk to goals of their own."""
    plan = PLAN if people <= 20 else CROWDED
    for dt in (0.4, 0.1):
        again: list[Step] = []

        def build(dt: float = dt, again: list[Step] = again) -> Step:
            env = pedzoo.make_env(f"goals:map={plan},people={people}", 1)
            start = env.reset()["agents", "history"][0, :, -1].numpy()
            others = np.concatenate([env.reset()["agents", "goal"][0].numpy() for _ in range(32)])
            far = np.linalg.norm(start[:, None] - others, axis=-1).argmax(1)  # nobody arrives in a turn
            goals = others[far] + np.random.default_rng(0).uniform(-0.05, 0.05, start.shape)
            controller = pedzoo.controller(MODEL, plan, dt=dt)
            position = start

            def step() -> None:
                nonlocal position
                velocity = controller.step(dict(enumerate(position)), dict(enumerate(goals)))
                position = position + dt * np.stack([velocity[person] for person in range(people)])

            def put_back() -> None:
                nonlocal position
                controller.reset(0)
                position = start
                for _ in range(OBSERVED):
                    step()

            again[:] = [put_back]
            return step

        name = f"{MODEL} every {dt:g} s in {plan}"
        yield TimedCase("controller", name, build, scenes, people, steps=CALLS, again=again)


def planners(scenes: int, people: int) -> Iterator[TimedCase]:
    """Give the first call with a new goal in one process, and networkx' A* on the same cells."""
    env = pedzoo.make_env(f"goals:map={CROWDED},people=2,pool=256", 1)
    draws = np.random.default_rng(0)

    def places() -> np.ndarray:
        return np.concatenate([env.reset()["agents", "goal"][0].numpy() for _ in range(64)])

    def ours() -> Step:
        controller = pedzoo.controller("go_to_goal", CROWDED, dt=0.1)
        goals = places()

        def step() -> None:
            one, other = draws.choice(goals, 2, replace=False)
            controller.reset(0)
            controller.step({0: one}, {0: other + draws.uniform(-0.02, 0.02, 2)})

        return step

    def theirs() -> Step:
        import networkx as nx

        grid = env.bank.grids[0]
        graph = nx.grid_2d_graph(*grid.cells.shape)
        graph.remove_nodes_from([tuple(cell) for cell in np.argwhere(grid.cells != 0)])
        free = max(nx.connected_components(graph), key=len)
        nodes = [tuple(node) for node in graph if node in free]

        def step() -> None:
            one, other = draws.choice(len(nodes), 2, replace=False)
            nx.astar_path(graph, nodes[one], nodes[other], lambda a, b: abs(a[0] - b[0]) + abs(a[1] - b[1]))

        return step

    yield TimedCase("planner", f"a step to a goal never asked for, {CROWDED}", ours)
    yield TimedCase("planner", f"networkx' A* on the same cells, {CROWDED}", theirs)


def forecasts(scenes: int, people: int) -> Iterator[TimedCase]:
    """Give twenty futures of 8 steps."""

    def build(name: str) -> Step:
        return torch.no_grad()(partial(pedzoo.load(name).sample, straight(scenes, people), 20, 8))

    for name in ("sgan_nopool.zara1", "sgan.zara1", "anchor_net.zara1"):
        yield TimedCase("forecast", name, partial(build, name), scenes, people, "20 futures of 8 steps")


def straight(scenes: int, people: int) -> Any:
    """Return the scene batch of people who have walked straight ahead, at random places."""
    env = pedzoo.make_env(f"circle:people={min(people, 8)}", scenes)
    batch = env.reset()
    agents = batch["agents"].apply(
        lambda value: value.repeat_interleave(-(-people // value.shape[1]), 1)[:, :people],
        batch_size=[scenes],
    )
    agents["history"] = agents["history"] + 10 * torch.rand(scenes, people, 1, 2)
    return batch.set("agents", agents)


def trainings(scenes: int, people: int) -> Iterator[TimedCase]:
    """Give one step of the generator's and the discriminator's training on 64 recorded windows."""

    def build() -> Step:
        from pedzoo.data.datamodule import TrajectoryDataModule

        data = TrajectoryDataModule("embedded")
        data.setup("fit")
        batches = iter(data.train_dataloader())
        model = pedzoo.load("sgan", pretrained=False).train()
        optimizer = torch.optim.Adam(model.parameters(), 1e-4)

        def step() -> None:
            nonlocal batches
            if (batch := next(batches, None)) is None:
                batches = iter(data.train_dataloader())
                batch = next(batches)
            loss = model.loss(batch)
            optimizer.zero_grad()
            loss.backward()
            optimizer.step()

        return step

    yield TimedCase("train", "Social GAN's generator, best of 20", build, scenes, people)


SECTIONS: dict[str, Callable[[int, int], Iterator[TimedCase]]] = {
    "start": starts,
    "environment": environments,
    "policies": policies,
    "robots": robots,
    "controller": controllers,
    "planner": planners,
    "forecast": forecasts,
    "train": trainings,
}

if __name__ == "__main__":
    serve("pedzoo", {"torch": torch.__version__}, cases)
