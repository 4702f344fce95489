"""Signs that boxes of a file are not of this video."""

import re

import numpy as np
import pytest

from bayesnet_track.sources.entrances.boxes import explain_lengths, explain_places


@pytest.mark.parametrize(
    ("true", "tracked", "ran", "words"),
    [
        (60, 60, None, []),
        (60, 52, None, []),
        (60, 30, range(31), ["29 of 60 true boxes are of frames after the last one of the run (31 to 59,"]),
        (60, 30, range(60), []),
        (30, 60, None, ["30 of 60 tracked boxes are of frames after the last true box (30 to 59,"]),
        (60, 0, None, []),
    ],
)
def test_lengths_that_do_not_fit(true, tracked, ran, words):
    said = list(explain_lengths(np.arange(true), np.arange(tracked), ran))
    assert len(said) == len(words) and all(one in text for one, text in zip(words, said, strict=True))


@pytest.mark.parametrize(
    ("box", "words"),
    [
        ((10, 10, 20, 20), None),
        ((500, 10, 20, 20), "4 of 4 true boxes lie outside of the frames of 120x90 px"),
        ((-5, -5, 120, 90), None),
        ((50, 40, 110, 85), "4 of 4 true boxes begin inside .* they can be corners"),
        ((50, 40, 300, 40), "4 of 4 true boxes begin inside .* of this video, and of its size"),
    ],
)
def test_places_that_do_not_fit(box, words):
    said = list(explain_places(np.array([box] * 4, dtype=float), (120, 90), "true boxes"))
    assert len(said) == (words is not None) and all(re.search(words, text) for text in said)
