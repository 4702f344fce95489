"""What a value of the specification looks like, in words, and which node a value is to be."""

from __future__ import annotations

from typing import Literal

import pytest

from bayesnet_track.graph.settings.base import Positive
from bayesnet_track.graph.settings.net import node_kind
from bayesnet_track.graph.text.hints import expects, shape_of


def test_annotations_are_taken_apart():
    assert shape_of(Positive | None).only is float
    assert expects(Positive | Literal["never"]) == "a number above 0 or never"


@pytest.mark.parametrize(
    ("value", "kind"),
    [
        ({"agent": "hue", "factor": "1"}, "agent"),
        ({"factor": "1"}, "factor"),
        ({"mask": "road.png"}, "factor"),
        ({}, "inference"),
        ("root", "inference"),
    ],
)
def test_a_node_is_known_by_its_keys(value, kind):
    assert node_kind(value) == kind
