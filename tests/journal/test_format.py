"""No event or field of the journal's format is ever lost; other formats are refused."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import MISSING, fields, is_dataclass
from pathlib import Path
from typing import Any, get_args

import pytest

from bayesnet_track.journal.codec import (
    JournalError,
    event_classes,
    event_name,
    field_names,
    from_json,
    type_hints,
)
from bayesnet_track.journal.encoder import key_of
from bayesnet_track.journal.events.runs import JOURNAL_VERSION
from make_pages.journal import words_of

FORMAT = Path(__file__).with_name("format_2.json")


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


def test_no_event_or_field_is_gone_or_of_another_type_and_added_fields_have_a_default() -> None:
    assert JOURNAL_VERSION == 2, "pin the new version's format, and remove this one"
    then, now = json.loads(FORMAT.read_text()), described()
    assert then.keys() <= now.keys()
    for name, before in then.items():
        after = now[name]
        for field, (kind, _) in before.items():  # it may have further kinds of value, which are added
            assert field in after, f"{name}: {field} is gone"
            assert set(kind.split(" or ")) <= set(after[field][0].split(" or ")), f"{name}: {field}"
        must = {field for field, (_, is_needed) in after.items() if is_needed}
        assert must <= {field for field, (_, is_needed) in before.items() if is_needed}, name


@pytest.mark.parametrize("number", [1, 3])
def test_a_journal_of_another_format_is_refused_with_the_version_that_wrote_it(number: int) -> None:
    versions = {"bayesnet-track": "7.5"}
    line = json.dumps({"event": "run_started", "journal": number, "versions": versions, "x": 1})
    words = rf"^format {number} of journals; this version reads format 2: read it with bayesnet-track 7\.5, "
    with pytest.raises(JournalError, match=words + r"which wrote it \(.*bayesnet-track==7\.5\)$"):
        from_json(line)


if __name__ == "__main__":
    FORMAT.write_text(json.dumps(dict(sorted(described().items())), indent=1) + "\n")
