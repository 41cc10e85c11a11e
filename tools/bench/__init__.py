"""Speed: every figure of the project, measured in one run and beside others where there are others."""

from pedzoo.core.registry import Registry

BENCHMARKS = Registry("benchmark", "tools.bench.sections")
