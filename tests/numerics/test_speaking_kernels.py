"""Messages between targets: products of what several say, and what follows of it."""

import numpy as np

from bayesnet_track.numerics.kernels.speaking_kernels import conclude, together

SAID = np.random.default_rng(0).random((4, 9))
AT = np.array([0, 3, 6])


def test_at_most_one_of_those_who_speak_hides_a_target():
    free, taken = together(SAID, AT, np.array([0, 2]), 3)
    (one, other) = SAID[:, :3], SAID[:, 6:]
    clear, more = one[0] + one[1], other[0] + other[1]
    np.testing.assert_allclose(free, clear * more, rtol=1e-14)
    np.testing.assert_allclose(taken, one[2] * more + clear * other[2], rtol=1e-14)
    nothing = together(SAID, AT, np.array([], dtype=np.int64), 3)
    assert nothing[0].tolist() == [1.0] * 3 and nothing[1].tolist() == [0.0] * 3


def test_a_target_weighs_all_that_is_said_of_it():
    rng = np.random.default_rng(1)
    log, seen = rng.normal(size=7), rng.random(7)
    starts, heard = np.array([0, 3, 7]), (np.array([0, 3, 3]), np.array([0, 1, 2]))
    after, hidden, fronts = conclude(log, seen, starts, AT, heard, SAID)
    assert after[3:].tolist() == log[3:].tolist(), "nobody speaks of the second"
    free, taken = together(SAID, AT, np.array([0, 1, 2]), 3)
    np.testing.assert_allclose(after[:3], log[:3] + np.log(free + taken), rtol=1e-14)
    for k in range(3):
        rest, rest_taken = together(SAID, AT, np.array([one for one in range(3) if one != k]), 3)
        own = SAID[:, 3 * k : 3 * k + 3]
        np.testing.assert_allclose(hidden[k], seen[:3] @ (rest * own[3]) / (seen[:3] @ (free + taken)))
        front = seen[:3] @ ((rest + rest_taken) * own[0])
        behind = seen[:3] @ ((rest + rest_taken) * own[1] + rest * own[2])
        np.testing.assert_allclose(fronts[k], front / (front + behind))
