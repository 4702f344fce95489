"""Each subject of the journal is one file: events, their sentences, and how its decisions change a net."""

from dataclasses import is_dataclass
from importlib import import_module
from pkgutil import iter_modules
from typing import get_args

import pytest

from bayesnet_track.journal import events
from bayesnet_track.journal.events.event import Event
from bayesnet_track.journal.events.inputs import Input
from bayesnet_track.journal.net.net import Decision, Switch
from bayesnet_track.journal.text.sentences import explain

SUBJECTS = {
    info.name: import_module(f"{events.__name__}.{info.name}")
    for info in iter_modules(events.__path__)
    if info.name not in ("event", "inputs")
}


def kinds(alias):
    """The classes of a union, or the one class that it is."""
    return set(get_args(alias) or (alias,))


def events_of(module):
    """The classes of a subject; where it has no other events, its decisions."""
    return kinds(module.Events if hasattr(module, "Events") else module.Decisions)


def test_every_event_has_one_subject():
    found = [kind for module in SUBJECTS.values() for kind in events_of(module)]
    assert len(found) == len(set(found))
    assert set(found) == set(get_args(Event))


@pytest.mark.parametrize("name", SUBJECTS)
def test_a_subject_leaves_none_of_its_classes_out(name):
    module = SUBJECTS[name]
    own = {
        value
        for value in vars(module).values()
        if is_dataclass(value) and value.__module__ == module.__name__
    }
    framed = {kind for kind in own if "frame" in kind.__dataclass_fields__}
    assert framed <= events_of(module) | set(get_args(Input))


def test_decisions_and_switches_are_those_of_the_subjects():
    decisions = [module.Decisions for module in SUBJECTS.values() if hasattr(module, "Decisions")]
    switches = [module.Switches for module in SUBJECTS.values() if hasattr(module, "Switches")]
    assert set().union(*map(kinds, decisions)) == set(get_args(Decision))
    assert set().union(*map(kinds, switches)) == set(get_args(Switch)) <= set(get_args(Decision))


def test_a_refused_request_says_whose_it_was():
    refused = SUBJECTS["by_hand"].InputRefused(7, "2", "motion", "it is shed")
    says = "the request for motion is refused: it is shed"
    assert explain(refused, name_target=True) == "frame 7, target 2: " + says
    assert explain(refused) == "frame 7: " + says
