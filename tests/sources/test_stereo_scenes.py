"""The two eyes of a scene see one world, whose depth is true: both matchers find it."""

import numpy as np
import pytest

from bayesnet_track.observation.planes import Frame, Region
from bayesnet_track.sources.scenes import make_scene
from bayesnet_track.sources.scenes.library import SceneSource
from bayesnet_track.vision.stereo_planes import Correlation, SemiGlobal

SEARCH = (0, 60)


@pytest.fixture(scope="module", params=["person_stereo", "glass_wall"])
def scene(request):
    return make_scene(request.param, 0)


def disparity(scene, index, matcher):
    """Found and true disparity of a frame, px."""
    region = Region(0, 0, scene.width, scene.height)
    view = scene.stereo
    found = matcher.disparity(scene.frames[index], view.right[index], *SEARCH, region)
    return found, view.geometry.focal_px * view.geometry.baseline_m / view.true_depth(index)


def inside(scene, index, inset=5):
    x, y, w, h = (int(v) for v in scene.truth[index])
    mask = np.zeros((scene.height, scene.width), bool)
    mask[y + inset : y + h - inset, x + inset : x + w - inset] = True
    return mask


@pytest.mark.parametrize("index", [0, 75])
def test_correlation_finds_the_true_disparity_as_semi_global_matching_does(scene, index):
    """On the textured person both are within 1 px nearly everywhere; elsewhere borders hide from one eye."""
    person = inside(scene, index)
    for matcher, min_dense, min_right in ((Correlation(), 0.45, 0.9), (SemiGlobal(), 0.85, 0.9)):
        found, true = disparity(scene, index, matcher)
        near = np.abs(found - true) <= 1.0
        known = np.isfinite(found)
        assert known[person].mean() > 0.9 and near[known & person].mean() > 0.99
        assert known.mean() > min_dense and near[known].mean() > min_right
        assert np.nanmedian(np.abs(found - true)[person]) < 0.35


def test_the_pane_is_left_out_by_correlation_alone():
    """Its pattern repeats: no peak of the correlation is the only one."""
    scene = make_scene("glass_wall", 0)
    pane = np.abs(scene.stereo.background_m - 5.0) < 1e-9
    pane[:, 0:150] = pane[:, 285:] = False  # half a window from the edges, where the background helps
    pane[150:] = False
    found, _ = disparity(scene, 0, Correlation())
    loose, _ = disparity(scene, 0, Correlation(min_difference=0.0))
    other, _ = disparity(scene, 0, SemiGlobal())
    assert np.isfinite(found[pane]).mean() < 0.02
    assert np.isfinite(loose[pane]).mean() > 0.5 and np.isfinite(other[pane]).mean() > 0.5


def test_frames_of_the_source_carry_the_right_eye(scene):
    source = SceneSource(scene, "scene", 2)
    frames = list(source)
    assert source.has_depth and len(frames) == 2 and isinstance(frames[1], Frame)
    np.testing.assert_array_equal(frames[1].depth.image, scene.stereo.right[1])
    assert frames[1].depth.geometry == scene.stereo.geometry
    assert not SceneSource(make_scene("two_squares", 0), "scene").has_depth


def test_the_true_depth_is_that_of_the_nearest(scene):
    depth = scene.stereo.true_depth(75)
    x, y, w, h = scene.truth[75]
    target = scene.stereo.depths_m[-1][75]
    assert depth[int(y + h / 2), int(x + w / 2)] == target
    assert h == pytest.approx(300 * 1.7 / target) and w == pytest.approx(300 * 0.5 / target)
    assert depth[-1, 0] == pytest.approx(1.2 * 300 / (239 - 99.5))
    assert depth.max() == 7.0


def test_the_other_one_enters_late_and_passes_behind():
    scene = make_scene("person_stereo", 0)
    (other,) = scene.others
    seen = (other[:, 0] < scene.width) & (other[:, 0] + other[:, 2] > 0)
    assert 55 <= int(np.flatnonzero(seen)[0]) <= 65
    apart = np.abs(other[:, 0] - scene.truth[:, 0])
    assert apart[seen].min() < 10
    assert (scene.visible > 0.99).all()


@pytest.mark.parametrize("seed", range(3))
def test_the_one_dressed_alike_stands_nearer_and_comes_and_goes(seed):
    """Depth alone tells them apart: any box of the target's size fits into him, and he has its hue."""
    scene = make_scene("person_same_clothes_nearer", seed)
    target, (other,) = scene.truth, scene.others
    inside = np.flatnonzero(other[:, 0] < scene.width)
    assert 45 <= inside[0] < inside[-1] <= 110
    beside = other[:, 0] < target[:, 0] + 1.5 * target[:, 2]
    assert 8 <= beside.sum() <= 20 and scene.visible[~beside].min() > 0.999
    assert scene.visible.min() > 0.6
    assert (other[:, 2:] > target[:, 2:] * 1.15).all()
    him, it = (depths[75] for depths in reversed(scene.stereo.depths_m))
    assert 2.9 <= him <= 3.3 and it == 3.9
    x, y, w, h = (int(v) for v in target[30])
    u, v, p, q = (int(v) for v in other[75])
    mine = scene.frames[30][y : y + h, x : x + w].reshape(-1, 3).mean(axis=0)
    his = scene.frames[75][v : v + q, u : u + p].reshape(-1, 3).mean(axis=0)
    np.testing.assert_allclose(mine / mine.sum(), his / his.sum(), atol=0.01)
