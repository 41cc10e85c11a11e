"""Model cards for tests."""

from pathlib import Path
from typing import Any

from pedzoo.core.paths import CARD, WEIGHTS
from pedzoo.models.base import Forecaster
from pedzoo.models.zoo.card import ModelCard, read_config, write_card
from pedzoo.models.zoo.loading import save_weights


def _report(command: str, protocol: dict[str, Any], **row: Any) -> dict[str, Any]:
    made = {"seeds": [0], "versions": {"pedzoo": "0.1.0"}}
    return {"command": command, "protocol": protocol, **made, "rows": [{"ci95": {}} | row]}


def make_card(name: str = "sgan_goal.zara1", **changed: Any) -> ModelCard:
    """Return a card with everything in it, and what is ``changed``."""
    protocol = {"fold": "zara1", "goal": "window_end", "pred_len": 8}
    trained = {"config": "sgan_goal", "fold": "zara1", "seed": 1, "chosen_by": "val/ade"}
    forecast = {"case": {"fold": "zara1", "split": "test"}, "n": 2875}
    suites = {"suites": ["door", "goals"], "quick": True, "deterministic": False}
    door = {"table": "door", "case": {"suite": "door", "physics": "bullet"}, "n": 40}
    errors, success = {"ade_m": 0.0571, "fde_m": 0.0086}, {"success": 0.975}
    values: dict[str, Any] = {
        "name": name,
        "architecture": "sgan",
        "sha256": "0123456789abcdef" * 4,
        "size": 192920,
        "config": {
            "architecture": "sgan",
            "init": {"goal_dim": 16, "map": None},
            "goal": "window_end",
            "protocol": protocol | {"clock": "benchmark"},
            "training": trained,
        },
        "training": trained
        | {"clock": "benchmark", "goal": "window_end", "seeds": {0: 0.0612, 1: 0.0605}, "value": 0.0605}
        | {"command": ["pedzoo", "fit", "--config", "sgan_goal", "--data.pred_len", "8"]}
        | {"step": 3959, "epoch": 44, "overrides": {"data.pred_len": "8"}},
        "data": {
            "recordings": ["biwi_eth", "biwi_hotel"],
            "source": "ETH/UCY",
            "terms": "for research",
            "citation": "Pellegrini et al. 2009; Lerner et al. 2007",
        },
        "evaluations": [
            _report("forecast", protocol | {"samples": 20}, name=name, **forecast, metrics=errors),
            _report(
                "evaluate",
                suites | {"warm_start": {"door": "orca"}},
                **{"name": name, **door, "metrics": success, "ci95": {"success": [0.871, 0.996]}},
            ),
        ],
        "versions": {"pedzoo": "0.1.0", "torch": "2.13.0"},
        "licence": "MIT",
    }
    return ModelCard(**(values | changed))


def write_model(model: Forecaster, folder: Path, name: str = "sgan_goal.mall", **changed: Any) -> ModelCard:
    """Write weights and their card into the model's own folder below one, and return the card."""
    weights = folder / name / WEIGHTS
    digest = save_weights(model, weights)
    config = read_config(weights)
    its = {"architecture": config["architecture"], "sha256": digest, "size": weights.stat().st_size}
    card = make_card(name, **{**its, "config": config, "evaluations": [], **changed})
    write_card(card, weights.with_name(CARD))
    return card
