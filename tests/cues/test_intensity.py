"""The gray pattern: both forms against their formulas, and the coarse look first."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from bayesnet_track import GrayPlane, floored
from bayesnet_track.cues.intensity import CUE, IntensityCue
from bayesnet_track.observation.cue import Hypotheses, log_size_penalty
from bayesnet_track.observation.planes import Frame, FramePair, PlaneCache, Planes, Region
from bayesnet_track.vision.kernels.patch_kernels import MOMENTS, patch_means, patch_moments

FORMS = ("correlation", "difference")


def textured(seed: int = 0, height: int = 120, width: int = 160) -> np.ndarray:
    noise = np.random.default_rng(seed).integers(0, 256, (height, width), dtype=np.uint8)
    return cv2.normalize(cv2.GaussianBlur(noise, (0, 0), 2.0), None, 0, 255, cv2.NORM_MINMAX)


def planes_of(gray: np.ndarray, region: Region | None = None) -> Planes:
    frame = Frame(0, 0.0, cv2.merge([gray] * 3))
    whole = Region(0, 0, frame.width, frame.height)
    return PlaneCache(FramePair(frame, None)).planes((GrayPlane(),), region or whole)


def made(**parameters: object) -> IntensityCue:
    return CUE.make(CUE.parameters(**parameters))


def scores(cue: IntensityCue, planes: Planes, boxes: list[list[float]], reference: object) -> np.ndarray:
    return cue.log_likelihood(planes, Hypotheses(np.array(boxes, dtype=np.float64)), reference)


def means_of(gray: np.ndarray, box: list[float], cells: int) -> tuple[np.ndarray, np.ndarray]:
    means, shares = np.zeros((cells, cells)), np.zeros((cells, cells))
    size = np.array([gray.shape[1], gray.shape[0]])
    patch_means(
        cv2.integral(gray, sdepth=cv2.CV_64F), np.array(box), np.zeros(2, np.int64), size, means, shares
    )
    return means, shares


@pytest.mark.parametrize(
    "box", [[60.0, 50.0, 40.0, 24.0], [31.5, 40.25, 3.0, 4.5], [79.5, 59.5, 160.0, 120.0]]
)
def test_a_cell_is_the_mean_over_its_area(box: list[float]) -> None:
    """Edges of these boxes' cells fall on sixteenths of a pixel: the mean over the enlarged image."""
    gray, cells, times = textured(), 6, 16
    large = np.kron(gray, np.ones((times, times)))
    left, top = (box[0] - box[2] / 2 + 0.5) * times, (box[1] - box[3] / 2 + 0.5) * times
    x = np.linspace(left, left + box[2] * times, cells + 1)
    y = np.linspace(top, top + box[3] * times, cells + 1)
    means, shares = means_of(gray, box, cells)
    for j in range(cells):
        for i in range(cells):
            rows, columns = np.arange(large.shape[0]), np.arange(large.shape[1])
            tall = np.clip(np.minimum(rows + 1, y[j + 1]) - np.maximum(rows, y[j]), 0, None)
            wide = np.clip(np.minimum(columns + 1, x[i + 1]) - np.maximum(columns, x[i]), 0, None)
            exact = tall @ large @ wide / (tall.sum() * wide.sum())
            # an edge is at most 1/2048 px from its place: a cell of 1/2 px or more changes by < 2/1024 of 255
            assert means[j, i] == pytest.approx(exact, abs=0.5)
    assert np.all(shares == 1.0)


def test_cells_outside_the_frame_have_no_share() -> None:
    means, shares = means_of(np.full((100, 100), 200, np.uint8), [-0.5, 50.0, 40.0, 40.0], 4)
    assert shares.tolist() == [[0.0, 0.0, 1.0, 1.0]] * 4
    assert means[:, 2:].tolist() == [[200.0, 200.0]] * 4


@pytest.mark.parametrize("form", FORMS)
def test_the_target_itself_is_the_best_match_wherever_it_moves(form: str) -> None:
    cue = made(form=form)
    gray = textured()
    reference = cue.learn(planes_of(gray), np.array([60.0, 50.0, 30.0, 24.0]))
    moved = planes_of(np.roll(gray, (7, -5), (0, 1)))
    shifts = [(dx, dy) for dx in range(-12, 13) for dy in range(-12, 13)]
    found = scores(cue, moved, [[60.0 + dx, 50.0 + dy, 30.0, 24.0] for dx, dy in shifts], reference)
    assert shifts[int(np.argmax(found))] == (-5, 7)
    assert found.max() == pytest.approx(0.0, abs=1e-9) and found.max() <= 0.0
    assert np.median(found) < -1.0


@given(
    boxes=st.lists(
        st.tuples(st.floats(-20, 180), st.floats(-20, 140), st.floats(2, 90), st.floats(2, 90)),
        min_size=1,
        max_size=6,
    ),
    slack=st.integers(0, 17),
)
def test_scores_do_not_depend_on_the_crop(boxes: list[tuple[float, ...]], slack: int) -> None:
    cue, gray = made(), textured()
    array = np.array(boxes)
    low = np.floor((array[:, :2] - array[:, 2:] / 2).min(axis=0) + 0.5).astype(int)
    high = np.ceil((array[:, :2] + array[:, 2:] / 2).max(axis=0) + 0.5).astype(int)
    region = Region(low[0] - slack, low[1], high[0], high[1] + slack)
    reference = cue.learn(planes_of(gray), np.array([60.0, 50.0, 30.0, 24.0]))
    whole = cue.log_likelihood(planes_of(gray), Hypotheses(array), reference)
    cropped = cue.log_likelihood(planes_of(gray, region), Hypotheses(array), reference)
    assert np.array_equal(whole, cropped)
    assert np.all((whole <= 0.0) & (whole >= np.log(cue.parameters.floor)))


def test_correlation_is_the_normalised_one_above_the_noise() -> None:
    cue = made(grid=12, sd_texture_gray=1e-3, sd_level_gray=1e6, sd_mask=1e6, floor=1e-9, sd_pattern=1.0)
    gray = textured()
    target, other = [60.0, 50.0, 36.0, 36.0], [70.3, 52.8, 36.0, 36.0]
    reference = cue.learn(planes_of(gray), np.array(target))
    a, b = means_of(gray, target, 12)[0].ravel(), means_of(gray, other, 12)[0].ravel()
    expected = -(1.0 - max(np.corrcoef(a, b)[0, 1], 0.0))
    assert scores(cue, planes_of(gray), [other], reference)[0] == pytest.approx(expected, abs=1e-6)


def test_difference_is_the_weighted_square_of_the_thesis() -> None:
    cue = made(grid=12, form="difference", sd_gray=60.0, floor=1e-9)
    gray = textured()
    target, other = [60.0, 50.0, 36.0, 36.0], [61.3, 50.8, 38.0, 35.0]
    reference = cue.learn(planes_of(gray), np.array(target))
    a, b = means_of(gray, target, 12)[0], means_of(gray, other, 12)[0]
    line = np.exp(-0.5 * (((np.arange(12) + 0.5) / 6.0 - 1.0) / 0.5) ** 2)
    weights = np.outer(line, line) / line.sum() ** 2
    size = log_size_penalty(np.array([other]), np.array(target[2:]), 0.5, 0.4)
    expected = floored(-0.5 * np.array([(weights * (a - b) ** 2).sum()]) / 60.0**2 + size, 1e-9)
    assert scores(cue, planes_of(gray), [other], reference) == pytest.approx(expected, abs=1e-9)


def test_correlation_forgives_a_change_of_contrast_and_difference_does_not() -> None:
    gray = textured()
    dim = np.rint(0.6 * gray.astype(float) + 0.4 * gray[38:62, 45:75].mean()).astype(np.uint8)
    box = [59.5, 49.5, 30.0, 24.0]
    found = {}
    for form in FORMS:
        cue = made(form=form, sd_texture_gray=1.0, sd_gray=10.0)
        reference = cue.learn(planes_of(gray), np.array(box))
        found[form] = scores(cue, planes_of(dim), [box], reference)[0]
    assert found["correlation"] > -0.05
    assert found["difference"] < -0.4


def test_flat_patches_are_told_apart_by_their_level() -> None:
    cue = made(sd_level_gray=25.0, floor=0.02)
    gray = np.full((120, 160), 100, np.uint8)
    gray[:, 80:] = 150
    reference = cue.learn(planes_of(gray), np.array([40.0, 60.0, 20.0, 20.0]))
    found = scores(cue, planes_of(gray), [[30.0, 50.0, 20.0, 20.0], [120.0, 60.0, 20.0, 20.0]], reference)
    assert found[0] == pytest.approx(0.0, abs=1e-9)
    assert found[1] == pytest.approx(floored(np.array([-0.5 * (50 / 25) ** 2]), 0.02)[0])


@pytest.mark.parametrize("form", FORMS)
def test_what_lies_outside_the_frame_does_not_match(form: str) -> None:
    cue, gray = made(form=form), textured()
    reference = cue.learn(planes_of(gray), np.array([20.0, 60.0, 41.0, 30.0]))
    boxes = [[x, 60.0, 41.0, 30.0] for x in (20.0, 14.0, 8.0, 2.0, -30.0, 400.0)]
    # the same picture moved along with the box, so that the visible part always matches
    found = np.array(
        [scores(cue, planes_of(np.roll(gray, int(b[0]) - 20, 1)), [b], reference)[0] for b in boxes]
    )
    assert found[0] == pytest.approx(0.0, abs=1e-9)
    assert np.all(np.diff(found[:4]) < 0)
    assert found[4:] == pytest.approx(np.log(cue.parameters.floor), abs=0.01)


def test_a_box_that_is_not_finite_or_empty_samples_nothing() -> None:
    gray = textured()
    integral, size = cv2.integral(gray, sdepth=cv2.CV_64F), np.array([160, 120])
    bad = [
        [np.nan, 5, 9, 9],
        [5, 5, np.inf, 9],
        [5, 5, 0, 9],
        [5, 5, -3, 9],
        [1e300, 5, 9, 9],
        [5, 5, 1e-6, 9],
    ]
    moments = np.ones((len(bad), MOMENTS))
    grid = np.ones((12, 12))
    patch_moments(integral, np.array(bad, dtype=float), np.zeros(2, np.int64), size, grid, grid, moments)
    assert np.all(moments == 0.0)


def test_blend_is_linear_where_both_have_seen_the_target() -> None:
    cue, gray = made(), textured()
    old = cue.learn(planes_of(gray), np.array([60.0, 50.0, 30.0, 24.0]))
    new = cue.learn(planes_of(gray), np.array([64.0, 52.0, 34.0, 20.0]))
    for name in old:
        assert np.array_equal(cue.blend(old, new, 0.0)[name], old[name])
        assert np.array_equal(cue.blend(old, new, 1.0)[name], new[name])
        assert cue.blend(old, new, 0.25)[name] == pytest.approx(0.75 * old[name] + 0.25 * new[name])


def test_blend_keeps_what_only_one_has_seen() -> None:
    cue, gray = made(grid=4), textured()
    whole = cue.learn(planes_of(gray), np.array([40.0, 60.0, 40.0, 40.0]))
    cut = cue.learn(planes_of(gray), np.array([-0.5, 60.0, 40.0, 40.0]))
    mixed = cue.blend(whole, cut, 0.5)
    assert mixed["grid"][:, :2] == pytest.approx(whole["grid"][:, :2])
    assert mixed["grid"][:, 2:] == pytest.approx(0.5 * (whole["grid"] + cut["grid"])[:, 2:])


def test_a_reference_that_has_seen_nothing_is_no_evidence() -> None:
    cue, gray = made(), textured()
    outside = cue.learn(planes_of(gray), np.array([-300.0, 60.0, 40.0, 40.0]))
    assert scores(cue, planes_of(gray), [[50.0, 50.0, 20.0, 20.0]], outside).tolist() == [0.0]


@pytest.mark.parametrize("form", FORMS)
def test_coarse_to_fine_keeps_the_first_look_only_where_it_is_bad(form: str) -> None:
    settings = {"form": form, "sd_gray": 15.0, "sd_pattern": 0.4}
    fine, coarse = made(grid=16, **settings), made(grid=4, floor=0.02, **settings)
    both = made(grid=16, coarse=4, coarse_below=0.3, **settings)
    gray, box = textured(), np.array([60.0, 50.0, 40.0, 32.0])
    rng = np.random.default_rng(2)
    boxes = np.column_stack([rng.normal(box[:2], 15.0, (300, 2)), np.tile(box[2:], (300, 1))])
    boxes[0] = box
    found = {
        name: cue.log_likelihood(planes_of(gray), Hypotheses(boxes), cue.learn(planes_of(gray), box))
        for name, cue in (("fine", fine), ("coarse", coarse), ("both", both))
    }
    bad = found["coarse"] < floored(np.log([0.3]), 0.02)[0]
    assert 5 < bad.sum() < 295  # both kinds are there
    assert np.array_equal(found["both"][bad], found["coarse"][bad])
    assert np.array_equal(found["both"][~bad], found["fine"][~bad])
    assert found["both"][0] == found["both"].max() == pytest.approx(0.0, abs=1e-9)


def test_a_first_look_is_learnt_and_blended_too() -> None:
    cue, gray = made(grid=12, coarse=3), textured()
    old = cue.learn(planes_of(gray), np.array([60.0, 50.0, 30.0, 24.0]))
    new = cue.learn(planes_of(gray), np.array([64.0, 52.0, 30.0, 24.0]))
    assert old["coarse"] == pytest.approx(old["grid"].reshape(3, 4, 3, 4).mean(axis=(1, 3)), abs=0.1)
    assert cue.blend(old, new, 0.25)["coarse"] == pytest.approx(0.75 * old["coarse"] + 0.25 * new["coarse"])
    assert "coarse" not in made().learn(planes_of(gray), np.array([60.0, 50.0, 30.0, 24.0]))


def test_a_first_look_at_nothing_and_at_nobody() -> None:
    cue, gray = made(grid=12, coarse=3), textured()
    outside = cue.learn(planes_of(gray), np.array([-300.0, 60.0, 40.0, 40.0]))
    assert scores(cue, planes_of(gray), [[50.0, 50.0, 20.0, 20.0]], outside).tolist() == [0.0]
    inside = cue.learn(planes_of(gray), np.array([60.0, 50.0, 30.0, 24.0]))
    far = scores(cue, planes_of(gray), [[-300.0, 50.0, 30.0, 24.0]], inside)
    assert far == pytest.approx(np.log(cue.parameters.floor), abs=1e-9)
