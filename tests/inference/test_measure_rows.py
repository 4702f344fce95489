"""Which nets are measured as arrays; that they are measured alike is in tests/engine/test_summaries.py."""

import pytest

from bayesnet_track import load_graph
from bayesnet_track.inference.measure import is_flat


@pytest.mark.parametrize(
    ("graph", "is_together"), [("general", True), ("person_parts", False), ("two_squares", True)]
)
def test_only_nets_of_one_belief_are_measured_together(graph, is_together):
    assert {is_flat(plate) for plate in load_graph(graph).targets.values()} == {is_together}
