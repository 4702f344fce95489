"""What the page of a session is told, and what it may ask for: without a browser and without a tracker."""

import json
import time
import urllib.error
import urllib.request

import numpy as np
import pytest

from bayesnet_track.runtime.annotation.answers import Header
from bayesnet_track.runtime.annotation.asking import TrackedBox
from bayesnet_track.runtime.annotation.desk import AnnotationServer
from bayesnet_track.runtime.annotation.frame_store import Video
from bayesnet_track.runtime.annotation.session import open_session

HEADER = Header(Video("made_up.mp4", 30, 320, 240, 0.04, "abc"), "general", "0" * 64, 0, 0.5, 1, "1.0")


class MadeUp:
    def __len__(self):
        return 30

    def image(self, frame):
        return np.full((2400, 3200, 3), frame, dtype=np.uint8)

    def at(self, start, box, frame):
        if box[0] == 99:
            raise RuntimeError("no cue")
        return TrackedBox(box, 0.9 if frame < 20 else 0.4, (1.0, 2.0), "uncertain")


@pytest.fixture
def desk(tmp_path):
    session, _ = open_session(tmp_path, HEADER)
    with AnnotationServer(session, MadeUp(), MadeUp(), "labels") as made:
        yield made


def do(desk, **what):
    request = urllib.request.Request(
        f"{desk.address}do",
        json.dumps(what).encode(),
        {"Content-Type": "application/json", "Origin": desk.address.rsplit("/", 2)[0]},
    )
    return urllib.request.urlopen(request).status


def told(desk, first=0):
    end = time.monotonic() + 20
    seen = 0
    while time.monotonic() < end:
        found = json.loads(urllib.request.urlopen(f"{desk.address}feed?from={first}&seen={seen}").read())
        if not found["behind"]:
            return found
        seen = found["version"]
    raise AssertionError("still behind")


def test_answers_are_tracked_and_the_page_is_told_the_question(desk):
    assert b"data-annotate" in urllib.request.urlopen(desk.address).read()
    assert told(desk)["targets"] == []
    assert do(desk, do="answer", kind="box", frame=0, target="ball 1", box=[5, 5, 20, 20]) == 200
    found = told(desk)
    (target,) = found["targets"]
    assert target["how"] == "g" + "t" * 20 + "." * 9
    assert target["percent"][19:22] == [90, 40, 0] and target["boxes"][21] is None
    assert found["questions"][0]["frame"] == 20 and "status uncertain" in found["questions"][0]["reason"]
    assert "targets" not in told(desk, found["marks"])
    do(desk, do="answer", kind="correct", frame=20, target="ball 1")
    assert told(desk)["targets"][0]["how"][20] == "g"
    do(desk, do="leave")
    desk.wait(lambda: False)


def test_what_makes_no_sense_is_refused_with_words(desk):
    for what, words in [
        ({"do": "answer", "kind": "gone", "frame": 1, "target": "a"}, "has no box yet"),
        ({"do": "answer", "kind": "box", "frame": 99, "target": "a", "box": [1, 2, 3, 4]}, "frames 0 to 29"),
        ({"do": "answer", "kind": "undo"}, "no answer to take back"),
        ({"do": "dance"}, "no such thing"),
    ]:
        with pytest.raises(urllib.error.HTTPError) as refused:
            do(desk, **what)
        assert refused.value.code == 400 and words in json.loads(refused.value.read())["error"]


def test_a_picture_is_of_the_frame_and_not_too_large(desk):
    answer = urllib.request.urlopen(f"{desk.address}picture?frame=77")
    assert answer.headers["X-Frame"] == "29" and answer.headers["Content-Type"] == "image/jpeg"
    import cv2

    picture = cv2.imdecode(np.frombuffer(answer.read(), np.uint8), cv2.IMREAD_COLOR)
    assert picture.shape == (1440, 1920, 3) and abs(int(picture[0, 0, 0]) - 29) < 4


def test_a_tracker_that_fails_is_told_and_the_answers_are_kept(desk):
    do(desk, do="answer", kind="box", frame=0, target="ball 1", box=[99, 5, 20, 20])
    do(desk, do="answer", kind="box", frame=3, target="ball 2", box=[5, 5, 20, 20])
    found = told(desk)
    assert "ball 1, frame 1: not tracked: RuntimeError: no cue" in found["trouble"]
    assert ("ball 1", 1) in [(one["target"], one["frame"]) for one in found["questions"]]
    assert [one["how"].count("t") for one in found["targets"]] == [0, 17]
    assert not desk.is_tracked
    do(desk, do="answer", kind="undo")
    do(desk, do="answer", kind="undo")
    assert told(desk)["trouble"] == "" and desk.is_tracked


def test_the_page_is_refused_a_box_from_which_no_tracker_starts(desk):
    for box, words in [
        ([5, 5, 0.5, 20], "width and height must be at least 1 px"),
        ([5, 5, 20, 2401], "at most 10 times the 320x240 frame"),
        ([5, 5, -20, 20], "width and height above 0"),
        ([1e308, 5, 1e308, 20], "outside"),
        (["5", 5, 20, 20], "four numbers"),
        ([True, 5, 20, 20], "four numbers"),
    ]:
        for kind in ("box", "correct"):
            with pytest.raises(urllib.error.HTTPError) as refused:
                do(desk, do="answer", kind=kind, frame=0, target="ball 1", box=box)
            assert refused.value.code == 400 and words in json.loads(refused.value.read())["error"]
    assert told(desk)["answers"] == 0


@pytest.mark.parametrize(
    "what",
    [
        {"kind": ["box"], "frame": 0, "target": "a", "box": [5, 5, 20, 20]},
        {"kind": "correct", "frame": [0], "target": "a"},
        {"kind": "correct", "frame": {}, "target": ["a"]},
        {"kind": "gone", "frame": 0, "target": {}},
        {"kind": "box", "frame": True, "target": "a", "box": [5, 5, 20, 20]},
        {"kind": "box", "frame": 0, "target": "a", "box": {"x": 5}},
        {"kind": "box", "frame": 0, "target": "a", "box": [10**400, 5, 20, 20]},
        {},
    ],
)
def test_a_message_of_other_types_is_refused_with_words(desk, what):
    with pytest.raises(urllib.error.HTTPError) as refused:
        do(desk, do="answer", **what)
    assert refused.value.code == 400 and len(json.loads(refused.value.read())["error"]) > 10
