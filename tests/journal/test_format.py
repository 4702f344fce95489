"""No event or field of the journal's format is ever lost; renamed words are read."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import MISSING, fields, is_dataclass
from pathlib import Path
from typing import Any, get_args

import pytest

from bayesnet_track.journal.codec import (
    _CAPITAL,
    JournalError,
    event_classes,
    event_name,
    field_names,
    from_json,
    type_hints,
)
from bayesnet_track.journal.encoder import key_of
from bayesnet_track.journal.events.runs import JOURNAL_VERSION
from bayesnet_track.journal.renamed import EVENTS, FIELDS
from make_pages.journal import words_of

FORMAT = Path(__file__).with_name("format_2.json")
FORMAT_1 = Path(__file__).with_name("format_1.json")


def within(hint: Any) -> Iterator[Any]:
    """The dataclasses that a field may hold."""
    if is_dataclass(hint):
        yield hint
    for part in get_args(hint):
        yield from within(part)


def described() -> dict[str, dict[str, list[object]]]:
    """Object -> field -> its type, and whether it must be there."""
    waiting, found = list(event_classes().values()), {}
    while waiting:
        kind: Any = waiting.pop()
        name = event_name(kind)
        if name in found:
            continue
        needed = {key_of(f) for f in fields(kind) if f.default is MISSING and f.default_factory is MISSING}
        hints = {key: type_hints(kind)[name] for key, name in field_names(kind).items()}
        found[name] = {field: [words_of(hint), field in needed] for field, hint in hints.items()}
        waiting += [one for hint in hints.values() for one in within(hint)]
    return found


def renamed(name: str, before: dict[str, list[object]]) -> dict[str, list[object]]:
    """The fields of an object of format 1 in today's words."""
    fields_ = next((new for kind, new in FIELDS.items() if _CAPITAL.sub("_", kind).lower() == name), {})
    return {fields_.get(field, field): what for field, what in before.items()}


@pytest.mark.parametrize("path", [FORMAT_1, FORMAT], ids=lambda path: path.stem)
def test_no_event_or_field_is_gone_or_of_another_type_and_added_fields_have_a_default(path: Path) -> None:
    assert JOURNAL_VERSION == 2, "pin the new version's format beside this one"
    then, now = json.loads(path.read_text()), described()
    if path == FORMAT_1:
        then = {EVENTS.get(name, name): renamed(name, object_) for name, object_ in then.items()}
    assert then.keys() <= now.keys()
    for name, before in then.items():
        after = now[name]
        assert {field: after.get(field, ["gone"])[0] for field in before} == {
            field: kind for field, (kind, _) in before.items()
        }, name
        must = {field for field, (_, is_needed) in after.items() if is_needed}
        assert must <= {field for field, (_, is_needed) in before.items() if is_needed}, name


def test_a_journal_of_a_later_format_is_refused_with_the_version_that_wrote_it() -> None:
    line = json.dumps({"event": "run_started", "journal": 3, "versions": {"bayesnet-track": "7.5"}, "x": 1})
    with pytest.raises(JournalError, match=r"format 3 of journals.*up to 2.*bayesnet-track 7\.5"):
        from_json(line)


if __name__ == "__main__":
    FORMAT.write_text(json.dumps(dict(sorted(described().items())), indent=1) + "\n")
