"""The language reference says what the specification says."""

from __future__ import annotations

from pathlib import Path

from bayesnet_track.graph.settings.base import Model
from make_pages.language import language_reference

PAGE = Path(__file__).parents[2] / "docs" / "language.md"


def test_the_committed_page_is_up_to_date():
    again = "python docs/make_pages/language.py > docs/language.md"
    assert PAGE.read_text(encoding="utf-8") == language_reference(), f"write it again: {again}"


def test_every_key_is_there_with_a_meaning(cues):
    rows = [line for line in language_reference(cues).splitlines() if line.startswith("| `")]
    keys = {row.split("`")[1] for row in rows}
    for model in _subclasses(Model):
        assert set(model.model_fields) <= keys | {"cue", "parameters"}, model
    assert [row for row in rows if row.endswith("|  |")] == []


def _subclasses(base):
    return set(base.__subclasses__()).union(*(_subclasses(model) for model in base.__subclasses__()))


def test_links_lead_to_sections(cues):
    page = language_reference(cues)
    sections = {line[3:].replace(" ", "-") for line in page.splitlines() if line.startswith("## ")}
    links = {part.split(")")[0] for part in page.split("](#")[1:]}
    assert links <= sections


def test_the_parameters_of_given_cues_are_listed(cues):
    page = language_reference(cues)
    assert "### hue" in page
    assert (
        "| `bins` | a whole number at least 4, at most 128 | `32` | bins round the hue circle, count |"
        in page
    )
    assert "### color_histogram" not in page
