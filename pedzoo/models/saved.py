"""What a model's file says about it, however the model is named."""

from __future__ import annotations

from typing import Any

from pedzoo.models.address import is_address
from pedzoo.models.header import read_config
from pedzoo.models.store import obtain
from pedzoo.models.zoo import read_checkpoint


def saved_config(name: str) -> dict[str, Any]:
    """Return architecture, settings, ``protocol`` and, of published weights, ``training`` of a model.

    Args:
        name: A ``.ckpt``, a ``.safetensors`` file, or what `pedzoo.models.store.find` accepts.

    Raises:
        UserError: There is no such model, or it cannot be read.
    """
    if name.endswith(".ckpt"):
        return read_checkpoint(name)["pedzoo"]
    if name.endswith(".safetensors") and not is_address(name):
        return read_config(name)
    return read_config(obtain(name))
