"""Identities of a run: what is asked first, what an answer says of the others, and the tracks that follow."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from bayesnet_track import track
from bayesnet_track.adapt import tracklets as pieces
from bayesnet_track.cli.main import main
from bayesnet_track.evaluate.truth import read_mot_tracks
from bayesnet_track.observation.planes import Frame
from bayesnet_track.runtime.annotation.identity_queue import IdentityAnswerError, IdentityQueue, Tracklets

SIZE, FRAMES, MEET = (640, 480), 100, 50


class Black:
    """Black frames."""

    width, height = SIZE
    expected_frames, frame_interval_s = FRAMES, 0.04
    description, end_reason = "black", "end_of_source"

    def __iter__(self) -> Iterator[Frame]:
        for k in range(FRAMES):
            yield Frame(k, 0.04 * k, np.zeros((SIZE[1], SIZE[0], 3), np.uint8))


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two people who meet, are one box, and turn round; a third one far away is not seen for a while."""
    folder, rng = tmp_path_factory.mktemp("queue"), np.random.default_rng(0)
    lines = []
    for k in range(FRAMES):
        away = 1.6 * abs(k - MEET) + 1.0
        centres = [(320 - away, 240.0), (320 + away, 240.0)] if away > 7 else [(320.0, 240.0)]
        if not 40 <= k < 48:
            centres.append((100.0 + 1.5 * k, 80.0))
        for x, y in centres:
            x, y, w, h = np.array([x, y, 30.0, 60.0]) + rng.normal(0, 1.2, 4)
            lines.append(f"{k + 1},-1,{x - w / 2:.2f},{y - h / 2:.2f},{w:.2f},{h:.2f},0.9\n")
    (folder / "detections.txt").write_text("".join(lines))
    for _ in track("kalman_detections", Black(), out=folder / "run", detections=folder / "detections.txt"):
        pass
    return folder / "run"


def places(tracks: Path, frame: int) -> dict[int, float]:
    """Identity -> its x in a frame, of the two in the middle."""
    read = read_mot_tracks(tracks)
    rows = (read.frames == frame) & (read.boxes[:, 1] > 150)
    return dict(zip(read.ids[rows].tolist(), (read.boxes[rows, 0] + 15).tolist(), strict=True))


def ask(run: Path, folder: Path, *answers: dict[str, object]) -> int:
    file = folder / "answers.txt"
    file.write_text("".join(f"{json.dumps(answer)}\n" for answer in answers))
    given = ["--answers", str(file)] if answers else ["--no-view"]
    return main(["annotate", "--identities", str(run), "--out", str(folder / "out"), *given])


@pytest.mark.slow
def test_an_exchange_is_asked_about_and_mended(
    run: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    # They seem to walk through each other: a constant velocity says so.
    assert ask(run, tmp_path) == 0
    first = capsys.readouterr().out.splitlines()[1]
    before = places(tmp_path / "out/tracks.txt", 15)
    names = sorted(map(str, before))
    assert any(f"target {name}: who was it" in first for name in names), first
    frame, target = int(first.split("frame ")[1].split(",")[0]), first.split("target ")[1].split(":")[0]
    kept, other = tmp_path / "keep", next(name for name in names if name != target)
    ends = {}
    for kind in ("keep", "swap"):
        kept = tmp_path / kind
        kept.mkdir()
        assert ask(run, kept, {"frame": frame, "target": target, "answer": kind}) == 0
        ends[kind] = places(kept / "out/tracks.txt", FRAMES - 1)
    keeps, swaps = ends["keep"], ends["swap"]
    assert keeps.keys() == swaps.keys() == before.keys()
    own, others = int(target), int(other)
    assert keeps[own] == pytest.approx(swaps[others]) and keeps[others] == pytest.approx(swaps[own])
    assert abs(keeps[own] - keeps[others]) > 100
    # Nobody else is touched, and both answers leave nothing to ask about the other one.
    assert f"target {other}" not in capsys.readouterr().out.splitlines()[-1]


def test_answers_are_kept_resumed_and_taken_back(
    run: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert ask(run, tmp_path) == 0
    first = capsys.readouterr().out.splitlines()[1]
    plain = (tmp_path / "out/tracks.txt").read_bytes()
    frame, target = int(first.split("frame ")[1].split(",")[0]), first.split("target ")[1].split(":")[0]
    assert ask(run, tmp_path, {"frame": frame, "target": target, "answer": "new"}) == 0
    changed = (tmp_path / "out/tracks.txt").read_bytes()
    assert changed != plain
    file = tmp_path / "out/identities.jsonl"
    with file.open("a") as torn:
        torn.write('{"frame": 1')  # a crash
    assert ask(run, tmp_path) == 0
    assert (tmp_path / "out/tracks.txt").read_bytes() == changed
    assert ask(run, tmp_path, {"answer": "undo"}) == 0
    assert (tmp_path / "out/tracks.txt").read_bytes() == plain
    assert len(file.read_text().splitlines()) == 3


@pytest.mark.parametrize(
    ("line", "found"),
    [
        ({"frame": 3, "target": "77", "answer": "keep"}, "line 2: target '77': the run has none"),
        ({"frame": 3, "target": "1", "answer": "maybe"}, "line 2: answer 'maybe': one of keep, swap"),
        (
            {"frame": 999, "target": "1", "answer": "keep"},
            "there is no question; the nearest one is of frame",
        ),
        ({"frame": "3", "target": "1", "answer": "new"}, "line 2: frame is a whole number"),
    ],
)
def test_a_bad_answer_is_refused_and_none_is_kept(
    run: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], line: dict[str, object], found: str
) -> None:
    assert ask(run, tmp_path) == 0
    first = capsys.readouterr().out.splitlines()[1]
    frame, target = int(first.split("frame ")[1].split(",")[0]), first.split("target ")[1].split(":")[0]
    before = (tmp_path / "out/identities.jsonl").read_bytes()
    assert ask(run, tmp_path, {"frame": frame, "target": target, "answer": "keep"}, line) == 2
    assert found in capsys.readouterr().err
    assert (tmp_path / "out/identities.jsonl").read_bytes() == before


def test_answers_about_another_run_are_refused(
    run: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "out").mkdir()
    (tmp_path / "out/identities.jsonl").write_text('{"format": "x"}\n')
    assert ask(run, tmp_path) == 2
    assert "line 1: these are no answers about this run" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("arguments", "found"),
    [
        (["annotate", "--out", "x"], "needs a VIDEO and --out"),
        (["annotate", "v.mp4", "--out", "x", "--answers", "a"], "--answers: of --identities RUN"),
        (["annotate", "v.mp4", "--identities", "x"], "VIDEO: of a video to label"),
        (["annotate", "--identities", "nowhere"], "nowhere"),
    ],
)
def test_arguments_that_do_not_go_together(
    arguments: list[str], found: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(arguments) == 2
    assert found in capsys.readouterr().err


def straight(name: str, first: int, last: int, x: float, speed: float) -> pieces.TrackPath:
    frame = np.arange(first, last + 1)
    boxes = np.tile([0.0, 240.0, 30.0, 60.0], (len(frame), 1))
    boxes[:, 0] = x + speed * (frame - first)
    return pieces.TrackPath(name, frame, boxes, np.ones(len(frame), dtype=bool))


def test_an_answer_about_one_says_something_of_those_that_share_its_end() -> None:
    """Two begin where one ended, as near: whoever it is, the other one is not."""
    paths = [straight("1", 0, 30, 100, 0.0), straight("2", 36, 60, 97, 0.0), straight("3", 36, 60, 103, 0.0)]
    queue = IdentityQueue(Tracklets.of(paths, SIZE))
    before = {one.target: one for one in queue.questions()}
    (first,) = before.values()  # the other one is settled with it
    share = {one.target: one.probability for one in first.candidates}["1"]
    assert 0.45 < share < 0.51
    queue.give({"frame": 36, "target": "2", "answer": "same", "other": "1"})
    assert not queue.questions()
    assert queue.changed == 1
    assert [set(names) for names in queue.labels()] == [{"1"}, {"1"}, {"3"}]
    queue.give({"answer": "undo"})
    queue.give({"frame": 36, "target": "2", "answer": "new"})
    after = {one.target: one.probability for one in queue.questions()[0].candidates}
    assert after["1"] > share + 0.3
    with pytest.raises(IdentityAnswerError, match="begins in frame 36"):
        queue.give({"frame": 36, "target": "2", "answer": "keep"})


def test_who_goes_on_straight_is_doubted_by_no_more_than_the_share_of_lapses() -> None:
    paths = [straight("1", 0, 60, 50, 5.0), straight("2", 0, 60, 350, -5.0)]
    queue = IdentityQueue(Tracklets.of(paths, SIZE))
    (question,) = queue.questions()
    assert len(queue.tracklets.pieces) == 4 and not queue.changed
    assert question.swap and question.doubt == pytest.approx(2 * pieces.LAPSE, rel=0.05)
