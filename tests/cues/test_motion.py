"""The motion cue with sparse flow: its likelihood, what it learns, and where it knows nothing."""

from __future__ import annotations

from functools import cache

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bayesnet_track import floored
from bayesnet_track.cues.motion import CUE, MotionCue
from bayesnet_track.observation.cue import Hypotheses, log_size_penalty
from bayesnet_track.observation.planes import Frame, FramePair, Planes, Region, for_reading
from bayesnet_track.vision.kernels.flow_kernels import RIM, corner_scores
from bayesnet_track.vision.motion_planes import FlowPlane

WIDTH, HEIGHT = 320, 240
WHOLE = Region(0, 0, WIDTH, HEIGHT)


def textured(seed: int, dx: float = 0.0, dy: float = 0.0) -> np.ndarray:
    """Texture with fine and coarse structure, as pictures have it, shifted by (dx, dy)."""
    rng = np.random.default_rng(seed)
    image = np.zeros((HEIGHT + 80, WIDTH + 80))
    for sd in (1.5, 4.0, 12.0):
        layer = cv2.GaussianBlur(rng.normal(size=image.shape), (0, 0), sd)
        image += 30.0 * layer / layer.std()
    move = np.array([[1, 0, dx - 40], [0, 1, dy - 40]], dtype=np.float32)
    moved = cv2.warpAffine(image + 128.0, move, (WIDTH, HEIGHT), flags=cv2.INTER_CUBIC)
    return np.clip(np.rint(moved), 0, 255).astype(np.uint8)


def frame(index: int, gray: np.ndarray) -> Frame:
    return Frame(index, float(index), cv2.merge([gray] * 3) if gray.ndim == 2 else gray)


def squares(index: int, rng: np.random.Generator) -> Frame:
    """Two orange squares of 40 px on gray, noise of sd 4; their edges are antialiased."""
    image = np.full((HEIGHT, WIDTH, 3), 120.0)
    for x, y in (other_at(index)[:2], target_at(index)[:2]):
        wide = np.clip(20.5 - np.abs(np.arange(WIDTH) - x), 0, 1)
        tall = np.clip(20.5 - np.abs(np.arange(HEIGHT) - y), 0, 1)
        cover = np.outer(tall, wide)[..., None]
        image = image * (1 - cover) + cover * np.array([40.0, 130.0, 230.0])
    return frame(index, np.clip(np.rint(image + rng.normal(0, 4, image.shape)), 0, 255).astype(np.uint8))


def target_at(index: int) -> np.ndarray:
    return np.array([270 - 4.0 * index, 190 - 2.74 * index, 40.0, 40.0])


def other_at(index: int) -> np.ndarray:
    return np.array([50 + 3.5 * index, 60 + 1.74 * index, 40.0, 40.0])


def made(**parameters: object) -> MotionCue:
    return CUE.make(CUE.parameters(**parameters))


def planes_with(cue: MotionCue, vectors: list[list[float]]) -> Planes:
    blank = frame(1, np.zeros((HEIGHT, WIDTH), np.uint8))
    return Planes(blank, WHOLE, {cue.flow: np.array(vectors, dtype=float).reshape(-1, 4)})


def test_corner_scores_are_the_smaller_eigenvalues() -> None:
    """OpenCV's own, with the same block and aperture; it works in float32, hence the tolerance."""
    gray = textured(3)
    scores = np.zeros(gray.shape)
    corner_scores(for_reading(gray), 9.0, scores)
    unscaled = cv2.cornerMinEigenVal(gray, 5, 3).astype(float) * (4 * 5 * 255.0) ** 2 / (8**2 * 25)
    inner = (slice(RIM, -RIM), slice(RIM, -RIM))
    expected = np.where(unscaled > 9.0, unscaled, 0.0)[inner]
    clear = np.abs(unscaled[inner] - 9.0) > 0.05
    np.testing.assert_allclose(scores[inner][clear], expected[clear], rtol=1e-3, atol=0.05)


@pytest.mark.parametrize("shift", [(3.4, -5.7), (0.0, 0.0), (-15.25, 12.5)])
def test_flow_is_the_shift_of_the_picture(shift: tuple[float, float]) -> None:
    pair = FramePair(frame(1, textured(0, *shift)), frame(0, textured(0)))
    vectors = FlowPlane().compute(pair, (), Region(30, 30, WIDTH - 30, HEIGHT - 30))
    assert len(vectors) > 100
    assert np.median(vectors[:, 2:], axis=0) == pytest.approx(shift, abs=0.06)
    off = np.abs(vectors[:, 2:] - shift).max(axis=1)
    assert np.mean(off < 0.25) > 0.95


def test_flow_is_per_unit_of_time() -> None:
    first, second = frame(0, textured(0)), Frame(1, 3.0, cv2.merge([textured(0, 6.0, -3.0)] * 3))
    vectors = FlowPlane().compute(FramePair(second, first), (), WHOLE)
    assert np.median(vectors[:, 2:], axis=0) == pytest.approx([2.0, -1.0], abs=0.03)


def test_no_vectors_without_a_usable_previous_frame() -> None:
    plane, current = FlowPlane(), frame(1, textured(0))
    small = frame(0, np.ascontiguousarray(textured(0)[:100]))
    for previous in (None, small, frame(1, textured(0)), frame(2, textured(0))):
        assert plane.compute(FramePair(current, previous), (), WHOLE).shape == (0, 4)
    flat = frame(0, np.full((HEIGHT, WIDTH), 90, np.uint8))
    assert plane.compute(FramePair(frame(1, flat.image), flat), (), WHOLE).shape == (0, 4)
    assert plane.compute(FramePair(current, flat), (), Region(5, 5, 5, 9)).shape == (0, 4)


@cache
def shifted() -> tuple[FramePair, np.ndarray]:
    """Two frames and all vectors of them."""
    pair = FramePair(frame(1, textured(1, 6.3, -4.6)), frame(0, textured(1)))
    return pair, FlowPlane().compute(pair, (), WHOLE)


@settings(max_examples=30, deadline=None)
@given(st.integers(0, WIDTH - 1), st.integers(0, HEIGHT - 1), st.integers(1, 150), st.integers(1, 150))
def test_vectors_do_not_depend_on_the_region(x: int, y: int, w: int, h: int) -> None:
    pair, whole = shifted()
    region = Region(x, y, min(x + w, WIDTH), min(y + h, HEIGHT))
    inside = (whole[:, 0] >= x) & (whole[:, 0] < region.x1) & (whole[:, 1] >= y) & (whole[:, 1] < region.y1)
    assert np.array_equal(FlowPlane().compute(pair, (), region), whole[inside])


def test_at_most_one_corner_per_lattice_cell() -> None:
    pair = FramePair(frame(1, textured(1)), frame(0, textured(1)))
    vectors = FlowPlane(spacing_px=16).compute(pair, (), WHOLE)
    cells = vectors[:, :2].astype(int) // 16
    assert len(np.unique(cells, axis=0)) == len(cells) > 100


def test_points_without_a_clear_match_are_not_valid() -> None:
    """Half of the picture is replaced by another one: there tracking back does not return."""
    now = textured(2)
    now[:, WIDTH // 2 :] = textured(7)[:, WIDTH // 2 :]
    pair = FramePair(frame(1, now), frame(0, textured(2)))
    vectors = FlowPlane().compute(pair, (), WHOLE)
    same = np.sum(vectors[:, 0] < WIDTH // 2 - 16)
    changed = np.sum(vectors[:, 0] > WIDTH // 2 + 16)
    assert changed < 0.25 * same


def test_two_squares_are_told_apart_by_their_flow() -> None:
    rng = np.random.default_rng(0)
    cue = made()
    frames = [squares(n, rng) for n in range(10)]
    reference = None
    for n in range(1, 10):
        vectors = cue.flow.compute(FramePair(frames[n], frames[n - 1]), (), WHOLE)
        planes = Planes(frames[n], WHOLE, {cue.flow: vectors})
        for box in (target_at(n), other_at(n)):
            corners = box[:2] + 20.0 * np.array([[-1, -1], [-1, 1], [1, -1], [1, 1]])
            near = np.abs(vectors[:, None, :2] - corners).max(axis=2) < 5
            assert np.all(near.sum(axis=0) >= 1)
        if reference is not None:
            boxes = np.array([target_at(n), other_at(n), [160.0, 200.0, 40.0, 40.0]])
            likelihood = np.exp(cue.log_likelihood(planes, Hypotheses(boxes), reference))
            assert likelihood[0] > 0.95
            assert likelihood[1:] == pytest.approx(0.02, abs=0.005)
        reference = cue.learn(planes, target_at(n))
        assert reference["flow"] == pytest.approx([-4.0, -2.74], abs=0.3)


def test_likelihood_is_the_thesis_formula_times_the_count_ratio() -> None:
    cue = made(sd_x_px=2.0, sd_y_px=3.0, floor=0.02)
    planes = planes_with(cue, [[100, 100, 1, 2], [104, 100, 3, 2], [96, 96, 2, 5], [200, 100, 4, 4]])
    reference = cue.learn(planes, np.array([100.0, 100.0, 30.0, 30.0]))
    assert reference["flow"].tolist() == [2.0, 3.0] and reference["valid"] == 3
    boxes = np.array([[100.0, 100.0, 30.0, 30.0], [202.0, 100.0, 30.0, 24.0], [20.0, 20.0, 30.0, 30.0]])
    found = cue.log_likelihood(planes, Hypotheses(boxes), reference)
    log = np.log(1 / 3) - (2.0**2 / (2 * 2.0**2) + 1.0**2 / (2 * 3.0**2))
    log += log_size_penalty(boxes[1:2], np.array([30.0, 30.0]), 0.5, 0.4)[0]
    assert found[0] == 0.0
    assert found[1] == pytest.approx(floored(np.array([log]), 0.02)[0])
    assert found[2] == pytest.approx(np.log(0.02))


def test_sds_follow_the_flow_of_the_target_where_they_are_asked_to() -> None:
    """The flow alternates by 8 px in x and stays in y: the sds come to 8 / 0.80 px, and to their least."""
    cue, fixed = made(sd_memory_frames=5), made()
    box = np.array([100.0, 100.0, 30.0, 30.0])
    reference = cue.learn(planes_with(cue, [[100, 100, 0, 2]]), box)
    for k in range(1, 60):
        reference = cue.blend(reference, cue.learn(planes_with(cue, [[100, 100, 8 * (k % 2), 2]]), box), 1.0)
    assert reference["spread"] * 2.0 == pytest.approx([8 / np.sqrt(2 / np.pi), 0.2], rel=1e-3)
    seen = planes_with(cue, [[100, 100, 3, 2]])
    wide, narrow = (one.log_likelihood(seen, Hypotheses(box[None]), reference)[0] for one in (cue, fixed))
    assert wide == pytest.approx(narrow)  # the reference says how wide, whoever reads it
    expected = -((5 / (8 / np.sqrt(2 / np.pi))) ** 2) / 2  # the last flow was 8
    assert wide == pytest.approx(floored(np.array([expected]), 0.02)[0], rel=1e-3)
    assert "spread" not in fixed.blend(fixed.learn(seen, box), fixed.learn(seen, box), 1.0)
    for other in ({"compare": "each"}, {"against": "velocity"}):
        with pytest.raises(ValueError, match="needs compare: mean and against: reference"):
            made(sd_memory_frames=5, **other)


def test_comparing_each_vector_scores_the_share_that_moves_as_the_target() -> None:
    """Half of the box moves as the target, half the other way: their mean is the flow of neither."""
    box = np.array([100.0, 100.0, 30.0, 30.0])
    target = [[95, 95, 4, 0], [105, 105, 4, 0]]
    mixed = planes_with(made(), [*target, [95, 105, -4, 0], [105, 95, -4, 0]])
    for compare, expected in (("mean", np.exp(-(4.0**2) / 2)), ("each", 0.5 + 0.5 * np.exp(-(8.0**2) / 2))):
        cue = made(compare=compare, sd_x_px=1.0, sd_y_px=1.0, floor=0.01)
        reference = cue.learn(planes_with(cue, target), box)
        found = cue.log_likelihood(mixed, Hypotheses(box[None]), reference)
        assert np.exp(found) == pytest.approx(0.01 + 0.99 * expected, rel=1e-5)
        few = planes_with(cue, target[:1])
        assert np.exp(cue.log_likelihood(few, Hypotheses(box[None]), reference)) == pytest.approx(0.505)
        none = planes_with(cue, [])
        assert np.exp(cue.log_likelihood(none, Hypotheses(box[None]), reference)) == pytest.approx(0.01)


def test_flow_is_learnt_where_the_vectors_agree() -> None:
    """Vectors 2 px from their mean: learnt at a limit of 2 px or without one, not below."""
    box = np.array([100.0, 100.0, 30.0, 30.0])
    for limit, known in ((None, 1), (2.0, 1), (1.9, 0)):
        cue = made(coherent_px=limit)
        planes = planes_with(cue, [[95, 95, 3, 1], [105, 105, -1, 1], [180, 100, 90, 90]])
        reference = cue.learn(planes, box)
        assert reference["known"] == known
        assert reference["flow"].tolist() == [1.0, 1.0]


def test_points_on_the_edge_count_and_order_of_hypotheses_does_not_matter() -> None:
    cue = made()
    planes = planes_with(cue, [[90, 100, 1, 0], [110, 100, 1, 0], [110.5, 100, 9, 9]])
    assert cue.learn(planes, np.array([100.0, 100.0, 20.0, 20.0]))["valid"] == 2
    rng = np.random.default_rng(0)
    boxes = np.column_stack([rng.normal(100, 8, (50, 2)), rng.uniform(15, 30, (50, 2))])
    reference = cue.learn(planes, np.array([100.0, 100.0, 20.0, 20.0]))
    order = rng.permutation(50)
    straight = cue.log_likelihood(planes, Hypotheses(boxes), reference)
    assert np.array_equal(cue.log_likelihood(planes, Hypotheses(boxes[order]), reference), straight[order])


def test_an_unknown_reference_is_no_evidence_and_gives_way() -> None:
    cue = made()
    box = np.array([100.0, 100.0, 30.0, 30.0])
    moving = planes_with(cue, [[100, 100, 1, 2]])
    known, unknown = cue.learn(moving, box), cue.learn(planes_with(cue, []), box)
    assert unknown["known"] == 0 and known["known"] == 1
    boxes = np.array([box, [10.0, 10.0, 90.0, 5.0]])
    assert cue.log_likelihood(moving, Hypotheses(boxes), unknown).tolist() == [0.0, 0.0]
    assert np.array_equal(cue.blend(unknown, known, 0.1)["flow"], known["flow"])
    assert np.array_equal(cue.blend(known, unknown, 0.9)["flow"], known["flow"])
    still = cue.learn(planes_with(cue, [[100, 100, 3, 0]]), box)
    assert cue.blend(known, still, 0.25)["flow"] == pytest.approx([1.5, 1.5])
    assert np.array_equal(cue.blend(known, still, 1.0)["flow"], still["flow"])
    assert CUE.rate_max == 1.0


def test_without_flow_in_this_frame_all_are_at_the_floor() -> None:
    cue = made()
    box = np.array([100.0, 100.0, 30.0, 30.0])
    reference = cue.learn(planes_with(cue, [[100, 100, 1, 2]]), box)
    found = cue.log_likelihood(planes_with(cue, []), Hypotheses(box[None]), reference)
    assert found == pytest.approx(np.log(cue.parameters.floor))
