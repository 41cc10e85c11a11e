"""AlexNet's five convolutions (https://arxiv.org/abs/1404.5997) with torchvision's ImageNet weights.

Defined here because torchvision is not a dependency; keys and shapes are those of its ``alexnet``.
"""

import hashlib
import os
from pathlib import Path

import torch
from safetensors.torch import load_file
from torch import Tensor
from torch.nn import functional as F

from pedzoo.core.errors import UserError
from pedzoo.core.fetch import fetch
from pedzoo.core.paths import expanded, sha256_of

FILE = "alexnet-owt-7be5be79.pth"
URLS = (f"https://download.pytorch.org/models/{FILE}", f"https://s3.amazonaws.com/pytorch/models/{FILE}")
"""Torchvision's published address, and the store behind it."""

SHA256 = "7be5be791159472b1fbf3c69796f7cb30dca7ad8466c2df70058c37116cdee02"
SIZE = 244_408_911  # of the published file, bytes

SHA256_FP16 = "0ef845d6e986e08581699f6b21519636884c2269921df75317a6d6e770777047"
"""Of the tensors below, rounded to half precision, in this order: the same for every file format."""

SHAPES = {
    "features.0": (64, 3, 11, 11),
    "features.3": (192, 64, 5, 5),
    "features.6": (384, 192, 3, 3),
    "features.8": (256, 384, 3, 3),
    "features.10": (256, 256, 3, 3),
}
KEYS = tuple(f"{layer}.{kind}" for layer in SHAPES for kind in ("weight", "bias"))

CHANNELS, STRIDE, FIRST = 256, 16, 15
"""Feature cell i of `features` is centred on input pixel 16 i + 15.

An output i of a layer with kernel k, stride s and padding p is centred on its input's s i + (k - 1) / 2 - p.
The first convolution (11, 4, 2) gives 4 i + 3. A pooling (3, 2, 0) puts 2 i + 1 in place of i: 8 i + 7, and
16 i + 15 after two of them. The other convolutions are centred on their own place.
"""

_OR_GIVE = "or give a .safetensors or .pth file as weights=... or in the environment variable PEDZOO_ALEXNET"


def input_length(cells: int) -> int:
    """Return the smallest input side, in pixels, that gives ``cells`` feature cells."""
    return STRIDE * cells + FIRST


def features(image: Tensor, weights: dict[str, Tensor]) -> Tensor:
    """Return the fifth convolution's features (B, 256, h, w), after ReLU, of images (B, 3, H, W) in [0, 1].

    The network's last max-pooling is left out: it would halve the resolution and smear walls over doors.
    """
    mean, std = image.new_tensor((0.485, 0.456, 0.406)), image.new_tensor((0.229, 0.224, 0.225))
    x = (image - mean.view(3, 1, 1)) / std.view(3, 1, 1)

    def layer(x: Tensor, index: int, stride: int = 1, padding: int = 1) -> Tensor:
        weight, bias = weights[f"features.{index}.weight"], weights[f"features.{index}.bias"]
        return F.conv2d(x, weight, bias, stride, padding).relu_()

    x = F.max_pool2d(layer(x, 0, stride=4, padding=2), 3, 2)
    x = F.max_pool2d(layer(x, 3, padding=2), 3, 2)
    return layer(layer(layer(x, 6), 8), 10)


def obtain() -> Path:
    """Return torchvision's file (244 MB), from a cache or downloaded. Raises UserError: no mirror has it."""
    of_torch_hub = Path(torch.hub.get_dir()) / "checkpoints" / FILE
    if of_torch_hub.is_file() and sha256_of(of_torch_hub) == SHA256:
        return of_torch_hub
    return fetch(URLS, SHA256, FILE, _OR_GIVE, SIZE)


def load(path: str | None = None) -> dict[str, Tensor]:
    """Return the convolutions' float32 weights by torchvision's keys.

    Args:
        path: A ``.safetensors`` file with these keys, or torchvision's ``alexnet*.pth``. None takes the file
            in the environment variable ``PEDZOO_ALEXNET``, else the published one, see `obtain`.

    Raises:
        UserError: No such file, no network, or other weights than the published ones.
    """
    given = path or os.environ.get("PEDZOO_ALEXNET")
    file = expanded(given) if given else obtain()
    if not file.is_file():
        raise UserError(f"no AlexNet weights at {given!r}: get {URLS[0]}, {_OR_GIVE}")
    try:
        if file.suffix == ".safetensors":
            tensors = load_file(file)
        else:
            tensors = torch.load(file, map_location="cpu", weights_only=True)
    except Exception as error:  # a damaged pickle can end in any
        raise UserError(f"{file} cannot be read as weights ({error}): delete it and get {URLS[0]}") from error
    # Through half precision always, so that features do not depend on the file's format.
    halved, digest = {}, hashlib.sha256()
    for key in KEYS:
        layer, _, kind = key.rpartition(".")
        shape = SHAPES[layer] if kind == "weight" else SHAPES[layer][:1]
        value = tensors.get(key) if isinstance(tensors, dict) else None
        if not isinstance(value, Tensor) or tuple(value.shape) != shape:
            raise UserError(
                f"{file} holds no AlexNet: expected {key} of shape {shape} as in torchvision's ({URLS[0]})"
            )
        halved[key] = value.half().contiguous()
        digest.update(halved[key].numpy().tobytes())
    if digest.hexdigest() != SHA256_FP16:
        raise UserError(
            f"{file} holds other AlexNet weights (sha256 over fp16 {digest.hexdigest()}, expected "
            f"{SHA256_FP16}), and features of others mean nothing to a trained model: delete it and get "
            f"{URLS[0]}"
        )
    return {key: value.float() for key, value in halved.items()}
