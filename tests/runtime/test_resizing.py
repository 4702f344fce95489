"""Tracking in smaller frames: the engine sees them, and everybody else has the pixels of the source.

The large video shows every pixel of the small one TWICE in each direction. Made smaller, it is the small one
again, bit for bit, so that every number of a run over it is known from the run over the small one.
"""

from __future__ import annotations

import dataclasses
import itertools
import json
import typing
from pathlib import Path

import cv2
import numpy as np
import pytest

from bayesnet_track import Start, Tracker, load_graph, open_run, track
from bayesnet_track.cli.main import main
from bayesnet_track.engine.starts import StartError
from bayesnet_track.evaluate.runs import score_run
from bayesnet_track.journal.events.beliefs import Reappeared
from bayesnet_track.journal.events.event import Event
from bayesnet_track.journal.events.lives import Recognition, TargetStarted
from bayesnet_track.journal.metrics import FrameMetrics, PartMetrics
from bayesnet_track.observation.planes import Frame, RightEye
from bayesnet_track.runtime.annotation.asking import TrackerRuns
from bayesnet_track.runtime.arguments import resizing_of
from bayesnet_track.runtime.checkpoints.recipe import Recipe
from bayesnet_track.runtime.checkpoints.resume import resume
from bayesnet_track.runtime.recording.run_reader import pictures_of
from bayesnet_track.runtime.resizing import Resizing
from bayesnet_track.runtime.smoothing import smooth
from bayesnet_track.sources.scenes import make_scene

TWICE, FRAMES = 2, 12
SCENE = make_scene("two_squares", 0)
HEIGHT, WIDTH = SCENE.frames[0].shape[:2]
LARGE = tuple(TWICE * value for value in SCENE.start_box)
OUTPUTS = ("journal.jsonl", "frames.npy.gz", "tracks.txt", "forecasts.jsonl", "run.json")
OPTIONS = {"keep_beliefs": True, "horizon": 2}


def enlarged(image: np.ndarray) -> np.ndarray:
    return image.repeat(TWICE, axis=0).repeat(TWICE, axis=1)


@pytest.fixture(scope="module")
def videos(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folders `small` and `large`, with the ground truth of each."""
    folder = tmp_path_factory.mktemp("videos")
    for name, factor in (("small", 1), ("large", TWICE)):
        (folder / name).mkdir()
        for index in range(FRAMES):
            image = SCENE.frames[index] if factor == 1 else enlarged(SCENE.frames[index])
            cv2.imwrite(str(folder / name / f"{index:03}.png"), image)
        rows = [",".join(f"{factor * value:g}" for value in box) for box in SCENE.truth[:FRAMES]]
        (folder / f"{name}.txt").write_text("\n".join(rows) + "\n")
    return folder


def begun(videos: Path, out: Path, frames: int | None = None, **more: object) -> Path:
    options = {**OPTIONS, "max_side": WIDTH, **more}
    results = track("two_squares", videos / "large", LARGE, out=out, **options)
    for _ in itertools.islice(results, frames):
        pass
    results.close()
    return out


@pytest.fixture(scope="module")
def small(videos: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("small") / "run"
    list(track("two_squares", videos / "small", SCENE.start_box, out=out, **OPTIONS))
    return out


@pytest.fixture(scope="module")
def large(videos: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return begun(videos, tmp_path_factory.mktemp("large") / "run")


def assert_doubled(found: FrameMetrics, known: FrameMetrics) -> None:
    np.testing.assert_allclose(found.xywh, TWICE * known.xywh, atol=1e-6)
    np.testing.assert_allclose(found.sd, TWICE * np.array(known.sd), rtol=1e-8)
    for region, of in ((found.region90, known.region90), (found.region50, known.region50)):
        np.testing.assert_allclose(np.array(region) + 0.5, TWICE * (np.array(of) + 0.5), atol=1e-6)
    cloud, seen = (
        np.array([box[:4] for box in one.cloud], dtype=float).reshape(-1, 4) for one in (found, known)
    )
    np.testing.assert_allclose(cloud + [0.5, 0.5, 0, 0], TWICE * (seen + [0.5, 0.5, 0, 0]), atol=0.5)
    for name in ("status", "score", "ud_px2", "kl", "active", "ess", "log_evidence"):
        assert getattr(found, name) == getattr(known, name)


@pytest.mark.slow
def test_boxes_are_in_pixels_of_the_source_and_all_else_is_that_of_the_smaller_frames(
    small: Path, large: Path
) -> None:
    known, found = open_run(small), open_run(large)
    for one, other in zip(found.metrics, known.metrics, strict=True):
        assert_doubled(one, other)
    assert (found.started.width, found.started.height) == (TWICE * WIDTH, TWICE * HEIGHT)
    assert found.started.tracked == (WIDTH, HEIGHT) and known.started.tracked == ()
    assert "tracked" not in (small / "journal.jsonl").read_text().splitlines()[0]
    start, first = (
        next(event for event in run.events if isinstance(event, TargetStarted)) for run in (found, known)
    )
    assert start.box[2:] == tuple(TWICE * side for side in first.box[2:])
    assert [type(event) for event in found.events] == [type(event) for event in known.events]
    assert Recipe.read(large).max_side == WIDTH and Recipe.read(small).max_side is None


def test_files_of_other_tools_are_in_pixels_of_the_source(small: Path, large: Path) -> None:
    found, known = (np.loadtxt(run / "tracks.txt", delimiter=",")[:, 2:6] for run in (large, small))
    np.testing.assert_allclose(found, TWICE * known, atol=2e-3)
    ahead, seen = (
        [json.loads(line) for line in (run / "forecasts.jsonl").read_text().splitlines()]
        for run in (large, small)
    )
    for one, other in zip(ahead, seen, strict=True):
        np.testing.assert_allclose(one["box"][2:], TWICE * np.array(other["box"][2:]), atol=2e-3)
        np.testing.assert_allclose(
            np.array(one["region90"]) + 0.5, TWICE * (np.array(other["region90"]) + 0.5), atol=2e-3
        )


def test_a_run_that_was_broken_off_goes_on_to_the_same_bytes(
    videos: Path, large: Path, tmp_path: Path
) -> None:
    run = begun(videos, tmp_path / "run", 4)
    assert [result.frame.index for result in resume(run)] == list(range(4, FRAMES))
    assert {name: (run / name).read_bytes() for name in OUTPUTS} == {
        name: (large / name).read_bytes() for name in OUTPUTS
    }


def test_what_if_tracks_in_the_same_size(large: Path, tmp_path: Path) -> None:
    out = tmp_path / "again"
    assert main(["what-if", str(large), "--out", str(out), "--quiet"]) == 0
    assert (out / "frames.npy.gz").read_bytes() == (large / "frames.npy.gz").read_bytes()


def test_scores_compare_with_the_truth_of_the_source(videos: Path, small: Path, large: Path) -> None:
    found = score_run(large, videos / "large.txt")
    assert found.mean_iou == pytest.approx(score_run(small, videos / "small.txt").mean_iou, abs=1e-6)


def test_smoothed_boxes_are_in_pixels_of_the_source(small: Path, large: Path) -> None:
    for one, other in zip(smooth(open_run(large)).metrics, smooth(open_run(small)).metrics, strict=True):
        assert_doubled(one, other)


def test_pictures_are_those_of_the_source(large: Path) -> None:
    run = open_run(large)
    with pictures_of(run.directory, run.started, 0, 1) as (found, _):
        assert found is not None
        assert [image.shape for _, image in found.images] == [(TWICE * HEIGHT, TWICE * WIDTH, 3)] * 2


def test_the_command_says_which_pixels_are_meant(
    videos: Path, large: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    run = ["run", "two_squares", "--source", str(videos / "large"), "--end", "3"]
    run += ["--init", ",".join(map(str, LARGE)), "--max-side", str(WIDTH), "--video"]
    assert main([*run, "--out", str(tmp_path / "run")]) == 0
    said = capsys.readouterr().err
    assert f"frames of {TWICE * WIDTH}x{TWICE * HEIGHT} px are tracked at {WIDTH}x{HEIGHT} px" in said
    video = cv2.VideoCapture(str(tmp_path / "run/video.mkv"))
    assert video.get(cv2.CAP_PROP_FRAME_WIDTH) == TWICE * WIDTH
    lines = [open_run(path).metrics[:3] for path in (tmp_path / "run", large)]
    assert lines[0] == lines[1]


def test_given_detections_are_in_pixels_of_the_source(videos: Path, tmp_path: Path) -> None:
    tracks = []
    for name, factor, side in (("small", 1, None), ("large", TWICE, WIDTH)):
        rows = [
            [n + 1, -1, *(factor * value for value in box), 1] for n, box in enumerate(SCENE.truth[:FRAMES])
        ]
        np.savetxt(tmp_path / name, rows, delimiter=",", fmt="%g")
        found = track("kalman_detections", videos / name, detections=tmp_path / name, max_side=side)
        tracks.append(np.array([target.xywh for result in found for target in result.targets]))
    assert len(tracks[0]) > FRAMES / 2
    np.testing.assert_allclose(tracks[1], TWICE * tracks[0], atol=1e-6)


def test_a_tracker_in_python_does_the_same() -> None:
    plain, resized = Tracker("two_squares"), Tracker("two_squares", max_side=WIDTH)
    plain.init(SCENE.frames[0], SCENE.start_box)
    resized.init(enlarged(SCENE.frames[0]), LARGE)
    for image in (SCENE.frames[index] for index in (1, 2, 3)):
        plain.update(image)
        _, box = resized.update(enlarged(image))
        assert_doubled(resized.metrics, plain.metrics)
        np.testing.assert_allclose(box, resized.xywh)
    for one, other in zip(resized.predict(2), plain.predict(2), strict=True):
        np.testing.assert_allclose(one.xywh, TWICE * other.xywh, atol=1e-6)
        np.testing.assert_allclose(one.sd, TWICE * np.array(other.sd))
    with pytest.raises(ValueError, match="frame 4 is 320x240 colour, the frames before it are 640x480"):
        resized.update(SCENE.frames[4])


def test_annotation_tracks_in_smaller_frames() -> None:
    class Store:
        def __len__(self) -> int:
            return 3

        def image(self, frame: int) -> np.ndarray:
            return enlarged(SCENE.frames[frame])

    graph = load_graph("two_squares")
    plain = Tracker(graph)
    plain.init(SCENE.frames[0], SCENE.start_box)
    plain.update(SCENE.frames[1])
    found = TrackerRuns(graph, Store(), max_side=WIDTH).at(0, LARGE, 1)
    np.testing.assert_allclose(found.box, TWICE * plain.xywh, atol=1e-6)


def test_a_mask_has_the_size_of_the_source() -> None:
    graph = load_graph("road_mask")
    (mask,) = graph.masks.values()
    rows, columns = mask.gray.shape
    resizing = Resizing.to(columns, rows, columns // 2)
    (smaller,) = resizing.graph(graph).masks.values()
    assert smaller.gray.shape == (round(rows / 2), columns // 2)
    image = np.zeros((rows, columns, 3), np.uint8)
    Tracker(graph, max_side=columns // 2).init(image + np.uint8(90), (20, 20, 30, 30))
    with pytest.raises(StartError, match="allowed: the frames' size"):
        Tracker(graph, max_side=columns // 2).init(enlarged(image), (20, 20, 30, 30))


@pytest.mark.parametrize(
    ("size", "side", "expected"),
    [
        ((1281, 721), 640, (640, 360)),
        ((721, 1281), 640, (360, 640)),
        ((320, 240), 640, (320, 240)),
        ((320, 240), None, (320, 240)),
        ((4000, 1), 40, (40, 1)),
    ],
)
def test_the_longer_side_is_what_is_given_and_no_frame_grows(
    size: tuple[int, int], side: int | None, expected: tuple[int, int]
) -> None:
    assert Resizing.to(*size, side).tracked == expected


def test_what_is_tracked_in_another_shape_comes_back_to_where_it_was() -> None:
    resizing = Resizing.to(1281, 721, 640)
    box = (100.0, 50.0, 61.0, 43.0)
    inside = resizing.start(Start(box)).box
    assert inside[0] == pytest.approx(100 * 640 / 1281) and inside[3] == pytest.approx(43 * 360 / 721)
    x, y, w, h = inside
    centre = (x + (w - 1) / 2, y + (h - 1) / 2, w, h)
    started = resizing.event(TargetStarted(0, "1", "square", centre, ()))
    assert isinstance(started, TargetStarted)
    np.testing.assert_allclose(started.box, [130.0, 71.0, 61.0, 43.0], atol=1e-9)
    part = PartMetrics(centre, (1.0, 1.0, 1.0, 1.0), 1.0, "seen")
    np.testing.assert_allclose(resizing._part(part).xywh, box, atol=1e-9)


def test_frames_are_means_over_areas() -> None:
    image = np.zeros((4, 6, 3), np.uint8)
    image[:2, :2] = [[[0], [40]], [[80], [120]]]
    seen = Resizing((6, 4), (3, 2)).frame(Frame(0, 0.0, image))
    assert seen.image.shape == (2, 3, 3) and seen.image[0, 0, 0] == 60 and seen.image[1:].max() == 0


def test_values_of_a_field_are_converted_along_its_axis() -> None:
    resizing, values = Resizing((200, 100), (100, 25)), np.array([0.0, 9.5])
    places = {"x": [0.5, 19.5], "y": [1.5, 39.5]}
    lengths = {"w": [0, 19], "vy": [0, 38], "turn": [0, 9.5]}
    for name, expected in (places | lengths).items():
        assert resizing.field(name, values) == pytest.approx(np.array(expected)), name


def test_every_place_that_an_event_has_is_converted() -> None:
    """A new event with a place or a distance in the image has to be named in `Resizing.event`."""
    resizing = Resizing((200, 100), (100, 50))
    places = {"box", "x", "y", "moved_px", "within_px", "recognition", "nearest"}
    near = Recognition("1", 0.9, 0.5, 1.0, 7.0, 0.0, 0.0, 0.0, (), "new", 0.1)
    values = {
        "box": (9.5, 9.5, 4.0, 4.0),
        "x": 9.5,
        "y": 9.5,
        "moved_px": 5.0,
        "within_px": 7.0,
        "recognition": near,
        "nearest": near,
    }
    found = set()
    for kind in typing.get_args(Event):
        names = {one.name for one in dataclasses.fields(kind)}
        for name in names & places:
            event = _made(kind, names, values)
            assert getattr(resizing.event(event), name) != getattr(event, name), (kind, name)
            found.add(kind)
        assert not [name for name in names - places if name in ("distance_px", "centre", "centre_box", "at")]
    assert Reappeared in found and len(found) >= 7


def _made(kind: type, names: set[str], values: dict[str, object]) -> Event:
    event: Event = kind(**{name: values.get(name) for name in names})
    return event


def test_frames_with_depth_are_refused(tmp_path: Path) -> None:
    class Pair:
        width, height, has_depth = 640, 480, True

    with pytest.raises(ValueError, match="frames with depth cannot be resized"):
        resizing_of(Pair(), 320)
    assert resizing_of(Pair(), 640).is_none
    image = np.zeros((40, 60, 3), np.uint8)
    with pytest.raises(ValueError, match="frames with depth cannot be resized"):
        Tracker("two_squares", max_side=30).init(image, (1, 1, 20, 20), depth=RightEye(image, None))


def test_python_and_the_command_line_take_the_same_sizes(capsys: pytest.CaptureFixture[str]) -> None:
    command = ["run", "two_squares", "--source", "none", "--init", "1,2,3,4", "--out", "none", "--max-side"]
    assert main([*command, "16"]) == 4  # there is no such source
    Tracker("two_squares", max_side=16)
    with pytest.raises(SystemExit):
        main([*command, "15"])
    assert "'15': a whole number from 16 on is needed" in capsys.readouterr().err
    with pytest.raises(ValueError, match="max_side=15: a whole number from 16 on is needed"):
        Tracker("two_squares", max_side=15)


def test_a_start_box_has_to_have_an_area_in_the_smaller_frames_too(videos: Path, tmp_path: Path) -> None:
    message = (
        "start box 300,200,30,60: only 0.938x1.88 px where frames are tracked at 20x15 px; "
        "width and height must be at least 1 px there; give a larger max_side, or none"
    )
    box, image = (300, 200, 30, 60), enlarged(SCENE.frames[0])
    tracker = Tracker("two_squares", max_side=20)
    with pytest.raises(StartError) as refused:
        tracker.init(image, box)
    assert str(refused.value) == message
    with pytest.raises(StartError) as refused:
        track("two_squares", videos / "large", box, out=tmp_path / "run", max_side=20)
    assert str(refused.value) == message and not (tmp_path / "run").exists()
    for most in range(16, 641):  # a side of just 1 px there
        assert Resizing.to(640, 480, most).start(Start((0, 0, 640 / most, 100))).box[2] == pytest.approx(1)
