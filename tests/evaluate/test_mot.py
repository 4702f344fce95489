"""MOTA, IDF1 and HOTA: by hand, against TrackEval's figures, and what must hold of any tracks."""

import json
import subprocess
import sys
from dataclasses import asdict

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from bayesnet_track.evaluate import paired_boxes
from bayesnet_track.evaluate.mot import MotScore, score_mot
from bayesnet_track.evaluate.scores import meanings
from bayesnet_track.evaluate.truth import Tracks


def tracks(*rows):
    """Of rows (frame, identity, left, top, width, height)."""
    values = np.array(rows, dtype=np.float64).reshape(-1, 6)
    return Tracks(values[:, 0].astype(np.int64), values[:, 1].astype(np.int64), values[:, 2:])


def near(**expected):
    return {name: pytest.approx(value, abs=1e-12) for name, value in expected.items()}


def figures(score, names):
    return {name: getattr(score, name) for name in names}


def check(score, **expected):
    assert figures(score, expected) == near(**expected)


# ------------------------------------------------------------------------------------ by hand

APART = {1: 0.0, 2: 100.0}
TWO = tracks(*[(frame, one, left, 5, 10, 20) for frame in range(10) for one, left in APART.items()])


def test_perfect_tracks():
    score = score_mot(TWO, Tracks(TWO.frames, 70 - TWO.ids, TWO.boxes))
    shares = ("mota", "motp", "idf1", "idp", "idr", "hota", "deta", "assa", "loca")
    check(score, fp=0, fn=0, idsw=0, **dict.fromkeys(shares, 1.0))
    check(score, frames=10, true_ids=2, true_boxes=20, track_ids=2, track_boxes=20)


def test_identities_swapped_half_way():
    """2 switches in 20 boxes. Each track shares 5 of its 10 boxes with either target: 5 / (10 + 10 - 5)."""
    swapped = Tracks(TWO.frames, np.where(TWO.frames < 5, TWO.ids, 3 - TWO.ids), TWO.boxes)
    score = score_mot(TWO, swapped)
    check(score, mota=0.9, motp=1.0, fp=0, fn=0, idsw=2, idf1=0.5, idp=0.5, idr=0.5)
    check(score, deta=1.0, assa=1 / 3, hota=np.sqrt(1 / 3), loca=1.0)


def test_a_target_found_again_under_another_name():
    """4 frames, 2 missed, 4 frames: the own track has 4 of 10 and of 8 boxes; shared are 4 / (10 + 4 - 4)."""
    target = tracks(*[(frame, 1, 0, 0, 9, 9) for frame in range(10)])
    found = tracks(*[(frame, 1 + (frame > 5), 0, 0, 9, 9) for frame in (0, 1, 2, 3, 6, 7, 8, 9)])
    score = score_mot(target, found)
    check(score, mota=0.7, fp=0, fn=2, idsw=1, idf1=8 / 18, idp=0.5, idr=0.4)
    check(score, deta=0.8, assa=0.4, hota=np.sqrt(0.32))


def test_no_tracks():
    """All missed. What is a share of nothing is 0, but for LocA: without a match nothing is out of place."""
    score = score_mot(TWO, tracks())
    check(score, mota=0, motp=0, fp=0, fn=20, idsw=0, idf1=0, idp=0, idr=0, hota=0, deta=0, assa=0, loca=1)


def test_tracks_in_other_frames_are_all_false():
    check(score_mot(TWO, tracks((12, 1, 0, 5, 10, 20))), mota=-0.05, fp=1, fn=20, idsw=0, frames=13, hota=0)


def test_an_overlap_of_just_the_threshold_counts():
    """IoU 1/2: matched by CLEAR and IDF1, and by 10 of the 19 thresholds of HOTA."""
    score = score_mot(tracks((0, 1, 0, 0, 10, 10)), tracks((0, 1, 0, 0, 10, 20)))
    check(score, mota=1, motp=0.5, idf1=1, hota=10 / 19, deta=10 / 19, assa=10 / 19, loca=14 / 19)


def test_less_than_the_threshold_does_not_count():
    score = score_mot(tracks((0, 1, 0, 0, 10, 10)), tracks((0, 1, 0, 0, 10, 20.01)))
    check(score, mota=-1, motp=0, fp=1, fn=1, idf1=0, hota=9 / 19)


def test_who_was_matched_stays_matched():
    """In frame 1 another track fits better (IoU 1 against 2/3), and the old one is still near."""
    target = tracks((0, 1, 0, 0, 10, 10), (1, 1, 0, 0, 10, 10))
    found = tracks((0, 1, 0, 0, 10, 10), (1, 2, 0, 0, 10, 10), (1, 1, 2, 0, 10, 10))
    check(score_mot(target, found), idsw=0, fp=1, fn=0, motp=(1 + 2 / 3) / 2)


def test_hota_prefers_the_track_that_fits_over_the_whole_sequence():
    """Track 2 covers the target in one frame exactly, track 1 in all four with IoU 2/3."""
    target = tracks(*[(frame, 1, 0, 0, 10, 10) for frame in range(4)])
    found = tracks(*[(frame, 1, 2, 0, 10, 10) for frame in range(4)], (3, 2, 0, 0, 10, 10))
    score = score_mot(target, found)
    at_half = score.alphas.index(0.5)
    assert score.assa_at[at_half] == pytest.approx(1.0) and score.deta_at[at_half] == pytest.approx(4 / 5)


# ------------------------------------------------------------------------------------ TrackEval's figures


def generated(seed, miss, jitter, switch):
    """Four targets that cross, and tracks with errors, in whole thousandths by integer arithmetic alone."""
    state = seed

    def draw(below):
        nonlocal state
        state = (1103515245 * state + 12345) % 2**31
        return (state >> 8) % below

    truth, found, names = [], [], {1: 1, 2: 2, 3: 3, 4: 4}
    for frame in range(30):
        if draw(100) < switch:
            a, b = 1 + draw(4), 1 + draw(4)
            names[a], names[b] = names[b], names[a]
        for one in range(1, 5):
            if not 3 * one <= frame < 20 + 3 * one:
                continue
            box = [20 * one + (one - 2) * frame, 10 + 5 * one, 30, 60]
            truth.append((frame, one, *box))
            if draw(100) >= miss:
                shaken = [value + (draw(2 * jitter + 1) - jitter) / 1000 for value in box]
                found.append((frame, names[one], *shaken))
        if draw(100) < miss:
            found.append((frame, 10 + frame // 4, draw(150), draw(50), 30, 60))
    return tracks(*truth), tracks(*found)


FIGURES = ("mota", "motp", "fp", "fn", "idsw", "idf1", "idp", "idr", "hota", "deta", "assa", "loca")
CHECKED = {
    (1, 0, 1000, 10): (
        0.9871794871794872,
        0.944044179081934,
        0,
        0,
        1,
        0.9871794871794872,
        0.9871794871794872,
        0.9871794871794872,
        0.9435554108368887,
        0.9603824531893231,
        0.9270724609129216,
        0.9451184668023533,
    ),
    (2, 10, 4000, 10): (
        0.782051282051282,
        0.8083322258876661,
        2,
        7,
        8,
        0.4900662251655629,
        0.5068493150684932,
        0.47435897435897434,
        0.3936801901206771,
        0.7051638123542927,
        0.22061019091587153,
        0.8319148240303612,
    ),
    (3, 30, 8000, 30): (
        0.2692307692307692,
        0.6755454120308187,
        22,
        31,
        4,
        0.5850340136054422,
        0.6231884057971014,
        0.5512820512820513,
        0.384841852042356,
        0.4058591323110114,
        0.36749116401733156,
        0.7233943230902071,
    ),
    (4, 60, 15000, 60): (
        -0.3333333333333333,
        0.6629165838945559,
        30,
        70,
        4,
        0.08620689655172414,
        0.13157894736842105,
        0.0641025641025641,
        0.09024301708096125,
        0.13297390320589184,
        0.06944677573170019,
        0.66797328372475,
    ),
}


@pytest.mark.parametrize("settings", CHECKED)
def test_the_figures_are_those_of_trackeval(settings):
    """Of TrackEval 1.3.0; rounding differs by 1e-15."""
    expected = dict(zip(FIGURES, CHECKED[settings], strict=True))
    assert figures(score_mot(*generated(*settings)), FIGURES) == near(**expected)


# ------------------------------------------------------------------------------------ of any tracks


@st.composite
def scenes(draw):
    """Boxes of a few targets and tracks that overlap now and then, ties left out by random fractions."""
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    sides = []
    for ids in (draw(st.integers(1, 5)), draw(st.integers(0, 5))):
        frame, one = np.nonzero(rng.random((draw(st.integers(1, 8)), ids)) < 0.8)
        corner = 4.0 * one[:, None] + rng.normal(0, 2, (len(one), 2))
        sides.append(Tracks(frame, one, np.hstack([corner, rng.uniform(8, 12, (len(one), 2))])))
    return sides if len(sides[0]) else [tracks((0, 0, 0, 0, 9, 9)), sides[1]]


@given(scenes())
def test_bounds_and_hota_of_its_parts(scene):
    score = score_mot(*scene)
    values = {**asdict(score), "mota": 0.0}
    shares = [values[name] for name in FIGURES if isinstance(values[name], float)]
    curves = np.array([score.hota_at, score.deta_at, score.assa_at, score.loca_at])
    assert min(shares) >= 0 and max(shares) <= 1 + 1e-12 and score.mota <= 1
    assert curves.min() >= 0 and curves.max() <= 1 + 1e-12
    np.testing.assert_allclose(curves[0] ** 2, curves[1] * curves[2], rtol=1e-12)
    np.testing.assert_allclose(curves.mean(axis=1), [score.hota, score.deta, score.assa, score.loca])
    assert (np.diff(curves[1]) <= 1e-12).all()  # fewer pairs reach a higher threshold
    assert score.true_boxes - score.fn == score.track_boxes - score.fp


@given(scenes(), st.randoms(use_true_random=False))
def test_the_names_of_identities_and_the_order_of_lines_change_nothing(scene, random):
    renamed = []
    for side in scene:
        names = random.sample(range(-50, 10**9), 5)
        order = random.sample(range(len(side)), len(side))
        ids = np.array([names[one] for one in side.ids], dtype=np.int64)
        renamed.append(Tracks(side.frames[order], ids[order], side.boxes[order]))
    assert figures(score_mot(*renamed), FIGURES) == near(**figures(score_mot(*scene), FIGURES))


@given(scenes())
def test_frames_that_are_compared_one_by_one(scene):
    """As those of a long sequence that are not compared together."""
    with pytest.MonkeyPatch.context() as patches:
        patches.setattr(paired_boxes, "_BLOCK_PAIRS", 1)
        alone = score_mot(*scene)
    assert figures(alone, FIGURES) == near(**figures(score_mot(*scene), FIGURES))


@given(scenes())
def test_truth_and_tracks_exchanged(scene):
    """HOTA and IDF1 treat both alike; what was precision becomes recall."""
    truth, found = scene
    if len(found):
        score, back = score_mot(truth, found), score_mot(found, truth)
        names = ("idf1", "hota", "deta", "assa", "loca")
        assert figures(back, names) == near(**figures(score, names))
        assert (back.idp, back.idr) == (score.idr, score.idp)


# ------------------------------------------------------------------------------------ what is said


def test_text_and_json_say_the_same():
    score = score_mot(*generated(1, 20, 4000, 20), trajectories=True)
    shown, lines = json.loads(score.json()), score.text(explained=True).splitlines()
    assert shown == json.loads(json.dumps(asdict(score)))
    assert [line.split()[0] for line in lines] == list(meanings(MotScore))
    assert all(float(line.split()[1]) == round(shown[line.split()[0]], 4) for line in lines)
    assert len(shown["alphas"]) == len(shown["hota_at"]) == 19


def test_figures_of_distances():
    """10 frames of two targets, found 3 px off but for one box: squares of 3 px, and of c / sqrt(2) once."""
    found = tracks(
        *[(f, one, x + 3, 5, 10, 20) for f in range(10) for one, x in APART.items() if (f, one) != (4, 2)]
    )
    score = score_mot(TWO, found, cutoff_px=20.0, trajectories=True)
    check(score, cutoff_px=20, gospa_loc=np.sqrt(19 * 9 / 10), gospa_missed=np.sqrt(200 / 10), gospa_false=0)
    check(score, gospa=np.sqrt(371 / 10), ospa2=np.sqrt((3**2 + 4.7**2) / 2))
    check(score, tgospa=score.gospa, tgospa_switch=0)
    assert score_mot(TWO, found).tgospa is None and "tgospa" not in score_mot(TWO, found).text()


def test_a_truth_without_boxes_is_refused():
    with pytest.raises(ValueError, match="the truth has no box"):
        score_mot(tracks(), TWO)


def test_scipy_is_loaded_only_when_scores_are_asked_for():
    code = "import sys, bayesnet_track.evaluate.mot; print('scipy' in sys.modules)"
    shown = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout
    assert shown == "False\n"
