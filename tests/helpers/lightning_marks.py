"""Marks of tests that run Lightning's trainer."""

import pytest

LIGHTNING_MARKS = [
    pytest.mark.filterwarnings("ignore:.*does not have many workers"),
    pytest.mark.filterwarnings("ignore:.*callbacks used to create the checkpoint"),
    pytest.mark.filterwarnings("ignore:.*Checkpoint directory .* exists and is not empty"),
]
"""Warnings of Lightning's that say nothing about such short runs."""
