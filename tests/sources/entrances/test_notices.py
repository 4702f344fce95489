"""Notices reach the caller's own line, and the command line once each."""

import warnings
from pathlib import Path

import pytest

from bayesnet_track.sources.entrances.notices import InputNotice, heard, notice


def test_a_notice_names_the_line_outside_of_the_package():
    with pytest.warns(InputNotice, match="2 of 30") as caught:
        notice("2 of 30 are left out")
    assert Path(caught[0].filename) == Path(__file__)


def test_heard_hands_over_each_text_once_and_other_warnings_go_their_way():
    said = []
    with pytest.warns(UserWarning, match="of another kind") as others, heard(said.append):
        for _ in range(2):
            notice("a.csv: one")
            notice("b.csv: two")
        warnings.warn("of another kind", UserWarning, stacklevel=1)
    assert said == ["a.csv: one", "b.csv: two"]
    assert len(others) == 1


def test_after_heard_a_notice_warns_again():
    with heard(lambda text: None):
        pass
    with pytest.warns(InputNotice, match="later"):
        notice("later")
