"""The environment: dynamics, worlds, scenarios and policies."""
