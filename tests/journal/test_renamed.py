"""Lines of format 1 are read in today's words."""

from __future__ import annotations

import json
from dataclasses import asdict, replace
from typing import Any

import pytest

from bayesnet_track.journal.codec import from_json, to_json
from bayesnet_track.journal.events.births import BirthsRefused, CandidateConfirmed
from bayesnet_track.journal.events.distractors import DistractorSeen
from bayesnet_track.journal.events.reidentification import Recognition
from bayesnet_track.journal.events.sample_sizes import SecondPass
from bayesnet_track.journal.events.switches import Deactivated
from bayesnet_track.journal.net.causes import Cause
from bayesnet_track.journal.renamed import EVENTS, FIELDS, VALUES

NEAR = Recognition("2", 0.4, 0.5, 9.0, 4.0, -1.0, 2.0, 0.5, (), "new", 0.6)
OFF = Deactivated(
    6, "1", "motion", "square", Cause("ud_baseline", 2.0, 1.5, 3, 1.7, 150.0, 100.0), "most_expensive", {}, 3
)
LINES = {
    "rival_seen": DistractorSeen(5, "1", 80.0, 60.0, 0.9, 1.5, 4.0, 0.3, 250),
    "deactivated": OFF,
    "births_refused": BirthsRefused(3, "t", "motion", 20, 20, 4, 1),
    "candidate_confirmed": CandidateConfirmed(3, "3", "t", "motion", 1, 3, 4, 0.9, NEAR),
    "second_pass": SecondPass(3, "1", "iterated", 3.0, 2.0, 500, 500, 9.0, 90.0),
}


def in_old_words(line: str, name: str) -> str:
    """The line as format 1 had it: each new word of the tables replaced by the old one."""
    values: dict[str, Any] = json.loads(line)
    old = {new: was for words in (EVENTS, *FIELDS.values()) for was, new in words.items()}
    old |= {new: was for of in VALUES.values() for words in of.values() for was, new in words.items()}
    kept = {"second_pass"} if values["event"] == "second_pass" else set()  # the event has this name, too

    def back(value: Any) -> Any:
        if isinstance(value, dict):
            return {
                old.get(key, key) if key not in kept else key: back(inside) for key, inside in value.items()
            }
        return old.get(value, value) if isinstance(value, str) and value not in kept else value

    return json.dumps({**back(values), "event": name})


@pytest.mark.parametrize("name", LINES)
def test_a_line_of_format_1_is_the_event_of_today(name: str) -> None:
    event = LINES[name]
    line = in_old_words(to_json(event), name)
    assert line != to_json(event)
    assert from_json(line) == event


def test_every_old_value_is_read() -> None:
    for was, new in VALUES["Deactivated"]["drop"].items():
        line = json.dumps({"event": "deactivated", **asdict(replace(OFF, drop=was))})
        assert from_json(line) == replace(OFF, drop=new)
    line = json.dumps({"event": "second_pass", **asdict(replace(LINES["second_pass"], method="adaptive"))})
    assert from_json(line) == replace(LINES["second_pass"], method="second_pass")
