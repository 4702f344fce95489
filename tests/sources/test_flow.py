"""What comes over the network without an end."""

from __future__ import annotations

from types import SimpleNamespace

import pytest

from bayesnet_track.sources.timing import flow_of


@pytest.mark.parametrize(
    ("name", "duration", "frames", "size", "endless", "is_sure"),
    [
        ("mpjpeg", None, 0, -38, True, True),
        ("hls", None, 0, 300, True, True),
        ("hls", 4_000_000, 0, 300, False, True),
        ("mpegts", None, 0, -38, True, False),
        ("mpegts", None, 0, 1000, False, True),
        ("mov,mp4,m4a,3gp,3g2,mj2", 4_000_000, 0, -38, False, True),
        ("avi", None, 90, -38, False, True),
    ],
)
def test_what_has_no_end(name, duration, frames, size, endless, is_sure):
    container = SimpleNamespace(format=SimpleNamespace(name=name), duration=duration, size=size)
    flow = flow_of(container, SimpleNamespace(duration=None, frames=frames))
    assert (flow.endless is not None, flow.is_sure) == (endless, is_sure)
