"""The run loop: the same bytes, a journal that rebuilds the net, early ends, gaps and damage of files."""

import hashlib
import os
import subprocess
import sys
from dataclasses import dataclass, field, replace
from importlib.util import find_spec

import cv2
import numpy as np
import pytest

from bayesnet_track import Start, Tracker, load_graph, open_run, track
from bayesnet_track.journal.events.lives import TargetStarted
from bayesnet_track.journal.events.runs import (
    FrameSizeChanged,
    FramesMissing,
    RunEnded,
    RunStarted,
    SourceDamaged,
)
from bayesnet_track.journal.events.switches import Activated, Deactivated
from bayesnet_track.journal.net import Decision, replay
from bayesnet_track.numerics.boxes import corner_from_centre
from bayesnet_track.observation.planes import Frame
from bayesnet_track.runtime.results import Summary
from bayesnet_track.runtime.run import StartError, run
from bayesnet_track.sources.scenes import make_scene
from bayesnet_track.sources.scenes.library import SceneSource
from bayesnet_track.sources.sources import open_source

REPRODUCIBLE = ("journal.jsonl", "frames.npy.gz", "tracks.txt", "graph.yaml")
SQUARE = (0, 5, 10, 10)
"""Corner box of the bright square in the first picture of this folder's videos; it moves 2 px a frame."""


def record(out, seed=0, frames=45, graph="two_squares"):
    """The first frames of the demo; the results."""
    scene = make_scene("two_squares")
    source = SceneSource(scene, "scene:two_squares", frames)
    return list(track(graph, source, scene.start_box, out=out, seed=seed))


def digests(out):
    return {name: hashlib.sha256((out / name).read_bytes()).hexdigest() for name in REPRODUCIBLE}


@pytest.fixture(scope="module")
def recorded(tmp_path_factory):
    out = tmp_path_factory.mktemp("recorded") / "run"
    return out, record(out)


class EventSink:
    """A sink that remembers what it was told."""

    def __init__(self):
        self.events, self.frames = [], []

    def event(self, event):
        self.events.append(event)

    def frame(self, result):
        self.frames.append(result.frame.index)


@dataclass
class Listed:
    """A source that gives these items."""

    items: list
    end_reason: str = "end_of_source"
    expected_frames: int | None = None
    description: str = "listed"
    frame_interval_s: float = 0.04
    width: int = 64
    height: int = 48
    given: list = field(default_factory=list)

    def __iter__(self):
        for item in self.items:
            self.given.append(item)
            yield item


def frame(index, time=None):
    image = np.full((48, 64, 3), 90, np.uint8)
    image[5:15, 2 * index : 2 * index + 10] = (40, 120, 250)
    return Frame(index, float(index if time is None else time), image, True, index * 0.04)


def altered(index, **changes):
    return replace(frame(index), **changes)


@pytest.fixture(scope="module")
def general():
    return load_graph("general")


# ------------------------------------------------------------------------------------ the same bytes


@pytest.mark.slow
def test_the_same_seed_gives_the_same_bytes_and_another_seed_others(recorded, tmp_path):
    record(tmp_path / "again")
    record(tmp_path / "other", seed=1)
    first, again, other = digests(recorded[0]), digests(tmp_path / "again"), digests(tmp_path / "other")
    assert again == first
    assert [name for name in REPRODUCIBLE if other[name] == first[name]] == ["graph.yaml"]


@pytest.mark.parametrize("threads", [1, 2])
def test_opencvs_threads_change_no_byte(recorded, tmp_path, threads):
    before = cv2.getNumThreads()
    cv2.setNumThreads(threads)
    try:
        record(tmp_path / "run")
    finally:
        cv2.setNumThreads(before)
    assert digests(tmp_path / "run") == digests(recorded[0])


@pytest.mark.slow
def test_another_process_gives_the_same_bytes(recorded, tmp_path):
    """With other hashes of strings and another number of threads."""
    environment = {**os.environ, "NUMBA_NUM_THREADS": "1", "OMP_NUM_THREADS": "1", "PYTHONHASHSEED": "123"}
    line = ["demo", "--end", "45", "--quiet", "--out", str(tmp_path / "run")]
    subprocess.run([sys.executable, "-m", "bayesnet_track", *line], env=environment, check=True)
    assert digests(tmp_path / "run") == digests(recorded[0])


@pytest.mark.slow
def test_kernels_from_the_cache_give_the_same_bytes_as_those_just_compiled(tmp_path):
    """Also where nothing can be cached."""
    line = ["demo", "--graph", "general", "--end", "40", "--quiet", "--out"]
    run_it = "import sys; from bayesnet_track.cli.main import main; sys.exit(main(sys.argv[1:]))"
    # How Numba tries whether it may write somewhere.
    denied = "def denied(**_): raise PermissionError(13, 'denied')\n"
    denied += "import tempfile; tempfile.TemporaryFile = denied\n"
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path / "cache")}
    found = []
    for name, code in (("compiled", run_it), ("cached", run_it), ("in_memory", denied + run_it)):
        subprocess.run([sys.executable, "-c", code, *line, str(tmp_path / name)], env=environment, check=True)
        found.append(digests(tmp_path / name))
    assert found[0] == found[1] == found[2]


def test_a_tracker_fed_with_the_same_frames_gives_the_same_boxes(recorded):
    scene = make_scene("two_squares")
    tracker = Tracker("two_squares")
    tracker.init(scene.frames[0], scene.start_box)
    for result in recorded[1][1:]:
        _, box = tracker.update(scene.frames[result.frame.index])
        assert box == tuple(corner_from_centre(result.targets[0].centre_box))
        assert tracker.score == result.targets[0].score
        assert tuple(e for e in tracker.events if isinstance(e, Decision)) == result.decisions


# ------------------------------------------------------------------------------- frames of one kind


@pytest.mark.parametrize(
    ("other", "found"),
    [
        (altered(2, image=np.zeros((40, 64, 3), np.uint8)), "64x40 colour"),
        (altered(2, image=np.zeros((48, 64, 3))), "64x48 colour with 3 channels of float64"),
        (altered(2, image=np.zeros((48, 64, 4), np.uint8)), "64x48 colour with 4 channels of uint8"),
        (altered(2, has_color=False), "64x48 gray"),
    ],
)
def test_frames_of_ones_own_are_all_of_one_kind(general, other, found):
    results, summary = [], Summary()
    with pytest.raises(ValueError, match=f"frame 2 is {found}, the frames before it are 64x48 colour; "):
        source = Listed([frame(0), frame(1), other, frame(3)])
        results.extend(run(general, source, [Start(SQUARE)], summary=summary))
    assert summary.frames == 2 and not summary.complete


def test_a_source_that_says_so_may_turn_gray(general):
    items = [
        frame(0),
        frame(1),
        FrameSizeChanged(2, 64, 48, "rescale"),
        altered(2, has_color=False),
        frame(3),
    ]
    assert len(list(run(general, Listed(items), [Start(SQUARE)]))) == 4


# ------------------------------------------------------------------------------------ the journal


def test_folding_the_journal_rebuilds_the_net_of_every_frame(recorded):
    out, results = recorded
    events = open_run(out).events
    metrics = open_run(out).metrics
    assert len(metrics) == len(results) == 45
    decisions = [event for event in events if isinstance(event, Decision)]
    assert {TargetStarted, Activated, Deactivated} <= {type(event) for event in decisions}
    for line in metrics:
        net = replay(decisions, line.frame).targets["1"]
        assert (set(line.active), line.status) == (net.active, net.status)
    assert len({line.active for line in metrics}) > 1


def test_the_journal_begins_and_ends_as_documented(recorded):
    events = open_run(recorded[0]).events
    started, target, ended = events[0], events[1], events[-1]
    assert isinstance(started, RunStarted) and isinstance(target, TargetStarted)
    assert (started.width, started.height, started.has_color, started.declared_frames) == (320, 240, True, 45)
    assert set(started.costs_ms) == {"color_histogram", "motion"}  # prices are the cues'
    always = {"python", "bayesnet-track", "numpy", "numba", "scipy", "av", "opencv", "zlib"}
    assert set(started.versions) - {"onnxruntime"} == always
    assert ("onnxruntime" in started.versions) == (find_spec("onnxruntime") is not None)
    assert ended == RunEnded(45, 45, True, "end_of_source")


def test_the_stored_graph_runs_again_to_the_same_tracks(recorded, tmp_path):
    record(tmp_path / "run", graph=recorded[0] / "graph.yaml")
    assert digests(tmp_path / "run") == digests(recorded[0])


def test_what_is_wrong_before_the_first_frame_comes_after_the_first_line(general):
    damaged, sink = SourceDamaged(0, "the first picture is missing"), EventSink()
    list(run(general, Listed([damaged, frame(1), frame(2)]), [Start((2, 5, 10, 10))], sinks=[sink]))
    assert [type(e) for e in sink.events[:3]] == [RunStarted, SourceDamaged, TargetStarted]
    assert sink.frames == [1, 2]


# ------------------------------------------------------------------------------------ early ends


def test_a_caller_may_stop_early(tmp_path):
    scene, summary = make_scene("two_squares"), Summary()
    source = SceneSource(scene, "scene")
    for result in track("two_squares", source, scene.start_box, out=tmp_path / "run", summary=summary):
        if result.frame.index == 4:
            break
    assert (summary.frames, summary.complete, summary.reason) == (5, False, "interrupted")
    assert open_run(tmp_path / "run").events[-1] == RunEnded(5, 200, False, "interrupted")
    assert len(open_run(tmp_path / "run").metrics) == 5


def test_an_error_of_a_sink_ends_the_run_and_the_journal_says_so(general):
    class Failing(EventSink):
        def frame(self, result):
            if result.frame.index == 2:
                raise OSError("the other side hung up")

    sink = Failing()
    with pytest.raises(OSError, match="hung up"):
        list(run(general, Listed([frame(n) for n in range(5)]), [Start(SQUARE)], sinks=[sink]))
    assert sink.events[-1] == RunEnded(3, None, False, "error")


def test_nothing_is_told_when_no_target_can_start(general):
    sink, source = EventSink(), Listed([frame(0)])
    with pytest.raises(StartError, match="lies outside the 64x48 frame"):
        list(run(general, source, [Start((64, 0, 9, 9))], sinks=[sink]))
    assert sink.events == [] and source.given == []


def test_the_source_decides_whether_it_was_whole(general):
    """What it declares may be an estimate: a video of uneven rate has fewer frames than its length says."""
    for reason in ("end_of_source", "source_truncated"):
        sink, summary = EventSink(), Summary()
        source = Listed([frame(n) for n in range(3)], expected_frames=5, end_reason=reason)
        list(run(general, source, [Start(SQUARE)], sinks=[sink], summary=summary))
        assert (summary.complete, summary.reason) == (reason == "end_of_source", reason)
        assert sink.events[-1] == RunEnded(3, 5, reason == "end_of_source", reason)


def test_the_summary_counts_reconfigurations_and_lost_frames(recorded):
    scene, summary = make_scene("two_squares"), Summary()
    list(track("two_squares", SceneSource(scene, "scene", 45), scene.start_box, summary=summary))
    switched = [e for e in open_run(recorded[0]).events if type(e) in (Activated, Deactivated)]
    assert summary.reconfigurations == len(switched) > 2
    assert summary.lost_frames == 0 and summary.seconds > 0

    dark = [frame(n) if n < 3 else Frame(n, float(n), np.zeros((48, 64, 3), np.uint8)) for n in range(20)]
    lost = Summary()
    results = list(run(load_graph("general"), Listed(dark), [Start(SQUARE)], summary=lost))
    assert lost.lost_frames == sum(r.targets[0].status == "lost" for r in results) > 0


def test_several_targets_do_not_depend_on_each_other(general):
    source = [frame(n) for n in range(6)]
    alone = [r.targets[0] for r in run(general, Listed(source), [Start(SQUARE)])]
    both = [r.targets for r in run(general, Listed(source), [Start(SQUARE), Start((40, 30, 12, 12))])]
    assert [targets[0] for targets in both] == alone
    assert [targets[1].target for targets in both] == ["2"] * 6


# ------------------------------------------------------------------------------------ uneven video


def test_a_truncated_video_saves_what_was_read(make_video, tmp_path):
    whole = make_video("whole.mkv", codec="libx264")
    cut = tmp_path / "cut.mkv"
    cut.write_bytes(whole.read_bytes()[: whole.stat().st_size * 6 // 10])
    summary = Summary()
    results = list(track("general", cut, SQUARE, out=tmp_path / "run", summary=summary))
    read = len(results)
    assert 3 < read < 40
    assert (summary.complete, summary.reason) == (False, "source_truncated")
    (notice,) = summary.notices
    assert notice.reason.startswith(f"the file is truncated: read {read} of 40 frames")
    events = open_run(tmp_path / "run").events
    assert notice in events and events[-1] == RunEnded(read, 40, False, "source_truncated")
    assert len((tmp_path / "run/tracks.txt").read_text().splitlines()) == read


def test_a_picture_that_cannot_be_decoded_is_a_gap(tmp_path):
    """Its number stays free, and the belief is predicted over two intervals."""
    folder = tmp_path / "images"
    folder.mkdir()
    for number in range(6):
        cv2.imwrite(str(folder / f"{number}.png"), frame(number).image)
    (folder / "3.png").write_bytes(b"no picture")
    summary = Summary()
    results = list(track("general", folder, SQUARE, summary=summary))
    assert [result.frame.index for result in results] == [0, 1, 2, 4, 5]
    assert [type(notice) for notice in summary.notices] == [SourceDamaged, FramesMissing]
    assert (summary.complete, summary.reason) == (False, "source_damaged")


def test_uncertainty_grows_through_a_gap_over_its_true_length(make_video, tmp_path):
    """Where nothing is seen, prediction alone decides, and over Δt a random walk has Δt times the variance.

    UD of 1000 hypotheses has a relative sd of about sqrt(2 / 1000) = 4.5 % per axis, of a ratio twice that;
    it adds the squared distance to the MAP, a random one of those in the cloud: within 35 %.
    """
    plate = dict(fuse="product", ud_fields=["x", "y"], motion={"random_walk": {"sd_px": {"x": 1, "y": 1}}})
    nodes = {"root": plate, "color": {"parent": "root", "agent": "color_histogram"}}
    graph = {"name": "gap", "targets": {"t": {"nodes": nodes}}}
    blank = np.full((240, 320, 3), 90, np.uint8)
    start = blank.copy()
    start[100:140, 100:140] = (40, 120, 250)

    def ud(*times):
        frames = [Frame(n, float(t), start if n == 0 else blank, True, t) for n, t in enumerate(times)]
        source = Listed(frames, width=320, height=240)
        return list(run(load_graph(graph), source, [Start((100, 100, 40, 40))]))[-1].targets[0].ud_px2

    near, far = ud(0, 1), ud(0, 10)
    assert far / near == pytest.approx(10, rel=0.35)


def test_a_gap_in_a_video_is_told_and_predicted_over(make_video):
    path = make_video("gap.mkv", stamps=[*range(10), *range(16, 26)], frames=20)
    summary = Summary()
    results = list(track("general", path, (0, 5, 10, 10), summary=summary))
    (notice,) = summary.notices
    assert notice == FramesMissing(10, pytest.approx(6.0, abs=0.05))
    assert summary.complete and len(results) == 20
    assert results[10].frame.time - results[9].frame.time == pytest.approx(7.0, abs=0.05)


def test_time_that_runs_backwards_ends_the_run(make_video):
    path = make_video("twice.ts", codec="mpeg2video", frames=20, gop=1)
    path.write_bytes(path.read_bytes() * 2)  # the clock starts again in the middle
    summary = Summary()
    results = list(track("general", path, SQUARE, summary=summary))
    times = [result.frame.time for result in results]
    assert len(times) >= 18 and times == sorted(set(times))
    assert (summary.complete, summary.reason) == (False, "source_damaged")
    assert "time runs backwards" in summary.notices[-1].reason


@pytest.mark.parametrize(("on_resize", "frames", "complete"), [("stop", 20, False), ("rescale", 40, True)])
def test_a_change_of_size_in_the_stream(make_video, tmp_path, on_resize, frames, complete):
    path = make_video("sizes.ts", codec="libx264", then=(96, 80))
    summary = Summary()
    with open_source(str(path), on_resize=on_resize) as source:
        list(track("general", source, SQUARE, out=tmp_path / "run", summary=summary))
    assert (summary.frames, summary.complete) == (frames, complete)
    assert FrameSizeChanged(20, 96, 80, on_resize) in open_run(tmp_path / "run").events
