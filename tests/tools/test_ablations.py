"""The ablations change those settings of the walker's config that they name, and no others."""

import pytest
import yaml

from pedzoo.cli.main import main
from tools.zoo.ablations import CONFIG, PARTS


def printed(capsys: pytest.CaptureFixture[str], settings: dict[str, str]) -> dict:
    """Return the whole config of a training with ``settings``, as `pedzoo fit --print_config` prints it."""
    options = [word for key, value in settings.items() for word in (f"--{key}", value)]
    with pytest.raises(SystemExit, match="0"):
        main(["fit", "--config", CONFIG, *options, "--print_config"])
    return yaml.safe_load(capsys.readouterr().out)


def flat(config: dict, place: str = "") -> dict[str, object]:
    """Return the settings of nested groups by their dotted names."""
    result: dict[str, object] = {}
    for key, value in config.items():
        result |= flat(value, f"{place}{key}.") if isinstance(value, dict) else {f"{place}{key}": value}
    return result


def test_ablations_change_what_they_name(capsys: pytest.CaptureFixture[str]) -> None:
    together = {key: value for settings in PARTS.values() for key, value in settings.items()}
    whole, changed = flat(printed(capsys, {})), flat(printed(capsys, together))
    differences = {key for key in whole | changed if whole.get(key) != changed.get(key)}
    assert {key.replace(".init_args", "") for key in differences} == {
        key.replace(".init_args", "") for key in together
    }
