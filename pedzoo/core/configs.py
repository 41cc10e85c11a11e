"""Config files with the values that they inherit (``base: sgan_goal``), and scenarios as texts."""

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from pedzoo.core.errors import UserError
from pedzoo.core.paths import find_config
from pedzoo.core.spec import with_settings
from pedzoo.core.untrusted import check_yaml, read_mapping

_OF_COURSE = ("scenes", "share", "planner")
"""A course's own keys beside ``scenario``; its other keys are settings of that."""


def load_config(name: str | Path) -> dict[str, Any]:
    """Return the settings of a config with those of its bases.

    Args:
        name: A shipped config's name or a file. A base is one of these, or a file beside the config.

    Raises:
        UserError: There is no such config or base, the bases go in a circle, or a file is no YAML mapping.
    """
    return _with_scenarios(_loaded(find_config(str(name)), ()))


def merged(base: Mapping[str, Any], changes: Mapping[str, Any]) -> dict[str, Any]:
    """Return ``base`` with ``changes``: mappings are merged key by key, all other values replaced.

    Another ``class_path`` takes other arguments: the ``init_args`` of the base are left out there.
    """
    result = dict(base)
    if "class_path" in changes and changes["class_path"] != base.get("class_path"):
        result.pop("init_args", None)
    for key, value in changes.items():
        before = result.get(key)
        if isinstance(before, Mapping) and isinstance(value, Mapping):
            value = merged(before, value)
        result[key] = value
    return result


def _loaded(path: Path, above: tuple[Path, ...]) -> dict[str, Any]:
    chain = (*above, path.resolve())
    if chain[-1] in above:
        circle = " -> ".join(file.stem for file in chain[above.index(chain[-1]) :])
        raise UserError(f"config {str(path)!r} is its own base: {circle}; remove one of these bases")
    settings = read_mapping(path, "config", "a mapping such as 'model: ...'")
    try:
        check_yaml(settings)
    except UserError as error:
        raise UserError(f"config {str(path)!r}: a text in it {error}") from error
    for key in (one for one in _keys(settings) if not isinstance(one, str)):
        raise UserError(f"config {str(path)!r}: {key!r:.60} stands in the place of an option's name")
    if (base := settings.pop("base", None)) is None:
        return settings
    if not isinstance(base, str):
        raise UserError(f"config {str(path)!r}: expected the name of one config as base, not {base!r:.60}")
    beside = path.parent / base
    try:
        file = beside if beside.is_file() else find_config(base)
    except UserError as error:
        raise UserError(f"base of config {str(path)!r}: {error}") from error
    except OSError as error:  # no file has so long a name
        raise UserError(f"base of config {str(path)!r}: {base!r:.60}: {error.strerror}") from error
    return merged(_loaded(file, chain), settings)


def _keys(settings: Any) -> Iterator[Any]:
    """Yield all keys in settings, at any depth of mappings."""
    if isinstance(settings, dict):
        yield from settings
        for value in settings.values():
            yield from _keys(value)


def _with_scenarios(settings: Any) -> Any:
    """Return settings with texts in place of the mappings of ``courses`` and ``scenarios``."""
    if not isinstance(settings, dict):
        return settings
    result = {key: _with_scenarios(value) for key, value in settings.items()}
    for key in ("courses", "scenarios"):
        if isinstance(items := result.get(key), list):
            result[key] = [
                _as_text(item, key == "courses") if isinstance(item, dict) else item for item in items
            ]
    return result


def _as_text(item: Mapping[str, Any], is_course: bool) -> Any:
    """Return ``{scenario: door, width: 0.9}`` as ``door:width=0.9``; in a course, beside its own keys."""
    own = {key: item[key] for key in _OF_COURSE if is_course and key in item}
    name = item.get("scenario")
    if not isinstance(name, str):
        raise UserError(f"scenario {item!r:.80}: expected its name, as in {{scenario: door, width: 0.9}}")
    text = with_settings(name, {key: item[key] for key in item if key != "scenario" and key not in own})
    return own | {"scenario": text} if is_course else text
