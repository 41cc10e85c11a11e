"""The closed-loop protocol of Grand Central: its measures by hand, and who walks from where to where."""

import math

import numpy as np
import pytest
import torch

from pedzoo.data.tracks import Tracks
from tools.paper.gc import DT, HISTORY, STRAIGHT, Clip, collisions, discrepancy, scores, simulated, transport


def clip() -> Clip:
    """Return three people: 7 walks 60 rows along x at 1 m/s and waits, 9 goes on, 2 is seen for 10 rows."""
    rows = [(n, 7, min(n, 60) * DT, 0.0) for n in range(90)]
    rows += [(n, 9, n * DT, 5.0) for n in range(90)]
    rows += [(n + 3, 2, 5.0, 1.0 + 0.1 * n) for n in range(10)]
    return Clip.of(Tracks.from_table("clip", np.array(rows)))


def test_scored_are_the_frames_behind_two_seconds():
    one = clip()
    assert one.scored.sum(0).tolist() == [0, 90 - HISTORY, 90 - HISTORY]
    assert one.speed.tolist() == pytest.approx([0.1 / DT, 1.0, 1.0])
    assert one.exit[1].tolist() == pytest.approx([60 * DT, 0.0])


def test_straight_walkers_go_to_the_exit_and_leave_half_a_metre_before():
    one = clip()
    walk = simulated(one, STRAIGHT, None)
    np.testing.assert_allclose(walk[:HISTORY], one.place[:HISTORY])
    gone = int(np.isfinite(walk[:, 1, 0]).sum())
    np.testing.assert_allclose(walk[:gone, 1, 0], np.arange(gone) * DT, atol=1e-6)
    assert 60 * DT - walk[gone - 1, 1, 0] >= 0.5 > 60 * DT - gone * DT
    # while people walk they agree; those who have left are at their exits
    missing = sum(60 - n for n in range(gone, 60)) + sum(89 - n for n in range(gone + 29, 89))
    assert scores(one, walk)["mae_m"] == pytest.approx(missing * DT / (2 * (90 - HISTORY)), abs=1e-6)
    np.testing.assert_allclose(walk[3:13, 0], one.place[3:13, 0])


def test_transport_of_two_points_by_hand():
    one = torch.tensor([[0.0, 0.0], [3.0, 0.0]])
    # far apart, the plan pairs each point with its own
    assert transport(one, one + torch.tensor([0.0, 1.0])) == pytest.approx(1.0, abs=1e-4)
    assert transport(one, one.flip(0)) == pytest.approx(0.0, abs=1e-4)


def test_discrepancy_of_two_points_by_hand():
    one, other = torch.zeros(1, 2), torch.tensor([[1.0, 0.0]])
    width = 2 / (4 - 2) / 4
    expected = 2 * (5 - sum(math.exp(-1 / (width * 2**power)) for power in range(5)))
    # two points: each alone has the kernel 1 five times
    assert discrepancy(one, other) == pytest.approx(expected, abs=1e-5)


def test_companions_do_not_collide():
    walk = np.full((40, 3, 2), np.nan)
    walk[:, 0] = 0.0
    walk[:30, 1] = 0.3  # 30 frames together: friends
    walk[5:9, 2] = (0.0, 0.4)  # near the first for four frames, and near the second
    assert collisions(walk) == 2 * 4 + 2 * 4
