"""Which recordings a training saw, where they come from and on whose terms, for model cards."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from pedzoo.data.datasets.eth_ucy import EVERYTHING, SCENES

TESTED = {
    "eth": ["biwi_eth"],
    "hotel": ["biwi_hotel"],
    "univ": ["students001", "students003"],
    "zara1": ["crowds_zara01"],
    "zara2": ["crowds_zara02"],
}
"""Recordings that a fold of ETH/UCY is tested on: all that its training leaves out."""

ALWAYS_TRAINED = ["crowds_zara03", "uni_examples"]
"""Recordings of tested scenes that no fold leaves out."""

ETH_UCY = {
    "source": "ETH (BIWI walking pedestrians) and UCY (crowds by example), split as by Social GAN; "
    "`pedzoo download eth_ucy`",
    "terms": "ETH is public for research, without a licence text; UCY may be used with credit to its authors",
    "citation": "S. Pellegrini, A. Ess, K. Schindler, L. Van Gool, You'll never walk alone, ICCV 2009; "
    "A. Lerner, Y. Chrysanthou, D. Lischinski, Crowds by example, Computer Graphics Forum 26(3), 2007",
}

FLOOR_PLANS = (
    "; the floor plans were drawn from scene masks under CC BY-NC 4.0 (LMTrajectory) and the obstacles of ETH"
)

EMBEDDED = {
    "recordings": ["plaza_train"],
    "source": "pedzoo's embedded recordings: synthetic people on a made-up plaza, no human data",
    "terms": "MIT, as pedzoo",
    "citation": "none: do not report results on them as if they said something about people",
}


def provenance(fold: str | None, files: Sequence[str] | None = None, plans: bool = False) -> dict[str, Any]:
    """Return ``recordings``, ``source``, ``terms`` and ``citation`` of what a model was trained on.

    Args:
        fold: As of the data; None where it is not known.
        files: Recordings of one's own.
        plans: The model reads floor plans, too.
    """
    if files:
        return _of_others([Path(file).name for file in files], "recordings of one's own")
    if fold in (*SCENES, EVERYTHING):
        seen = [name for scene in SCENES if scene != fold for name in TESTED[scene]]
        terms = ETH_UCY["terms"] + FLOOR_PLANS * plans
        return {"recordings": sorted([*seen, *ALWAYS_TRAINED]), **ETH_UCY, "terms": terms}
    return EMBEDDED if fold == "embedded" else _of_others([], f"dataset {fold or 'unknown'}")


def together(one: dict[str, Any], other: dict[str, Any]) -> dict[str, Any]:
    """Return what is said of a model that was trained on the data of both, one after the other."""
    texts = {key: "; ".join(dict.fromkeys((other[key], one[key]))) for key in ("source", "terms", "citation")}
    return {"recordings": sorted({*one["recordings"], *other["recordings"]}), **texts}


def _of_others(recordings: list[str], source: str) -> dict[str, Any]:
    terms = "unknown to pedzoo: ask who recorded them"
    return {"recordings": recordings, "source": source, "terms": terms, "citation": "unknown to pedzoo"}
