"""Mutation tests: small mistakes are made in the code, and tests must see them.

```
pip install cosmic-ray
python -m tools.mutants planner --sample 100   # of one module; all by default
```

Cosmic Ray says what can be mutated. Each mutant of a sample is written into a copy of HEAD, and tested in a
fork of a process that has imported torch already. Survivors are printed; those of `EQUIVALENT` are harmless.
"""

import argparse
import ast
import importlib
import multiprocessing
import os
import re
import signal
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

ROOT = Path(__file__).parents[1]

MODULES: dict[str, tuple[str, str]] = {
    "metrics": (
        "pedzoo/metrics/*.py",
        "tests/metrics --ignore=tests/metrics/test_own_metrics.py --ignore=tests/metrics/test_realism.py "
        "--ignore=tests/metrics/test_two_sample.py",
    ),
    "rewards": (
        "pedzoo/sim/robots/rewards.py pedzoo/train/ppo/self_play.py",
        "tests/sim/test_robot_env.py tests/train/test_ppo.py -k rewards+reward_adds+negative",
    ),
    "losses": (
        "pedzoo/models/blocks/variety.py pedzoo/train/closed_loop/loop_losses.py",
        "tests/models/test_sgan.py tests/train/test_episode_segments.py tests/train/test_imitation.py",
    ),
    "planner": (
        "pedzoo/maps/planning/*.py",
        "tests/maps/test_planner.py tests/maps/test_online_planner.py tests/sim/test_kernel.py",
    ),
    "orca": ("pedzoo/policies/rule_based/*orca*.py", "tests/policies/test_orca.py"),
    "pooling": (
        "pedzoo/models/blocks/people/pooling.py pedzoo/models/blocks/people/approach.py",
        "tests/models/test_blocks.py tests/models/test_models.py tests/models/test_social_walker.py",
    ),
    "score": (
        "pedzoo/eval/scoring/*.py pedzoo/metrics/realism/*.py",
        "tests/metrics/test_realism.py tests/metrics/test_two_sample.py tests/eval/test_scoring.py",
    ),
}
"""Files that are mutated, and the tests that must see it."""

OPERATORS = re.compile(
    r"core/(NumberReplacer|AddNot|ReplaceAndWithOr|ReplaceOrWithAnd|ReplaceTrueWithFalse|ReplaceFalseWithTrue"
    r"|ReplaceUnaryOperator_(Delete_.*|USub_UAdd)|ReplaceBinaryOperator_(Add_Sub|Sub_Add|Mul_Div|Div_Mul"
    r"|BitOr_BitAnd|BitAnd_BitOr|FloorDiv_Div|Pow_Mul|Mod_Mul)|ReplaceComparisonOperator_(Lt_(LtE|GtE)"
    r"|LtE_(Lt|Gt)|Gt_(GtE|LtE)|GtE_(Gt|Lt)|Eq_NotEq|NotEq_Eq))"
)
"""Mistakes that people make: a sign, a border, a constant, a condition."""

EQUIVALENT = {
    "metrics/contacts.py": ("_AT_ONCE = 100001", "(closing < 0)"),
    "metrics/forecast.py": ("split( 257)", "there.unsqueeze(1), 1).sum"),
    "metrics/robots.py": ("clamp_min( 0), there.any",),
    "metrics/arrival.py": ("number.numel() else 1",),
    "metrics/realism/walks.py": ("scatter_reduce( -1",),
    "metrics/ratios.py": ("(at,))[:, -1]",),
    "models/blocks/variety.py": ("zeros_like(z[", "self.best_k >= 1", "self.best_k > 0"),
    "maps/planning/graph.py": ("< _KEPT",),
    "models/blocks/people/pooling.py": (
        "_CPU_FLOATS = ",
        "needs_input_grad[ 1] or",
        "crowd.shape[1] < _AT_ONCE",
        "// u.shape[ 0]",
    ),
}
"""Parts of mutants' lines, by file, that change no result: sizes of pieces that are computed at once, one of
several tensors of the same shape, one of several indices of the same element, values that are never read."""

PATIENCE = 240
"""Seconds that the tests of a mutant may take; one that never ends is seen, too."""


class Mutant(NamedTuple):
    """A file with one mistake, by Cosmic Ray's operator at one of its places."""

    file: str
    line: int
    operator: str
    occurrence: int


def mutants_of(pattern: str) -> list[Mutant]:
    """Return all mutants of files, annotations and messages apart."""
    plugins: Any = importlib.import_module("cosmic_ray.plugins")
    read: Any = importlib.import_module("cosmic_ray.ast")
    names = [name for name in plugins.operator_names() if OPERATORS.fullmatch(name)]
    result = []
    for path in sorted(file for one in pattern.split() for file in ROOT.glob(one)):
        inside = [*ast.walk(ast.parse(path.read_text()))]
        parts = [getattr(node, name, None) for node in inside for name in ("annotation", "returns")]
        parts += [node for node in inside if isinstance(node, ast.JoinedStr)]
        skipped = [
            ((one.lineno, one.col_offset), (one.end_lineno, one.end_col_offset)) for one in parts if one
        ]
        nodes = [*_nodes(read.get_ast(path.read_text()))]
        for name in names:
            operator, number = plugins.get_operator(name)(), 0
            for node in nodes:
                for place, _ in operator.mutation_positions(node):
                    if not any(first <= place < last for first, last in skipped):
                        result.append(Mutant(str(path.relative_to(ROOT)), place[0], name, number))
                    number += 1
    return result


def _nodes(tree: Any) -> Iterator[Any]:
    yield tree
    for child in getattr(tree, "children", ()):
        yield from _nodes(child)


def killed(copy: Path, tests: list[str], silent: bool = True) -> bool:
    """Return whether a test fails, in a fork."""
    child = multiprocessing.get_context("fork").Process(target=_test, args=(copy, tests, silent))
    child.start()
    child.join(PATIENCE)
    if child.exitcode is None:
        os.killpg(child.pid or 0, signal.SIGKILL)
    return child.exitcode != 0


def _test(copy: Path, tests: list[str], silent: bool) -> None:
    import pytest

    os.setsid()
    os.chdir(copy)
    for place in (1, 2) if silent else ():
        os.dup2(os.open(os.devnull, os.O_WRONLY), place)
    sys.exit(int(pytest.main(["-x", "-q", "--assert=plain", "-p", "no:cacheprovider", *tests])))


def survivors(module: str, sample: int, seed: int, copy: Path) -> tuple[int, list[str]]:
    """Return how many mutants of a module were tried, and those that no test has seen."""
    mutating: Any = importlib.import_module("cosmic_ray.mutating")
    plugins: Any = importlib.import_module("cosmic_ray.plugins")
    pattern, tests = MODULES[module]
    words = [word.replace("+", " or ") for word in tests.split()]
    if killed(copy, words, silent=False):
        raise SystemExit(f"{module}: the tests fail without a mistake")
    known = mutants_of(pattern)
    drawn = np.random.default_rng(seed).permutation(len(known))[:sample]
    result = []
    for count, mutant in enumerate((known[i] for i in drawn), 1):
        path = copy / mutant.file
        before = path.read_text()
        after = mutating.mutate_code(before, plugins.get_operator(mutant.operator)(), mutant.occurrence)
        path.write_text(after)
        line = after.splitlines()[mutant.line - 1].strip()
        said = f"{mutant.file.removeprefix('pedzoo/')}:{mutant.line} {line}"
        seen = killed(copy, words)
        path.write_text(before)
        print(f"{module} {count}/{len(drawn)} {'killed' if seen else 'SURVIVED'} {said}", flush=True)
        if not seen:
            result.append(said)
    return len(drawn), result


def main() -> None:
    """Try the mutants of modules and print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("modules", nargs="*", help=", ".join(MODULES))
    parser.add_argument("--sample", type=int, default=100, help="mutants of each module")
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    os.environ |= {"OMP_NUM_THREADS": "1", "MKL_NUM_THREADS": "1"}
    os.environ.setdefault("PEDZOO_SHARED", str(ROOT.parent / "shared"))
    rows = []
    with tempfile.TemporaryDirectory() as home:
        copy = Path(home, "copy")
        subprocess.run(["git", "-C", ROOT, "worktree", "add", "-q", "--detach", copy, "HEAD"], check=True)
        try:
            sys.dont_write_bytecode = True  # a file of the same size and second would be taken for another
            sys.modules.pop("tools", None)
            sys.path[:] = [str(copy), *(one for one in sys.path if one not in ("", str(ROOT)))]
            for name in ("torch", "torchrl", "lightning", "scipy.stats", "cv2", "numba"):
                importlib.import_module(name)
            for module in options.modules or MODULES:
                tried, alive = survivors(module, options.sample, options.seed, copy)
                said = [mutant.partition(":")[::2] for mutant in alive]  # as they are printed
                same = sum(any(part in line for part in EQUIVALENT.get(file, ())) for file, line in said)
                share = (tried - len(alive)) / max(tried - same, 1)
                rows.append(f"| {module} | {tried} | {tried - len(alive)} | {same} | {share:.3f} |")
        finally:
            subprocess.run(["git", "-C", ROOT, "worktree", "remove", "--force", copy], check=False)
    print("\n| module | mutants | killed | equivalent | share |\n|---|---|---|---|---|")
    print("\n".join(rows))


if __name__ == "__main__":
    main()
