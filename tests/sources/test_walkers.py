"""A simulated crowd: its people do what is said of them, and its detector errs as often as is said."""

import importlib.util
import json
from pathlib import Path

import numpy as np
import pytest

from bayesnet_track.evaluate.truth import read_mot_truth
from bayesnet_track.numerics.boxes import centre_from_corner, overlap
from bayesnet_track.sources.detection_files import parse_detections
from simulated.crowd_detector import DetectorSettings, detect_crowd, detections_text
from simulated.walkers import LEG, CrowdSettings, make_crowd

SCRIPT = Path(__file__).parents[2] / "benchmarks" / "simulate_crowd.py"
LONG = CrowdSettings(frames=400, alone=8, births=0.1, life=120.0, crossings=5, beside=5)
EXACT = DetectorSettings(missed=0.0, clutter=0.0, place_px=0.0, size=0.0)


@pytest.fixture(scope="module")
def crowd():
    return make_crowd(LONG, 3)


def present(boxes):
    return np.flatnonzero(np.isfinite(boxes[:, 0]))


def bounds(mean, variance):
    """Five standard deviations: about one in two million falls outside."""
    return mean - 5 * np.sqrt(variance), mean + 5 * np.sqrt(variance)


# ------------------------------------------------------------------------------------ people


def test_everybody_is_there_for_one_stretch_and_inside_the_image(crowd):
    there = np.isfinite(crowd.boxes).all(axis=2)
    assert (there == np.isfinite(crowd.boxes).any(axis=2)).all() and there.any(axis=0).all()
    assert (np.abs(np.diff(np.pad(there.astype(int), ((1, 1), (0, 0))), axis=0)).sum(axis=0) == 2).all()
    boxes = crowd.boxes[there]
    edges = np.hstack([boxes[:, :2] - boxes[:, 2:] / 2, boxes[:, :2] + boxes[:, 2:] / 2])
    assert (edges >= -0.5 - 1e-9).all() and (edges[:, 2] <= 1279.5 + 1e-9).all()
    assert (edges[:, 3] <= 719.5 + 1e-9).all()


def test_people_are_born_and_gone_as_often_as_is_said(crowd):
    """Births are Poisson; lives are exponential, so that a known share is still there in the last frame."""
    there = np.isfinite(crowd.boxes[..., 0])
    alone = there[:, : there.shape[1] - 20]
    first = alone.argmax(axis=0)
    assert (first[:8] == 0).all() and (first[8:] > 0).all()
    low, high = bounds(0.1 * 399, 0.1 * 399)
    assert low <= len(first) - 8 <= high
    last_to_end = np.exp(-(400 - first - 1) / 120.0)  # who is still there in the last frame
    low, high = bounds(last_to_end.sum(), (last_to_end * (1 - last_to_end)).sum())
    assert low <= alone[-1].sum() <= high


def test_those_who_cross_do_cross(crowd):
    for one in (one for one in crowd.encounters if one.kind == "crossing"):
        a, b = crowd.boxes[:, one.first], crowd.boxes[:, one.second]
        both = np.flatnonzero(np.isfinite(a[:, 0]) & np.isfinite(b[:, 0]))
        assert both.tolist() == list(range(one.frame - LEG, one.frame + LEG + 1))
        between = (a - b)[both, :2]
        iou = overlap(a[both], b[both])
        assert np.hypot(*between[LEG]) <= 0.25 * 40 and iou[LEG] > 0.3
        assert iou[0] == iou[-1] == 0 and between[0] @ between[-1] < 0
        ways = [side[both[-1], :2] - side[both[0], :2] for side in (a, b)]
        assert ways[0] @ ways[1] <= 1e-6  # by a right angle at least


def test_those_who_run_side_by_side_do_so_without_overlap(crowd):
    for one in (one for one in crowd.encounters if one.kind == "beside"):
        a, b = crowd.boxes[:, one.first], crowd.boxes[:, one.second]
        both = np.flatnonzero(np.isfinite(a[:, 0]) & np.isfinite(b[:, 0]))
        width = (a[both, 2] + b[both, 2]) / 2
        apart = np.abs(a - b)[both, 0] / width
        assert (overlap(a[both], b[both]) == 0).all()
        np.testing.assert_allclose(apart[LEG - 25 : LEG + 26], 1.1)
        np.testing.assert_allclose(apart[[0, -1]], 3.0)
        assert np.hypot(*(a[one.frame] - a[one.frame - 1])[:2]) >= 2


def test_its_truth_file_is_exact(crowd, tmp_path):
    path = tmp_path / "gt.txt"
    path.write_text(crowd.mot_text())
    truth = read_mot_truth(path)
    np.testing.assert_allclose(
        centre_from_corner(truth.boxes), crowd.boxes[truth.frames, truth.ids - 1], rtol=0, atol=1e-12
    )
    assert len(truth) == np.isfinite(crowd.boxes[..., 0]).sum()


def test_the_same_seed_gives_the_same_bytes_and_another_one_others():
    short = CrowdSettings(frames=91, alone=4, crossings=1, beside=1)
    crowd, again, other = (make_crowd(short, seed) for seed in (3, 3, 4))
    assert again.mot_text() == crowd.mot_text() != other.mot_text()
    settings = DetectorSettings(merging="hull")
    texts = [detections_text(detect_crowd(crowd, settings, seed)) for seed in (3, 3, 4)]
    assert texts[0] == texts[1] != texts[2]


def test_its_pictures_show_who_is_there():
    """A flat colour in the middle of each box that no other one covers."""
    crowd = make_crowd(
        CrowdSettings(width=720, height=480, frames=91, alone=2, life=30, births=0, crossings=0)
    )
    movie = crowd.movie()
    for frame in (0, 90):
        image, boxes = movie[frame].astype(float), crowd.boxes[frame]
        for one in present(boxes):
            if overlap(boxes[one], boxes[present(boxes)]).sum() > 1:
                continue
            x, y = np.rint(boxes[one, :2]).astype(int)
            colour = movie.sprites[one].cells[0, 0]
            assert np.abs(image[y - 3 : y + 4, x - 3 : x + 4].mean(axis=(0, 1)) - colour).max() < 3
    assert len(movie) == 91


# ------------------------------------------------------------------------------------ detections


def test_an_exact_detector_reports_everybody_exactly(crowd):
    for boxes, reported in zip(crowd.boxes, detect_crowd(crowd, EXACT), strict=True):
        people = [one for (one,) in reported.people]
        assert sorted(people) == present(boxes).tolist()
        np.testing.assert_array_equal(reported.detections.boxes, boxes[people])


def test_misses_clutter_and_noise_are_as_often_and_as_large_as_is_said(crowd):
    settings = DetectorSettings(missed=0.3, clutter=4.0, place_px=3.0, size=0.05)
    reported = detect_crowd(crowd, settings, 1)
    n = int(np.isfinite(crowd.boxes[..., 0]).sum())
    people = [group for one in reported for group in one.people]
    found, false = sum(map(bool, people)), sum(not group for group in people)
    low, high = bounds(0.7 * n, 0.21 * n)
    assert low <= found <= high
    low, high = bounds(4.0 * 400, 4.0 * 400)
    assert low <= false <= high
    seen, true = [], []
    for boxes, one in zip(crowd.boxes, reported, strict=True):
        for box, group in zip(one.detections.boxes, one.people, strict=True):
            if group:
                seen.append(box)
                true.append(boxes[group[0]])
    off = np.array(seen)[:, :2] - np.array(true)[:, :2]
    scale = np.log(np.array(seen)[:, 2:] / np.array(true)[:, 2:])
    for values, sd in ((off, 3.0), (scale, 0.05)):
        assert abs(values.std() / sd - 1) < 5 / np.sqrt(2 * values.size)
        assert abs(values.mean()) < 5 * sd / np.sqrt(values.size)


def test_misses_do_not_depend_on_what_else_is_drawn(crowd):
    """So that detectors of the same seed with more clutter are compared on the same misses."""
    few, many = (
        [
            sorted(group for group in one.people if group)
            for one in detect_crowd(crowd, DetectorSettings(clutter=clutter), 5)
        ]
        for clutter in (0.0, 20.0)
    )
    assert few == many


@pytest.mark.slow
@pytest.mark.parametrize("merging", ["front", "hull"])
def test_merged_people_are_one_box(crowd, merging):
    settings = DetectorSettings(missed=0, clutter=0, place_px=0, size=0, merging=merging, merge_iou=0.2)
    merged = 0
    for boxes, one in zip(crowd.boxes, detect_crowd(crowd, settings), strict=True):
        assert sorted(person for group in one.people for person in group) == present(boxes).tolist()
        group_of = {person: group for group in one.people for person in group}
        iou = overlap(boxes[:, None], boxes[None, :])
        assert all(group_of[a] == group_of[b] for a, b in np.argwhere(iou >= 0.2))
        assert all(len(group) == 1 or (iou[list(group)] >= 0.2).sum() > len(group) for group in one.people)
        for box, group in zip(one.detections.boxes, one.people, strict=True):
            own = boxes[list(group)]
            low, high = (own[:, :2] - own[:, 2:] / 2).min(axis=0), (own[:, :2] + own[:, 2:] / 2).max(axis=0)
            hull = np.concatenate([(low + high) / 2, high - low])
            assert np.abs(box - (own[-1] if merging == "front" else hull)).max() < 1e-9
            merged += len(group) > 1
    assert merged >= 5 * 3  # each crossing for some frames


def test_its_detections_file_is_read_back(crowd):
    reported = detect_crowd(crowd, DetectorSettings())
    read = parse_detections(detections_text(reported))
    written = [frame for frame, one in enumerate(reported) if one.people]
    assert list(read) == written and all((one.scores == 1).all() for one in read.values())
    boxes = np.concatenate([read[frame].boxes for frame in written])
    np.testing.assert_allclose(
        boxes, np.concatenate([reported[frame].detections.boxes for frame in written]), atol=2e-3
    )


def test_the_script_writes_the_same_files_from_one_seed(tmp_path, capsys):
    spec = importlib.util.spec_from_file_location("simulate_crowd", SCRIPT)
    script = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(script)
    for name in ("a", "b"):
        script.main(
            [str(tmp_path / name), "--no-video", "--frames", "91", "--merging", "front", "--seed", "7"]
        )
    names = ("crowd.json", "det.txt", "gt.txt")
    first, second = ([(tmp_path / folder / name).read_bytes() for name in names] for folder in "ab")
    assert first == second and json.loads(first[0])["detector"]["merging"] == "front"
    assert first[2].decode() == make_crowd(CrowdSettings(frames=91), 7).mot_text()
    with pytest.raises(SystemExit):
        script.main([str(tmp_path / "c"), "--width", "100"])
    assert "a crowd needs at least 720x480" in capsys.readouterr().err and not (tmp_path / "c").exists()


# ------------------------------------------------------------------------------------ refused


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: CrowdSettings(width=640), "image 640x720 px; a crowd needs at least 720x480"),
        (lambda: CrowdSettings(frames=90), "90 frames; these people need at least 91"),
        (lambda: CrowdSettings(births=-1), "births -1; expected a number from 0 on"),
        (lambda: CrowdSettings(life=0), "life 0; expected a number of frames above 0"),
        (lambda: CrowdSettings(alone=0, crossings=0, beside=0), "nobody in frame 0 and no pairs"),
        (lambda: DetectorSettings(missed=1.1), "missed 1.1; expected a probability from 0 to 1"),
        (lambda: DetectorSettings(clutter=np.nan), "clutter nan; expected a number from 0 on"),
        (lambda: DetectorSettings(merging="all"), "merging 'all'; expected none, front, hull"),
        (lambda: DetectorSettings(merge_iou=0), "merge_iou 0; expected an overlap above 0, at most 1"),
        (lambda: make_crowd(CrowdSettings(), -1), "a seed is 0 or more, not -1"),
    ],
)
def test_settings_that_mean_nothing_are_refused(make, message):
    with pytest.raises(ValueError, match=message):
        make()
