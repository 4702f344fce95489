"""Sentences of switches by evidence, and of the drift guard: each golden, and true at its turning point."""

from __future__ import annotations

import math

import pytest

from bayesnet_track.journal.codec import from_json, to_json
from bayesnet_track.journal.events.switches import Activated, Deactivated, ReferenceGuarded
from bayesnet_track.journal.target_net import Concentration
from bayesnet_track.journal.text.sentences import explain

UNSURE = Concentration(0.9, 0.25, 0.95, 0.62, 214.3, 0.5628, 2, 0.5714, 10.24, 350.0)
SURE = Concentration(0.9, 0.25, 0.95, 0.971, 214.3, 0.9447, 6, 0.9312, 10.24, 35.0)
EXACT = Concentration(0.9, 0.25, 0.95, 0.8996, math.inf, 0.8996, 1, 0.8996, 10.24, 350.0)
INDEX = {"motion": 0.1204, "color": 0.4}

GOLDEN = [
    (
        Activated(30, "1", "motion", "square", UNSURE),
        "frame 30: 62 % within 10.2 px of the mode, of 214 effective hypotheses: at 95 % confidence at least "
        "0.563 lies there, < 0.9 for 2 frames → motion on; would have stayed off at share ≤ 0.571",
    ),
    (
        Activated(30, "1", "motion", "square", UNSURE, 0.5, {"motion": 1.25, "color": 0.75}),
        "frame 30: 62 % within 10.2 px of the mode, of 214 effective hypotheses: at 95 % confidence at least "
        "0.563 lies there, < 0.9 for 2 frames → motion on (1.25 nats per ms expected against color 0.75); "
        "would have stayed off at share ≤ 0.571",
    ),
    (
        Activated(30, "1", "motion", "square", EXACT, None, {"motion": math.inf, "color": math.inf}),
        "frame 30: 90 % within 10.2 px of the mode, exactly: 0.8996 < 0.9 for 1 frame → motion on "
        "(never tried against color never tried either); would have stayed off at share ≤ 0.8996",
    ),
    (
        Deactivated(40, "1", "motion", "square", SURE, "min_information_per_ms", INDEX),
        "frame 40: 97.1 % within 10.2 px of the mode, of 214 effective hypotheses: at 95 % "
        "confidence at least "
        "0.945 lies there, ≥ 0.9 for 6 frames → motion off (min information per ms 0.12 against "
        "color 0.40); "
        "would have stayed on at share > 0.932",
    ),
    (
        ReferenceGuarded(50, "1", "hue", True, -0.31, -1.42, 1.0, 0.05, 0),
        "frame 50: hue: the estimate scores -0.31 nats by its reference, -1.42 by its slow one: "
        "1.11 > 1 apart → "
        "stops learning, pulled back by 0.05 a frame; would have learnt at apart_nats ≥ 1.11",
    ),
    (
        ReferenceGuarded(70, "1", "hue", False, -0.31, -0.9, 1.0, 0.05, 20),
        "frame 70: hue: the estimate scores -0.31 nats by its reference, -0.90 by its slow one: "
        "0.59 ≤ 1 apart "
        "after 20 frames → learns again",
    ),
]


@pytest.mark.parametrize(("event", "sentence"), GOLDEN, ids=lambda one: type(one).__name__)
def test_the_sentence(event, sentence):
    assert explain(event) == sentence


@pytest.mark.parametrize("event", [event for event, _ in GOLDEN])
def test_the_log_keeps_it(event):
    assert from_json(to_json(event)) == event
