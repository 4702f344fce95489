"""The journal's documentation covers every field and is the one committed."""

from pathlib import Path

import pytest

from bayesnet_track.journal.codec import event_classes, event_name, type_hints
from bayesnet_track.journal.target_net import Cause, Concentration
from make_pages.journal import document_events, parts_of

KINDS = [*event_classes().values(), Cause, Concentration]
COMMITTED = Path(__file__).parents[2] / "docs" / "journal"


@pytest.mark.parametrize(
    "kind", [*event_classes().values(), Cause, Concentration], ids=lambda kind: kind.__name__
)
def test_every_field_is_documented_and_nothing_else(kind):
    text, described = parts_of(kind)
    assert text
    assert list(described) == list(type_hints(kind))
    assert all(len(words) > 3 for words in described.values())


def test_every_event_has_a_section():
    text = "\n".join(document_events().values())
    for kind in event_classes().values():
        assert text.count(f"\n## `{event_name(kind)}`") == 1


def test_the_committed_pages_are_the_generated_ones():
    committed = {page.name: page.read_text(encoding="utf-8") for page in COMMITTED.glob("*.md")}
    assert committed == document_events(), "write them again: python docs/make_pages/journal.py"
