"""Model cards for tests."""

from __future__ import annotations

from typing import Any

from pedzoo.models.zoo.card import ModelCard


def make_card(name: str = "sgan_goal.zara1", **changed: Any) -> ModelCard:
    """Return a card with everything in it, and what is ``changed``."""
    report = {
        "command": "forecast",
        "protocol": {"fold": "zara1", "goal": "window_end", "pred_len": 8, "samples": 20},
        "seeds": [0],
        "versions": {"pedzoo": "0.1.0"},
        "rows": [
            {
                "name": name,
                "case": {"fold": "zara1", "split": "test"},
                "n": 2875,
                "metrics": {"ade_m": 0.0571, "fde_m": 0.0086},
                "ci95": {},
            }
        ],
    }
    door = {
        "command": "evaluate",
        "protocol": {
            "suites": ["door", "goals"],
            "quick": True,
            "deterministic": False,
            "warm_start": {"door": "orca"},
        },
        "seeds": [0],
        "versions": {"pedzoo": "0.1.0"},
        "rows": [
            {
                "name": name,
                "table": "door",
                "case": {"suite": "door", "physics": "bullet"},
                "n": 40,
                "metrics": {"success": 0.975},
                "ci95": {"success": [0.871, 0.996]},
            }
        ],
    }
    values: dict[str, Any] = {
        "name": name,
        "architecture": "sgan",
        "sha256": "0123456789abcdef" * 4,
        "size": 192920,
        "config": {
            "architecture": "sgan",
            "init": {"goal_dim": 16, "map": None},
            "goal": "window_end",
            "protocol": {"fold": "zara1", "goal": "window_end", "clock": "benchmark", "pred_len": 8},
            "training": {"config": "sgan_goal", "fold": "zara1", "seed": 1, "chosen_by": "val/ade"},
        },
        "training": {
            "config": "sgan_goal",
            "fold": "zara1",
            "clock": "benchmark",
            "goal": "window_end",
            "seed": 1,
            "seeds": {0: 0.0612, 1: 0.0605},
            "chosen_by": "val/ade",
            "value": 0.0605,
            "step": 3959,
            "epoch": 44,
            "command": ["pedzoo", "fit", "--config", "sgan_goal", "--data.pred_len", "8"],
            "overrides": {"data.pred_len": "8"},
        },
        "data": {
            "recordings": ["biwi_eth", "biwi_hotel"],
            "source": "ETH/UCY",
            "terms": "for research",
            "citation": "Pellegrini et al. 2009; Lerner et al. 2007",
        },
        "evaluations": [report, door],
        "versions": {"pedzoo": "0.1.0", "torch": "2.13.0"},
        "licence": "MIT",
        "file": f"{name}.safetensors",
        "url": None,
    }
    return ModelCard(**(values | changed))
