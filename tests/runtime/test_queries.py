"""Queries of a graph, through the front doors: Python, files of a run, the log, and a resumed run."""

from __future__ import annotations

import csv
import itertools
import json
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import yaml

from bayesnet_track import DetectionsTracker, Start, Tracker, open_run, track
from bayesnet_track.cli.main import main
from bayesnet_track.graph.checks.run import check_graph
from bayesnet_track.graphs import find_graph
from bayesnet_track.journal.events.beliefs import QueryPassed
from bayesnet_track.runtime.checkpoints.resume import resume
from bayesnet_track.sources.scenes.library import SceneSource

FRAMES = 12
FILES = ("journal.jsonl", "frames.npy.gz", "tracks.csv", "queries.csv", "graph.yaml")
QUERIES = {
    "right": {"of": "square", "probability": "x > 100", "event_above": 0.9},
    "speed": {"of": "square", "value": "hypot(vx, vy) / frame_s", "unit": "px/s"},
    "crossed": {"of": "square", "crosses": {"line": [[100, 0], [100, 240]]}},
    "inside": {"of": "square", "count": {"polygon": [[0, 0], [100, 0], [100, 240], [0, 240]]}},
}


def graph_with(queries: dict[str, object], name: str = "two_squares_velocity") -> dict[str, object]:
    graph = yaml.safe_load(find_graph(name).read_text(encoding="utf-8"))
    return {**graph, "queries": queries}


def begun(folder: Path, frames: int | None = None, **options: object) -> Path:
    source = SceneSource.named("two_squares", 0, FRAMES)
    graph = check_graph(graph_with(QUERIES))
    results = track(graph, source, [Start(source.scene.start_box)], out=folder, **options)
    for _ in itertools.islice(results, frames):
        pass
    results.close()
    return folder


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return begun(tmp_path_factory.mktemp("whole") / "run")


def test_answers_are_those_of_the_belief() -> None:
    source = SceneSource.named("two_squares", 0, 4)
    results = list(track(check_graph(graph_with(QUERIES)), source, source.scene.start_box))
    for result in results[1:]:
        belief = result.states["1"].belief
        weights, x = belief.weights.weights, belief.states[:, 0]
        assert result.queries["right"]["1"].probability == pytest.approx(weights[x > 100].sum())
        speed = np.hypot(belief.states[:, 4], belief.states[:, 5]) * 25
        answer = result.queries["speed"]["1"]
        assert (answer.mean, answer.unit) == (pytest.approx(weights @ speed), "px/s")
        assert answer.low < answer.mean < answer.high
        assert result.targets[0].queries["speed_sd"] == answer.sd
        assert result.queries["inside"].total.mean == result.queries["inside"]["1"].mean


def test_a_run_that_was_broken_off_goes_on_with_the_same_bytes(tmp_path: Path, whole: Path) -> None:
    run = begun(tmp_path / "run", 5)
    assert len(list(resume(run))) == FRAMES - 5
    for name in FILES:
        assert (run / name).read_bytes() == (whole / name).read_bytes(), name


def test_the_files_of_a_run_have_the_answers(whole: Path) -> None:
    with (whole / "queries.csv").open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    of_last = [row for row in rows if row["frame"] == str(FRAMES - 1)]
    assert [(row["query"], row["of"]) for row in of_last] == [
        ("right", "1"),
        ("speed", "1"),
        ("crossed", "1"),
        ("crossed", "all"),
        ("inside", "1"),
        ("inside", "all"),
    ]
    right, speed, _, _, _, total = of_last
    assert (right["mean"], speed["probability"], speed["unit"]) == ("", "", "px/s")
    with (whole / "tracks.csv").open(encoding="utf-8") as file:
        line = list(csv.DictReader(file))[-1]
    assert (line["right"], line["speed"], line["speed_sd"]) == (
        right["probability"],
        speed["mean"],
        speed["sd"],
    )
    metrics = open_run(whole).metrics[-1]
    assert metrics.queries["speed"] == pytest.approx(float(speed["mean"]), rel=1e-4)
    assert metrics.queries["inside_count"] == pytest.approx(float(total["mean"]), abs=1e-5)


def test_tables_and_exports_have_the_answers(whole: Path, capsys: pytest.CaptureFixture[str]) -> None:
    table = open_run(whole).to_dict()
    assert len(table["speed"]) == FRAMES
    assert table["speed"][0] is None  # no time has passed before the first frame
    assert table["right"][-1] == pytest.approx(open_run(whole).metrics[-1].queries["right"])
    assert main(["export", str(whole), "--format", "frames"]) == 0
    last = json.loads(capsys.readouterr().out.splitlines()[-1])
    assert last["queries"]["speed"] == pytest.approx(table["speed"][-1])
    assert main(["export", str(whole), "--format", "csv"]) == 0
    assert "speed_high" in capsys.readouterr().out.splitlines()[0]


def test_the_log_says_where_a_probability_passes_its_level(
    whole: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    passed = [event for event in open_run(whole).events if isinstance(event, QueryPassed)]
    assert passed
    assert main(["log", str(whole)]) == 0
    said = capsys.readouterr().out
    first = passed[0]
    assert f"frame {first.frame}: right of" in said
    assert "(no event if event_above > " in said or "at any event_above" in said


def test_a_level_that_the_log_names_would_have_prevented_the_event(whole: Path) -> None:
    first = next(event for event in open_run(whole).events if isinstance(event, QueryPassed))
    assert first.probability >= first.level
    text = first.describe()
    if "no event" in text:
        named = float(text.rsplit("> ", 1)[1].rstrip(")"))
        assert named >= first.probability


def crowd(queries: dict[str, object], frames: int = 12, **options: object) -> DetectionsTracker:
    graph = graph_with(queries, "kalman_detections")
    tracker = DetectionsTracker(check_graph(graph), size=(640, 480), fps=25, **options)
    rng = np.random.default_rng(3)
    places = np.array([[100.0, 100], [200, 300], [400, 200], [500, 400]])
    for _ in range(frames):
        places = places + [2.0, 1.0]
        centres = places + rng.normal(0, 1, places.shape)
        boxes = np.hstack([centres - 10, centres + 10])
        tracker.update(SimpleNamespace(xyxy=boxes, confidence=np.ones(len(boxes))))
    return tracker


def test_crowds_answer_as_rows_and_pairs() -> None:
    tracker = crowd(
        {
            "left": {"of": "target", "probability": "x < 320"},
            "count": {"of": "target", "count": {"condition": "x < 320"}},
            "gap": {"of": ["target", "target"], "value": "b.x - a.x"},
        }
    )
    left = tracker.queries["left"]
    assert sorted(left) == [one.target for one in tracker.targets]
    assert sorted(round(left[one].probability, 6) for one in left) == [0, 0, 1, 1]
    assert tracker.queries["count"].total.mean == pytest.approx(2.0, abs=1e-6)
    places = {one.target: one.centre_box[0] for one in tracker.targets}
    gaps = tracker.queries["gap"]
    assert len(gaps) == 6
    for (first, second), answer in gaps.items():
        assert answer.mean == pytest.approx(places[second] - places[first], abs=1e-9)


def test_a_crowd_that_exists_with_a_probability_is_counted_so() -> None:
    graph = graph_with({"all": {"of": "person", "count": {"condition": "x > -1000"}}}, "jpda")
    kind = next(iter(graph["targets"]))
    graph["queries"]["all"]["of"] = kind
    tracker = DetectionsTracker(check_graph(graph), size=(640, 480), fps=25)
    for step in range(8):
        boxes = np.array([[100.0 + step, 100, 120 + step, 140], [300, 200, 320, 240]])[: 2 if step < 6 else 1]
        tracker.update(SimpleNamespace(xyxy=boxes, confidence=np.ones(len(boxes))))
    total = tracker.queries["all"].total
    expected = sum(one.existence for one in tracker.targets)
    assert 0 < total.mean < 2
    assert total.mean == pytest.approx(expected, rel=1e-9)


def test_answers_are_stored_with_a_tracker(tmp_path: Path) -> None:
    tracker = crowd({"left": {"of": "target", "probability": "x < 320"}})
    tracker.save(tmp_path / "tracker")
    again = DetectionsTracker.load(tmp_path / "tracker")
    assert dict(again.queries["left"]) == dict(tracker.queries["left"])


def test_a_forecast_answers_for_frames_to_come(tmp_path: Path) -> None:
    folder = begun(tmp_path / "run", horizon=2)
    lines = [json.loads(line) for line in (folder / "forecasts.jsonl").read_text().splitlines()]
    last = [line for line in lines if line["frame"] == FRAMES - 1]
    assert [line["ahead"] for line in last] == [1, 2]
    for line in last:
        assert set(line["queries"]) == {"right"}  # `speed` reads frame_s
        x, sd = line["box"][0], line["sd"][0]
        assert line["queries"]["right"] == pytest.approx(
            float(x > 100), abs=0.5 if abs(x - 100) < 3 * sd else 0.01
        )


def test_a_smoothed_run_answers_from_its_smoothed_beliefs(tmp_path: Path) -> None:
    folder = begun(tmp_path / "run", keep_beliefs=True)
    assert main(["smooth", str(folder), "--out", str(tmp_path / "smooth")]) == 0
    before, after = open_run(folder).metrics, open_run(tmp_path / "smooth").metrics
    for line in after[1:]:
        assert line.queries["inside_count"] == pytest.approx(line.queries["inside"], abs=1e-6)
    assert [line.queries for line in before[1:-1]] != [line.queries for line in after[1:-1]]
    assert after[-1].queries["right"] == pytest.approx(before[-1].queries["right"], abs=0.3)
    spread = [sum(line.queries["speed_sd"] for line in lines[1:]) for lines in (after, before)]
    assert spread[0] < spread[1]  # later frames tell of earlier velocities


def test_a_graph_without_queries_has_no_stage_for_them(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["graph", "two_squares", "--plan"]) == 0
    assert "queries" not in capsys.readouterr().out


def test_a_tracker_answers_from_its_first_frame_on() -> None:
    rng = np.random.default_rng(0)
    image = rng.integers(0, 90, (120, 160, 3), dtype=np.uint8)
    image[50:70, 40:60] = (0, 0, 255)
    tracker = Tracker(check_graph(graph_with(QUERIES)))
    assert tracker.queries == {}
    tracker.init(image, (40, 50, 20, 20))
    assert tracker.queries["right"]["1"].probability == 0.0
    tracker.update(image)
    assert tracker.metrics.queries["right"] == tracker.queries["right"]["1"].probability
    with pytest.raises(ValueError, match="no probability"):
        _ = tracker.queries["speed"]["1"].probability


def walked(paths: list[list[tuple[float, float] | None]], crosses: dict[str, object], name: str) -> float:
    """The mean number of crossings of targets that walk along paths; None where nothing is detected."""
    graph = graph_with({"crossed": {"of": "target", "crosses": crosses}}, name)
    graph["queries"]["crossed"]["of"] = next(iter(graph["targets"]))
    tracker = DetectionsTracker(check_graph(graph), size=(640, 480), fps=25)
    rng = np.random.default_rng(0)
    for places in zip(*paths, strict=True):
        centres = np.array([place for place in places if place is not None]).reshape(-1, 2)
        centres = centres + rng.normal(0, 0.5, centres.shape)
        boxes = np.hstack([centres - 15, centres + 15])
        tracker.update(SimpleNamespace(xyxy=boxes, confidence=np.ones(len(boxes))))
    return tracker.queries["crossed"].total.mean


LINE = {"line": [[50, 200], [590, 200]], "from": "left"}


def down(x: float, first: float, last: float, frames: int = 40) -> list[tuple[float, float] | None]:
    return [(x, first + (last - first) * k / (frames - 1)) for k in range(frames)]


@pytest.mark.slow
@pytest.mark.parametrize("name", ["kalman_detections", "jpda"])
def test_a_crowd_is_counted_across_a_line(name: str) -> None:
    paths = [down(100, 120, 300), down(300, 110, 320), down(500, 150, 190), down(400, 330, 100)]
    assert walked(paths, LINE, name) == pytest.approx(2.0, abs=0.1)
    assert walked(paths, {**LINE, "from": "right"}, name) == pytest.approx(1.0, abs=0.1)
    assert walked(paths, {"line": LINE["line"]}, name) == pytest.approx(3.0, abs=0.1)


def test_a_target_that_is_lost_at_the_line_and_found_again_is_counted_once() -> None:
    path = down(300, 100, 300)
    hidden = [None if 15 <= k < 24 else place for k, place in enumerate(path)]
    assert walked([hidden, down(100, 60, 60)], LINE, "kalman_detections") == pytest.approx(1.0, abs=0.1)


def test_a_target_that_hesitates_at_the_line_is_counted_once() -> None:
    path = [
        *down(300, 150, 198, 20),
        *[(300.0, 200.0 + (-1) ** k) for k in range(20)],
        *down(300, 202, 240, 20),
    ]
    crosses = {**LINE, "hysteresis_px": 6}
    assert walked([path], crosses, "kalman_detections") == pytest.approx(1.0, abs=0.05)


@pytest.mark.slow
def test_the_count_of_drawn_crowds_is_calibrated() -> None:
    """Crowds drawn from what the filter assumes: the randomised PIT of the number in a polygon is uniform."""
    from scipy.stats import kstest

    from bayesnet_track.belief.asked import GaussianGroup
    from bayesnet_track.graph.spec import Query
    from bayesnet_track.inference.queries import compile_query, probabilities, sum_of_events

    asked = compile_query("q", Query(of="t", count={"polygon": [[0, 0], [60, 0], [60, 60], [0, 60]]}), {})
    transforms = []
    for seed in range(200):
        rng = np.random.default_rng(10_000 + seed)
        truth = rng.uniform(-20, 100, (12, 2))
        mean, variance = truth + rng.normal(0, 15, (12, 2)), np.full((12, 2), 15.0**2)
        truth = mean + rng.normal(0, 15, (12, 2))
        for _ in range(15):  # a random walk, seen with noise
            truth = truth + rng.normal(0, 4, truth.shape)
            predicted = variance + 16.0
            gain = predicted / (predicted + 36.0)
            mean = mean + gain * (truth + rng.normal(0, 6, truth.shape) - mean)
            variance = (1 - gain) * predicted
        covariances = np.zeros((12, 4, 4))
        covariances[:, [0, 1], [0, 1]] = variance
        means = np.hstack([mean, np.full((12, 2), 8.0)])
        group = GaussianGroup([str(k) for k in range(12)], ("x", "y", "w", "h"), means, covariances)
        distribution = sum_of_events(probabilities(asked, group, {}))
        count = int(((truth > 0) & (truth < 60)).all(axis=1).sum())
        below = distribution[:count].sum()
        transforms.append(below + rng.random() * distribution[count])
    assert kstest(transforms, "uniform").pvalue > 0.01


@pytest.mark.slow
def test_the_count_of_targets_that_share_detections_is_calibrated_and_hardly_wider_than_exact() -> None:
    """Four targets a scan, beside each other: the sum of events against all associations, enumerated.

    The exact distribution mixes those of the associations; the belief of each target is matched by moments.
    """
    from scipy.stats import kstest

    transforms, widths = [], []
    for seed in range(200):
        rng = np.random.default_rng(20_000 + seed)
        matched, exact, count = counts_of_a_scan(rng)
        transforms.append(matched[:count].sum() + rng.random() * matched[count])
        widths.append([np.ptp(np.searchsorted(np.cumsum(d), (0.05, 0.95))) for d in (matched, exact)])
    assert kstest(transforms, "uniform").pvalue > 0.01
    width, exact_width = np.mean(widths, axis=0)
    assert width <= 1.2 * exact_width


def counts_of_a_scan(rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray, int]:
    """Number of targets in a square: by the moments of each target, by enumeration, and as drawn."""
    from scipy.stats import norm

    from bayesnet_track.belief.asked import GaussianGroup
    from bayesnet_track.graph.spec import Query
    from bayesnet_track.inference.queries import compile_query, probabilities, sum_of_events

    asked = compile_query("q", Query(of="t", count={"polygon": [[0, 0], [60, 0], [60, 60], [0, 60]]}), {})
    detected, false, area, variance, error = 0.9, 0.5, 120.0**2, 15.0**2, 6.0**2
    gain = variance / (variance + error)
    mean = rng.uniform(-15, 75, (4, 2))
    truth = mean + rng.normal(0, variance**0.5, (4, 2))
    seen = [place + rng.normal(0, error**0.5, 2) for place in truth if rng.random() < detected]
    seen += [rng.uniform(-30, 90, 2) for _ in range(rng.poisson(false))]
    places = np.array(seen).reshape(-1, 2)
    rng.shuffle(places)
    away = places[None] - mean[:, None]
    fit = norm.logpdf(away, scale=(variance + error) ** 0.5).sum(axis=2)
    odds = np.hstack([np.exp(fit) * detected / (1 - detected) * area / false, np.ones((4, 1))])
    choices = [np.flatnonzero(row > 1e-3).tolist() for row in odds]
    # A target's state given each of its choices; the last one is that it was missed.
    means = np.concatenate([mean[:, None] + gain * away, mean[:, None]], axis=1)
    variances = np.append(np.full(len(places), (1 - gain) * variance), variance)
    scaled = [(bound - means) / variances[:, None] ** 0.5 for bound in (0, 60)]
    inside = (norm.cdf(scaled[1]) - norm.cdf(scaled[0])).prod(axis=2)
    exact, shares = np.zeros(5), np.zeros_like(odds)
    for association in itertools.product(*choices):
        used = [choice for choice in association if choice < len(places)]
        if len(used) == len(set(used)):
            rows = np.arange(4), np.array(association)
            weight = odds[rows].prod()
            exact += weight * sum_of_events(inside[rows])
            shares[rows] += weight
    shares /= shares.sum(axis=1, keepdims=True)
    matched = np.einsum("kj,kjd->kd", shares, means)
    apart = means - matched[:, None]
    covariances = np.zeros((4, 4, 4))
    covariances[:, :2, :2] = np.einsum("kj,kjd,kje->kde", shares, apart, apart)
    covariances[:, [0, 1], [0, 1]] += (shares @ variances)[:, None]
    boxes = np.hstack([matched, np.full((4, 2), 8.0)])
    group = GaussianGroup([str(k) for k in range(4)], ("x", "y", "w", "h"), boxes, covariances)
    count = int(((truth > 0) & (truth < 60)).all(axis=1).sum())
    return sum_of_events(probabilities(asked, group, {})), exact / exact.sum(), count


def test_velocities_are_measured_too(whole: Path, capsys: pytest.CaptureFixture[str]) -> None:
    line = open_run(whole).metrics[-1]
    assert set(line.state) == {"vx", "vy", "vx_sd", "vy_sd"}
    speed = line.queries["speed"] / 25
    assert np.hypot(line.state["vx"], line.state["vy"]) == pytest.approx(speed, abs=line.state["vx_sd"] * 2)
    assert main(["export", str(whole), "--format", "frames"]) == 0
    last = json.loads(capsys.readouterr().out.splitlines()[-1])
    assert last["state"]["vx"] == pytest.approx(line.state["vx"])
    table = open_run(whole).to_dict()
    assert table["vx"][-1] == line.state["vx"] and table["vy_sd"][-1] == line.state["vy_sd"]


def test_velocities_of_rows_are_those_of_their_lines() -> None:
    from bayesnet_track.journal.frame_columns import lines_of
    from bayesnet_track.runtime.recording.tracks import measured

    tracker = crowd({})
    lines = tracker._now.metrics
    columns = lines.columns()
    assert columns is not None
    back = list(lines_of(columns))
    for line, other in zip(tracker.targets, back, strict=True):
        assert line.state == pytest.approx(other.state)
        assert set(line.state) >= {"vx", "vy_sd"}
    assert measured(tracker.targets)[0]["state/vx"].shape == (4,)
