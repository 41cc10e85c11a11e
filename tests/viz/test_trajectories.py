"""Pictures of rollouts: the moment they are about, what they show, and where they are written."""

from dataclasses import replace

import matplotlib.image
import numpy as np
import pytest
import torch
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure

from pedzoo.core.errors import UserError
from pedzoo.core.geometry import move_to_scene
from pedzoo.eval.comparison import PolicyRollout
from pedzoo.eval.rollout import rollout
from pedzoo.sim.rollout import Rollout
from pedzoo.viz.trajectories import (
    _Episode,
    common_moments,
    draw_episode,
    meeting,
    meeting_and_end,
    plot_rollouts,
)


@pytest.fixture(scope="module")
def walked() -> PolicyRollout:
    return PolicyRollout("go_to_goal", *rollout("go_to_goal", "door", "compiled", 2))


def passing(walked: Rollout, at: int) -> Rollout:
    """Return a copy in which the two people of episode 0 meet at a trace point and every person stays."""
    trace = walked.trace.clone()
    steps = torch.arange(trace.shape[2]) - at
    trace[0, 0] = torch.stack((0.3 * steps, torch.zeros_like(steps)), dim=-1)
    trace[0, 1] = torch.stack((-0.3 * steps, torch.ones_like(steps)), dim=-1)
    return replace(walked, trace=trace, present=torch.ones_like(walked.present))


def drawn(walked: PolicyRollout, point: int) -> Axes:
    axes = Figure().subplots()
    _Episode(walked, 0).draw(axes, point)
    return axes


def test_meeting_is_when_two_are_first_nearest(walked: PolicyRollout) -> None:
    for at in (5, 12):
        assert meeting(passing(walked.rollout, at), 0) == at
    both = passing(walked.rollout, 12)
    trace = both.trace.clone()  # they stop before each other
    trace[0, :, 6:] = trace[0, :, 6:7] + 0.001 * torch.arange(trace.shape[2] - 6).unsqueeze(-1)
    assert meeting(replace(both, trace=trace), 0) == 6
    present = torch.zeros_like(walked.rollout.present)
    present[0, 0, :20] = True  # who is alone meets no person
    assert meeting(replace(walked.rollout, present=present), 0) == 10


def points(axes: Axes, marker: str, fill: str = "full") -> list[np.ndarray]:
    """Return the points of all lines that have a marker."""
    lines = [one for one in axes.lines if one.get_marker() == marker and one.get_fillstyle() == fill]
    return [np.asarray(line.get_xydata()) for line in lines]


def test_star_dots_and_coloured_way(walked: PolicyRollout) -> None:
    path = walked.rollout.path[0].numpy()
    axes = drawn(walked, 20)
    stars, dots = points(axes, "*"), points(axes, "o")
    paths = [lines for lines in axes.collections if isinstance(lines, LineCollection)]
    assert len(stars) == len(dots) == len(paths) == 2
    for person in (0, 1):
        np.testing.assert_allclose(stars[person], path[person, 20:21])
        np.testing.assert_allclose(dots[person], path[person, [8, 12, 16]])  # 0.4 s apart
        segments = np.array(paths[person].get_segments())
        np.testing.assert_allclose(segments[:, 0], path[person, :20])
        np.testing.assert_allclose(segments[:, 1], path[person, 1:21])
    grey = [np.asarray(line.get_xydata()) for line in axes.lines if line.get_color() == "0.6"]
    np.testing.assert_allclose(grey[0], walked.rollout.past[0, 0])
    np.testing.assert_allclose(np.concatenate(points(axes, "x")), walked.rollout.goal[0, :, 20])


def test_who_has_left_stays_there_without_a_goal(walked: PolicyRollout) -> None:
    present = walked.rollout.present.clone()
    present[0, 1, 15:] = False
    axes = drawn(walked._replace(rollout=replace(walked.rollout, present=present)), 30)
    np.testing.assert_allclose(points(axes, "*")[1], walked.rollout.trace[0, 1, 14:15])
    assert len(points(axes, "x")) == 1


def test_scenes_are_drawn_as_their_map_lies(walked: PolicyRollout) -> None:
    """A turned and mirrored scene gives the same picture."""
    pose = torch.tensor([[0.7, -1.0, 2.0, -1.0]]).expand(2, 4)
    moved = {key: move_to_scene(getattr(walked.rollout, key), pose) for key in ("trace", "goal", "past")}
    turned = walked._replace(rollout=replace(walked.rollout, pose=pose, **moved))
    for mine, other in zip(drawn(walked, 20).lines, drawn(turned, 20).lines, strict=True):
        np.testing.assert_allclose(np.asarray(mine.get_xydata()), np.asarray(other.get_xydata()), atol=1e-5)


def test_all_policies_are_shown_at_the_same_moments(walked: PolicyRollout) -> None:
    assert common_moments([20, 30], [50, 60]) == [12, 25, 38, 60]
    assert common_moments([2], [20]) == [0, 5, 10, 20]
    assert common_moments([19, 19], [20, 18]) == [11, 16, 20]  # no moment twice
    present = walked.rollout.present.clone()
    present[:, :, 10:] = False
    shorter = walked._replace(rollout=replace(walked.rollout, present=present))
    met = 1 + meeting(walked.rollout, 0)
    # most have met at the first moment, and all are over at the last
    assert meeting_and_end([walked, shorter, walked]) == (met, int(walked.rollout.length[0]))
    axes = Figure().subplots()
    draw_episode(axes, shorter, 0, 20)
    assert axes.get_title() == "2.0 s (ended at 1.0 s)"


def test_touches_are_marked_where_they_begin(walked: PolicyRollout) -> None:
    contact = torch.zeros_like(walked.rollout.wall_contact)
    contact[0, 1, 7:10] = True
    none = torch.zeros_like(contact)
    touched = replace(walked.rollout, wall_contact=contact, agent_contact=none)
    axes = drawn(walked._replace(rollout=touched), 20)
    rings = np.concatenate(points(axes, "o", "none"))
    np.testing.assert_allclose(rings, walked.rollout.trace[0, 1, 7:8])


def test_picture_is_written_whole(walked: PolicyRollout, tmp_path) -> None:
    path = tmp_path / "new" / "door.png"
    plot_rollouts([walked, walked._replace(name="again")], path, 1)
    assert list(path.parent.iterdir()) == [path]
    picture = matplotlib.image.imread(path)
    assert picture.shape[1] > picture.shape[0] > 300 and picture[..., :3].std() > 0.05


def test_mistakes(walked: PolicyRollout, tmp_path) -> None:
    (tmp_path / "file").write_text("")
    for name, episode, message in (
        ("a.bmp", 0, r"\.png or \.pdf or \.svg"),
        ("file/a.png", 0, "cannot write"),
        ("a.png", 7, "episode 7: go_to_goal has walked 2, 0 to 1"),
    ):
        with pytest.raises(UserError, match=message):
            plot_rollouts([walked], tmp_path / name, episode)
    with pytest.raises(UserError, match="episode 2"):
        draw_episode(Figure().subplots(), walked, 2)


def test_an_episode_on_axes_of_ones_own(walked: PolicyRollout) -> None:
    axes = Figure().subplots()
    draw_episode(axes, walked, 1)
    ends = torch.tensor([axes.get_xlim(), axes.get_ylim()])
    seen = walked.rollout.trace[1][walked.rollout.present[1]]
    assert (ends[:, 0] < seen.amin(0)).all() and (seen.amax(0) < ends[:, 1]).all()
    assert "ended at" in axes.get_title()
