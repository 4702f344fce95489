"""Answers are on the disk at once, and a session that is gone on with gives the same bytes."""

import json
from dataclasses import replace

import numpy as np
import pytest

from bayesnet_track import load_graph
from bayesnet_track.runtime.annotation import asking
from bayesnet_track.runtime.annotation.answers import (
    UNDO,
    Answer,
    AnswerError,
    AnswersFileError,
    Header,
    append_answers,
    first_difference,
    read_answers,
)
from bayesnet_track.runtime.annotation.asking import TrackedBox, TrackerRuns
from bayesnet_track.runtime.annotation.desk import WRITERS
from bayesnet_track.runtime.annotation.frame_store import FrameStore, Video
from bayesnet_track.runtime.annotation.session import open_session
from bayesnet_track.sources.entrances.notices import InputNotice
from bayesnet_track.sources.scenes.library import SceneSource

VIDEO = Video("made_up.mp4", 30, 320, 240, 0.04, "abc")
HEADER = Header(VIDEO, "general", "0" * 64, 0, 0.5, 1, "1.0")


class MadeUp:
    """A box that moves two px a frame, doubtful ten frames from an answer on."""

    def at(self, start, box, frame):
        probability = 0.9 if abs(frame - start) < 10 else 0.3
        return TrackedBox((box[0] + 2 * (frame - start), *box[1:]), probability, (1.0, 1.0), "tracking")


def box(frame, target="ball 1"):
    return {"kind": "box", "frame": frame, "target": target, "box": [10 + 2 * frame, 10, 20, 20]}


STEPS = (box(0), box(10), {"kind": "undo"}, box(10), {"kind": "correct", "frame": 20, "target": "ball 1"})


def test_a_session_gone_on_with_after_every_answer_has_the_same_bytes(tmp_path):
    whole, _ = open_session(tmp_path / "whole", HEADER)
    for step in STEPS:
        whole.give(step)
        assert whole.update(MadeUp())
    for step in STEPS:
        again, difference = open_session(tmp_path / "again", HEADER)
        assert difference is None
        again.update(MadeUp())
        again.give(step)
    again, _ = open_session(tmp_path / "again", HEADER)
    again.update(MadeUp())
    assert (tmp_path / "again/answers.jsonl").read_bytes() == (tmp_path / "whole/answers.jsonl").read_bytes()
    assert again.annotations == whole.annotations
    for write in WRITERS.values():
        assert write(again.document) == write(whole.document)
    assert len(read_answers(whole.path).answers) == len(STEPS)


def test_undo_gives_what_there_was_before(tmp_path):
    session, _ = open_session(tmp_path, HEADER)
    session.give(box(0))
    session.update(MadeUp())
    before = session.annotations
    session.give({"kind": "gone", "frame": 4, "target": "ball 1"})
    session.update(MadeUp())
    assert session.annotations != before
    session.give({"kind": "undo"})
    session.update(MadeUp())
    assert session.annotations == before
    session.give({"kind": "undo"})
    with pytest.raises(AnswerError, match="no answer to take back"):
        session.give({"kind": "undo"})


def test_what_makes_no_sense_is_refused_and_not_kept(tmp_path):
    session, _ = open_session(tmp_path, HEADER)
    for given, said in [
        ({"kind": "gone", "frame": 1, "target": "ball 1"}, "has no box yet"),
        ({"kind": "correct", "frame": 1, "target": "ball 1"}, "no box of ball 1 to confirm"),
    ]:
        with pytest.raises(AnswerError, match=said):
            session.give(given)
    assert session.path.read_bytes().count(b"\n") == 1


def test_an_answer_that_comes_while_it_tracks_ends_that(tmp_path):
    session, _ = open_session(tmp_path, HEADER)
    session.give(box(0))

    def interrupt(target, frame):
        if frame == 5:
            session.give(box(5))

    assert not session.update(MadeUp(), interrupt)
    assert session.update(MadeUp())
    assert session.annotations.marks["ball 1"][5].how == "given"


def test_what_is_still_tracked_when_a_session_is_closed_changes_nothing(tmp_path):
    session, _ = open_session(tmp_path, HEADER)
    session.give(box(0))
    assert session.update(MadeUp())
    before = session.annotations
    session.give(box(3, "ball 2"))
    assert not session.update(MadeUp(), lambda target, frame: session.close())
    assert session.annotations is before


def test_a_line_torn_by_a_crash_is_cut_off_and_others_are_refused(tmp_path):
    session, _ = open_session(tmp_path, HEADER)
    session.give(box(0))
    whole = session.path.read_bytes()
    session.path.write_bytes(whole + b'{"kind": "bo')
    with pytest.warns(InputNotice, match="the last line, 3, is unfinished"):
        open_session(tmp_path, HEADER)
    assert list(read_answers(session.path).answers) == [Answer("box", 0, "ball 1", (10.0, 10.0, 20.0, 20.0))]
    assert session.path.read_bytes() == whole
    session.path.write_bytes(whole + b'{"kind": "box"}\n')
    with pytest.raises(AnswersFileError, match=r"answers.jsonl, line 3: frame None"):
        read_answers(session.path)
    session.path.write_bytes(b'{"kind": "box"}\n')
    with pytest.raises(AnswersFileError, match="line 1: no header"):
        open_session(tmp_path, HEADER)


def test_another_video_is_refused_and_another_version_is_told(tmp_path):
    open_session(tmp_path, HEADER)
    longer = Header(Video("made_up.mp4", 31, 320, 240, 0.04, "abc"), *list(vars(HEADER).values())[1:])
    with pytest.raises(AnswersFileError, match="frames: 31, it was 30"):
        open_session(tmp_path, longer)
    newer = Header(VIDEO, "general", "0" * 64, 0, 0.5, 1, "2.0")
    assert open_session(tmp_path, newer)[1] == "version: 2.0, it was 1.0"
    assert first_difference(HEADER, HEADER) is None
    smaller = replace(HEADER, max_side=160)
    assert first_difference(HEADER, smaller) == "max side: 160, it was None"
    other = Header(Video("x", 30, 320, 240, 0.04, "abd"), *list(vars(HEADER).values())[1:])
    assert "frames differ" in first_difference(HEADER, other)


def test_append_adds_lines_only(tmp_path):
    session, _ = open_session(tmp_path, HEADER)
    append_answers(session.file, [UNDO])
    assert json.loads(session.path.read_text().splitlines()[-1]) == {"kind": "undo"}


@pytest.mark.slow
def test_frames_come_in_any_order_as_they_were(tmp_path):
    source = SceneSource.named("two_squares", end=60)
    seen = []
    with FrameStore.of(source, "two_squares", 0.04, seen.append) as store:
        assert len(store) == 60 and seen[-1] == 60
        frames = SceneSource.named("two_squares", end=60).scene.frames
        for frame in (59, 0, 30, 1):
            assert np.array_equal(store.image(frame), frames[frame])
        about = store.about()
        assert (about.frames, about.width, about.height) == (60, 320, 240) and len(about.pixels) == 64


def test_the_tracker_runs_forward_and_backward_from_a_box():
    source = SceneSource.named("two_squares", end=6)
    truth = source.scene.truth
    with FrameStore.of(source, "two_squares", 0.04) as store:
        runs = TrackerRuns(load_graph("gray_square"), store)
        x, y, w, h = truth[3]
        for frame in (5, 4, 0):
            found = runs.at(3, (float(x), float(y), float(w), float(h)), frame)
            assert np.abs(np.array(found.box) - truth[frame]).max() < 12
            assert 0 <= found.probability <= 1
        assert runs.at(3, (float(x), float(y), float(w), float(h)), 5) is runs.at(3, (x, y, w, h), 5)


def test_a_target_that_ended_is_lost_where_it_was_last():
    class Store:
        def __len__(self):
            return 12

        def image(self, frame):
            image = np.full((90, 160, 3), 40, np.uint8)
            if frame < 3:
                cells = np.random.default_rng(0).integers(150, 255, (5, 5, 1))
                image[30:50, 20:40] = np.kron(cells, np.ones((4, 4, 1)))
            return image

    node = {"motion": {"random_walk": {"sd_px": {"x": 2, "y": 2}}}, "belief": {"particles": {"size": 100}}}
    nodes = {"s": node, "a": {"parent": "s", "agent": "intensity"}}
    kind = {"death": {"lost_frames": 2}, "nodes": nodes}
    runs = TrackerRuns(load_graph({"name": "ends", "targets": {"square": kind}}), Store())
    found = [runs.at(0, (20.0, 30.0, 20.0, 20.0), frame) for frame in range(1, 12)]
    ended = found[-1]
    assert ended == found[-2] and (ended.probability, ended.status) == (0.0, "lost")
    assert ended.box in [one.box for one in found if one.probability > 0]


def test_a_run_whose_tracker_was_let_go_goes_on_as_if_nothing_had_been(monkeypatch):
    source = SceneSource.named("two_squares", end=7)
    x, y, w, h = map(float, source.scene.truth[0])
    graph = load_graph("gray_square")
    with FrameStore.of(source, "two_squares", 0.04) as store:
        straight = [TrackerRuns(graph, store).at(0, (x, y, w, h), frame) for frame in (3, 6)]
        monkeypatch.setattr(asking, "AT_ONCE", 1)
        runs = TrackerRuns(graph, store)
        first = runs.at(0, (x, y, w, h), 3)
        runs.at(2, (x, y, w, h), 3)
        assert [first, runs.at(0, (x, y, w, h), 6)] == straight
