"""The language reference says what the specification says."""

from __future__ import annotations

import re
from pathlib import Path

from bayesnet_track.graph.spec import Model
from make_pages.language import language_reference

FOLDER = Path(__file__).parents[2] / "docs" / "language"


def test_the_committed_pages_are_up_to_date():
    again = "python docs/make_pages/language.py"
    committed = {page.name: page.read_text(encoding="utf-8") for page in FOLDER.glob("*.md")}
    assert committed == language_reference(), f"write them again: {again}"


def test_every_model_has_one_page(cues):
    headings = [
        line
        for name, page in language_reference(cues).items()
        for line in page.splitlines()
        if name != "cues.md" and line.startswith("## ")
    ]
    assert len(headings) == len(set(headings)) > 50


def test_every_key_is_there_with_a_meaning(cues):
    pages = language_reference(cues).values()
    rows = [line for page in pages for line in page.splitlines() if line.startswith("| `")]
    keys = {row.split("`")[1] for row in rows}
    for model in _subclasses(Model):
        assert set(model.model_fields) <= keys | {"cue", "parameters"}, model
    assert [row for row in rows if row.endswith("|  |")] == []


def _subclasses(base):
    return set(base.__subclasses__()).union(*(_subclasses(model) for model in base.__subclasses__()))


def test_links_lead_to_sections(cues):
    pages = language_reference(cues)
    sections = {
        f"{name}#{line[3:].replace(' ', '-')}"
        for name, page in pages.items()
        for line in page.splitlines()
        if line.startswith("## ")
    }
    links = {
        (target if target[0] != "#" else name + target)
        for name, page in pages.items()
        for target in re.findall(r"\]\(([a-z]*(?:\.md)?#[^)]+)\)", page)
    }
    assert len(links) > 50
    assert links <= sections


def test_the_parameters_of_given_cues_are_listed(cues):
    page = language_reference(cues)["cues.md"]
    assert "## hue" in page
    assert (
        "| `bins` | a whole number at least 4, at most 128 | `32` | bins round the hue circle, count |"
        in page
    )
    assert "## color_histogram" not in page
