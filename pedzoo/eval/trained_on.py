"""Which recordings the weights of a policy were trained on, and which others of the zoo were not."""

from typing import Any

from pedzoo.core.paths import weight_files
from pedzoo.core.spec import parse
from pedzoo.data.recordings import find_fold
from pedzoo.models.zoo.card import read_config
from pedzoo.models.zoo.loading import read_checkpoint
from pedzoo.models.zoo.store import find
from pedzoo.policies.crowd_names import parts


def for_fold(policy: str, fold: str) -> str:
    """Return the policy to walk on a fold: where there are any, weights that did not see it.

    Weights are named after the fold that they did not see. On hotel ``sgan_goal.zara1:noise=step`` becomes
    ``sgan_goal.hotel:noise=step``, and ``approach_net_goal.indoor``, of all recordings, becomes
    ``approach_net_goal.indoor_hotel``.
    Anything else stays as it is. In a mixed crowd this holds for each policy.
    """
    return "+".join(_for_fold(part, fold) for part in parts(policy))


def _for_fold(policy: str, fold: str) -> str:
    name, to, known = parse(policy).name, find_fold(fold), weight_files()
    if name not in known or not to or (held_out := find_fold(_held_out(name))) in (None, to):
        return policy
    architecture, _, tag = name.partition(".")
    other = f"{architecture}.{tag.replace(held_out.name, to.name, 1)}"
    if held_out.whole and f"{name}_{to.name}" in known:
        other = f"{name}_{to.name}"
    return policy.replace(name, other, 1) if other in known else policy


def has_seen(policy: str, fold: str) -> bool:
    """Return whether weights in a policy were trained on the test recordings of a fold."""
    return any(_has_seen(part, fold) for part in parts(policy))


def _has_seen(policy: str, fold: str) -> bool:
    name, to = parse(policy).name, find_fold(fold)
    if not to or not to.tested:
        return False
    if entry := find(name):
        return not set(to.tested).isdisjoint(entry.card.data["recordings"])
    held_out = find_fold(_held_out(name))
    return held_out is not None and held_out.dataset == to.dataset and held_out.name != to.name


def _held_out(name: str) -> str | None:
    """Return the fold that weights were trained for, which is what they did not see; None without weights."""
    config: dict[str, Any] = {}
    if (file := weight_files().get(name)) or name.endswith(".safetensors"):
        config = read_config(file or name)
    elif name.endswith(".ckpt"):
        config = read_checkpoint(name)["pedzoo"]
    # pedzoo fit writes down its data, the zoo also the training
    return config.get("training", config.get("protocol", {})).get("fold")
