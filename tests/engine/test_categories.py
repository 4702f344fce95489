"""What a target is and stays: labels and expressions as evidence, against enumeration."""

from __future__ import annotations

import csv
import json
import pickle
from types import SimpleNamespace

import cv2
import numpy as np
import pytest
from scipy.stats import norm

from bayesnet_track import DetectionsTracker, Start, Tracker, load_graph, open_run, track
from bayesnet_track.cli.main import main
from bayesnet_track.journal.events.beliefs import ModeChanged
from bayesnet_track.journal.text.sentences import why

TABLE = {"red": {"red": 0.9, "blue": 0.1}, "blue": {"red": 0.2, "blue": 0.8}}
PRIOR = {"red": 0.3, "blue": 0.7}
BELIEFS = {
    "gaussian": {"gaussian": {"filter": "kalman", "gate": 1}},
    "particles": {"particles": {"size": 500}},
}
LIVES = {
    "assigned": {},
    "tentative": {"tentative": True},
    "existing": {"existence": {}},
    "marginal": {"existence": {}, "associate": "marginal"},
}


def crowd(belief="gaussian", life="marginal", **more):
    root = {
        "belief": BELIEFS[belief],
        "motion": {"constant_velocity": {"sd_velocity_px": 1, "sd_px": {"x": 1, "y": 1, "w": 1, "h": 1}}},
        "category": {"team": {"values": ["red", "blue"], "prior": PRIOR}},
        **more,
    }
    own = dict(LIVES[life])
    birth = {"detector": "detections", **({"tentative": True} if own.pop("tentative", False) else {})}
    seen = {"parent": "player", "agent": {"detection": {"confusion": {"team": TABLE}}}}
    target = {"birth": birth, **own, "nodes": {"player": root, "seen": seen}}
    return {
        "bayesnet": 1,
        "name": "teams",
        "queries": {"is_red": {"of": "player", "probability": "team == red", "event_above": 0.9}},
        "targets": {"player": target},
    }


def posterior(labels):
    """P(red | labels), by Bayes' rule."""
    red, blue = PRIOR["red"], PRIOR["blue"]
    for label in labels:
        red, blue = red * TABLE["red"].get(label, 1.0), blue * TABLE["blue"].get(label, 1.0)
    return red / (red + blue)


def give(boxes, labels):
    return SimpleNamespace(
        xyxy=np.array(boxes, float), confidence=np.full(len(boxes), 0.9), data={"class_name": labels}
    )


def walk(frame):
    return [[100 + 3 * frame, 100, 140 + 3 * frame, 200], [500 - 3 * frame, 300, 540 - 3 * frame, 400]]


LABELS = [("red", "blue"), ("red", "red"), ("blue", "blue"), ("red", "red"), ("red", "blue"), ("red", "blue")]


@pytest.mark.parametrize(
    ("belief", "life"),
    [*(("gaussian", life) for life in LIVES), ("particles", "assigned"), ("particles", "existing")],
)
def test_labels_of_all_detections_of_a_target_give_its_posterior(belief, life):
    tracker = DetectionsTracker(load_graph(crowd(belief, life)), size=(640, 480))
    for frame, labels in enumerate(LABELS):
        tracker.update(give(walk(frame), labels))
    assert len(tracker.targets) == 2
    error = 2e-4 if belief == "gaussian" else 0.03
    for target in tracker.targets:
        which = 0 if target.centre_box[1] < 250 else 1
        exact = posterior([labels[which] for labels in LABELS])
        assert target.categories["team"]["red"] == pytest.approx(exact, abs=error)
        assert target.category["team=blue"] == pytest.approx(1 - exact, abs=error)
        assert target.queries["is_red"] == pytest.approx(exact, abs=error)
        assert not target.modes


def test_a_value_that_seemed_out_comes_back_also_with_particles():
    labels = ["red"] * 12 + ["blue"] * 12
    tracker = DetectionsTracker(load_graph(crowd("particles", "assigned")), size=(640, 480))
    for frame, label in enumerate(labels):
        tracker.update(give(walk(0)[:1], [label]))
        if frame == 11:
            assert tracker.targets[0].categories["team"]["red"] > 0.999
    exact = posterior(labels)
    assert exact < 0.1 and tracker.targets[0].categories["team"]["red"] == pytest.approx(exact, abs=0.1)


def test_it_is_told_when_another_value_becomes_the_most_probable_one():
    tracker = DetectionsTracker(load_graph(crowd("gaussian", "assigned")), size=(640, 480))
    told = []
    for frame, label in enumerate(["blue", "blue", "blue", *["red"] * 6]):
        tracker.update(give(walk(frame)[:1], [label]))
        told += [event for event in tracker.events if isinstance(event, ModeChanged)]
    (event,) = told
    # Of odds 7 / 3 three blue labels make 1195 / 1; each red one divides them by 4.5: the fifth turns them.
    assert (event.of, event.mode, event.before, event.frame) == ("team", "red", "blue", 7)
    assert event.nats == pytest.approx(np.log(4.5), abs=1e-6)
    assert event.describe().startswith(
        "the frame's evidence is 1.5 nats higher for team red than for blue → team"
    )


@pytest.mark.slow
@pytest.mark.parametrize("life", ["assigned", "marginal"])
def test_two_targets_that_meet_keep_their_identities_by_their_labels(life):
    def boxes(frame):  # both turn round where they meet
        away = 4 * abs(frame - 14)
        return [[300 - away, 100, 340 - away, 200], [306 + away, 100, 346 + away, 200]]

    def ends(labels):
        graph = crowd("gaussian", life)
        graph["targets"]["player"]["nodes"]["player"]["motion"] = {
            "constant_velocity": {"sd_velocity_px": 0.5, "sd_px": {"w": 1, "h": 1}}
        }
        tracker = DetectionsTracker(load_graph(graph), size=(640, 480))
        for frame in range(29):
            tracker.update(give(boxes(frame), labels))
            if frame == 8:
                start = {one.target: one.centre_box[0] < 320 for one in tracker.targets}
        return start, {one.target: one.centre_box[0] < 320 for one in tracker.targets}

    start, end = ends(["red", "blue"])
    assert start == end and len(start) == 2
    start, swapped = ends(["", ""])  # by motion alone they go on across each other
    assert start != swapped


@pytest.mark.filterwarnings("ignore::bayesnet_track.sources.entrances.notices.InputNotice")
def test_a_label_that_is_not_known_says_nothing():
    tracker = DetectionsTracker(load_graph(crowd("gaussian", "assigned")), size=(640, 480))
    for frame, label in enumerate(["red", "referee", "", "blue", "red"]):
        tracker.update(give(walk(frame)[:1], [label]))
    exact = posterior(["red", "blue", "red"])
    assert tracker.targets[0].categories["team"]["red"] == pytest.approx(exact, abs=1e-6)


def test_it_is_said_which_labels_say_nothing():
    tracker = DetectionsTracker(load_graph(crowd("gaussian", "assigned")), size=(640, 480))
    with pytest.warns(UserWarning, match="label 'referee' of detections says nothing of team: its confusion"):
        tracker.update(give(walk(0)[:1], ["referee"]))


def test_what_a_target_is_stays_beside_modes():
    modes = {
        "walk": {"mean_frames": 30},
        "run": {
            "mean_frames": 15,
            "motion": {"constant_velocity": {"sd_velocity_px": 5, "sd_px": {"x": 1, "y": 1, "w": 1, "h": 1}}},
        },
    }
    tracker = DetectionsTracker(load_graph(crowd("gaussian", "marginal", modes=modes)), size=(640, 480))
    for frame, labels in enumerate(LABELS):
        tracker.update(give(walk(frame), labels))
    for target in tracker.targets:
        which = 0 if target.centre_box[1] < 250 else 1
        exact = posterior([labels[which] for labels in LABELS])
        assert target.categories["team"]["red"] == pytest.approx(exact, abs=2e-4)
        assert set(target.modes) == {"walk", "run"} and sum(target.modes.values()) == pytest.approx(1)


# ------------------------------------------------------------------------------------ readers

FRAMES = 12
SEEN = 100 + 3 * np.arange(FRAMES) + np.random.default_rng(1).normal(0, 2, FRAMES)


def filtered(pieces):
    """P(red) and the mean of x, by a Kalman filter for each value: its prior, H, and a factor."""
    found = []
    for prior, h, factor in pieces:
        mean, variance, log = 99.5, 0.0, np.log(prior)
        for frame in range(1, FRAMES):
            variance += 9.0
            for value, slope, error in [(SEEN[frame], h, 16.0), *([factor] if factor else [])]:
                spread = slope * slope * variance + error
                log += norm.logpdf(value, slope * mean, np.sqrt(spread))
                gain = slope * variance / spread
                mean, variance = mean + gain * (value - slope * mean), variance - gain * slope * variance
        found.append((mean, log))
    logs = np.array([log for _, log in found])
    shares = np.exp(logs - logs.max())
    shares /= shares.sum()
    return shares[0], float(shares @ [mean for mean, _ in found])


def ball(belief, nodes):
    root = {
        "belief": belief,
        "motion": {"random_walk": {"sd_px": {"x": 3, "y": 1}}},
        "category": {"team": {"values": ["red", "blue"], "prior": {"red": 0.4, "blue": 0.6}}},
        "fuse": "product",
        "estimate": "mean",
    }
    return {"bayesnet": 1, "name": "g", "targets": {"ball": {"nodes": {"ball": root, **nodes}}}}


def follow(graph):
    tracker = Tracker(load_graph(graph), fps=25)
    image = np.random.default_rng(0).integers(0, 255, (240, 320, 3), dtype=np.uint8)
    tracker.init(image, (90, 110, 20, 20))
    for _ in range(1, FRAMES):
        tracker.update(image)
    return tracker.targets[0]


@pytest.fixture
def readings(tmp_path):
    def write(*names):
        rows = "".join(f"{frame},{x:.9f},120\n" for frame, x in enumerate(SEEN))
        path = tmp_path / "r.csv"
        path.write_text(f"frame,{names[0]},{names[1]}\n{rows}", encoding="utf-8")
        return {"readings": {"file": str(path), "sd": dict.fromkeys(names, 4), "floor": 1e-12}}

    return write


GAUSSIAN = {"gaussian": {"filter": "extended", "gate": 1, "likelihood": "sigma_points"}}
UNSCENTED = {"gaussian": {"filter": "unscented", "gate": 1, "likelihood": "sigma_points"}}
PARTICLES = {"particles": {"size": 4000}}
NAMES = ["extended", "unscented", "particles"]


@pytest.mark.parametrize(
    ("belief", "error"),
    [(GAUSSIAN, 1e-6), (UNSCENTED, 1e-6), (PARTICLES, 0.06)],
    ids=lambda one: str(one)[:12],
)
def test_a_factor_that_reads_the_category_is_evidence_on_it_and_on_the_place(belief, error, readings):
    exact, mean = filtered([(0.4, 1.0, (130.0, 1.0, 1600.0)), (0.6, 1.0, (100.0, 1.0, 1600.0))])
    factor = {"parent": "ball", "factor": "where(team == red, normal(x, 130, 40), normal(x, 100, 40))"}
    last = follow(ball(belief, {"s": {"parent": "ball", "agent": readings("x", "y")}, "f": factor}))
    assert last.categories["team"]["red"] == pytest.approx(exact, abs=error)
    assert last.centre_box[0] == pytest.approx(mean, abs=max(10 * error, 1e-4))


@pytest.mark.parametrize(
    ("belief", "error"),
    [(GAUSSIAN, 1e-6), (UNSCENTED, 1e-6), (PARTICLES, 0.06)],
    ids=lambda one: str(one)[:12],
)
def test_a_measurement_function_may_read_the_category(belief, error, readings):
    exact, mean = filtered([(0.4, 1.0, None), (0.6, 1.1, None)])
    agent = {
        "parent": "ball",
        "agent": readings("u", "v"),
        "measures": {"u": "where(team == red, x, 1.1 * x)", "v": "y"},
    }
    last = follow(ball(belief, {"s": agent}))
    assert last.categories["team"]["red"] == pytest.approx(exact, abs=error)
    assert last.centre_box[0] == pytest.approx(mean, abs=max(10 * error, 1e-4))


def test_a_joins_factor_tells_one_target_by_the_other(readings, tmp_path):
    """Two of one team stay close to each other: what is known of one team tells the other."""
    graph = ball(PARTICLES, {"s": {"parent": "ball", "agent": readings("x", "y")}})
    graph["targets"]["ball"]["nodes"]["f"] = {"parent": "ball", "factor": "where(team == red, 1, 0.2)"}
    graph["joins"] = [
        {
            "between": ["ball", "ball"],
            "factor": "where(a.team == b.team, 1, 0.05)",
            "when": {"overlap": 0},
        }
    ]
    rng = np.random.default_rng(0)
    (tmp_path / "images").mkdir()
    for number in range(4):
        assert cv2.imwrite(
            str(tmp_path / "images" / f"{number}.png"), rng.integers(0, 255, (240, 320, 3), dtype=np.uint8)
        )
    starts = [Start((90, 110, 20, 20), "ball"), Start((92, 110, 20, 20), "ball")]
    results = list(track(load_graph(graph), str(tmp_path / "images"), starts, seed=1))
    shares = [[one.categories["team"] for one in result.targets] for result in results]
    joined = next(number for number, result in enumerate(results) if result.targets[0].join is not None)
    # The frame weighs each target by its factor, then both by that of the pair.
    own = [np.array([share["red"], 0.2 * share["blue"]]) for share in shares[joined - 1]]
    joint = np.outer(*own) * np.array([[1, 0.05], [0.05, 1]])
    joint /= joint.sum()
    assert shares[joined][0]["red"] == pytest.approx(joint.sum(axis=1)[0], abs=0.04)
    assert shares[joined][1]["red"] == pytest.approx(joint.sum(axis=0)[0], abs=0.04)


# ------------------------------------------------------------------------------------ what is written


def run_of(tmp_path, capsys):
    graph = tmp_path / "teams.yaml"
    graph.write_text(json.dumps(crowd()), encoding="utf-8")
    lines = []
    for frame, labels in enumerate(LABELS):
        boxes = [[left, top, right - left, bottom - top] for left, top, right, bottom in walk(frame)]
        found = [{"box": box, "score": 0.9, "label": name} for box, name in zip(boxes, labels, strict=True)]
        lines.append(json.dumps({"frame": frame, "detections": found}))
    detections = tmp_path / "teams.jsonl"
    detections.write_text("\n".join(lines) + "\n", encoding="utf-8")
    folder, images = tmp_path / "run", tmp_path / "images"
    images.mkdir()
    for frame in range(len(LABELS)):
        assert cv2.imwrite(str(images / f"{frame}.png"), np.full((480, 640, 3), 90, np.uint8))
    command = ["run", str(graph), "--source", str(images)]
    said = main([*command, "--detections", str(detections), "--out", str(folder)])
    assert said == 0, capsys.readouterr().err
    return folder


def test_files_and_log_have_the_posterior(tmp_path, capsys):
    folder = run_of(tmp_path, capsys)
    run = open_run(folder)
    last = [line for line in run.metrics if line.frame == len(LABELS) - 1]
    exact = {posterior([labels[k] for labels in LABELS]) for k in (0, 1)}
    found = {round(line.categories["team"]["red"], 3) for line in last}
    assert found == {round(one, 3) for one in exact}
    with (folder / "tracks.csv").open(encoding="utf-8") as file:
        row = list(csv.DictReader(file))[-1]
    assert float(row["team=red"]) + float(row["team=blue"]) == pytest.approx(1, abs=1e-3)
    assert "team=red" in run.to_dict()
    text = why(run.events, run.metrics, len(LABELS) - 1)
    assert "  team  " in text and "red predicted" in text and "nats" in text
    assert main(["report", str(folder)]) == 0


def test_a_resumed_tracker_goes_on_in_its_categories(tmp_path):
    images = np.random.default_rng(0).integers(0, 255, (6, 120, 160, 3), dtype=np.uint8)
    factor = {"parent": "ball", "factor": "where(team == red, normal(x, 130, 40), normal(x, 100, 40))"}
    graph = load_graph(ball(GAUSSIAN, {"c": {"parent": "ball", "agent": "intensity"}, "f": factor}))
    whole = Tracker(graph, fps=25)
    whole.init(images[0], (50, 50, 20, 20))
    for image in images[1:3]:
        whole.update(image)
    again = pickle.loads(pickle.dumps(whole))
    for image in images[3:]:
        whole.update(image), again.update(image)
    assert whole.targets[0].category == again.targets[0].category
