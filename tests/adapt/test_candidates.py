"""What candidates gather until they are confirmed."""

from __future__ import annotations

from bayesnet_track.adapt.lifecycle import is_refusal_notable


def test_refusals_are_told_at_powers_of_ten():
    notable = [n for n in range(1, 2000) if is_refusal_notable(n - 1, n)]
    assert notable == [1, 10, 100, 1000] and is_refusal_notable(7, 400) and not is_refusal_notable(100, 999)
