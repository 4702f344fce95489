"""Shading against its definition, and what it does not depend on."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from bayesnet_track.cues.shading import CUE, ShadingCue, polynomials
from bayesnet_track.observation.cue import Hypotheses
from bayesnet_track.observation.planes import Frame, FramePair, PlaneCache, Planes, Region

BOX = [60.0, 50.0, 40.0, 40.0]


def planes_of(cue: ShadingCue, gray: np.ndarray) -> Planes:
    frame = Frame(0, 0.0, cv2.merge([np.clip(np.rint(gray), 0, 255).astype(np.uint8)] * 3))
    return PlaneCache(FramePair(frame, None)).planes(cue.needs, Region(0, 0, frame.width, frame.height))


def made(**parameters: object) -> ShadingCue:
    return CUE.make(CUE.parameters(**parameters))


def scores(cue: ShadingCue, gray: np.ndarray, boxes: list[list[float]], reference: object) -> np.ndarray:
    return cue.log_likelihood(planes_of(cue, gray), Hypotheses(np.array(boxes)), reference)


def hill(x: float, y: float, tilt: tuple[float, float], bend: float) -> np.ndarray:
    """(120, 160): 120 and a slope and a dome round (x, y), in gray levels per 20 px."""
    rows, columns = np.mgrid[:120, :160]
    across, down = (columns - x) / 20.0, (rows - y) / 20.0
    return 120.0 + tilt[0] * across + tilt[1] * down - bend * (across**2 + down**2)


@pytest.mark.parametrize("degree", [1, 2, 3, 5])
@pytest.mark.parametrize("cells", [6, 8, 32])
def test_the_polynomials_are_orthonormal_under_the_mask(cells: int, degree: int) -> None:
    mask, lines = polynomials(cells, degree, 0.5)
    assert mask.sum() == pytest.approx(1.0)
    assert (lines * mask) @ lines.T == pytest.approx(np.eye(degree + 1), abs=1e-9)
    place = (2 * np.arange(cells) + 1) / cells - 1
    assert np.polyfit(place, lines[-1], degree)[0] > 0  # its sign is fixed, whatever LAPACK returns


def test_a_slope_has_the_coefficients_of_a_slope() -> None:
    """Brightness a x + b y, in half sides, has coefficients a sd and b sd, sd that of place in the mask."""
    cue = made(degree=3)
    found = cue.shading(planes_of(cue, hill(60, 50, (24.0, -8.0), 0.0)), np.array([BOX]))[1][0]
    mask, _ = polynomials(8, 3, 0.5)
    place = (2 * np.arange(8) + 1) / 8 - 1
    sd = np.sqrt((mask * place**2).sum())
    # gray levels are rounded: of a cell's 25 px each is wrong by at most 1/2
    assert found[:2] == pytest.approx([24.0 * sd, -8.0 * sd], abs=0.5)
    assert found[2:] == pytest.approx(0.0, abs=0.5)


def test_gain_and_offset_do_not_matter_above_the_noise() -> None:
    cue = made(sd_noise_gray=0.5)
    gray = hill(60, 50, (24.0, -8.0), 14.0)
    reference = cue.learn(planes_of(cue, gray), np.array(BOX))
    for gain, offset in ((0.6, 70.0), (1.3, -30.0), (1.0, 60.0)):
        assert scores(cue, gain * (gray - 120) + 120 + offset, [BOX], reference)[0] > -0.02
    assert scores(cue, 240 - gray, [BOX], reference)[0] < -3.0
    assert scores(cue, np.full_like(gray, 120.0), [BOX], reference)[0] < -2.0


def test_fine_texture_does_not_matter() -> None:
    """Speckles of cells of 2 px: 20 of them to a side, far above what degree 3 can follow."""
    cue, gray = made(), hill(60, 50, (30.0, 20.0), 10.0)
    reference = cue.learn(planes_of(cue, gray), np.array(BOX))
    rng = np.random.default_rng(1)
    speckles = rng.choice([-20.0, 20.0], (60, 80)).repeat(2, axis=0).repeat(2, axis=1)
    # the mask counts (pi/2) 2 sd^2 20^2 = 314 of 400 speckles at most: a coefficient moves by 20/10 = 2
    # with a cautious 100 of them, against |b| = 16; 1 - rho is then below 9 (2/16)^2 / 2 = 0.07, times 1/sd^2
    assert scores(cue, gray + speckles, [BOX], reference)[0] > -0.28


def test_flat_and_flat_are_alike_at_any_level() -> None:
    cue, gray = made(), np.full((120, 160), 90.0)
    reference = cue.learn(planes_of(cue, gray), np.array(BOX))
    assert scores(cue, gray + 100.0, [BOX], reference)[0] == pytest.approx(0.0, abs=1e-12)
    assert scores(cue, hill(60, 50, (30.0, 0.0), 0.0), [BOX], reference)[0] < -1.0


def test_the_peak_is_where_the_dome_is() -> None:
    cue, gray = made(), np.full((120, 160), 100.0)
    rows, columns = np.mgrid[:120, :160]

    def ball(x: float, y: float) -> np.ndarray:
        inside = (columns - x) ** 2 + (rows - y) ** 2 <= 20.0**2
        return np.where(inside, hill(x, y, (15.0, 15.0), 30.0), gray)

    reference = cue.learn(planes_of(cue, ball(60, 50)), np.array(BOX))
    boxes = [[90.0 + dx, 62.0 + dy, 40.0, 40.0] for dx in range(-16, 17) for dy in range(-16, 17)]
    best = boxes[int(np.argmax(scores(cue, ball(90, 62), boxes, reference)))]
    assert best == [90.0, 62.0, 40.0, 40.0]


def test_what_lies_outside_does_not_match_and_is_not_learnt() -> None:
    cue, gray = made(), hill(0, 50, (24.0, -8.0), 0.0)
    cut = [-0.5, 50.0, 40.0, 40.0]
    reference = cue.learn(planes_of(cue, gray), np.array(cut))
    assert reference["known"] == pytest.approx(0.5)
    # half of it is gone: at best -(1 - 1/2) / 0.25
    assert scores(cue, gray, [cut], reference)[0] <= np.log(0.02 + 0.98 * np.exp(-2.0)) + 1e-9
    assert scores(cue, gray, [[-100.0, 50, 40, 40]], reference)[0] == pytest.approx(np.log(0.02))
    outside = cue.learn(planes_of(cue, gray), np.array([-100.0, 50, 40, 40]))
    assert scores(cue, gray, [BOX], outside).tolist() == [0.0]
    assert cue.blend(outside, reference, 0.1)["shading"] == pytest.approx(reference["shading"])
