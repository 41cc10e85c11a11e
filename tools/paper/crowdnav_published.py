"""What others have printed of robots in CrowdNav and CrowdNav++, with the cases that they tested."""

from __future__ import annotations

from typing import NamedTuple


class Published(NamedTuple):
    """A row of others.

    Attributes:
        robot: As they call it.
        ours: The robot here that is the same; empty: there is none.
        success: Share of cases.
        collision: Share of cases.
        time_s: Mean of the successful cases, seconds.
        source: Where it is printed.
        intrusion_ratio: Mean share of a case's steps in which the robot intrudes; empty: not printed.
    """

    robot: str
    ours: str
    success: str
    collision: str
    time_s: str
    source: str
    intrusion_ratio: str = ""


_SECOND_HAND = "ICRA 2019 paper, second hand"
_LOG = "shipped test log"

ORCA_PP = "crowdnav_orca:max_neighbors=20,safety_space=0.15"
"""CrowdNav++'s robot with ORCA."""

PUBLISHED = {
    "crowdnav": (
        Published("ORCA", "crowdnav_orca", ".43", ".57", "10.86", _SECOND_HAND),
        Published("CADRL", "", ".78", ".22", "10.80", _SECOND_HAND),
        Published("LSTM-RL", "", ".95", ".03", "11.82", _SECOND_HAND),
        Published("SARL", "", ".99 or 1.00", ".00", "10.55", f"{_SECOND_HAND}: two notes disagree"),
        Published("LM-SARL", "", "1.00", ".00", "10.46", _SECOND_HAND),
    ),
    "crowdnav_visible": (
        Published("ORCA", "crowdnav_orca:safety_space=0.15", ".99", "-", "12.29", "second hand"),
    ),
    "crowdnav_pp": (
        Published("GST, attention", "", ".92", ".07", "15.42", f"{_LOG}, other cases", "4.23 %"),
        Published("social force", "crowdnav_social_force", ".34", ".64", "19.95", _LOG, "21.35 %"),
        Published("ORCA", ORCA_PP, ".69", ".29", "14.77", f"{_LOG}, of random people", "19.61 %"),
    ),
}
"""By setting. Papers: Chen et al., ICRA 2019 (CrowdNav); Liu et al., ICRA 2023 (CrowdNav++); logs:
github.com/Shuijing725/CrowdNav_Prediction_AttnGraph, ``trained_models/*/test``."""


class Log(NamedTuple):
    """How the cases of a log of CrowdNav++ ended.

    Its 500 runs are 250 cases twice. Each run is reset twice, at the end of the one before and at its own
    start, and the number of the case goes on at each, modulo 500.

    Attributes:
        name: Folder of ``trained_models``.
        robot: The robot here that is the same.
        first: Seed of the first case; case k has ``first + 2 k``.
        outcomes: A letter for each case: success, collision, timeout.
    """

    name: str
    robot: str
    first: int
    outcomes: str

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
