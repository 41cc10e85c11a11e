"""What others have printed: the paper on iGibson and the released Social GAN models, with their sources.

"The paper" extends Social GAN by a goal and a map and lets it walk in iGibson's social navigation. Its
numbers are those that the project's notes quote (facts ``baselines.md``, section 3, and ``igibson_orca.md``,
section 2). It prints FDE before ADE, and says neither how samples are scored nor how long a step of its
Table II is.
"""

from __future__ import annotations

from typing import Any, NamedTuple


class Errors(NamedTuple):
    """ADE and FDE, metres."""

    ade: float
    fde: float


class Printed(NamedTuple):
    """A row of the paper's Table I, and what stands beside it here.

    Attributes:
        label: As the paper calls it.
        errors: On ZARA1, 8 observed and 8 predicted steps.
        ours: Architecture of this zoo.
        goal: Goal protocol under which that is compared.
    """

    label: str
    errors: Errors
    ours: str
    goal: str


TABLE_1 = (
    Printed("SGAN", Errors(0.21, 0.42), "sgan", "none"),
    Printed("Social-VRNN", Errors(0.41, 0.70), "social_vrnn", "none"),
    Printed("SGAN + goal", Errors(0.07, 0.07), "sgan_goal", "window_end"),
    Printed("SGAN + goal + image (partial)", Errors(0.17, 0.27), "sgan_goal_map_alexnet", "window_end"),
)
"""The paper's Table I. SGAN's row equals the best of 20 of the released SGAN-20V-20 (`RELEASED`)."""


class Released(NamedTuple):
    """Best of 20 per scene of a released Social GAN, by fold.

    Attributes:
        label: As its authors call it.
        ours: Architecture of this zoo with the same parts.
        errors: By fold, for 8 or 12 predicted steps.
    """

    label: str
    ours: str
    errors: dict[int, dict[str, Errors]]

    def plain(self) -> dict[str, Any]:
        """Return it as it is in JSON."""
        errors = {
            str(steps): {fold: value._asdict() for fold, value in by_fold.items()}
            for steps, by_fold in self.errors.items()
        }
        return {"label": self.label, "ours": self.ours, "errors": errors}


FOLDS = ("eth", "hotel", "univ", "zara1", "zara2")


def _by_fold(*pairs: tuple[float, float]) -> dict[str, Errors]:
    return {fold: Errors(*pair) for fold, pair in zip(FOLDS, pairs, strict=True)}


RELEASED = (
    Released(
        "SGAN-20V-20 (released)",
        "sgan",
        {
            8: _by_fold((0.58, 1.13), (0.36, 0.71), (0.33, 0.70), (0.21, 0.42), (0.21, 0.42)),
            12: _by_fold((0.71, 1.29), (0.48, 1.02), (0.56, 1.18), (0.34, 0.69), (0.31, 0.64)),
        },
    ),
    Released(
        "SGAN-20VP-20 (released)",
        "sgan_pool",
        {
            8: _by_fold((0.57, 1.14), (0.38, 0.73), (0.42, 0.79), (0.22, 0.43), (0.24, 0.48)),
            12: _by_fold((0.77, 1.39), (0.43, 0.88), (0.75, 1.50), (0.34, 0.68), (0.36, 0.73)),
        },
    ),
)
"""github.com/agrimgupta92/sgan, MODEL_ZOO.md; one sample for all people of a window."""

TABLE_2_STEPS = {(2, 3): 227, (2, 5): 300, (3, 3): 139, (3, 5): 280, (5, 3): 265}
"""The paper's Table II: total steps of its learned model in one run of each cell, people and goals."""

TABLE_2_GOALS = {cell: cell[1] for cell in TABLE_2_STEPS} | {(5, 3): 5}
"""Goals that all reach there at least: with five people and three goals it lists at least five."""

DEFAULT_STEPS_PER_GOAL = 100
"""Steps per goal that the paper compares these with."""

IGIBSON_STEP = 0.1
"""Seconds of a step of iGibson's social navigation (``action_timestep``)."""


FIGURE_4 = {
    "orca:radius=0.5": "blocked",
    "orca:radius=0.1": "circular pattern of a radius of about 0.1 m",
}
"""What the paper shows in its Figure 4, as far as the notes quote it."""
