"""What others have printed of a best of 20 on ETH/UCY, 8 -> 12, and what helps their numbers."""

from __future__ import annotations

from typing import Any, NamedTuple

from tools.paper.paper import Errors


class Peer(NamedTuple):
    """A row of others: the best of 20 for each person, minima of ADE and FDE of samples of their own.

    Attributes:
        name: As they call it.
        leak: What makes the number smaller than a fair one, as far as it is known.
        mean: Of the five folds.
        folds: Of each fold in the order of `tools.paper.paper.FOLDS`; empty where only the mean is quoted.
    """

    name: str
    leak: str
    mean: Errors
    folds: tuple[Errors, ...] = ()

    def plain(self) -> dict[str, Any]:
        """Return it as it is in JSON."""
        return self._asdict() | {"mean": self.mean._asdict(), "folds": [one._asdict() for one in self.folds]}


def _of(*pairs: tuple[float, float]) -> tuple[Errors, ...]:
    return tuple(Errors(*pair) for pair in pairs)


PEERS = (
    Peer("Social GAN (paper)", "per scene, so larger than per person", Errors(0.58, 1.18)),
    Peer("Trajectron++, without its leak", "none known", Errors(0.32, 0.55)),
    Peer("PECNet", "none known", Errors(0.29, 0.48)),
    Peer("SocialVAE", "none known", Errors(0.24, 0.42)),
    Peer("GeoTDM", "none known", Errors(0.24, 0.40)),
    Peer(
        "TUTR",
        "epoch chosen on the test set (its train.py)",
        Errors(0.21, 0.36),
        _of((0.40, 0.61), (0.11, 0.18), (0.23, 0.42), (0.18, 0.34), (0.13, 0.25)),
    ),
    Peer(
        "EigenTrajectory-LB-EBM",
        "none known: chosen on validation, the fair peer",
        Errors(0.21, 0.34),
        _of((0.36, 0.53), (0.12, 0.19), (0.24, 0.43), (0.19, 0.33), (0.14, 0.24)),
    ),
    Peer("SingularTrajectory", "not checked", Errors(0.21, 0.32)),
    Peer("MoRE", "20 clusters of many samples", Errors(0.21, 0.28)),
    Peer("MoFlow", "one person per scene is scored (its issue 3)", Errors(0.20, 0.32)),
)
"""Second hand, from the project's notes (facts ``forecast_floor.md``), with two digits as printed."""

QUIRKS = (
    "future derivatives as inputs: Trajectron++ as first published, whose row here is the corrected one",
    "eth at .667 s per step called .4 s: everybody's windows, ours too (`--data.clock true` resamples)",
    "minima of ADE and FDE taken from different samples: everybody's, ours too; the column FDE of the "
    "best by "
    "ADE is without it",
    "the test epoch chosen on the test set: TUTR, Y-Net",
    "test-time sampling (TTST: 10,000 samples clustered to 20): Y-Net; clustering of samples: MoRE",
    "univ trained on students003, one of its own test recordings: some",
    "people who are seen in all 20 frames are the only neighbours that Social GAN's windows have: "
    "everybody's, "
    "ours too",
)
"""What to ask of any row of such a table."""
