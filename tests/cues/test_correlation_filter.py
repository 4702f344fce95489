"""The correlation filter: its regression, answers against plain sums, scale, tiles, learning."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bayesnet_track import GraphSpec, Tracker
from bayesnet_track.cues.correlation_filter import CUE, LEAST_ANSWER, REACH, TURN_STEP, CorrelationFilter
from bayesnet_track.journal.codec import from_json, to_json
from bayesnet_track.observation.cue import Hypotheses
from bayesnet_track.observation.planes import Frame, FramePair, PlaneCache, Planes, Region
from bayesnet_track.vision.correlation import (
    CHANNELS,
    equations,
    gaussian_label,
    halves,
    hann,
    patch_at,
    scaled_answers,
    solve,
    tile_spectra,
    turned_features,
)

SIZE = (40.0, 52.0)


def texture(seed: int, rows: int, columns: int, cell: int = 5) -> np.ndarray:
    coarse = np.random.default_rng(seed).integers(0, 256, (rows // cell + 2, columns // cell + 2, 3))
    return cv2.resize(coarse.astype(np.uint8), (columns, rows), interpolation=cv2.INTER_LINEAR)


def scene(x: float, y: float, scale: float = 1.0, seed: int = 2, angle: float = 0.0) -> np.ndarray:
    """A textured target with its middle at (x, y) on another texture, 400 x 300, turned clockwise."""
    image, target = texture(1, 300, 400, 9), texture(seed, 52, 40)
    sine, cosine = scale * np.sin(np.radians(angle)), scale * np.cos(np.radians(angle))
    turn = np.array([[cosine, -sine], [sine, cosine]])
    matrix = np.column_stack([turn, [x, y] - turn @ [19.5, 25.5]])
    over = cv2.warpAffine(target, matrix, (400, 300), flags=cv2.INTER_LINEAR)
    mask = cv2.warpAffine(np.ones((52, 40), np.uint8), matrix, (400, 300), flags=cv2.INTER_NEAREST)
    return np.where(mask[..., None] > 0, over, image)


def planes_of(image: np.ndarray) -> Planes:
    whole = Region(0, 0, image.shape[1], image.shape[0])
    return PlaneCache(FramePair(Frame(0, 0.0, image), None)).planes(made().needs, whole)


def made(**parameters: object) -> CorrelationFilter:
    return CUE.make(CUE.parameters(**parameters))


def box(x: float, y: float, scale: float = 1.0) -> np.ndarray:
    return np.array([x, y, SIZE[0] * scale, SIZE[1] * scale])


def score(
    cue: CorrelationFilter, image: np.ndarray, boxes: list[np.ndarray], reference: object
) -> np.ndarray:
    return cue.log_likelihood(planes_of(image), Hypotheses(np.array(boxes)), reference)


def answered(cue: CorrelationFilter, image: np.ndarray, boxes: list[np.ndarray], of: object) -> np.ndarray:
    return cue.answers(planes_of(image), np.array(boxes), of, np.ones(len(boxes), bool))


@given(st.floats(-2, 2), st.floats(-2, 2), st.integers(0, 1000))
@settings(max_examples=20, deadline=None)
def test_the_filter_gives_the_wanted_answer_to_its_own_sample(x: float, y: float, seed: int) -> None:
    """Without a ridge the regression is exact: cyclic answers are the label, also between cells."""
    sample = np.random.default_rng(seed).normal(size=(3, 16, 16)).astype(np.float32)
    label = gaussian_label(16, 1.3, x, y)
    kernel = solve(*equations(sample, label), 1e-9)
    cyclic = np.fft.ifft2(np.sum(np.conj(np.fft.fft2(kernel)) * np.fft.fft2(sample), axis=0)).real
    np.testing.assert_allclose(cyclic, label, atol=1e-4)  # complex64 and a power of 16^2 * 3 per frequency


def test_answers_are_sums_of_products() -> None:
    rng = np.random.default_rng(3)
    patch = rng.normal(size=(4, 30, 30)).astype(np.float32)
    kernel = rng.normal(size=(4, 10, 10)).astype(np.float32)
    found = scaled_answers(tile_spectra(patch, 10), halves(kernel), 1.0)
    plain = [[np.sum(kernel * patch[:, j : j + 10, i : i + 10]) for i in range(21)] for j in range(21)]
    np.testing.assert_allclose(found, plain, atol=1e-3)  # 400 products of order 1 in float32


def test_the_window_is_as_wide_as_asked() -> None:
    window = hann(20, 10.0, 16.0)
    assert np.flatnonzero(window.sum(axis=0)).tolist() == list(range(5, 15))
    assert np.flatnonzero(window.sum(axis=1)).tolist() == list(range(2, 18))
    np.testing.assert_array_equal(window, window[::-1, ::-1])


@pytest.mark.parametrize(("x", "cell"), [(120.3, 0.7), (20.0, 3.2), (-90.0, 4.0), (700.0, 9.1)])
def test_a_patch_says_where_its_cells_lie(x: float, cell: float) -> None:
    """Brightness rises with the column, so that a cell's brightness tells the column of its middle."""
    image = np.repeat(np.tile(np.arange(256.0) / 2, (80, 1))[..., None], 3, axis=2).astype(np.uint8)
    patch = patch_at(image, x, 40.0, cell, 12)
    assert patch.features.shape == (CHANNELS, 12, 12)
    assert abs(patch.x - x) <= 1.0 and abs(patch.cell - cell) <= 0.06 * cell
    columns = np.clip(patch.x + (np.arange(12) - 5.5) * patch.cell, 0, 255)
    read = (patch.features[-3, 5] + 0.5) * 255 * 2
    # gray levels are cut to whole ones, half a px each; a cell over the border is partly repeated border
    inside = (columns > patch.cell) & (columns < 255 - patch.cell) | (columns <= 0) | (columns >= 255)
    np.testing.assert_allclose(read[inside], columns[inside], atol=2.0)


@pytest.mark.parametrize(("scale", "signed"), [(0.9, True), (1.0, True), (1.12, True), (1.12, False)])
def test_place_and_scale_are_found(scale: float, signed: bool) -> None:
    cue = made(signed=signed)
    reference = cue.learn(planes_of(scene(150, 120)), box(150, 120))
    image = scene(163.5, 108, scale)
    scales = np.exp(np.arange(-0.24, 0.241, 0.02))
    values = answered(cue, image, [box(163.5, 108, one) for one in scales], reference)
    assert abs(np.log(scales[values.argmax()] / scale)) <= 0.05  # half a level and the steps asked
    offsets = [(dx, dy) for dx in range(-6, 7) for dy in range(-6, 7)]
    values = answered(cue, image, [box(163.5 + dx, 108 + dy, scale) for dx, dy in offsets], reference)
    assert max(map(abs, offsets[values.argmax()])) <= 1


def test_a_target_several_tiles_away_is_found_and_tiles_join() -> None:
    cue = made()
    reference = cue.learn(planes_of(scene(60, 60)), box(60, 60))
    image = scene(330, 220)
    far, beside, where_it_was = score(cue, image, [box(330, 220), box(310, 220), box(60, 60)], reference)
    assert far > max(beside, where_it_was) + 1.5  # what was around it is still there
    cell = (52 + 1.5 * np.sqrt(40 * 52)) / 24
    seam = 60 + 0.5 * (REACH - 4) * cell
    before, after = (answered(cue, scene(seam, 60), [box(seam + d, 60)], reference)[0] for d in (-1e-6, 1e-6))
    assert before == pytest.approx(after, abs=0.15)  # the lattices of cells are off by a part of a cell
    assert min(before, after) > 0.5 * float(reference["usual"])


@pytest.mark.parametrize("rate", [0.0, 0.02, 0.5, 1.0])
def test_following_is_blending_with_what_is_learnt(rate: float) -> None:
    cue, now = made(), planes_of(scene(152, 119, seed=9))
    old = cue.learn(planes_of(scene(150, 120)), box(150, 120))
    found = cue.follow(now, box(152, 119), old, rate)
    expected = cue.blend(old, cue.learn(now, box(152, 119)), rate)
    assert found.keys() == expected.keys()
    assert all(np.array_equal(found[name], expected[name]) for name in expected)


def test_the_usual_answer_follows_what_the_target_looks_like() -> None:
    cue = made()
    old = cue.learn(planes_of(scene(150, 120)), box(150, 120))
    changed = cv2.addWeighted(scene(150, 120), 0.3, scene(150, 120, seed=9), 0.7, 0)
    new = cue.learn(planes_of(changed), box(150, 120))
    reference = {**old, "usual": old["usual"] * 10}
    at_first = score(cue, changed, [box(150, 120)], reference)[0]
    for _ in range(10):
        reference = cue.blend(reference, new, 0.01)
    assert score(cue, changed, [box(150, 120)], reference)[0] > at_first + 3.0
    foreign = cue.learn(planes_of(scene(150, 120, seed=9)), box(150, 120))
    for _ in range(3):
        reference = cue.blend(reference, {**foreign, "patch": -foreign["patch"]}, 0.5)
    assert float(reference["usual"]) >= LEAST_ANSWER


def test_learning_in_small_steps_ends_at_the_new_look() -> None:
    """Numerator and denominator blended: n equal steps of rate r leave (1 - r)^n of the old ones."""
    cue = made()
    old, new = (cue.learn(planes_of(scene(150, 120, seed=s)), box(150, 120)) for s in (2, 9))
    reference = old
    for _ in range(5):
        reference = cue.blend(reference, new, 0.2)
    left = 0.8**5
    for name in ("numerator", "denominator"):
        expected = left * old[name] + (1 - left) * new[name]
        np.testing.assert_allclose(reference[name], expected, atol=1e-5 * np.abs(expected).max())


def test_sharpness_is_the_log_likelihood_of_no_answer() -> None:
    """A box half outside of the frame keeps half of its answer; one outside is at the floor."""
    cue = made(sharpness=5.0, floor=1e-9, sd_log_area=100, sd_log_aspect=100)
    reference = {**cue.learn(planes_of(scene(0, 120)), box(0, 120)), "usual": np.array(0.2)}
    half, outside = score(cue, scene(0, 120), [box(-0.5, 120), box(-60, 120)], reference)
    assert half == pytest.approx(-2.5, abs=0.01)
    assert outside == pytest.approx(-5.0, abs=0.01)


@pytest.mark.parametrize("angle", [0.0, 22.5, 90.0, -130.0, 405.0])
def test_a_turned_target_is_found_at_its_angle(angle: float) -> None:
    """To half a level and a step asked; once round it is the same, and the reverse is another."""
    cue = made()
    reference = cue.learn(planes_of(scene(150, 120)), box(150, 120))
    image = planes_of(scene(150, 120, angle=angle))
    angles = angle + np.arange(-60.0, 60.1, 2.0)
    boxes = np.tile(box(150, 120), (len(angles), 1))
    values = cue.answers(image, boxes, reference, np.ones(len(angles), bool), angles)
    assert abs(angles[values.argmax()] - angle) <= TURN_STEP / 2 + 2.0
    assert values[30] > 0.75 * float(reference["usual"])
    turned = Hypotheses(boxes[:3], {"angle": np.array([angle, angle + 360.0, angle + 180.0])})
    there, once_round, reverse = cue.log_likelihood(image, turned, reference)
    assert there == pytest.approx(once_round, abs=1e-9)
    assert there > reverse + 3.0


def test_an_angle_of_nothing_is_none() -> None:
    """Angles of 0 give the bits of no angles, whatever else is asked; likelihoods are of each for itself."""
    cue = made()
    image = planes_of(scene(153, 118))
    reference = cue.learn(planes_of(scene(150, 120)), box(150, 120))
    boxes = np.array([box(150 + d, 120, 1 + d / 50) for d in range(6)])
    plain = cue.log_likelihood(image, Hypotheses(boxes), reference)
    zeros = cue.log_likelihood(image, Hypotheses(boxes, {"angle": np.zeros(6)}), reference)
    np.testing.assert_array_equal(plain, zeros)
    angles = np.array([0.0, 3.0, 40.0, -170.0, 0.0, 500.0])
    mixed = cue.log_likelihood(image, Hypotheses(boxes, {"angle": angles}), reference)
    for n in range(6):
        alone = Hypotheses(boxes[n : n + 1], {"angle": angles[n : n + 1]})
        assert cue.log_likelihood(image, alone, reference)[0] == pytest.approx(mixed[n], abs=1e-9)


@pytest.mark.parametrize(("angle", "signed"), [(7.0, True), (90.0, True), (-130.0, True), (7.0, False)])
def test_what_is_learnt_turned_is_the_upright_target(angle: float, signed: bool) -> None:
    """Its filter answers to the upright picture, and so a blend of both is one of the same target."""
    cue = made(signed=signed)
    upright = cue.learn(planes_of(scene(150, 120)), box(150, 120))
    turned = cue.learn_turned(planes_of(scene(150, 120, angle=angle)), box(150, 120), angle)
    seen = answered(cue, scene(150, 120), [box(150, 120), box(160, 120)], turned)
    assert seen[0] > 0.75 * float(upright["usual"]) and seen[0] > 2 * seen[1]
    plain = cue.learn_turned(planes_of(scene(150, 120)), box(150, 120), 0.0)
    np.testing.assert_array_equal(plain["kernel"], upright["kernel"])


def test_a_quarter_turn_of_features_moves_places_and_orientations() -> None:
    """By an eighth of a turn orientations move by one, by a quarter cells fall on cells: exact."""
    features = np.random.default_rng(8).normal(size=(CHANNELS, 8, 8)).astype(np.float32)
    turned = turned_features(features, 90.0)
    placed = np.rot90(features, -1, axes=(1, 2))  # clockwise
    np.testing.assert_allclose(turned[:8], np.roll(placed[:8], 2, axis=0), atol=1e-5)
    np.testing.assert_allclose(turned[8:12], np.roll(placed[8:12], 2, axis=0), atol=1e-5)
    np.testing.assert_allclose(turned[12:], placed[12:], atol=1e-5)
    np.testing.assert_array_equal(turned_features(features[8:], 90.0), turned[8:])  # those without signs
    flat = np.ones((CHANNELS, 9, 9), np.float32) * np.arange(CHANNELS, dtype=np.float32)[:, None, None]
    eighth = turned_features(flat, 45.0)[:, 4, 4]
    np.testing.assert_allclose(eighth[:8], np.roll(np.arange(8), 1), atol=1e-4)
    np.testing.assert_allclose(eighth[8:12], 8 + np.roll(np.arange(4), 1), atol=1e-4)


@pytest.mark.parametrize(
    "belief", [{"particles": {"size": 300}}, {"gaussian": {"filter": "extended", "samples": 300}}]
)
def test_a_target_that_turns_is_followed_by_its_angle(belief: dict[str, object]) -> None:
    """6 degrees per frame, sd 8: within 15 degrees, which is a level; without an angle the file says none."""
    noise = {"sd_px": {"x": 2, "y": 2}}

    def graph(motion: dict[str, object]) -> GraphSpec:
        root = {"belief": belief, "motion": {"random_walk": motion}, "estimate": "mean"}
        root["learn"] = {"below": {"ud_box": 0.5}}
        nodes = {"root": root, "filter": {"parent": "root", "agent": "correlation_filter"}}
        return GraphSpec.model_validate({"name": "g", "targets": {"t": {"nodes": nodes}}})

    tracker = Tracker(graph({**noise, "sd_angle_deg": 8}), seed=1)
    tracker.init(scene(150, 120), (130.0, 94.0, 40.0, 52.0))
    for turn in range(1, 21):
        tracker.update(scene(150, 120, angle=6.0 * turn))
        assert tracker.metrics.angle == pytest.approx(6.0 * turn, abs=TURN_STEP)
        assert np.hypot(tracker.metrics.centre_box[0] - 150, tracker.metrics.centre_box[1] - 120) < 5.0
    assert from_json(to_json(tracker.metrics)).angle == pytest.approx(tracker.metrics.angle, rel=1e-4)
    plain = Tracker(graph(noise), seed=1)
    plain.init(scene(150, 120), (130.0, 94.0, 40.0, 52.0))
    plain.update(scene(150, 120, angle=6.0))
    assert '"angle"' not in to_json(plain.metrics)


def test_a_frame_that_is_asked_about_again_gives_the_same_answers():
    """Its tiles are known by then, and some of the answers."""
    cue, planes = made(), planes_of(scene(200, 150))
    reference, other = cue.learn(planes, box(200, 150)), cue.learn(planes, box(210, 150, 1.1))
    rng = np.random.default_rng(5)
    boxes = np.array([box(*rng.uniform(120, 260, 2), rng.uniform(0.8, 1.2)) for _ in range(60)])
    for of in (reference, other, reference):
        cue.log_likelihood(planes, Hypotheses(boxes[:20]), of)
        known = cue.log_likelihood(planes, Hypotheses(boxes), of)
        np.testing.assert_array_equal(known, score(cue, scene(200, 150), list(boxes), of))
