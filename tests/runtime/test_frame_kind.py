"""What frames have in common, in words, and the refusal of another one."""

import numpy as np
import pytest

from bayesnet_track.observation.planes import Frame
from bayesnet_track.runtime.results import FrameKind

GRAY = Frame(3, 3.0, np.zeros((4, 6, 3), np.uint8), False)


def test_a_kind_in_words():
    assert str(FrameKind.of(GRAY)) == "6x4 gray"
    assert str(FrameKind.of(GRAY).of_either_color) == "6x4"
    assert str(FrameKind.of(Frame(0, 0.0, np.zeros((4, 6))))) == "6x4 colour with 1 channel of float64"


def test_another_kind_is_refused_with_what_can_be_done():
    colour = FrameKind(6, 4, True, 3, "uint8")
    with pytest.raises(ValueError) as refused:
        colour.check(GRAY, "start again")
    assert str(refused.value) == (
        "frame 3 is 6x4 gray, the frames before it are 6x4 colour; "
        "bring it to their size and channels, or start again"
    )
    colour.of_either_color.check(GRAY, "start again")
    FrameKind.of(GRAY).check(GRAY, "start again")
