"""What all trainings at the command line share: config files with what they inherit, and a progress bar."""

import os
from collections.abc import Mapping
from types import MappingProxyType
from typing import Any

import yaml
from jsonargparse import Namespace
from lightning.pytorch.callbacks import RichProgressBar
from lightning.pytorch.cli import LightningArgumentParser

from pedzoo.cli.parsing import PARSER_SETTINGS
from pedzoo.core.configs import load_config


class ProgressBar(RichProgressBar):
    """Lightning's bar without the version, which here is the name of the run folder."""

    def get_metrics(self, *args: Any) -> dict[str, Any]:
        """Return what is shown beside the bar."""
        return {key: value for key, value in super().get_metrics(*args).items() if key != "v_num"}


class ConfigParser(LightningArgumentParser):
    """Reads config files with what they inherit.

    Attributes:
        classes: Those that the command line and its config files name, by their place.
    """

    classes: Mapping[str, str] = MappingProxyType({})

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        """Make a parser, also one of a class within: these have no settings of `PARSER_SETTINGS`."""
        super().__init__(*args, **PARSER_SETTINGS | kwargs)

    def parse_path(self, path: str | os.PathLike, *args: Any, **kwargs: Any) -> Namespace:
        """Parse a config file; arguments as of jsonargparse's."""
        whole = yaml.safe_dump(load_config(os.fspath(path), self.classes), sort_keys=False)
        return self.parse_string(whole, os.path.basename(path), *args, **kwargs)
