"""Baseline: people walk straight to their goal."""

from tensordict import TensorDict
from torch import Tensor

from pedzoo.core.batch import goals_of
from pedzoo.core.types import TIMED, GoalProtocol
from pedzoo.models.base import Forecaster, Random, for_all_samples
from pedzoo.models.blocks.people import linear_extrapolation


class StraightLine(Forecaster):
    """Straight to the goal: at even speed to arrive at the window's end, else at the last speed."""

    needs = frozenset({"goal"})
    stochastic = False
    path = staticmethod(linear_extrapolation.straight_line)

    def __init__(self, goal_protocol: GoalProtocol = "window_end") -> None:
        """``window_end`` goals are reached at the last step; others are walked to at the last speed."""
        super().__init__()
        self.config = {"goal_protocol": goal_protocol}
        self.goal_protocol = goal_protocol

    def sample(self, batch: TensorDict, samples: int, steps: int, generator: Random = None) -> Tensor:
        """Return the same future (B, K, A, T, 2) for every sample."""
        history = batch["agents", "history"]
        goal, _ = goals_of(batch, type(self).__name__)
        last = history[..., -1, :]
        path = self.path(last - history[..., -2, :], goal - last, steps, self.goal_protocol in TIMED)
        return for_all_samples(path, batch, samples)
