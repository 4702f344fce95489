"""Events of the journal: their sentences, and how decisions change a net."""

from dataclasses import is_dataclass
from importlib import import_module
from pkgutil import iter_modules
from typing import get_args

from bayesnet_track.journal import events
from bayesnet_track.journal.events.event import Event, Input
from bayesnet_track.journal.events.joins import Joined, Parted
from bayesnet_track.journal.events.load import InputRefused
from bayesnet_track.journal.net import ENDS, STARTS, Decision, Switch
from bayesnet_track.journal.text.sentences import explain

EVENTS = [
    value
    for info in iter_modules(events.__path__)
    for value in vars(import_module(f"{events.__name__}.{info.name}")).values()
    if is_dataclass(value) and value.__module__.endswith(f".{info.name}") and hasattr(value, "describe")
]


def test_every_class_with_a_sentence_is_an_event():
    assert len(EVENTS) > 50
    assert set(EVENTS) == set(get_args(Event)) | {
        kind for kind in get_args(Input) if hasattr(kind, "describe")
    }


def test_decisions_are_the_events_that_change_a_net():
    changing = {kind for kind in EVENTS if hasattr(kind, "change")}
    of_several = {*STARTS, *ENDS, Joined, Parted}
    assert changing | of_several == set(get_args(Decision)) <= set(get_args(Event))
    assert {kind for kind in changing if hasattr(kind, "shorten")} == set(get_args(Switch))


def test_a_refused_request_says_whose_it_was():
    refused = InputRefused(7, "2", "motion", "it is shed")
    says = "the request for motion is refused: it is shed"
    assert explain(refused, name_target=True) == "frame 7, target 2: " + says
    assert explain(refused) == "frame 7: " + says
