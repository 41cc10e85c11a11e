"""The environment in which policies walk: kernel, physics backends, scenarios, replay of recorded people."""
