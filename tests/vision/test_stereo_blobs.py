"""The stereo detector finds the people of a rendered room, and blobs of drawn points exactly."""

import numpy as np
import pytest

from bayesnet_track.numerics.boxes import centre_from_corner, overlap
from bayesnet_track.observation.planes import Frame, NoDepth, PointMap, StereoGeometry
from bayesnet_track.sources.scenes import make_scene
from bayesnet_track.sources.scenes.library import SceneSource
from bayesnet_track.vision.detectors.stereo_blobs import StereoBlobSettings, detect_stereo_blobs
from bayesnet_track.vision.stereo_planes import Range, SemiGlobal

GEOMETRY = StereoGeometry(100.0, 0.2, 60.0, 50.0)
IN_ROOM = Range(1.0, 6.5, camera_height_m=1.2, min_pixels=400)


def drawn(*blobs, shape=(100, 120)):
    """A frame of points: each blob is (x, y, w, h) corner box and depth."""
    depth = np.full(shape, np.nan, np.float32)
    for x, y, w, h, z in blobs:
        depth[y : y + h, x : x + w] = z
    return Frame(0, 0.0, np.zeros((*shape, 3), np.uint8), depth=PointMap(GEOMETRY.points_of_depth(depth)))


def settings(**changes):
    return StereoBlobSettings(range=Range(0.5, 10.0, min_pixels=100), **changes)


def test_boxes_depths_and_sizes_of_drawn_blobs():
    found = detect_stereo_blobs(drawn((10, 20, 20, 60, 3.0), (70, 30, 15, 40, 5.0)), settings())
    order = np.argsort(found.depths_m)
    np.testing.assert_allclose(
        found.boxes[order], centre_from_corner([(10, 20, 20, 60), (70, 30, 15, 40)]), atol=1e-9
    )
    assert found.scores.tolist() == [1.0, 1.0]
    assert found.depths_m[order] == pytest.approx([3.0, 5.0])
    assert found.heights_m[order] == pytest.approx([59 / 100 * 3, 39 / 100 * 5])
    assert found.widths_m[order] == pytest.approx([19 / 100 * 3, 14 / 100 * 5])


def test_neighbours_of_other_depth_are_two_and_holes_cost_score():
    frame = drawn((10, 20, 20, 60, 3.0), (30, 20, 20, 60, 4.0), (33, 30, 10, 40, np.nan))
    found = detect_stereo_blobs(frame, settings())
    assert len(found) == 2
    assert found.depths_m.tolist() == pytest.approx([3.0, 4.0])  # the best first
    assert found.scores == pytest.approx([1.0, 1 - 400 / 1200])


def test_what_is_too_small_too_low_or_too_much_is_left_out():
    frame = drawn((10, 20, 9, 10, 3.0), (40, 80, 60, 10, 3.0), (70, 5, 20, 60, 3.0))
    found = detect_stereo_blobs(frame, settings())
    assert len(found) == 1 and found.boxes[0, 0] == 79.5
    many = drawn(*((5 + 20 * n, 10, 15, 60, 3.0) for n in range(5)))
    assert len(detect_stereo_blobs(many, settings(max_blobs=3))) == 3


def test_nothing_gives_nothing():
    found = detect_stereo_blobs(drawn(), settings())
    assert found.boxes.shape == (0, 4) and len(found.scores) == 0
    with pytest.raises(NoDepth):
        detect_stereo_blobs(Frame(0, 0.0, np.zeros((9, 9, 3), np.uint8)))


@pytest.mark.slow
@pytest.mark.parametrize("name", ["person_stereo", "glass_wall"])
def test_the_person_is_found_in_every_room(name):
    """Correlation windows make blobs half a window larger on each side: 3 px of 38 x 128."""
    scene = make_scene(name, 0)
    for frame in SceneSource(scene, name, 60):
        if frame.index % 15 == 0:
            found = detect_stereo_blobs(frame, StereoBlobSettings(range=IN_ROOM))
            best = overlap(found.boxes, centre_from_corner(scene.truth[frame.index]))
            assert best.max() > 0.65
            assert abs(found.depths_m[best.argmax()] - scene.stereo.depths_m[-1][frame.index]) < 0.1


@pytest.mark.slow
def test_semi_global_matching_links_the_person_to_the_pane():
    """Thesis Figure 3.19: close to the glass wall the blob is that of both."""
    scene = make_scene("glass_wall", 0)
    (frame,) = (frame for frame in SceneSource(scene, "glass", 111) if frame.index == 110)
    true = centre_from_corner(scene.truth[110])
    apart = detect_stereo_blobs(frame, StereoBlobSettings(range=IN_ROOM, max_height_m=9))
    linked = detect_stereo_blobs(
        frame, StereoBlobSettings(matcher=SemiGlobal(), range=IN_ROOM, max_height_m=9)
    )
    assert overlap(apart.boxes, true).max() > 0.7
    assert overlap(linked.boxes, true).max() < 0.3
