"""Targets are named by type and number, where their type is known."""

import pytest

from bayesnet_track.journal.events.lives import TargetStarted
from bayesnet_track.journal.text.sentences import kinds_of, name_targets, narrate

BORN = TargetStarted(3, "2", "ball", (30.0, 35.0, 41.0, 31.0), ("color",))


@pytest.mark.parametrize(
    ("text", "named"),
    [
        ("frame 9, target 2: UD 3 px² > 2", "frame 9, ball 2: UD 3 px² > 2"),
        ("target 2 overlaps target 12", "ball 2 overlaps target 12"),
        ("targets 1, 2 are joined in a ring", "targets 1, 2 are joined in a ring"),
        ("frame 3: target 2 starts as ball, centre 30", "frame 3: ball 2 starts, centre 30"),
    ],
)
def test_a_target_is_named_by_its_type_and_number(text, named):
    assert name_targets(text, kinds_of([BORN])) == named


def test_the_sentence_of_an_event():
    assert narrate(BORN, {"2": "ball"}).startswith(
        "frame 3: ball 2 starts, centre 30, 35, 41 x 31 px → color on"
    )
    assert narrate(BORN, {}).startswith("frame 3: target 2 starts, centre")
