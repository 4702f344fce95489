"""Colour blobs: matching by hand, its penalties, and targets moved, turned in hue or cut off."""

import numpy as np
import pytest
from scipy import ndimage

from bayesnet_track.observation.planes import Frame, FramePair
from bayesnet_track.vision.kernels.blob_kernels import (
    blob_costs,
    grow_blobs,
    match_blobs,
)

RED, GREEN, BLUE, GRAY = (0, 0, 255), (0, 255, 0), (255, 0, 0), (90, 90, 90)


def still(image):
    return FramePair(Frame(0, 0.0, image), None)


def flag(left=RED, right=BLUE, at=(60, 40)):
    """A 40 x 40 target, left and right half of one colour each, its corner at `at`, on gray."""
    image = np.empty((140, 180, 3), np.uint8)
    image[:] = GRAY
    x, y = at
    image[y : y + 40, x : x + 20] = left
    image[y : y + 40, x + 20 : x + 40] = right
    return image


BOX = np.array([79.5, 59.5, 40.0, 40.0])


@pytest.mark.parametrize("cells", [4, 8, 10, 17])
def test_blobs_are_the_connected_components_of_the_grid(cells):
    rng = np.random.default_rng(4)
    for _ in range(30):
        classes = rng.integers(-1, 3, (cells, cells))
        hue = np.where(classes < 0, -1, classes * 80).astype(np.int16)
        expected = []
        for value in range(3):
            labels, count = ndimage.label(classes == value)
            for label in range(1, count + 1):
                y, x = np.nonzero(labels == label)
                place = ((v.mean() + 0.5) / cells - 0.5 for v in (x, y))
                expected.append((*place, value * 80 * 360 / 256, len(x) / cells**2))
        box = np.array([[(cells - 1) / 2, (cells - 1) / 2, cells, cells]])
        blobs, found = grow_blobs(hue, box, (0, 0), cells, 20.0, 1e-9, cells**2)
        assert found[0] == len(expected)
        assert sorted(map(tuple, blobs[0, : found[0]].round(3))) == sorted(
            map(tuple, np.array(expected).reshape(-1, 4).round(3))
        )
        assert (np.diff(blobs[0, : found[0], 3]) <= 0).all()


@pytest.mark.parametrize("cells", [4, 7, 8, 11])
def test_outside_the_plane_there_is_no_hue(cells):
    """Bit for bit, on noise and on patches of similar hues, as in a plane with a wide margin of no hue."""
    rng = np.random.default_rng(cells)
    noise = rng.integers(-1, 256, (60, 80))
    patches = np.kron(rng.choice([-1, 3, 10, 250, 128], (12, 16)), np.ones((5, 5), int))
    boxes = np.column_stack([rng.uniform(-10, 90, (400, 2)), rng.uniform(2, 50, (400, 2))])
    for hue in (noise, patches):
        padded = np.pad(hue, 50, constant_values=-1)
        planes = ((hue, (3, 2)), (padded, (-47, -48)))
        one, other = (grow_blobs(h.astype(np.int16), boxes, at, cells, 15.0, 0.02, 6) for h, at in planes)
        np.testing.assert_array_equal(one[0], other[0])
        np.testing.assert_array_equal(one[1], other[1])


def test_neighbours_join_across_the_start_of_the_hue_circle():
    hue = np.array([[254, 2], [254, 2]], np.int16)
    blobs, found = grow_blobs(hue, np.array([[0.5, 0.5, 2, 2]]), (0, 0), 4, 10.0, 0.05, 4)
    assert found[0] == 1
    assert blobs[0, 0] == pytest.approx([0, 0, 0, 1], abs=1e-6)


def test_small_blobs_are_left_out_and_the_largest_kept():
    hue = np.full((10, 10), -1, np.int16)
    hue[0, :4], hue[2, :3], hue[4, :2] = 10, 90, 170
    box = np.array([[4.5, 4.5, 10, 10]])
    shares = [
        grow_blobs(hue, box, (0, 0), 10, 10.0, least, most)[0][0, :, 3].tolist()
        for least, most in ((0.03, 3), (0.01, 2))
    ]
    assert shares == [[0.04, 0.03, 0.0], [0.04, 0.03]]


def test_matching_is_one_to_one_in_turn():
    ours = np.array([[0.2, 0, 10, 0.3], [0.1, 0, 10, 0.3], [0.3, 0, 10, 0.1]])
    theirs = np.array([[0.3, 0, 10, 0.3], [0.15, 0, 350, 0.3]])
    match, cost = match_blobs(ours, theirs, 0.1, 20.0, 4.0)
    assert match.tolist() == [0, 1, -1]
    assert cost == pytest.approx([0.5, 0.5 * 0.25 + 0.5, 4.0])  # 20 degrees apart round the circle
    assert match_blobs(ours[:1], theirs[1:], 0.1, 20.0, 0.6)[0].tolist() == [-1]  # .625 is beyond the limit


def test_cost_is_the_mean_by_area_and_charges_both_sides():
    reference = np.array([[0.0, 0, 0, 0.6], [0.3, 0, 120, 0.2]])
    blobs = np.zeros((4, 3, 4))
    blobs[0, :2] = reference
    blobs[1, 0] = reference[0]
    blobs[2, :2] = reference
    blobs[2, 2] = [-0.3, 0, 240, 0.1]
    costs = blob_costs(blobs, np.array([2, 1, 3, 0]), reference, 0.1, 15.0, 4.0)
    assert costs == pytest.approx([0, 4 * 0.2 / 0.8, 4 * 0.1 / 0.8, 4])
    none = blob_costs(blobs, np.array([2, 1, 3, 0]), np.empty((0, 4)), 0.1, 15.0, 4.0)
    assert none == pytest.approx([3.2, 2.4, 3.6, 0])


def test_learns_two_blobs_and_prefers_them_in_place(ask):
    asked = ask("color_blobs")
    reference = asked.learn(still(flag()), BOX)
    by_x = reference["blobs"][np.argsort(reference["blobs"][:, 0])]
    assert by_x == pytest.approx(np.array([[-0.25, 0, 0, 0.5], [0.25, 0, 171 * 360 / 256, 0.5]]), abs=1e-4)
    same, swapped, gray, one = (
        asked.score(still(image), BOX[None], reference)[0]
        for image in (flag(), flag(BLUE, RED), flag(GRAY, GRAY), flag(RED, GRAY))
    )
    assert same == pytest.approx(0, abs=1e-12)
    assert swapped < -2.5  # the same histogram, in other places
    assert gray < -2.5  # a box without blobs is no match
    assert swapped < one < -1.5
    assert gray < one


def test_a_hue_near_the_start_of_the_circle_is_near(ask):
    asked = ask("color_blobs")
    reference = asked.learn(still(flag(left=(10, 0, 255))), BOX)  # just below red
    near = asked.score(still(flag(left=(0, 10, 255))), BOX[None], reference)[0]  # just above
    assert near > -0.1


def test_blend_fades_blobs_in_and_out(ask):
    asked = ask("color_blobs")
    old = asked.learn(still(flag(RED, BLUE)), BOX)
    new = asked.learn(still(flag(RED, GREEN)), BOX)
    reference = old
    hues = []
    for _ in range(40):
        reference = asked.cue.blend(reference, new, 0.1)
        seen = reference["blobs"][reference["blobs"][:, 3] >= asked.cue.parameters.min_share]
        hues.append(tuple(np.sort(seen[:, 2].round()) % 360))
        assert len(reference["blobs"]) <= 2 * asked.cue.parameters.max_blobs
    assert hues[0] == (0, 240) or hues[0] == (0, 120, 240)
    assert (0, 120, 240) in hues
    assert hues[-1] == (0, 120)
    assert asked.score(still(flag(RED, GREEN)), BOX[None], reference)[0] > -0.05


def test_sds_follow_the_blobs_of_the_target_where_they_are_asked_to(ask):
    """Blobs that stay where they were and change their hue by 30 degrees: only the sd of hue grows."""
    asked = ask("color_blobs", sd_memory_frames=5)
    old, new = (asked.learn(still(flag(left, BLUE)), BOX) for left in (RED, (0, 128, 255)))
    turned = asked.score(still(flag((0, 128, 255), BLUE)), BOX[None], old)[0]
    reference = old
    for _ in range(40):
        reference = asked.cue.blend(reference, new, 1e-6)
    assert reference["spread"][0] == pytest.approx(0.1)
    assert reference["spread"][1] == pytest.approx(15 / 15 / np.sqrt(2 / np.pi), rel=0.03)  # 30 of one in two
    assert asked.score(still(flag((0, 128, 255), BLUE)), BOX[None], reference)[0] > turned
    assert asked.cue.blend(old, new, 0.0)["spread"].tolist() == [1.0, 1.0]


def test_blend_turns_hue_the_short_way(ask):
    asked = ask("color_blobs")
    old, new = (
        {"blobs": np.array([[0.0, 0, hue, 0.5]]), "size": np.array([20.0, 20.0]), "sharper": np.array(1.0)}
        for hue in (350.0, 10.0)
    )
    assert asked.cue.blend(old, new, 0.25)["blobs"][0, 2] == pytest.approx(355)
    assert asked.cue.blend(old, new, 0.75)["blobs"][0, 2] == pytest.approx(5)


def test_a_target_without_blobs_does_not_leave_the_frame(ask):
    asked = ask("color_blobs")
    gray = still(flag(GRAY, GRAY))
    reference = asked.learn(gray, BOX)
    boxes = np.array([[79.5, 59.5, 40, 40], [-0.5, 59.5, 40, 40], [-100, 59.5, 40, 40]])
    p = asked.cue.parameters
    expected = np.log(p.floor + (1 - p.floor) * np.exp([0.0, -p.unmatched / 2, -p.unmatched]))
    assert asked.score(gray, boxes, reference) == pytest.approx(expected)
