"""The tables of a score."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from pedzoo.data.text_format import is_recording
from pedzoo.eval.results import ResultTable, cell
from pedzoo.metrics.realism.bottlenecks import HEADWAYS
from pedzoo.metrics.realism.features import FEATURES
from pedzoo.metrics.realism.wosac import WEIGHTS

CROWDES = ("density", "coverage", "population", "kinematics", "dtw", "diversity", "collision")

TABLES = {
    "how near to the real crowd": (
        *("realism", "coarse_realism", "classifier_auc", "coarse_classifier_auc"),
        *("coarse_acceleration_p95_ratio", "coarse_acceleration_p99_ratio"),
    ),
    "realism by feature, coarse positions": tuple(f"coarse_w1_{name}" for name in FEATURES),
    "likelihood of what people did (8 s, 32 joint rollouts), and distance to it": (
        *("likelihood", *(f"likelihood_{name}" for name in WEIGHTS)),
        *("ade_8s_m", "min_ade_20_8s_m", "closed_loop_ade_m", "closed_loop_min_ade_3_m"),
    ),
    "standing, company and touching": (
        *("standing_share", "company_share", "companions_near_share", "lane_order"),
        *("agent_contacts_per_min", "wall_contacts_per_min"),
    ),
    "the opening": (
        *("opening_through_share", "specific_flow_per_m_s"),
        *(f"opening_headway_{name}_s" for name in HEADWAYS),
    ),
    "columns of CrowdES": tuple(f"crowdes_{name}" for name in CROWDES),
}
"""Columns of each table; the report has more."""


def pages(report: Mapping[str, Any]) -> list[ResultTable]:
    """Return the tables of a report of `pedzoo.eval.scoring.score.score`; columns without numbers are out."""
    rows, result = report["rows"], []
    for title, columns in TABLES.items():
        known = [key for key in columns if any(key in row["metrics"] for row in rows)]
        some = [row for row in rows if any(key in row["metrics"] for key in known)]
        body = [[_label(row), str(row["n"]), *(cell(row, key) for key in known)] for row in some]
        if known:
            result.append(ResultTable(title, ["crowd", "n", *known], body, 2))
    telling = [
        [_label(row), test, feature, f"{share:.0%}"]
        for row in rows
        for test, features in row.get("telling", {}).items()
        for feature, share in features.items()
    ]
    if telling:
        head = ["crowd", "test", "feature", "share of gain"]
        result.append(ResultTable("what the classifier goes by", head, telling, 3))
    return result


def _label(row: Mapping[str, Any]) -> str:
    """Return what tables call a crowd: files without their folders."""
    return Path(row["name"]).name if is_recording(row["name"]) else row["name"]
