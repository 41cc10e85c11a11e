"""Robots among people for Gymnasium and PettingZoo; importing it registers ``pedzoo/Goals-v0`` and more."""

from __future__ import annotations

from pedzoo.core.errors import need

need("gym", "pedzoo.sim.gym")

from pedzoo.sim.gym.ids import register_all  # noqa: E402  what it imports has to be there

register_all()
