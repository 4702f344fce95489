"""Every built-in cue is explained: a row in the table of cues, a page that names it, pictures."""

import re
from pathlib import Path

import pytest

from bayesnet_track.observation.cue import installed_cues

DOCS = Path(__file__).parents[2] / "docs"
INDEX = DOCS / "cues" / "index.md"
ROW = re.compile(r"^\| \[`(\w+)`\]\(([^)#]+)[^)]*\) \|", re.MULTILINE)
BUILT_IN = sorted(
    name for name, one in installed_cues().items() if one.make.make.__module__.startswith("bayesnet_track.")
)


def test_the_table_has_a_row_for_each_cue():
    rows = [name for name, _ in ROW.findall(INDEX.read_text(encoding="utf-8"))]
    assert len(rows) == len(set(rows))
    assert set(BUILT_IN) <= set(rows)


@pytest.mark.parametrize("cue", BUILT_IN)
def test_a_cue_has_a_page_with_pictures(cue):
    page = INDEX.parent / dict(ROW.findall(INDEX.read_text(encoding="utf-8")))[cue]
    text = page.read_text(encoding="utf-8")
    assert f"`{cue}`" in text or f"{{{cue}" in text or f"agent: {cue}" in text
    pictures = re.findall(r"!\[([^\]]+)\]\(([^)]+)\)", text)
    assert pictures
    for words, picture in pictures:
        assert words.strip()
        assert (page.parent / picture).is_file(), picture
