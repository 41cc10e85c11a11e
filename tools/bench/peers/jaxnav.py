"""JaxMARL's JaxNav as a peer of `pedzoo bench`: with the rays of its lidar, and with next to none.

    python -m venv ../venv_peers && ../venv_peers/bin/pip install jaxmarl==0.2.0
    pedzoo bench environment --peer tools/bench/peers/jaxnav.py --peer_python ../venv_peers/bin/python

Robots with differential drive and a body of 0.3 m get random actions in grids of 11 x 11 m. Observations,
rewards and resets are computed in each step of 0.1 s. A robot that touches something stands. An episode ends
when all robots of its scene have touched something or arrived, or after 500 steps; the scene goes on from one
of 64 starts drawn beforehand. JaxNav's own reset draws a map in every step, needed or not, and is slower.

In the section ``robots`` the lidar has 64 rays: those of the last robot alone
are computed, and all robots get them; JaxNav itself computes those of each.

One step of all scenes is one compiled program, on one thread and one processor.
"""

from __future__ import annotations

import math
import os
from functools import partial
from importlib.metadata import version
from typing import Any

from answering import Sizes, Step, TimedCase, serve

ONE_THREAD = "--xla_cpu_multi_thread_eigen=false intra_op_parallelism_threads=1"
STARTS = 64
WARM = 3
"""Steps before the first turn: the types of the state settle in them, and each new one is compiled."""

MOST = 100

KINDS = {
    "lidar": ((12, True), "12 rays each"),
    "no lidar": ((2, True), "2 rays each, the fewest that it takes"),
}
ROBOTS = {"lidar": ((64, False), "64 rays of one robot among walls of its own")}


def cases(asked: Sizes) -> list[TimedCase]:
    """Return all kinds for every size that is asked about."""
    os.environ["XLA_FLAGS"] = f"{os.environ.get('XLA_FLAGS', '')} {ONE_THREAD}".strip()
    os.sched_setaffinity(0, {max(os.sched_getaffinity(0))})
    note = "JaxNav, {about}, random actions, scenes that end go on from starts drawn beforehand"
    return [
        TimedCase(section, f"JaxNav, {name}", partial(built, *size, *kind), *size, note.format(about=about))
        for section, kinds in (("environment", KINDS), ("robots", ROBOTS))
        for size in asked.get(section, [])
        if size[1] <= MOST
        for name, (kind, about) in kinds.items()
    ]


def built(scenes: int, people: int, rays: int, each: bool) -> Step:
    """Return what makes one step of all scenes; so many rays of each robot, or of the last one."""
    # XLA reads its flags when jax is first used.
    import jax  # pyright: ignore[reportMissingImports]
    from jax import numpy as jnp  # pyright: ignore[reportMissingImports]
    from jaxmarl.environments.jaxnav import JaxNav  # pyright: ignore[reportMissingImports]

    class LastLidar(JaxNav):
        """All robots get what the last one's lidar says: it is computed once."""

        def _lidar_sense(self, idx: Any, state: Any) -> Any:
            return super()._lidar_sense(self.num_agents - 1, state)

    side = max(11, math.ceil(11 * math.sqrt(people / 5)))
    make = JaxNav if each else LastLidar
    env = make(num_agents=people, lidar_num_beams=rays, map_params={"map_size": (side, side), "fill": 0.3})
    split, tree_map = jax.random.split, jax.tree.map
    starts = jax.jit(jax.vmap(env.sample_test_case))(split(jax.random.PRNGKey(0), STARTS))

    def one(key: Any, state: Any) -> tuple[Any, ...]:
        draw, move, pick = split(key, 3)
        keys = split(draw, people)
        actions = {name: env.action_space(name).sample(keys[i]) for i, name in enumerate(env.agents)}
        seen, after, reward, done, _ = env.step_env(move, state, actions)
        row = jax.random.randint(pick, (), 0, STARTS)
        state = tree_map(lambda new, old: jnp.where(done["__all__"], new[row], old), starts, after)
        return state, seen, reward, done

    @jax.jit
    def step_all(key: Any, state: Any) -> tuple[Any, ...]:
        key, draw = split(key)
        return key, *jax.vmap(one)(split(draw, scenes), state)

    first = jnp.arange(scenes) % STARTS
    key, state = jax.random.PRNGKey(1), tree_map(lambda value: value[first], starts)

    def step() -> None:
        nonlocal key, state
        key, state, *rest = step_all(key, state)
        jax.block_until_ready((state, rest))

    for _ in range(WARM):
        step()
    return step


if __name__ == "__main__":
    serve("JaxNav", {"jaxmarl": version("jaxmarl"), "jax": version("jax")}, cases)
