"""Tracking in one call: what may be given as graph, source and box, and that nothing is written too early."""

import json
from pathlib import Path

import numpy as np
import pytest

import bayesnet_track
from bayesnet_track import Result, Start, load_graph, track
from bayesnet_track.graph.text.messages import GraphError
from bayesnet_track.runtime.checkpoints.recipe import Recipe
from bayesnet_track.runtime.recording.rundir import FILES, RunDirectoryError
from bayesnet_track.runtime.results import Summary
from bayesnet_track.runtime.run import StartError
from bayesnet_track.sources.sources import SourceError, open_source

SQUARE = (0, 5, 10, 10)
"""Corner box of the bright square in the first picture of this folder's videos; it moves 2 px a frame."""


@pytest.fixture(scope="module")
def video(whole_videos):
    return whole_videos["h264.mkv"]


def test_an_iterator_over_frames(video):
    results = track("color_fusion", video, SQUARE)
    first, second = next(results), next(results)
    results.close()
    assert isinstance(first, Result)
    assert [first.frame.index, second.frame.index] == [0, 1]
    (target,) = second.targets
    assert len(target.centre_box) == 4 and target.status == "tracking" and target.active
    assert second.covariances["1"].shape[0] >= 4
    assert np.diag(second.covariances["1"])[:2] == pytest.approx(np.square(target.sd[:2]))
    assert second.total_seconds >= max(second.seconds.values()) > 0


def test_a_result_shows_what_matters_and_draws_on_a_copy(video):
    result = next(track("general", video, SQUARE))
    shown = "<frame 0: <target 1 in frame 0: tracking, score 1.00, xywh 0.0,5.0,10.0,10.0, "
    assert repr(result).startswith(shown) and repr(result).endswith("; 1 decision>")
    before = result.frame.image.copy()
    other = np.zeros_like(before)
    assert (result.plot() != before).any() and np.array_equal(result.frame.image, before)
    assert (result.plot(other) != other).any() and not other.any()
    np.testing.assert_array_equal(result.plot(other[..., 0].astype(np.uint16)), result.plot(other))
    assert repr(result.detections()) == "<Detections: 1, tracker_id [1]>"


def test_every_kind_of_graph_source_and_box(video, tmp_path):
    def boxes(graph, source, box):
        results = track(graph, source, box)
        found = [next(results).targets[0].centre_box for _ in range(3)]
        results.close()
        return found

    wanted = boxes("general", video, SQUARE)
    graph = load_graph("general")
    path = tmp_path / "copy.yaml"
    path.write_text(graph.text)
    assert boxes(path, str(video), list(SQUARE)) == wanted
    assert boxes(graph.spec, video, np.array(SQUARE)) == wanted
    with open_source(str(video)) as source:
        assert boxes(graph, source, [Start(SQUARE, "target")]) == wanted


def test_several_targets(video):
    result = next(track("general", video, [Start(SQUARE), Start((30, 20, 10, 10))]))
    assert [(target.target, target.centre_box) for target in result.targets] == [
        ("1", (4.5, 9.5, 10.0, 10.0)),
        ("2", (34.5, 24.5, 10.0, 10.0)),
    ]


def test_nothing_is_written_without_a_folder(video, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert next(track("general", video, SQUARE)).targets
    assert list(tmp_path.iterdir()) == []


def test_a_run_directory_with_a_video(video, tmp_path):
    summary = Summary()
    for result in track("general", video, SQUARE, out=tmp_path / "run", video=True, summary=summary):
        if result.frame.index == 5:
            break
    held = {path.name for path in (tmp_path / "run").iterdir()} - {"checkpoint.previous"}
    assert held == {".lock", *FILES.values()} - {
        "checkpoint.previous",
        "truth.txt",
        "beliefs.jsonl",
        "forecasts.jsonl",
        "queries.csv",
        "cameras.csv",
        "tracks.csv",
        "manifest.json",
        "inputs.jsonl",
        "inputs_ahead.jsonl",
        "report.html",
        "video.mp4",
    }
    assert (summary.frames, summary.reason) == (6, "interrupted")


@pytest.mark.parametrize(
    ("changed", "error", "message"),
    [
        ({"graph": "generl"}, GraphError, "no installed graph of this name"),
        ({"source": "nothing.mp4"}, SourceError, "no such file or folder"),
        ({"box": (64, 5, 10, 10)}, StartError, "lies outside the 64x48 frame"),
        ({"box": (1, 2, 3)}, StartError, r"start box \(1, 2, 3\): four finite numbers x,y,w,h are needed"),
        ({"box": []}, StartError, r"start box \[\]: four finite numbers"),
        ({"box": [Start(SQUARE, "ball")]}, StartError, "no plate 'ball' in graph general; there are target"),
        (
            {"box": [Start(SQUARE), SQUARE]},
            StartError,
            "one box x, y, w, h, or one Start per target, not both",
        ),
        ({"box": [Start(SQUARE), Start((0, 0, 0, 0))]}, StartError, "width and height must be at least 1 px"),
    ],
)
def test_a_mistake_is_told_before_anything_is_written(video, tmp_path, changed, error, message):
    given = {"graph": "general", "source": video, "box": SQUARE, **changed}
    with pytest.raises(error, match=message):
        track(**given, out=tmp_path / "run")  # at the call, before any result is asked for
    assert not (tmp_path / "run").exists()


@pytest.mark.parametrize(
    ("name", "value", "message"),
    [
        ("seed", 1.5, "seed=1.5: a whole number from 0 on is needed"),
        ("seed", -1, "seed=-1: a whole number from 0 on"),
        ("stride", 0, "stride=0: a whole number from 1 on"),
        ("horizon", "2", "horizon='2': a whole number from 0 on"),
        ("max_side", 99.7, r"max_side=99\.7: a whole number from 16 on"),
        ("max_side", 15, "max_side=15: a whole number from 16 on"),
        (
            "budget_ms",
            -1,
            "budget_ms=-1: milliseconds above 0 and below 1e\\+07 are needed; None for no budget",
        ),
        ("budget_ms", 0, "budget_ms=0: milliseconds above 0"),
        ("budget_ms", float("nan"), "budget_ms=nan: milliseconds above 0"),
        ("budget_ms", "fast", "budget_ms='fast': milliseconds above 0"),
        ("video", "avi", "video='avi': False, True, 'mkv' or 'mp4' is needed"),
    ],
)
def test_a_value_out_of_its_range_is_refused_at_the_call(video, tmp_path, name, value, message):
    with pytest.raises(ValueError, match=message):
        track("general", video, SQUARE, out=tmp_path / "run", **{name: value})
    assert not (tmp_path / "run").exists()


@pytest.mark.parametrize(("name", "value"), [("stride", 2), ("live", True), ("value_range", (0, 9))])
def test_what_says_how_a_source_is_opened_does_not_fit_an_open_one(video, name, value):
    with open_source(str(video)) as source, pytest.raises(ValueError, match=f"{name} .* open already"):
        next(track("general", source, SQUARE, **{name: value}))


def test_a_run_that_was_decoded_in_a_process_of_its_own_is_read_again(video, tmp_path):
    """As runs of earlier versions were, by an option that is gone."""
    list(track("general", video, SQUARE, out=tmp_path / "run"))
    path = tmp_path / "run" / "run.json"
    plain = json.loads(path.read_text())
    plain["origin"]["isolate_decoder"] = True
    path.write_text(json.dumps(plain))
    with Recipe.read(tmp_path / "run").open_source() as again:
        assert next(iter(again)).index == 0


def test_numbers_of_numpy_are_recorded(video, tmp_path):
    whole = {"seed": np.int64(3), "stride": np.uint8(2), "horizon": np.int32(1), "max_side": np.int16(48)}
    next(track("general", video, SQUARE, out=tmp_path / "run", **whole, budget_ms=np.float32(500)))
    recipe = Recipe.read(tmp_path / "run")
    assert (recipe.seed, recipe.origin.stride, recipe.horizon, recipe.max_side) == (3, 2, 1, 48)
    assert recipe.budget_ms == 500.0


def test_a_mistake_does_not_cost_an_earlier_run(video, tmp_path):
    for _ in track("general", video, SQUARE, out=tmp_path / "run"):
        break
    before = (tmp_path / "run/journal.jsonl").read_bytes()
    with pytest.raises(StartError):
        track("general", video, (64, 0, 9, 9), out=tmp_path / "run", overwrite=True)
    with pytest.raises(RunDirectoryError, match="a run is there already"):
        track("general", video, SQUARE, out=tmp_path / "run")
    assert (tmp_path / "run/journal.jsonl").read_bytes() == before


def test_a_source_opened_here_is_closed_here(video, monkeypatch):
    closed = []
    source = open_source(str(video))
    monkeypatch.setattr("bayesnet_track.runtime.session.open_source", lambda _, **__: source)
    close = source.close
    monkeypatch.setattr(source, "close", lambda: (closed.append(True), close()))
    results = track("general", video, SQUARE)
    next(results)
    results.close()
    track("general", video, SQUARE).close()  # of which no result was asked for
    assert closed == [True, True]
    own = open_source(str(video))  # the caller's own stays open
    results = track("general", own, SQUARE)
    next(results)
    results.close()
    assert next(iter(own)).index == 1
    own.close()


def test_the_package_offers_these_names():
    assert dir(bayesnet_track) == sorted([*bayesnet_track.__all__, "__version__"])
    for name in bayesnet_track.__all__:
        assert getattr(bayesnet_track, name).__name__ == name
    with pytest.raises(AttributeError, match="has no attribute 'Traker'"):
        _ = bayesnet_track.Traker
    assert Path(bayesnet_track.__file__).with_name("py.typed").exists()
