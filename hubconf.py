"""Models through torch.hub: ``torch.hub.load(CHECKOUT, "sgan_goal", pretrained="zara1", source="local")``.

There is a function for every family of released weights; ``torch.hub.list`` names them.
"""

from __future__ import annotations

from collections.abc import Callable as _Callable

from pedzoo.models.base import Forecaster as _Forecaster
from pedzoo.models.zoo.loading import list_models as _list_models
from pedzoo.models.zoo.loading import load as _load

dependencies = ["torch", "torchrl", "tensordict", "jsonargparse", "safetensors", "scipy", "yaml"]


def _family(name: str) -> _Callable[..., _Forecaster]:
    tags = [model.partition(".")[2] for model in _list_models(f"{name}.*")]

    def entry(pretrained: str = "eth_ucy") -> _Forecaster:
        return _load(f"{name}.{pretrained}")

    entry.__name__ = entry.__qualname__ = name
    entry.__doc__ = f"""Return {name} in eval mode.

    Args:
        pretrained: What the weights did not see; eth_ucy saw every scene. There are {", ".join(tags)}.
    """
    return entry


globals().update({name: _family(name) for name in {model.partition(".")[0] for model in _list_models()}})
