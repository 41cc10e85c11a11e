"""What a model's file says about it, however the model is named."""

from typing import Any

from pedzoo.core.registry import MODELS, names_code
from pedzoo.core.spec import parse, unquoted
from pedzoo.models.zoo.address import is_address
from pedzoo.models.zoo.file_header import read_config
from pedzoo.models.zoo.loading import read_checkpoint
from pedzoo.models.zoo.store import check_scheme, find, no_model, weights_of


def saved_config(name: str) -> dict[str, Any]:
    """Return architecture, settings, ``protocol`` and, of published weights, ``training`` of a model.

    Nothing is said of a model that was not trained: a baseline, or a class in a file. Names and errors as of
    `load`.
    """
    check_scheme(name)
    if names_code(name):
        name = unquoted(parse(name).settings.get("weights", ""))
        return saved_config(name) if name else {}
    if name.endswith(".ckpt"):
        return read_checkpoint(name)["pedzoo"]
    if name.endswith(".safetensors") and not is_address(name):
        return read_config(name)
    if entry := find(name):
        return read_config(weights_of(entry))
    if name in MODELS.names():
        return {}
    raise no_model(name)
