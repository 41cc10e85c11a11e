"""The recordings of a training, their sources and their terms, for model cards."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from pedzoo.data.recordings import find_fold

_FREE = "MIT, as pedzoo"
"""Terms of recordings that pedzoo made itself."""

_NO_TRADE = "CC BY-NC 4.0"
"""Terms of masks that floor plans were drawn from."""


def provenance(fold: str | None, files: Sequence[str] | None = None, plans: bool = False) -> dict[str, Any]:
    """Return ``recordings``, ``source``, ``terms`` and ``citation`` of what a model was trained on.

    The dataset's class says them, see `pedzoo.data.recordings.Dataset`; a file is read, and never run.
    ``plans``: the model reads floor plans, too.
    """
    known = None if files else find_fold(fold)
    source = "recordings of one's own" if files else f"dataset {fold or 'unknown'}"
    recordings = [Path(file).name for file in files or ()]
    terms, citation = "unknown to pedzoo: ask who recorded them", "unknown to pedzoo"
    if known:
        recordings = known.trained
        source, citation = known.constant("SOURCE", source), known.constant("CITATION", citation)
        terms = known.constant("TERMS", terms) + known.constant("PLAN_TERMS", "") * plans
    return {"recordings": recordings, "source": source, "terms": terms, "citation": citation}


def licence(terms: str) -> str:
    """Return the licence of weights by the terms of what they were trained on.

    Weights are pedzoo's to give away where nothing but its own recordings went into them.
    """
    if terms.replace(_FREE, "").strip("; ") == "":
        return "MIT"
    return "terms of the recordings" + f" and {_NO_TRADE}" * (_NO_TRADE in terms)


def together(one: dict[str, Any], other: dict[str, Any]) -> dict[str, Any]:
    """Return what is said of a model that was trained on the data of both, one after the other."""
    texts = {key: "; ".join(dict.fromkeys((other[key], one[key]))) for key in ("source", "terms", "citation")}
    return {"recordings": sorted({*one["recordings"], *other["recordings"]}), **texts}
