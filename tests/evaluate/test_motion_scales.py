"""Where a motion's parameters are searched for: the scales are undone, and starts keep what a graph says."""

import numpy as np

from bayesnet_track.evaluate.motion_fit import MOST_STARTS, bounds_of, search_places, search_values, starts_of

VELOCITY = ("constant_velocity", "sd_velocity_px")
BEGIN = {
    ("motion", *VELOCITY): 0.5,
    ("modes", "turn", "motion", *VELOCITY): 6.0,
    ("modes", "turn", "mean_frames"): 2.0,
    ("motion", "constant_velocity", "heavy_tail", "weight"): 0.1,
    ("motion", "constant_velocity", "heavy_tail", "factor"): 5.0,
}
PATHS, GIVEN = list(BEGIN), np.array(list(BEGIN.values()))


def test_values_are_those_of_their_places():
    places = search_places(PATHS, GIVEN)
    np.testing.assert_allclose(search_values(PATHS, places), GIVEN, rtol=1e-12)
    np.testing.assert_allclose(places[[0, 3]], [np.log(0.5), np.log(0.1 / 0.9)])
    ends = search_values(PATHS, np.array([np.full(5, -np.inf), np.full(5, np.inf)]))
    assert ends.tolist() == [[0, 0, 0, 0, 0], [np.inf, np.inf, np.inf, 1, np.inf]]


def test_bounds_are_of_what_a_graph_may_say():
    low, high = (search_values(PATHS, one) for one in bounds_of(PATHS, search_places(PATHS, GIVEN)))
    np.testing.assert_allclose(low, [0.0005, 0.006, 1, 0.001, 1.05])
    np.testing.assert_allclose(high, [500, 6000, 2000, 0.95, 5000])


def test_starts_keep_the_order_of_the_modes_noise():
    starts = starts_of({path: value for path, value in BEGIN.items() if "heavy_tail" not in path})
    assert starts[0].tolist() == [0.5, 6, 2] and (starts[:, 0] < starts[:, 1]).all()
    assert len(np.unique(starts, axis=0)) == len(starts) > 30 and starts[:, 2].min() == 1


def test_many_modes_have_no_more_starts():
    many = {("modes", f"m{k}", "motion", *VELOCITY): 2.0**k for k in range(12)}
    starts = starts_of(many | {("modes", "m0", "mean_frames"): 9.0})
    assert starts[0].tolist() == [*many.values(), 9] and 1 <= len(starts) <= MOST_STARTS
