"""Probabilities of existence against enumeration, and estimates against what was drawn."""

from itertools import product

import numpy as np
import pytest

from bayesnet_track.adapt.existence import DetectionModel, Expected, Pairs, UnconfirmedTracks, share
from bayesnet_track.adapt.presence import UNSEEN
from bayesnet_track.graph.spec import Existence


def enumerated(r, d, likelihoods, nobody):
    """Existence (T,) and pairs (T, N) by going through who exists, who is detected, and as what."""
    count, found = likelihoods.shape
    total, exists, pairs = 0.0, np.zeros(count), np.zeros((count, found))
    states = [None, "missed", *range(found)]  # of a target: not there, there and missed, detected as ...
    for chosen in product(states, repeat=count):
        taken = [one for one in chosen if isinstance(one, int)]
        if len(set(taken)) < len(taken):
            continue
        p = np.prod([nobody[n] for n in range(found) if n not in taken])
        for t, one in enumerate(chosen):
            p *= 1 - r[t] if one is None else r[t] * (1 - d[t] if one == "missed" else d[t])
            p *= likelihoods[t, one] if isinstance(one, int) else 1.0
        total += p
        for t, one in enumerate(chosen):
            exists[t] += p * (one is not None)
            if isinstance(one, int):
                pairs[t, one] += p
    return exists / total, pairs / total


@pytest.mark.parametrize("seed", range(6))
def test_sharing_is_what_enumeration_gives(seed):
    rng = np.random.default_rng(seed)
    r, d = rng.uniform(0.05, 0.999, 3), rng.uniform(0.1, 0.95, 3)
    likelihoods, nobody = np.exp(rng.normal(-3, 3, (3, 3))), np.exp(rng.normal(-4, 1, 3))
    rows, columns = (one.ravel() for one in np.indices((3, 3)))
    given = Pairs(rows, columns, np.log(likelihoods).ravel())
    found = share(Expected(r, d), given, np.log(nobody))
    exists, pairs = enumerated(r, d, likelihoods, nobody)
    np.testing.assert_allclose(found.existence, exists, rtol=1e-7)
    np.testing.assert_allclose(found.free, 1 - pairs.sum(axis=0), atol=1e-9)
    np.testing.assert_allclose(found.seen, pairs.sum(axis=1), atol=1e-9)
    own = np.zeros((3, 3))
    own[found.pairs.rows, found.pairs.columns] = found.pairs.values
    np.testing.assert_allclose(own, pairs / exists[:, None], atol=1.001e-3)  # less is left out
    np.testing.assert_allclose(own.sum(axis=1) + found.missed, 1.0, atol=1e-9)


def test_a_miss_counts_by_how_surely_it_would_have_been_a_detection():
    nothing = Pairs(np.empty(0, int), np.empty(0, int), np.empty(0))
    found = share(Expected(np.array([0.9, 0.9, 0.9]), np.array([0.9, 0.4, 0.0])), nothing, np.empty(0))
    np.testing.assert_allclose(found.existence, [0.09 / 0.19, 0.54 / 0.64, 0.9], rtol=1e-6)
    assert found.missed.tolist() == [1, 1, 1]


def test_who_certainly_exists_is_not_lost_by_rounding():
    pair = Pairs(np.array([0]), np.array([0]), np.array([800.0]))
    found = share(Expected(np.ones(1), np.ones(1)), pair, np.zeros(1))
    assert found.existence[0] == pytest.approx(1.0) and found.free[0] == pytest.approx(0.0, abs=1e-12)


def test_clutter_and_detection_are_estimated():
    rng, detection_model = np.random.default_rng(0), DetectionModel(UnconfirmedTracks.none(8))
    for _ in range(400):
        cover = np.repeat([0.0, 1.0], [20, 5])
        seen = rng.random(25) < np.where(cover, 0.3, 0.7)
        detection_model = detection_model.after_look(rng.poisson(7.0)).after_chances(cover, seen, np.ones(25))
    rule = Existence()
    # sds of the means over the last 100 frames and 2000 chances: .26 and .01
    assert detection_model.clutter_rate(rule) == pytest.approx(7.0, abs=1.1)
    chain = detection_model.chain(rule)
    in_the_open = chain.detection * (1 - chain.blind_share)
    assert in_the_open == pytest.approx(0.7, abs=0.05)
    hidden = detection_model.share_hidden(rule)
    assert (1 - hidden) * in_the_open + hidden * UNSEEN == pytest.approx(0.3, abs=0.05)
    fixed = Existence(clutter=3.0, detection=0.6, covered=0.5)
    chain = detection_model.chain(fixed)
    assert detection_model.clutter_rate(fixed) == 3.0
    assert chain.detection * (1 - chain.blind_share) == pytest.approx(0.6)
    assert detection_model.share_hidden(fixed) == pytest.approx(0.1 / 0.55)
    assert (
        detection_model.share_hidden(Existence(detection=0.2, covered=0.5)) == 0.0
    )  # no surer than in the open
    assert detection_model.new_share(Existence(clutter=0.9, births=0.1)) == pytest.approx(0.1)


def test_sizes_have_a_density_that_integrates_to_one():
    rng = np.random.default_rng(1)
    heights = rng.uniform(60, 100, 200)
    boxes = np.column_stack([np.zeros((200, 2)), 0.4 * heights, heights])
    detection_model = DetectionModel(UnconfirmedTracks.none(8))
    for k in range(0, 200, 10):
        detection_model = detection_model.with_sizes(boxes[k : k + 10])
    w, h = np.meshgrid(np.arange(5.0, 80, 0.5), np.arange(20.0, 240, 0.5))
    grid = np.column_stack([np.zeros((w.size, 2)), w.ravel(), h.ravel()])
    assert np.exp(detection_model.log_density(grid, 1000.0)).sum() * 0.25 * 1000 == pytest.approx(
        1.0, abs=0.02
    )
    usual, odd = np.array([[0, 0, 32, 80.0]]), np.array([[0, 0, 80, 32.0]])
    assert detection_model.log_density(usual, 1.0)[0] > detection_model.log_density(odd, 1.0)[0] + 10
    assert detection_model.with_sizes(np.empty((0, 4))) is detection_model
