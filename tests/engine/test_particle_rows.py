"""Targets held by particles that are filtered together: the same bytes as one by one."""

import numpy as np
import pytest

from bayesnet_track.cues.color_histogram import ColorHistogram
from bayesnet_track.engine import finishing, learning
from bayesnet_track.engine import step as steps
from bayesnet_track.engine.frame_work import FrameWork
from bayesnet_track.engine.rows import plain_rows
from bayesnet_track.engine.rows.particle_rows import filter_rows, plate_fits
from bayesnet_track.engine.rows.shared_planes import planes_of_each
from bayesnet_track.graph.text.load import load_graph
from bayesnet_track.journal.codec import to_json
from bayesnet_track.observation.planes import Frame, FramePair, PlaneCache, region_of_boxes

NODES = {
    "thing": {
        "belief": {"particles": {"size": 80}},
        "motion": {"constant_velocity": {"sd_velocity_px": 1.0}},
        "fuse": "product",
        "ud_fields": ["x", "y"],
        "learn": {"below": {"ud_px2": 100}},
    },
    "color": {"parent": "thing", "agent": {"color_histogram": {"floor": 0.003}}},
    "coarse": {"parent": "thing", "agent": {"color_histogram": {"bins": 8}}, "temperature": 2.0},
}
GRAPH = load_graph({"name": "things", "targets": {"thing": {"nodes": NODES}}})
PLACES = ((20.0, 20.0), (60.0, 40.0), (118.0, 90.0), (64.0, 44.0))


def frame(index):
    cells = np.random.default_rng(1).integers(0, 255, (6, 8, 3), dtype=np.uint8)
    image = np.kron(cells, np.ones((16, 16, 1), np.uint8))
    return Frame(index, float(index), np.roll(image, 2 * index, axis=1))


def started(graph=GRAPH, plate="thing"):
    engine, state = steps.make_engine(graph, 3), steps.State()
    for number, at in enumerate(PLACES):
        box = np.array([*at, 16.0, 16.0])
        state = steps.start_target(engine, state, frame(0), str(number), plate, box).state
    return engine, state


def lines(frames=5):
    """All that is written down."""
    engine, state = started()
    written = []
    for index in range(1, frames):
        outcome = steps.step(engine, state, frame(index))
        state = outcome.state
        written += [to_json(one) for one in (*outcome.metrics, *outcome.events)]
    return written


def test_together_and_one_by_one_are_the_same_bytes(monkeypatch):
    asked = []
    own = ColorHistogram.log_likelihood_of_each
    monkeypatch.setattr(
        ColorHistogram, "log_likelihood_of_each", lambda self, *args: asked.append(0) or own(self, *args)
    )
    together = lines()
    assert len(asked) == 8
    monkeypatch.setattr(steps, "filter_rows", lambda work, before: {})
    assert lines() == together


@pytest.mark.parametrize("answer", ["raises", "positive", "short", "nothing"])
def test_what_a_cue_says_of_all_and_cannot_be_used_is_asked_one_by_one(monkeypatch, answer):
    def said(self, planes, boxes, starts, references):
        if answer == "raises":
            raise RuntimeError("of all")
        shape = len(boxes) - (answer == "short")
        return np.full(shape, {"positive": 1.0, "nothing": np.nan}.get(answer, 0.0))

    expected = lines(3)
    monkeypatch.setattr(ColorHistogram, "log_likelihood_of_each", said)
    assert lines(3) == expected


@pytest.mark.parametrize("answer", ["raises", "not finite"])
def test_agents_of_all_that_cannot_learn_together_learn_one_by_one(monkeypatch, answer):
    def followed(self, planes, boxes, references, rates):
        if answer == "raises":
            raise RuntimeError("of all")
        return [{**one, "alpha": np.array(np.nan)} for one in references]

    expected = lines(3)
    monkeypatch.setattr(ColorHistogram, "follow_each", followed)
    assert lines(3) == expected


def test_agents_of_all_targets_learn_in_one_call(monkeypatch):
    asked, own = [], ColorHistogram.follow_each
    monkeypatch.setattr(
        ColorHistogram, "follow_each", lambda self, *args: asked.append(len(args[1])) or own(self, *args)
    )
    together = lines(4)
    assert asked and max(asked) > 1
    monkeypatch.setattr(finishing, "finish_rows", lambda *_: {})
    monkeypatch.setattr(learning, "plate_learns", lambda compiled: False)
    assert lines(4) == together


def test_finished_together_and_one_by_one_are_the_same_bytes(monkeypatch):
    """So is what the rules remember; a target that looks lost is finished by itself."""
    finished = []

    def finish(*given):
        found = plain_rows.finish_rows(*given)
        finished.append(len(found))
        return found

    def memories():
        engine, state = started()
        for index in range(1, 14):
            state = steps.step(engine, state, frame(index if index < 10 else index + 30)).state
        return {target: one.memory for target, one in state.targets.items()}

    monkeypatch.setattr(finishing, "finish_rows", finish)
    together, remembered = lines(8), memories()
    assert max(finished) == len(PLACES) and min(finished) < len(PLACES)
    monkeypatch.setattr(finishing, "finish_rows", lambda *_: {})
    assert lines(8) == together and memories() == remembered


def test_only_targets_that_fit_go_together():
    engine, state = started()
    work = FrameWork(engine, state.net, PlaneCache(FramePair(frame(1), frame(0))))
    assert list(filter_rows(work, state.targets)) == ["0", "1", "2", "3"]
    work.availability.known["0", "color", "observing"] = "late"
    assert filter_rows(work, state.targets) == {}
    for name, is_fit in (("two_squares", True), ("crowd", True), ("general", False), ("kalman_ball", False)):
        plates = steps.make_engine(load_graph(name)).plates.values()
        assert {plate_fits(plate) for plate in plates} == {is_fit}


@pytest.mark.parametrize("side", [8.0, 200.0])
def test_planes_hold_the_boxes_of_each_target(side):
    engine, state = started()
    work = FrameWork(engine, state.net, PlaneCache(FramePair(frame(1), None)))
    boxes = np.array([[[*at, side, side], [at[0] + 3, at[1], side, side]] for at in PLACES])
    needs = engine.plates["thing"].cues["color"].needs
    starts = np.arange(0, 2 * len(boxes) + 1, 2)
    found = planes_of_each(work, needs, boxes.reshape(-1, 4), starts, 0.5)
    for planes, own in zip(found, boxes, strict=True):
        assert planes.region.contains(region_of_boxes(own, 0.5).within(work.frame))
        assert planes[needs[0]].shape == (
            planes.region.y1 - planes.region.y0,
            planes.region.x1 - planes.region.x0,
        )
