"""Robots among people for Gymnasium and PettingZoo; importing it registers ``pedzoo/Goals-v0`` and more."""

from __future__ import annotations

from importlib.util import find_spec

from pedzoo.core.errors import UserError

if find_spec("gymnasium") is None:
    raise UserError("pedzoo.sim.gym needs gymnasium: pip install '.[gym]' in a checkout")

from pedzoo.sim.gym.ids import register_all

register_all()
