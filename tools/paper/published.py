"""What others have printed: the paper on iGibson, released models, forecasters, and robots in CrowdNav.

"The paper" extends Social GAN by a goal and a map and lets it walk in iGibson's social navigation. Its
numbers are second hand. It prints FDE before ADE, and says neither how samples are scored nor how long a step
of its Table II is.
"""

from __future__ import annotations

from itertools import zip_longest
from statistics import fmean
from typing import Any, NamedTuple

FOLDS = ("eth", "hotel", "univ", "zara1", "zara2")


def errors(ade: float, fde: float) -> dict[str, float]:
    """Return ADE and FDE, metres."""
    return {"ade": ade, "fde": fde}


def mean_errors(by_fold: dict[str, dict[str, float]]) -> dict[str, float]:
    """Return the means over the folds of errors that others printed."""
    return {key: fmean(one[key] for one in by_fold.values()) for key in ("ade", "fde")}


def _by_fold(*pairs: tuple[float, float]) -> dict[str, dict[str, float]]:
    return {fold: errors(*pair) for fold, pair in zip(FOLDS, pairs, strict=True)}


TABLE_1 = [
    {"label": label, "errors": errors(*printed), "ours": ours, "goal": goal}
    for label, printed, ours, goal in (
        ("SGAN", (0.21, 0.42), "sgan", "none"),
        ("Social-VRNN", (0.41, 0.70), "social_vrnn", "none"),
        ("SGAN + goal", (0.07, 0.07), "sgan_goal", "window_end"),
        ("SGAN + goal + image (partial)", (0.17, 0.27), "sgan_goal_map", "window_end"),
    )
]
"""The paper's Table I on ZARA1, 8 observed and 8 predicted steps, and what stands beside each row here.

SGAN's row equals the best of 20 of the released SGAN-20V-20 (`RELEASED`)."""

RELEASED: list[dict[str, Any]] = [
    {
        "label": "SGAN-20V-20 (released)",
        "ours": "sgan_nopool",
        "errors": {
            "8": _by_fold((0.58, 1.13), (0.36, 0.71), (0.33, 0.70), (0.21, 0.42), (0.21, 0.42)),
            "12": _by_fold((0.71, 1.29), (0.48, 1.02), (0.56, 1.18), (0.34, 0.69), (0.31, 0.64)),
        },
    },
    {
        "label": "SGAN-20VP-20 (released)",
        "ours": "sgan",
        "errors": {
            "8": _by_fold((0.57, 1.14), (0.38, 0.73), (0.42, 0.79), (0.22, 0.43), (0.24, 0.48)),
            "12": _by_fold((0.77, 1.39), (0.43, 0.88), (0.75, 1.50), (0.34, 0.68), (0.36, 0.73)),
        },
    },
]
"""Best of 20 per scene, by steps and fold: github.com/agrimgupta92/sgan, MODEL_ZOO.md; one sample for all
people of a window. ``ours`` is the architecture of this zoo with the same parts."""

TABLE_2_STEPS = {(2, 3): 227, (2, 5): 300, (3, 3): 139, (3, 5): 280, (5, 3): 265}
"""The paper's Table II: total steps of its learned model in one run of each cell, people and goals."""

TABLE_2_PARITY = {
    (2, 3): (3, 3),
    (2, 5): (5, 8),
    (3, 3): (3, 4, 3),
    (3, 5): (5, 5, 5),
    (5, 3): (5, 5, 5, 5, 7),
}
"""Goals that each person reaches there: with five people and three goals it lists at least five."""

DEFAULT_STEPS_PER_GOAL = 100
"""Steps per goal that the paper compares these with."""

IGIBSON_STEP = 0.1
"""Seconds of a step of iGibson's social navigation (``action_timestep``)."""

FIGURE_4 = {
    "orca 0.5": "the pedestrians are blocked due to the lack of free space for ORCA's collision avoidance "
    "mechanism",
    "orca 0.1": "although the two pedestrians could successfully reach their goals, the pedestrians' "
    "trajectories form a circular pattern with a radius around 0.1m",
    "learned": "the blue pedestrian stops to let the red pedestrian with faster speed to pass first. "
    "Moreover, the pedestrians successfully figure out collision-free and socially acceptable movements to "
    "pass through the door without sticking their trajectories to a circular pattern",
}
"""The paper's words on what its Figure 4 shows: ORCA of radius 0.5 and of 0.1, and its modified SGAN."""


def _peer(name: str, leak: str, mean: tuple[float, float], *folds: tuple[float, float]) -> dict[str, Any]:
    return {"name": name, "leak": leak, "mean": errors(*mean), "folds": [errors(*one) for one in folds]}


PEERS = [
    _peer("Social GAN (paper)", "per scene, so larger than per person", (0.58, 1.18)),
    _peer("Trajectron++, without its leak", "none known", (0.32, 0.55)),
    _peer("PECNet", "none known", (0.29, 0.48)),
    _peer("SocialVAE", "none known", (0.24, 0.42)),
    _peer("GeoTDM", "none known", (0.24, 0.40)),
    _peer(
        *("TUTR", "epoch chosen on the test set (its train.py)", (0.21, 0.36)),
        *((0.40, 0.61), (0.11, 0.18), (0.23, 0.42), (0.18, 0.34), (0.13, 0.25)),
    ),
    _peer(
        *("EigenTrajectory-LB-EBM", "none known: chosen on validation, the fair peer", (0.21, 0.34)),
        *((0.36, 0.53), (0.12, 0.19), (0.24, 0.43), (0.19, 0.33), (0.14, 0.24)),
    ),
    _peer("SingularTrajectory", "not checked", (0.21, 0.32)),
    _peer("MoRE", "20 clusters of many samples", (0.21, 0.28)),
    _peer("MoFlow", "one person per scene is scored (its issue 3)", (0.20, 0.32)),
]
"""Best of 20 on ETH/UCY, 8 -> 12, for each person: mean of the folds, and each fold where it is quoted.

``leak`` is what makes a number smaller than a fair one, as far as it is known. Second hand, from the
project's notes (facts ``forecast_floor.md``), with two digits as printed."""

QUIRKS = (
    "future derivatives as inputs: Trajectron++ as first published, whose row here is the corrected one",
    "eth at .667 s per step called .4 s: everybody's windows, ours too (`--data.clock true` resamples)",
    "minima of ADE and FDE taken from different samples: everybody's, ours too; the column FDE of the "
    "best by ADE is without it",
    "the test epoch chosen on the test set: TUTR, Y-Net",
    "test-time sampling (TTST: 10,000 samples clustered to 20): Y-Net; clustering of samples: MoRE",
    "univ trained on students003, one of its own test recordings: some",
    "people who are seen in all 20 frames are the only neighbours that Social GAN's windows have: "
    "everybody's, ours too",
)
"""What to ask of any row of such a table."""

ORCA_PP = "crowdnav_orca:max_neighbors=20,safety_space=0.15"
"""CrowdNav++'s robot with ORCA."""

_SECOND_HAND = "ICRA 2019 paper, second hand"
_LOG = "shipped test log"
_KEYS = ("robot", "ours", "success", "collision", "time_s", "source", "intrusion_ratio")

CROWDNAV_ROWS: dict[str, list[dict[str, str]]] = {
    setting: [dict(zip_longest(_KEYS, row, fillvalue="")) for row in rows]
    for setting, rows in {
        "crowdnav": (
            ("ORCA", "crowdnav_orca", ".43", ".57", "10.86", _SECOND_HAND),
            ("CADRL", "", ".78", ".22", "10.80", _SECOND_HAND),
            ("LSTM-RL", "", ".95", ".03", "11.82", _SECOND_HAND),
            ("SARL", "", ".99 or 1.00", ".00", "10.55", f"{_SECOND_HAND}: two notes disagree"),
            ("LM-SARL", "", "1.00", ".00", "10.46", _SECOND_HAND),
        ),
        "crowdnav_visible": (
            ("ORCA", "crowdnav_orca:safety_space=0.15", ".99", "-", "12.29", "second hand"),
        ),
        "crowdnav_pp": (
            ("GST, attention", "", ".92", ".07", "15.42", f"{_LOG}, other cases", "4.23 %"),
            ("social force", "crowdnav_social_force", ".34", ".64", "19.95", _LOG, "21.35 %"),
            ("ORCA", ORCA_PP, ".69", ".29", "14.77", f"{_LOG}, of random people", "19.61 %"),
        ),
    }.items()
}
"""Robots of others by setting, and ours that is the same, if there is one. ``success`` and ``collision`` are
shares of cases, ``time_s`` is the mean of successful ones, ``intrusion_ratio`` that of a case's steps in
which the robot intrudes. Papers: Chen et al., ICRA 2019 (CrowdNav); Liu et al., ICRA 2023 (CrowdNav++);
logs: github.com/Shuijing725/CrowdNav_Prediction_AttnGraph, ``trained_models/*/test``."""


class Log(NamedTuple):
    """How the cases of a log of CrowdNav++ ended; its 500 runs are 250 cases twice."""

    name: str  # folder of ``trained_models``
    robot: str  # the robot here that is the same
    first: int  # seed of the first case; case k has ``first + 2 k``
    outcomes: str  # a letter for each case: success, collision, timeout

    @property
    def seeds(self) -> list[int]:
        """The seeds of the cases."""
        return [self.first + 2 * number for number in range(len(self.outcomes))]


SOCIAL_FORCE_LOG = Log(
    "SF_no_rand",
    "crowdnav_social_force",
    1425,
    "ccsscssccscccctccscscccccsssscssccssccccscccsccccs"
    "scsccccctcsctsctcscscccsssccccssccscscccccscccsscc"
    "cccccccccscscscssscssccccsccccccsccccccctsccccsccs"
    "cssscsccscssscccsscccsccccccccccscccccscssccccsccc"
    "sccsccssscccscscscccscscscccscccssscsssccccsscctss",
)

ORCA_LOG = Log(
    "ORCA_no_rand",
    ORCA_PP,
    1425,
    "csscsccscsssccsscsssccsssssstsccsscscsscsscsssccsc"
    "scssscsssssscsssssssscsssssscssssssssccscscscsssss"
    "sscsccssscssccscscccccscsscsssccscsssscssscsssssss"
    "tsscsssssscscssssssssscssscsssscscssssscscsscssscs"
    "cssssscsssscsscsssscssscssscssssssstcsstssscccsccc",
)
