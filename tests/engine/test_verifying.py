"""Verifiers: cues that a score asks about the estimate alone, with references of their own."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from bayesnet_track import Tracker
from bayesnet_track.engine.scoring.score import probability
from bayesnet_track.graph.spec import Logistic
from bayesnet_track.journal.events.faults import VerifierFailed

TWO = {"root": {"fuse": "product", "ud_fields": ["x", "y"]}, "a": "root", "b": "root"}


def nodes(verifiers, **rule):
    score = {"logistic": {"bias": 2.0, "memory_frames": 0, "verifiers": verifiers, **rule}}
    return {**TWO, "root": {**TWO["root"], "score": score}}


def run(fakes, says, frames=9, verifiers=None, **rule):
    """Outcomes of a target at rest; `says` is what the verifiers' cue `c` says of a frame."""

    def see(planes, hypotheses, reference):
        return np.full(len(hypotheses), says(planes.frame.index))

    sees = {"a": fakes.gaussian(50.0, 40.0, 3.0), "b": fakes.flat(), "c": see}
    engine, cues = fakes.engine(nodes(verifiers or {"v": {"agent": "c", "coefficient": 0.5}}, **rule), sees)
    return fakes.play(engine, frames), cues


def said(outcomes, name="v"):
    return [outcome.metrics[0].features[name] for outcome in outcomes[1:]]


def failures(outcomes):
    return [event for outcome in outcomes for event in outcome.events if isinstance(event, VerifierFailed)]


def test_a_verifier_is_a_feature_of_the_score_and_moves_no_box(fakes):
    outcomes, _ = run(fakes, lambda frame: -0.25 * frame)
    assert said(outcomes) == [-0.25 * frame for frame in range(1, 10)]
    rule = Logistic(bias=2.0, memory_frames=0, verifiers={"v": {"agent": "c", "coefficient": 0.5}})
    for outcome in outcomes[1:]:
        line = outcome.metrics[0]
        assert line.score == pytest.approx(probability(rule, line.features))
    boxes = [outcome.metrics[0].centre_box for outcome in outcomes]
    others, _ = run(fakes, lambda frame: -5.0)
    assert boxes == [outcome.metrics[0].centre_box for outcome in others]


def test_it_is_asked_of_the_estimate_alone(fakes):
    asked = []

    def see(planes, hypotheses, reference):
        asked.append((planes.frame.index, hypotheses.boxes.copy()))
        return np.zeros(len(hypotheses))

    sees = {"a": fakes.gaussian(50.0, 40.0, 3.0), "b": fakes.flat(), "c": see}
    engine, _ = fakes.engine(nodes({"v": {"agent": "c"}}), sees)
    outcomes = fakes.play(engine, 4)
    assert [frame for frame, _ in asked] == [1, 2, 3, 4]
    for (_, boxes), outcome in zip(asked, outcomes[1:], strict=True):
        assert boxes[0] == pytest.approx(outcome.metrics[0].centre_box) and len(boxes) == 1


def test_all_are_asked_in_the_first_frame_and_then_those_whose_turn_it_is(fakes):
    """A verifier that has said nothing yet would count as one that says 0, its best."""
    every = {name: {"agent": "c", "every": 3} for name in ("v", "w")}
    outcomes, _ = run(fakes, lambda frame: -1.0 * frame, verifiers=every)
    assert said(outcomes) == [-1, -1, -3, -3, -3, -6, -6, -6, -9]
    assert said(outcomes, "w") == [-1, -2, -2, -2, -5, -5, -5, -8, -8]


@pytest.mark.parametrize("first", [0, 1])
def test_with_a_stride_they_take_turns_too(fakes, first):
    every = {name: {"agent": "c", "every": 2} for name in ("v", "w")}
    sees = {
        "a": fakes.gaussian(50.0, 40.0, 3.0),
        "b": fakes.flat(),
        "c": lambda planes, h, reference: np.full(len(h), -1.0 * planes.frame.index),
    }
    engine, _ = fakes.engine(nodes(every), sees)
    frames = [replace(fakes.frame(first + 2 * n), stride=2) for n in range(6)]
    outcomes = fakes.play(engine, frames)
    asked = {name: np.flatnonzero(np.diff(said(outcomes, name))).tolist() for name in ("v", "w")}
    assert asked == {"v": [0, 2], "w": [1, 3]}


def test_it_learns_in_the_first_frame_and_while_the_score_is_no_less_than_a_tenth(fakes):
    often = {"v": {"agent": "c", "coefficient": 1.0, "learn_rate": 0.5}}
    _, cues = run(fakes, lambda frame: 0.0 if frame < 4 else -9.0, verifiers=often)
    assert sorted(frame for frame, *_ in cues["c"].learnt) == [0, 1, 2, 3]
    never = {"v": {"agent": "c", "learn_rate": 0}}
    _, cues = run(fakes, lambda frame: 0.0, verifiers=never)
    assert [frame for frame, *_ in cues["c"].learnt] == [0]


def test_what_it_says_while_nothing_fits_is_forgotten(fakes):
    """As in a black frame: all are asked, whoever's turn it is, and take up again where they were."""
    dark = range(4, 7)

    def fits(planes, hypotheses, reference):
        seen = fakes.gaussian(50.0, 40.0, 3.0, floor=1e-3)(planes, hypotheses, None)
        return np.full(len(hypotheses), -7.0) if planes.frame.index in dark else seen

    def see(planes, hypotheses, reference):
        return np.full(len(hypotheses), -50.0 if planes.frame.index in dark else -0.5)

    rule = {"memory_frames": 4, "full_fit": 0.05, "bias": 9.0}
    described = nodes({"v": {"agent": "c", "every": 5, "coefficient": 1.0}}, **rule)
    described["root"]["lost"] = {"score_below": 1e-9, "uncertain_below": 1e-8}
    engine, _ = fakes.engine(described, {"a": fits, "b": fakes.flat(), "c": see})
    outcomes = fakes.play(engine, 9)
    assert said(outcomes)[2:] == [-0.5, -20.0, -20.0, -20.0, -0.5, -0.5, -0.5]  # -20: the least that counts
    widths = [one.metrics[0].features["log_ud_box"] for one in outcomes[1:]]
    assert len(set(widths[2:6])) == 1  # a belief that nothing fits is as wide as its motion makes it
    (line,) = outcomes[7].metrics
    own = np.log(line.ud_px2 / (line.centre_box[2] * line.centre_box[3]))
    assert widths[6] == pytest.approx(own)  # what was before is forgotten when something fits


@pytest.mark.parametrize("wrong", ["raises", "positive", "nan"])
def test_one_that_fails_is_reported_once_and_the_run_goes_on(fakes, wrong):
    def says(frame):
        if frame == 3 and wrong == "raises":
            raise RuntimeError("too dark")
        return {"positive": 1.0, "nan": np.nan, "raises": -1.0}[wrong] if frame >= 3 else -1.0

    outcomes, _ = run(fakes, says)
    (event,) = failures(outcomes)
    assert (event.frame, event.target, event.verifier) == (3, "1", "v")
    assert {"raises": "raised RuntimeError: too dark", "positive": "not at most 0", "nan": "not at most 0"}[
        wrong
    ] in event.reason
    assert said(outcomes) == [-1.0] * 9


def test_one_that_cannot_learn_is_asked_again_in_the_next_frame_and_then_no_more(fakes):
    class Unlearned(fakes.Oracle):
        def learn(self, planes, box):
            raise ValueError("nothing there")

    sees = {"a": fakes.gaussian(50.0, 40.0, 3.0), "b": fakes.flat(), "c": Unlearned(fakes.flat())}
    engine, _ = fakes.engine(nodes({"v": {"agent": "c"}}), sees)
    outcomes = fakes.play(engine, 5)
    assert [(event.frame, event.reason) for event in failures(outcomes)] == [
        (1, "raised ValueError: nothing there")
    ]
    assert said(outcomes) == [0.0] * 5


def stripes(image, across, box=(40, 30, 24, 24)):
    x, y, w, h = box
    line = np.where(np.arange(24) // 3 % 2, 220, 60).astype(np.uint8)
    image[y : y + h, x : x + w] = (line[None, :, None] if across else line[:, None, None]) + np.zeros(
        (h, w, 3), np.uint8
    )
    return image


def test_texture_tells_that_something_else_of_the_same_colours_has_taken_its_place():
    rng = np.random.default_rng(3)
    ground = rng.integers(90, 130, (90, 120, 3)).astype(np.uint8)
    verifiers = {"texture": {"agent": "texture", "coefficient": 1.5, "learn_rate": 0.02}}
    root = {
        "motion": {"random_walk": {"sd_px": {"x": 1, "y": 1}}},
        "score": {"logistic": {"bias": 4, "memory_frames": 0, "verifiers": verifiers}},
    }
    tree = {"root": root, "a": {"parent": "root", "agent": "color_histogram"}}
    tracker = Tracker({"name": "g", "targets": {"t": {"nodes": tree}}}, 0)
    tracker.init(stripes(ground.copy(), True), (40, 30, 24, 24))
    scores = []
    for frame in range(1, 12):
        tracker.update(stripes(ground.copy(), frame < 6))
        scores.append(tracker.score)
    assert min(scores[:5]) > 0.8 and max(scores[5:]) < 0.3
