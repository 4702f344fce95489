"""Mean shift and CamShift: how far they reach, what hides them, what their covariances say."""

import cv2
import numpy as np
import pytest

from bayesnet_track.observation.cue import Hypotheses
from bayesnet_track.observation.planes import region_of_boxes


def cloud(centre, size, sd=10.0, n=200):
    rng = np.random.default_rng(3)
    return np.column_stack([rng.normal(centre, sd, (n, 2)), np.tile(size, (n, 1))])


def painted(scene, box, colour=(40, 60, 210), angle=0.0):
    """A filled, possibly turned ellipse on a wall of one colour with grain."""
    grain = np.random.default_rng(1).integers(-6, 7, (scene.height, scene.width, 3))
    image = (np.array([60, 140, 150]) + grain).astype(np.uint8)
    x, y, w, h = box
    centre, axes = (round(x * 16), round(y * 16)), (round(w * 8), round(h * 8))
    cv2.ellipse(image, centre, axes, angle, 0, 360, colour, -1, cv2.LINE_AA, 4)
    return scene.pair_of(image, image)


@pytest.mark.parametrize("sd", [5.0, 10.0, 20.0])
def test_the_first_window_reaches_as_far_as_the_prediction_is_uncertain(ask, scene, sd):
    """It holds the box and two sds on each side, and shrinks to the box: found from two sds off."""
    asked = ask("mean_shift")
    reference = asked.learn(scene.pair(), scene.box())
    boxes = cloud(scene.start + [2.0 * sd, 0.0], scene.size, sd)
    measured = asked.measure(scene.pair(), boxes, reference)
    assert np.abs(measured.mean - scene.start).max() < 1.0
    equal = np.full(len(boxes), 1.0 / len(boxes))
    planes = asked.planes(scene.pair(), region_of_boxes(boxes))
    path = asked.cue.climb(planes, Hypotheses(boxes), equal, reference)
    np.testing.assert_allclose(path[0, :2], boxes[:, :2].mean(axis=0))
    np.testing.assert_allclose(path[0, 2:], scene.size / 2 + 2.0 * boxes[:, :2].std(axis=0))
    np.testing.assert_allclose(path[-1, 2:], scene.size / 2)
    assert (np.diff(path[1:, 2:], axis=0) <= 0).all()


def test_the_covariance_is_the_inverse_curvature_of_the_likelihood(ask, scene):
    """Against (3.92) at every place around the peak, by least squares of a paraboloid."""
    asked = ask("mean_shift", sd_px=1e-6)
    pair = scene.pair()
    reference = asked.learn(pair, scene.box())
    measured = asked.measure(pair, cloud(scene.start, scene.size, 3.0), reference)
    from bayesnet_track.vision.kernels.mean_shift_kernels import kernel_histogram

    cells = asked.planes(pair, region_of_boxes(scene.box()[None], 2.0))
    grid, region = cells[asked.cue.needs[0]], cells.region
    offset = np.array([(a, b) for a in np.linspace(-8, 8, 9) for b in np.linspace(-6, 6, 9)])
    log = []
    for move in offset:
        at = measured.mean + move - [region.x0, region.y0]
        here = kernel_histogram(grid, *at, *(scene.size / 2), len(reference["shares"]))
        log.append((np.sqrt(here * reference["shares"]).sum() - 1.0) / (2 * 0.02))
    a, b = offset.T
    fit = np.linalg.lstsq(np.column_stack([a**2, a * b, b**2, a, b, np.ones(len(a))]), log, rcond=None)[0]
    expected = np.linalg.inv(-np.array([[2 * fit[0], fit[1]], [fit[1], 2 * fit[2]]]))
    np.testing.assert_allclose(np.sqrt(np.diag(measured.covariance)), np.sqrt(np.diag(expected)), rtol=0.3)


@pytest.mark.parametrize("name", ["mean_shift", "camshift"])
def test_the_more_is_hidden_the_wider_the_message_until_it_is_not_seen(ask, scene, name):
    asked = ask(name)
    reference = asked.learn(scene.pair(), scene.box())
    boxes = cloud(scene.start, scene.size, 5.0)
    low, high = (scene.start - scene.size / 2).astype(int), (scene.start + scene.size / 2).astype(int)
    sds = []
    for share in (0.0, 0.5, 0.9):
        image = scene.pair().current.image.copy()
        edge = low[0] + round(share * scene.size[0])
        image[low[1] : high[1] + 1, low[0] : edge] = scene.background[low[1] : high[1] + 1, low[0] : edge]
        measured = asked.measure(scene.pair_of(image, image), boxes, reference)
        sds.append(None if measured is None else np.sqrt(np.diag(measured.covariance)[:2]).mean())
    assert sds[0] < sds[1] and sds[2] is None


@pytest.mark.parametrize("factor", [0.85, 1.0, 1.2])
def test_camshift_measures_the_size(ask, scene, factor):
    """An ellipse 15 % smaller, 20 % larger: within 5 % of its sides, from a prediction of the old size."""
    asked = ask("camshift")
    box = np.array([150.0, 120.0, 50.0, 36.0])
    reference = asked.learn(painted(scene, box), box)
    now = box * [1, 1, factor, factor]
    measured = asked.measure(painted(scene, now), cloud(box[:2] + 4.0, box[2:], 3.0), reference)
    assert measured.fields == ("x", "y", "w", "h")
    np.testing.assert_allclose(measured.mean[2:], now[2:], rtol=0.05)
    np.testing.assert_allclose(measured.mean[:2], now[:2], atol=1.0)


def test_camshift_changes_a_side_no_more_than_it_may(ask, scene):
    asked = ask("camshift", change_max=1.1)
    box = np.array([150.0, 120.0, 50.0, 36.0])
    reference = asked.learn(painted(scene, box), box)
    measured = asked.measure(painted(scene, box * [1, 1, 1.6, 1.6]), cloud(box[:2], box[2:], 3.0), reference)
    assert measured is None or (measured.mean[2:] <= 1.1 * box[2:] + 1e-9).all()


@pytest.mark.parametrize("angle", [0.0, 30.0, -50.0])
def test_camshift_sees_the_orientation(ask, scene, angle):
    asked = ask("camshift")
    box = np.array([150.0, 120.0, 64.0, 64.0])
    bar = np.array([150.0, 120.0, 60.0, 20.0])
    pair = painted(scene, bar, angle=angle)
    reference = asked.learn(pair, box)
    boxes = cloud(box[:2], box[2:], 2.0)
    equal = np.full(len(boxes), 1.0 / len(boxes))
    planes = asked.planes(pair, region_of_boxes(boxes))
    found = asked.cue.climb(planes, Hypotheses(boxes), equal, reference)
    assert np.degrees(found.axis) == pytest.approx(angle, abs=3.0)
    assert len(found.path) > 1


def test_a_ring_of_the_same_colour_is_no_target(ask, scene):
    """Learnt on a coloured box, asked where the whole surroundings have its colour: nothing says where."""
    asked = ask("camshift")
    box = np.array([150.0, 120.0, 50.0, 36.0])
    reference = asked.learn(painted(scene, box), box)
    assert asked.measure(painted(scene, box * [1, 1, 5, 6]), cloud(box[:2], box[2:], 3.0), reference) is None


def test_hsv_cells_are_less_disturbed_by_the_light(ask, scene):
    """Half the light: hue and saturation stay, rgb cells all change."""
    darker = scene.pair_of(*[(f.image * 0.5).astype(np.uint8) for f in (scene.pair().current,) * 2])
    shares = []
    for space in ("rgb", "hsv"):
        asked = ask("mean_shift", space=space)
        one = asked.learn(scene.pair(), scene.box())["shares"]
        other = asked.learn(darker, scene.box())["shares"]
        shares.append(np.sqrt(one * other).sum())
    assert shares[1] > shares[0] + 0.05
