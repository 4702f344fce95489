"""Addresses without their secrets."""

from __future__ import annotations

import pytest

from bayesnet_track.sources.origin import Origin
from bayesnet_track.sources.paths import hide_secrets, shown_address

SECRET = [
    "rtsp://admin:geheim@10.0.0.7:554/live",
    "rtsp://admin:geheim@geheim@10.0.0.7/live",
    "http://admin:ge/heim@10.0.0.7:80/x.mjpg",
    "http://admin:#geheim?@10.0.0.7/x",
    "http://admin:with geheim in it@10.0.0.7/x",
    "https://geheim@10.0.0.7/x",
    "http://admin:geheim@[fe80::1]:80/x",
    "http://10.0.0.7/video.cgi?user=geheim&pwd=geheim&fps=5",
    "http://10.0.0.7/x;access_token=geheim#part",
    "http://10.0.0.7/x?PASSWORD=geheim",
    "HTTP://admin:geheim@10.0.0.7/",
]


@pytest.mark.parametrize("address", SECRET)
def test_no_secret_is_shown(address):
    shown = shown_address(address)
    assert "heim" not in shown and "***" in shown and ("10.0.0.7" in shown or "fe80" in shown)
    origin = Origin("right", address, address, right=address)
    assert "heim" not in f"{origin.text} {origin.right}"
    if " " not in address:  # in a sentence an address ends at a blank
        assert "heim" not in origin.description


@pytest.mark.parametrize(
    "plain",
    ["video.mp4", "a@b:c.mp4", "./http:x", "0", "http://cam:8080/two@2x.mp4", "http://[::1]:80/x?mail=a@b"],
)
def test_what_holds_none_stays_as_it_is(plain):
    assert shown_address(plain) == plain
    assert hide_secrets(f"{plain} is not there") == f"{plain} is not there"
