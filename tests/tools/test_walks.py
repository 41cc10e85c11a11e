"""`python -m tools.walks`: the ways that CONTRIBUTING counts can still be walked."""

from tools.walks import plan_to_input, track_to_loss


def test_ways_through_the_code_can_be_walked() -> None:
    for walk, first in ((track_to_loss, "data/datamodule.py"), (plan_to_input, "maps/plans.py")):
        trace = walk()
        assert next(iter(trace.files)) == first
        assert 2 < len(trace.files) < 60 and trace.changes >= 1
