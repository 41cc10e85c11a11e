"""Names of policies and of mixed crowds: ``orca:share=0.5+approach_net_goal_map.indoor``. Needs no torch.

The policies of a crowd are joined by ``+``. The setting ``share`` belongs to the team, not to the policy. A
``+`` does not join policies in these places:

* in brackets, and in a number (``1e+3``);
* in the name of a file or folder that exists;
* in a path or an address. There it joins if the name of a policy, of a model or of a file that exists
  follows, or an address.
"""

import math
import os
import re

from pedzoo.core.errors import UserError
from pedzoo.core.paths import expanded
from pedzoo.core.registry import MODELS, POLICIES, names_code
from pedzoo.core.spec import name_of, parse, split
from pedzoo.models.zoo.card import is_name
from pedzoo.models.zoo.store import is_address, names

_SHARE = "share"
_ROUNDING = 1e-6


def parts(text: str) -> list[str]:
    """Return the policies that are joined in a text, each with its settings and its ``share``."""
    pieces = split(text, "+")
    result = pieces[:1]
    for place in range(1, len(pieces)):
        if _goes_on(result[-1], pieces[place:]):
            result[-1] += f"+{pieces[place]}"
        else:
            result.append(pieces[place])
    return [part.strip() for part in result]


def is_crowd(text: str) -> bool:
    """Return whether a text is a crowd of teams: several policies, or one with a ``share``."""
    result = parts(text)
    return len(result) > 1 or (":" in text and _SHARE in parse(text).settings)


def members(text: str) -> list[tuple[str, float]]:
    """Return the teams of a crowd: their policies with settings, and their shares of the agents.

    Those without a share have equal parts of what the others leave.

    Raises:
        UserError: A share is no positive number, or the shares do not sum to 1.
    """
    shares: list[tuple[str, float | None]] = []
    for part in parts(text):
        if not part:
            raise UserError(
                f"{text!r:.200}: a policy is missing beside '+': expected orca:share=0.5+go_to_goal"
            )
        name, settings = parse(part)
        own = ",".join(f"{key}={value}" for key, value in settings.items() if key != _SHARE)
        share = _share_of(part, settings[_SHARE]) if _SHARE in settings else None
        shares.append((f"{name}:{own}" if own else name, share))
    without = [policy for policy, share in shares if share is None]
    given = sum(share or 0.0 for _, share in shares)
    rest, wrong = 1 - given, ""
    if rest < -_ROUNDING:
        wrong = f"the shares sum to {given:g}: expected at most 1; make them smaller"
    elif not without and rest > _ROUNDING:
        wrong = f"the shares sum to {given:g}, and the rest has no policy: leave out one share, "
        wrong += "which then is the rest, or make them larger"
    elif without and rest <= _ROUNDING:
        wrong = f"nothing is left for {without[0]!r:.200}: make the other shares smaller"
    if wrong:
        raise UserError(f"{text!r:.200}: {wrong}")
    return [(one, rest / len(without) if share is None else share) for one, share in shares]


def _share_of(part: str, text: str) -> float:
    try:
        share = float(text)
    except ValueError:
        share = math.nan
    if not 0 < share < math.inf:
        raise UserError(f"{part!r:.200}: share {text:.200}: expected a number above 0, at most 1")
    return share


def _goes_on(before: str, pieces: list[str]) -> bool:
    """Return whether a policy's text goes on behind the ``+``, with the first of the pieces."""
    if re.search(r"\d\.?[eE]$", before) and pieces[0][:1].isdigit():
        return True
    # the name, or the value of the last setting
    value = re.split(r"[:,]\s*\w+\s*=", before)[-1]
    if re.search(r"\.py:\w+\s*$", value):
        return False
    joined = ["+".join(pieces[:count]) for count in range(1, len(pieces) + 1)]
    if any(_exists(f"{value}+{ahead}") for ahead in joined):
        return True
    return "/" in value and not any(is_policy(ahead) for ahead in joined)


def is_policy(text: str) -> bool:
    """Return whether a text without settings names a policy, a model or a file that exists."""
    name = name_of(text.strip())
    if is_name(name) and name.partition(".")[0] in MODELS.names():
        return True
    return is_address(name) or name in (*POLICIES.names(), *MODELS.names(), *names()) or _exists(text)


def _exists(text: str) -> bool:
    """Return whether the name in a text is that of a file, or of a model in a folder."""
    name = str(expanded(name_of(text.strip())))
    file = name.rpartition(":")[0] if names_code(name) else name
    return os.path.exists(file) or os.path.exists(f"{file}.yaml")
