"""Commands that a checkout has and a wheel lacks: benchmarks, and the tables of papers."""
