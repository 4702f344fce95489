"""Bytes in names of files are hidden in text and come back, wherever they stand."""

from __future__ import annotations

import os

from hypothesis import given
from hypothesis import strategies as st

from bayesnet_track.runtime.checkpoints.recipe import change_texts, hide_bytes, restore_bytes


@given(st.binary(max_size=20))
def test_every_name_comes_back_from_text(name):
    held = {"sources": (os.fsdecode(name), 3)}
    hidden = change_texts(held, hide_bytes)
    hidden["sources"][0].encode("utf-8")  # it is text now
    assert change_texts(hidden, restore_bytes) == held
