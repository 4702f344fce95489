"""Disparity and points of small pictures whose depth is known."""

import numpy as np
import pytest

from bayesnet_track.observation.planes import (
    Frame,
    FramePair,
    NoDepth,
    PlaneCache,
    PointMap,
    Region,
    RightEye,
    StereoGeometry,
)
from bayesnet_track.vision.stereo_planes import (
    Correlation,
    PointsPlane,
    Range,
    SemiGlobal,
    all_points,
    laplacian_of_gaussian,
)

GEOMETRY = StereoGeometry(200.0, 0.2, 80.0, 60.0)  # 40 px at 1 m
WHOLE = Region(0, 0, 160, 120)
MATCHERS = [Correlation(), SemiGlobal()]


def picture(seed=0, cell=3):
    rng = np.random.default_rng(seed)
    cells = rng.integers(20, 236, (120 // cell, 160 // cell + 40, 1), dtype=np.uint8)
    return cells.repeat(cell, 0).repeat(cell, 1).repeat(3, 2)


def frame(near=10, far=4, box=(50, 30, 40, 60)):
    """A textured wall with a box before it, in both eyes, at whole disparities."""
    wall, person = picture(0), picture(1)
    left, right = wall[:, :160].copy(), wall[:, far : 160 + far].copy()
    x, y, w, h = box
    for image, at in ((left, x), (right, x - near)):
        image[y : y + h, at : at + w] = person[:h, :w]
    return Frame(0, 0.0, left, depth=RightEye(right, GEOMETRY))


@pytest.mark.parametrize("matcher", MATCHERS)
def test_both_surfaces_have_their_disparity(matcher):
    now = frame()
    found = matcher.disparity(now.image, now.depth.image, 0, 20, WHOLE)
    inside = found[38:82, 58:82]
    wall = found[5:-5, 100:150]
    for part, value in ((inside, 10), (wall, 4)):
        assert np.isfinite(part).mean() > 0.9
        assert (np.abs(part - value) <= 1)[np.isfinite(part)].mean() > 0.99


@pytest.mark.parametrize("matcher", MATCHERS)
def test_disparity_does_not_depend_on_the_region(matcher):
    now, region = frame(), Region(41, 22, 101, 77)
    whole = matcher.disparity(now.image, now.depth.image, 0, 20, WHOLE)
    part = matcher.disparity(now.image, now.depth.image, 0, 20, region)
    np.testing.assert_array_equal(part, region.of(whole))
    assert matcher.disparity(now.image, now.depth.image, 0, 20, Region(160, 5, 160, 9)).size == 0


def test_the_filtered_picture_is_one_picture():
    now = frame()
    whole = laplacian_of_gaussian(now.image, WHOLE, 1.2)
    for region in (Region(0, 0, 30, 30), Region(33, 18, 90, 111), Region(150, 100, 160, 120)):
        np.testing.assert_array_equal(laplacian_of_gaussian(now.image, region, 1.2), region.of(whole))
    flat = laplacian_of_gaussian(np.full((40, 40, 3), 93, np.uint8), Region(0, 0, 40, 40), 1.2)
    assert not flat.any()


@pytest.mark.parametrize("sd", [0.5, 1.0, 1.5])
def test_brightness_and_contrast_of_one_eye_change_nothing_much(sd):
    now = frame()
    dimmed = np.rint(now.depth.image * 0.6 + 30).astype(np.uint8)
    matcher = Correlation(sd_px=sd)
    one = matcher.disparity(now.image, now.depth.image, 0, 20, WHOLE)
    other = matcher.disparity(now.image, dimmed, 0, 20, WHOLE)
    both = np.isfinite(one) & np.isfinite(other)
    assert both.sum() > 0.95 * np.isfinite(one).sum()
    assert np.quantile(np.abs(one - other)[both], 0.95) < 0.1


def test_points_lie_where_the_geometry_says():
    now = frame()
    points = all_points(now, Correlation(), Range(1.5, 20), WHOLE)
    x, y, z = np.nanmedian(points[40:50, 60:70].reshape(-1, 3), axis=0)
    assert z == pytest.approx(4.0, rel=0.01)  # 40 / 10
    assert x == pytest.approx((64.5 - 80) / 200 * z, abs=0.02)
    assert y == pytest.approx((44.5 - 60) / 200 * z, abs=0.02)


def test_depth_and_disparity_are_inverse_with_an_offset():
    geometry = StereoGeometry(300.0, 0.1, 10.0, 10.0, offset_px=2.0)
    assert geometry.disparity_of(3.0) == pytest.approx(8.0)
    points = geometry.points(np.array([[8.0, -2.0, -5.0, np.nan]], np.float32))
    assert points[0, 0, 2] == pytest.approx(3.0) and np.isnan(points[0, 1:]).all()


def test_the_range_keeps_what_is_near_enough_and_off_the_floor():
    points = np.array([[[0, 0, 0.5], [0, 0, 3], [0, 0, 30], [0, 1.45, 3], [0, -3.0, 3], [np.nan] * 3]])
    points = points.astype(np.float32)
    assert Range(1, 10).keeps(points).tolist() == [[False, True, False, True, True, False]]
    standing = Range(1, 10, camera_height_m=1.5, min_elevation_m=0.1, max_elevation_m=2.5)
    assert standing.keeps(points).tolist() == [[False, True, False, False, False, False]]
    # A camera that looks down 45 degrees: 2 m ahead along its axis lies 1.41 m below it.
    down = Range(1, 10, camera_height_m=1.5, pitch_deg=45)
    assert down.keeps(np.array([[[0, 0, 2], [0, 0, 1.5]]], np.float32)).tolist() == [[False, True]]


def test_the_plane_leaves_the_box_only_and_no_specks():
    reach = Range(2.5, 5.0, min_pixels=60)
    points = PlaneCache(FramePair(frame(), None)).planes([PointsPlane(range=reach)], WHOLE)[
        PointsPlane(range=reach)
    ]
    valid = np.isfinite(points[..., 2])
    # Half a window around the box's edges belongs to neither surface for sure.
    assert valid[38:82, 58:82].mean() > 0.95
    valid[22:98, 42:98] = False
    assert valid.sum() == 0


def test_the_plane_does_not_depend_on_the_region():
    rng = np.random.default_rng(3)
    depth = np.where(rng.random((120, 160)) < 0.58, 3.0, np.nan).astype(np.float32)
    now = Frame(0, 0.0, picture()[:, :160], depth=PointMap(GEOMETRY.points_of_depth(depth)))
    for plane in (PointsPlane(), PointsPlane(range=Range(min_pixels=7))):
        whole = plane.compute(FramePair(now, None), (), WHOLE)
        for region in (Region(60, 40, 75, 62), Region(0, 0, 9, 120)):
            part = plane.compute(FramePair(now, None), (), region)
            np.testing.assert_array_equal(part, region.of(whole))


def test_a_point_map_stands_in_for_the_pair_and_is_not_changed():
    depth = np.full((120, 160), 3.0, np.float32)
    depth[:, 80:] = 30.0
    points = GEOMETRY.points_of_depth(depth)
    kept = points.copy()
    now = Frame(0, 0.0, picture()[:, :160], depth=PointMap(points))
    found = PointsPlane().compute(FramePair(now, None), (), WHOLE)
    np.testing.assert_array_equal(found[:, :80], kept[:, :80])
    assert np.isnan(found[:, 80:]).all()
    np.testing.assert_array_equal(points, kept)


def test_one_eye_is_refused_with_the_way_out():
    now = Frame(0, 0.0, picture()[:, :160])
    with pytest.raises(NoDepth, match=r"right=SOURCE.*calibration=FILE.*depth="):
        PointsPlane().compute(FramePair(now, None), (), WHOLE)


def test_pictures_narrower_than_the_search_have_no_match():
    tiny = picture()[:12, :9]
    now = Frame(0, 0.0, tiny, depth=RightEye(tiny, GEOMETRY))
    for matcher in MATCHERS:
        found = all_points(now, matcher, Range(1.0, 2.0), Region(0, 0, 9, 12))
        assert np.isnan(found[..., 2]).all()
