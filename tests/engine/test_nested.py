"""Latent nodes with a motion of their own: exact against Kalman on the joint state, and remembered."""

from __future__ import annotations

import numpy as np
import pytest

from bayesnet_track.belief.motion.composed import Deviation

START = (55.0, 50.0, 20.0, 60.0)
ROOT_SD = 3.0
OFFSETS, HEIGHTS = {"torso": 0.1, "badge": -0.25}, {"torso": 0.5, "badge": 0.1}
GIVEN = {"torso": 5.0, "badge": 3.0}
STEP = {"torso": 2.0, "badge": 1.0}
SEEN_SD = {"torso": 4.0, "badge": 2.0}
SHAPE = {"torso": 30.0, "badge": 3.0}
FRAMES = 12


def part(name, parent, moves=True):
    given = {
        "offset_box": {"y": OFFSETS[name]},
        "size_box": {"h": HEIGHTS[name]},
        "sd_px": {"x": GIVEN[name], "y": GIVEN[name]},
    }
    walk = {"motion": {"random_walk": {"sd_px": {"x": STEP[name], "y": STEP[name]}}}} if moves else {}
    return {"parent": parent, "fuse": {"latent": {"given": given}}, **walk}


def nodes(size, moves=True):
    """Three levels of inference nodes: a whole, a part of it, and a part of that part."""
    return {
        "person": {
            "belief": {"particles": {"size": size}},
            "motion": {"random_walk": {"sd_px": {"x": ROOT_SD, "y": ROOT_SD}}},
            "estimate": "mean",
            "ud_fields": ["x", "y"],
        },
        "torso": part("torso", "person", moves),
        "badge": part("badge", "torso", moves),
        "shirt": "torso",
        "name": "badge",
    }


def rows_seen(seed=4):
    """Frame -> where the rows of torso and badge are seen; the badge is hidden in frames 5 to 8."""
    rng = np.random.default_rng(seed)
    torso = START[1] + OFFSETS["torso"] * START[3] + np.cumsum(rng.normal(0.0, 3.0, FRAMES + 1))
    badge = torso + OFFSETS["badge"] * SHAPE["torso"] + 4.0 + rng.normal(0.0, 2.0, FRAMES + 1)
    return {"torso": torso, "badge": badge}


def is_hidden(name, frame):
    return name == "badge" and 5 <= frame <= 8


def played(fakes, size, moves=True):
    seen = rows_seen()

    def sees(name):
        def see(planes, h, reference):
            frame = planes.frame.index
            if is_hidden(name, frame):
                return np.full(len(h), np.log(0.02))
            log = -0.5 * ((h.boxes[:, 1] - seen[name][frame]) / SEEN_SD[name]) ** 2
            return log - 0.5 * ((h.boxes[:, 0] - START[0]) / SEEN_SD[name]) ** 2

        return see

    engine, _ = fakes.engine(nodes(size, moves), {"shirt": sees("torso"), "name": sees("badge")})
    return fakes.play(engine, FRAMES, {"1": START})


def kalman():
    """Frame -> mean and covariance of the rows of whole, torso and badge: (whole, deviation, deviation)."""
    seen = rows_seen()
    kept = {name: np.sqrt(1.0 - (STEP[name] / GIVEN[name]) ** 2) for name in STEP}
    move = np.diag([1.0, kept["torso"], kept["badge"]])
    noise = np.diag([ROOT_SD**2, STEP["torso"] ** 2, STEP["badge"] ** 2])
    at = START[1] + OFFSETS["torso"] * START[3]
    places = np.array([0.0, at - START[1], at - START[1] + OFFSETS["badge"] * SHAPE["torso"]])
    to_rows = np.array([[1.0, 0.0, 0.0], [1.0, 1.0, 0.0], [1.0, 1.0, 1.0]])
    mean, covariance = np.array([START[1], 0.0, 0.0]), np.zeros((3, 3))
    for frame in range(1, FRAMES + 1):
        mean, covariance = move @ mean, move @ covariance @ move.T + noise
        for k, name in ((1, "torso"), (2, "badge")):
            if is_hidden(name, frame):
                continue
            row = to_rows[k]
            gain = covariance @ row / (row @ covariance @ row + SEEN_SD[name] ** 2)
            mean = mean + gain * (seen[name][frame] - places[k] - row @ mean)
            covariance = covariance - np.outer(gain, row @ covariance)
        yield frame, to_rows @ mean + places, to_rows @ covariance @ to_rows.T


@pytest.mark.slow
def test_three_levels_have_the_posterior_of_a_kalman_filter_over_the_joint_state(fakes):
    """20,000 particles, of which some 2,000 are effective in each of 12 frames: means and sds within 10 % of
    an sd, which is 4.5 standard errors.
    """
    outcomes = played(fakes, 20_000)
    for frame, mean, covariance in kalman():
        (line,) = outcomes[frame].metrics
        sds = np.sqrt(np.diag(covariance))
        found = [line.centre_box[1], *(line.parts[name].centre_box[1] for name in ("torso", "badge"))]
        spread = [line.sd[1], *(line.parts[name].sd[1] for name in ("torso", "badge"))]
        np.testing.assert_allclose(found, mean, atol=0.1 * sds.max(), err_msg=str(frame))
        np.testing.assert_allclose(spread, sds, rtol=0.1, err_msg=str(frame))


@pytest.mark.slow
def test_a_deviation_is_remembered_while_the_part_is_hidden(fakes):
    """Drawn anew in each frame, a hidden badge is back in its place at once; here it is still away."""
    remembered, anew = (played(fakes, 3_000, moves)[5].metrics[0].parts["badge"] for moves in (True, False))
    (_, mean, covariance) = next(one for one in kalman() if one[0] == 5)
    assert abs(remembered.centre_box[1] - mean[2]) < 0.35 * np.sqrt(covariance[2, 2])
    assert anew.sd[1] > 1.2 * remembered.sd[1]


@pytest.mark.parametrize(("sd", "step"), [(5.0, 2.0), (3.0, 3.0)])
def test_two_half_steps_are_one_and_the_long_run_is_what_given_says(sd, step):
    one = Deviation("head.x", sd, step)
    kept, added = one.over(1.0)
    half, half_added = one.over(0.5)
    assert half**2 == pytest.approx(kept)
    assert half_added**2 * (1 + half**2) == pytest.approx(added**2)
    assert kept**2 * sd**2 + added**2 == pytest.approx(sd**2) and added == pytest.approx(step)
