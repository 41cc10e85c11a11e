"""The picture of a crowd twice, real and simulated, and what the page says about it."""

from __future__ import annotations

import re

import numpy as np
import torch
from helpers.pages import ROOT
from PIL import Image

from pedzoo.metrics.realism.features import SampledRollout
from tools.pages.crowd_twice import OUT, REAL, SECONDS, walks_of

PAGE = (ROOT / "docs" / "score.md").read_text()


def test_page_names_the_real_side_below_the_picture() -> None:
    answer = re.findall(r"Side ([AB]) of the picture is real, side ([AB]) is simulated", PAGE)
    assert answer == [(REAL, "AB".replace(REAL, ""))]
    assert PAGE.index("Side A") > PAGE.index(f"](pictures/{OUT.name})")


def test_picture_is_small_and_plays_in_real_time() -> None:
    assert OUT.stat().st_size < 2.5e6
    with Image.open(OUT) as picture:
        frames, milliseconds = getattr(picture, "n_frames", 0), picture.info["duration"]
        assert 850 <= picture.width <= 950
    assert frames * milliseconds / 1000 == SECONDS
    assert milliseconds <= 200


def test_both_sides_are_drawn_from_places_every_step() -> None:
    along = torch.arange(6.0)
    xy = torch.stack((along, torch.zeros(6)), 1).view(1, 1, 6, 2)
    person = torch.tensor([[[-1, 7, 7, 7, 7, -1]]])
    known = torch.tensor([[[False, False, True, True, True, False]]])
    (walk,) = walks_of(SampledRollout(xy, person, torch.zeros_like(xy), known, known, torch.ones(1, 1)))
    assert walk.begin == 4
    np.testing.assert_allclose(walk.xy[:, 0], np.linspace(1, 4, 13), atol=1e-6)
    np.testing.assert_allclose(walk.heading, 0.0)
