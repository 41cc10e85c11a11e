"""``pedzoo download``: datasets, AlexNet's weights and models, to where pedzoo finds them."""

import os
from importlib import import_module
from pathlib import Path

from pedzoo.core.errors import UserError
from pedzoo.core.paths import data_home, expanded
from pedzoo.core.registry import DATASETS

HELP = "download a dataset, AlexNet's weights or a model, checked, to where they are found"
EXAMPLE = "pedzoo download eth_ucy"

ALEXNET = "alexnet"


def run(name: str, /, to: str | None = None) -> int:
    """Download, and print what came, where it is and on whose terms.

    Args:
        name: eth_ucy or another dataset, alexnet, or a model as `pedzoo info` takes it.
        to: Put a dataset into this folder; by default into one of the user's cache.
    """
    from pedzoo.data.published.files import published

    datasets = published()
    if name in datasets:
        _dataset(name, to)
        return 0
    if to:
        raise UserError(f"--to {to}: only for datasets ({', '.join(datasets)}), not {name!r}")
    print(_alexnet() if name == ALEXNET else _model(name, datasets))
    return 0


def _dataset(name: str, to: str | None) -> None:
    module = import_module(f"pedzoo.data.published.{name}")
    folder = expanded(to) if to else data_home() / name
    if folder.exists() and not folder.is_dir():
        raise UserError(f"{str(folder)!r} is a file, expected a folder: give another --to")
    print(f"terms: {module.TERMS}")
    print(f"cite: {module.CITATION}")
    files = module.download(folder)
    size = sum(file.size for file in files) / 1e6
    print(f"{name}: {len(files)} files, {size:.1f} MB, each with the expected sha256, in {folder}")
    found_without = not to and not os.environ.get("PEDZOO_DATA")
    fold = next(iter(DATASETS.constant(name, "FOLDS")))
    print(f"use: --data.fold {fold}{'' if found_without else f' --data.root {folder}'}")


def _alexnet() -> Path:
    from pedzoo.models.blocks.alexnet import obtain

    return obtain()


def _model(name: str, datasets: list[str]) -> Path:
    from pedzoo.models.zoo.store import find, no_model, weights_of

    if entry := find(name):
        return weights_of(entry)
    raise no_model(name, [*datasets, ALEXNET], "dataset or model")
