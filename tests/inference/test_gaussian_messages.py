"""Gaussian messages: exact powers, products and widenings, silence, faults, one question a frame."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from bayesnet_track.belief.contract import BOX_FIELDS, Step
from bayesnet_track.belief.particles.belief import ParticleSet
from bayesnet_track.inference.gaussian_messages import measurement_message
from bayesnet_track.inference.measure import measure
from bayesnet_track.inference.messages import evaluate, without
from bayesnet_track.numerics.log_weights import LogWeights
from bayesnet_track.observation.cue import Hypotheses, Measurement

BOXES = np.array([[10.0 * k, 5.0 + k, 4.0 + k, 4.0] for k in range(5)])
PRODUCT = {"root": {"fuse": "product"}, "m": "root", "a": "root"}
POOL = {
    "root": {"fuse": "product"},
    "pool": {"parent": "root", "fuse": {"pool": {"m": 3.0, "k": 1.0, "a": 2.0}}},
    **dict.fromkeys("mka", "pool"),
    "b": "root",
}
GIVEN = {"sd_px": {"x": 6.0, "y": 6.0}}


def latent(belief=None, given_=None, **more):
    node = {"parent": "root", "fuse": {"latent": {"given": given_ or GIVEN, **more}}}
    return node if belief is None else {**node, "belief": belief}


def squares(x, y, sd):
    return -0.5 * ((BOXES[:, 0] - x) ** 2 + (BOXES[:, 1] - y) ** 2) / sd**2


def values(log):
    return lambda planes, hypotheses, reference: np.asarray(log, dtype=np.float64)


OTHER = np.array([-1.0, -0.5, 0.0, -2.0, -3.0])

# ------------------------------------------------------------------------------------ exact values


def test_a_measurement_is_a_likelihood_of_peak_1_over_its_floor(asked, measuring):
    _, sharp = asked(PRODUCT, {"m": measuring.place(20.0, 7.0), "a": values(OTHER)}, BOXES)
    np.testing.assert_allclose(sharp.messages["m"], squares(20.0, 7.0, 3.0), rtol=1e-12, atol=1e-14)
    assert sharp.messages["m"][2] == 0.0
    np.testing.assert_allclose(sharp.log_likelihood, squares(20.0, 7.0, 3.0) + OTHER, rtol=1e-12)
    _, robust = asked(PRODUCT, {"m": measuring.place(20.0, 7.0, floor=0.1), "a": values(OTHER)}, BOXES)
    np.testing.assert_allclose(
        robust.messages["m"], np.log(0.1 + 0.9 * np.exp(squares(20.0, 7.0, 3.0))), rtol=1e-12, atol=1e-14
    )


def test_choices_are_a_mixture_with_none_of_them(asked, measuring):
    places = (20.0, 7.0), (30.0, 8.0)
    first, second = (Measurement(("x", "y"), np.array(at), 9.0 * np.eye(2)) for at in places)
    several = replace(first, choices=((0.5, first), (0.3, second)))
    _, found = asked(PRODUCT, {"m": measuring.Measurer(lambda *_: several), "a": values(OTHER)}, BOXES)
    expected = np.log(0.2 + 0.5 * np.exp(squares(20.0, 7.0, 3.0)) + 0.3 * np.exp(squares(30.0, 8.0, 3.0)))
    np.testing.assert_allclose(found.messages["m"], expected, rtol=1e-12)
    assert found.gaussians["m"].missed == pytest.approx(0.2)


def test_correlated_fields_of_the_box_and_beyond(fakes):
    h = Hypotheses(BOXES, {"vx": np.arange(5.0)})
    covariance = np.array([[4.0, 1.0, -0.5], [1.0, 2.0, 0.3], [-0.5, 0.3, 1.5]])
    one = Measurement(("vx", "y", "w"), np.array([1.5, 6.0, 5.0]), covariance)
    away = np.column_stack([h.fields["vx"], BOXES[:, 1], BOXES[:, 2]]) - one.mean
    expected = [-0.5 * row @ np.linalg.solve(covariance, row) for row in away]
    np.testing.assert_allclose(measurement_message(one, h), expected, rtol=1e-12)


def test_it_reaches_the_root_as_it_is_through_products(asked, measuring):
    nodes = {**PRODUCT, "n": {"parent": "root", "fuse": "product"}, "m": "n", "k": "n"}
    sees = {"m": measuring.place(20.0, 7.0), "k": measuring.place(22.0, 6.0, 5.0), "a": values(OTHER)}
    _, evidence = asked(nodes, sees, BOXES)
    assert evidence.gaussians.keys() == {"m", "k"}
    np.testing.assert_array_equal(evidence.gaussians["m"].covariance, 9.0 * np.eye(2))
    np.testing.assert_array_equal(evidence.gaussians["k"].mean, [22.0, 6.0])
    np.testing.assert_array_equal(evidence.sampled, OTHER)
    np.testing.assert_allclose(
        evidence.log_likelihood, squares(20, 7, 3) + squares(22, 6, 5) + OTHER, rtol=1e-12
    )


@pytest.mark.parametrize(
    ("active", "powers"),
    [("mkab", {"m": 1 / 2, "k": 1 / 6, "a": 1 / 3}), ("mab", {"m": 0.6, "a": 0.4}), ("mb", {"m": 1.0})],
)
def test_a_pool_divides_the_covariance_by_the_power_over_present_children(asked, measuring, active, powers):
    sees = {
        "m": measuring.place(20.0, 7.0, 3.0, 0.01),
        "k": measuring.place(11.0, 6.0, 2.0),
        "a": values(OTHER),
        "b": values(2 * OTHER),
    }
    _, evidence = asked(POOL, sees, BOXES, active=active)
    assert evidence.gaussians.keys() == set(powers) & {"m", "k"}
    for agent, sd, floor in (("m", 3.0, 0.01), ("k", 2.0, 0.0)):
        if agent in powers:
            reached = evidence.gaussians[agent]
            np.testing.assert_allclose(reached.covariance, sd**2 / powers[agent] * np.eye(2), rtol=1e-12)
            assert reached.floor == pytest.approx(floor ** powers[agent])
    rest = powers.get("a", 0.0) * OTHER + 2 * OTHER
    np.testing.assert_allclose(evidence.sampled, rest, rtol=1e-12)
    said = sum(powers[c] * evidence.messages[c] for c in powers) + 2 * OTHER
    np.testing.assert_allclose(evidence.log_likelihood, said, rtol=1e-12)


@given(data=st.data())
def test_gaussians_and_the_rest_are_the_whole_in_any_tree(fakes, measuring, asked, data):
    """The net's log-likelihood is `sampled` plus the Gaussian messages as they reach the root."""
    inner = data.draw(st.integers(1, 4))
    nodes = {"n0": {"fuse": data.draw(st.sampled_from(["product", "pool"]))}}
    for k in range(1, inner):
        parent = f"n{data.draw(st.integers(0, k - 1))}"
        nodes[f"n{k}"] = {"parent": parent, "fuse": data.draw(st.sampled_from(["product", "pool"]))}
    homes = [*nodes, *data.draw(st.lists(st.sampled_from(sorted(nodes)), max_size=4))]
    kinds = st.sampled_from(["place", "nothing", "sampled"])
    sees = {}
    for k, home in enumerate(homes):
        nodes[f"a{k}"] = home
        kind = data.draw(kinds)
        sees[f"a{k}"] = {
            "place": measuring.place(5.0 * k, 6.0, 2.0 + k),
            "nothing": measuring.nothing(),
            "sampled": values(OTHER * (k + 1)),
        }[kind]
    _, evidence = asked(nodes, sees, BOXES)
    total = np.zeros(5) if evidence.sampled is None else evidence.sampled
    for one in evidence.gaussians.values():
        total = total + measurement_message(one, Hypotheses(BOXES))
    if evidence.sampled is not None:
        np.testing.assert_allclose(evidence.log_likelihood, total, rtol=1e-10, atol=1e-12)
    else:
        assert not evidence.gaussians
    # and the silent ones do not count in any pool: the net compiled without them says the same
    speaking = [agent for agent in sees if evidence.measured.get(agent, 0) is not None]
    _, alone = asked(nodes, sees, BOXES, active=speaking)
    np.testing.assert_allclose(evidence.log_likelihood, alone.log_likelihood, rtol=1e-12, atol=1e-14)


# ------------------------------------------------------------------------------------ silence and faults


def test_an_agent_that_sees_nothing_is_left_out_of_the_pool(asked, measuring):
    sees = {"m": measuring.nothing(), "a": values(OTHER)}
    nodes = {"root": {"fuse": "pool"}, "m": "root", "a": "root"}
    plan, evidence = asked(nodes, sees, BOXES)
    np.testing.assert_array_equal(evidence.log_likelihood, OTHER)  # not OTHER / 2
    np.testing.assert_array_equal(evidence.messages["m"], np.zeros(5))
    assert evidence.measured == {"m": None} and not evidence.faults
    assert not evidence.gaussians and evidence.sampled is None
    left = without(plan, evidence, "a", Hypotheses(BOXES), np.full(5, -np.log(5)))
    assert "root" not in left  # nobody is left who says anything


def test_nobody_sees_anything(asked, measuring):
    _, evidence = asked({"root": {}, "m": "root"}, {"m": measuring.nothing()}, BOXES)
    np.testing.assert_array_equal(evidence.log_likelihood, np.zeros(5))
    assert evidence.sampled is None and not evidence.gaussians


REAL = "not a Measurement of real numbers or None"
GOOD = Measurement(("x", "y"), np.array([1.0, 2.0]), np.eye(2))
FAULTS = {
    "another type": (np.zeros(2), "returned a ndarray, not a Measurement of real numbers or None"),
    "no field": (replace(GOOD, fields=()), "measured nothing; the hypotheses have x, y, w, h"),
    "unknown": (replace(GOOD, fields=("x", "vx")), "measured vx; the hypotheses have x, y, w, h"),
    "twice": (replace(GOOD, fields=("x", "x")), "measured a field twice: x, x"),
    "mean": (replace(GOOD, mean=np.zeros(3)), "measured 2 fields by arrays of shape (3,) and (2, 2)"),
    "covariance": (
        replace(GOOD, covariance=np.ones(2)),
        "measured 2 fields by arrays of shape (2,) and (2,)",
    ),
    "choices of other fields": (
        replace(GOOD, choices=((0.5, Measurement(("x",), np.zeros(1), np.eye(1))),)),
        "measured choices that are no measurements of the same fields",
    ),
    "too many choices": (
        replace(GOOD, choices=((0.8, GOOD), (0.7, GOOD))),
        "measured choices with probabilities that sum to 1.5",
    ),
    "NaN": (replace(GOOD, mean=np.array([np.nan, 0.0])), "measured a place that is not finite"),
    "infinite": (replace(GOOD, covariance=np.diag([np.inf, 1.0])), "measured a place that is not finite"),
    "asymmetric": (
        replace(GOOD, covariance=np.array([[1.0, 0.5], [0.0, 1.0]])),
        "measured a covariance that is not symmetric and positive definite",
    ),
    "singular": (
        replace(GOOD, covariance=np.ones((2, 2))),
        "measured a covariance that is not symmetric and positive definite",
    ),
    "tiny": (
        replace(GOOD, covariance=1e-320 * np.eye(2)),
        "measured a covariance too small to be inverted",
    ),
    "negative floor": (replace(GOOD, floor=-0.1), "measured with a floor of -0.1, not in 0..1"),
    "floor NaN": (replace(GOOD, floor=float("nan")), "measured with a floor of nan, not in 0..1"),
    "floor 1": (replace(GOOD, floor=1.0), "measured with a floor of 1, not in 0..1"),
    "confidence above 1": (
        replace(GOOD, confidence=1.5),
        "measured with a confidence of 1.5, not in 0..1",
    ),
    "confidence NaN": (
        replace(GOOD, confidence=float("nan")),
        "measured with a confidence of nan, not in 0..1",
    ),
    **{
        f"{part} {kind}": (
            replace(GOOD, **{part: value}),
            f"returned a Measurement whose {part} is of type {kind}, {REAL}",
        )
        for part, value, kind in (
            ("mean", np.array(["a", "b"]), "array of <U1"),
            ("mean", np.array([1.0, 2j]), "array of complex128"),
            ("mean", np.ma.masked_invalid([1.0, 2.0]), "masked array"),
            ("covariance", np.eye(2).astype(object), "array of object"),
            ("floor", "low", "array of <U3"),
            ("floor", None, "NoneType"),
            ("confidence", "high", "array of <U4"),
        )
    },
}


@pytest.mark.parametrize("fault", FAULTS)
def test_a_faulty_measurement_leaves_no_trace_but_its_name(fakes, asked, measuring, fault):
    wrong, said = FAULTS[fault]
    sees = {"m": measuring.Measurer(lambda h, w: wrong), "a": fakes.Oracle(values(OTHER))}
    observer = fakes.observer(sees)
    _, evidence = asked(PRODUCT, sees, BOXES, observer=observer)
    assert set(observer.faults) == {"m"}
    assert observer.faults["m"].split(":")[0] == said.split(":")[0]
    assert observer.faults["m"] == said or fault == "text"
    np.testing.assert_array_equal(evidence.log_likelihood, OTHER)
    assert "m" not in evidence.messages and "m" not in evidence.measured and not evidence.gaussians


def test_one_that_raises_or_meddles(fakes, asked, measuring):
    def meddling(hypotheses, weights):
        hypotheses.boxes[:] = 0.0
        weights[:] = np.nan
        raise ZeroDivisionError("nothing there")

    sees = {"m": measuring.Measurer(meddling), "a": fakes.Oracle(values(OTHER))}
    observer = fakes.observer(sees)
    _, evidence = asked(PRODUCT, sees, BOXES.copy(), observer=observer)
    assert observer.faults == {"m": "raised ZeroDivisionError: nothing there"}
    np.testing.assert_array_equal(evidence.log_likelihood, OTHER)


def test_a_place_beyond_all_numbers_is_no_match_without_a_warning(asked, measuring):
    for spread in (1e-200 * np.eye(2), 1e-300 * np.array([[2.0, 1.0], [1.0, 2.0]])):
        far = Measurement(("x", "y"), np.array([1e200, -1e200]), spread)
        _, evidence = asked(
            PRODUCT, {"m": measuring.Measurer(lambda h, w, o=far: o), "a": values(OTHER)}, BOXES
        )
        assert np.isfinite(evidence.log_likelihood).all() and (evidence.log_likelihood < -1e100).all()


# ------------------------------------------------------------------------------------ once a frame


def test_it_is_asked_once_a_frame_with_the_first_hypotheses(fakes, asked, measuring):
    cue = measuring.Measurer(
        lambda h, w: Measurement(("x", "y"), w @ h.boxes[:, :2], np.eye(2))  # depends on who asks
    )
    observer = fakes.observer({"m": cue, "a": fakes.Oracle(values(OTHER))})
    beta = np.log([0.1, 0.3, 0.2, 0.25, 0.15])
    _, first = asked(PRODUCT, {"m": cue, "a": values(OTHER)}, BOXES, beta, observer=observer)
    _, second = asked(PRODUCT, {"m": cue, "a": values(OTHER)}, BOXES + 3.0, observer=observer)
    assert len(cue.asked) == 1
    np.testing.assert_allclose(cue.asked[0][1], np.exp(beta))
    np.testing.assert_array_equal(first.gaussians["m"].mean, second.gaussians["m"].mean)
    np.testing.assert_allclose(
        second.messages["m"], measurement_message(first.gaussians["m"], Hypotheses(BOXES + 3.0))
    )
    asked(PRODUCT, {"m": cue, "a": values(OTHER)}, BOXES)  # another frame
    assert len(cue.asked) == 2


def test_silence_and_faults_hold_for_the_frame_too(fakes, asked, measuring):
    for see in (lambda h, w: None, lambda h, w: 7):
        cue = measuring.Measurer(see)
        observer = fakes.observer({"m": cue})
        outcomes = [
            asked({"root": {}, "m": "root"}, {"m": cue}, BOXES, observer=observer)[1] for _ in range(2)
        ]
        assert len(cue.asked) == 1
        assert outcomes[0].faults == outcomes[1].faults and outcomes[0].measured == outcomes[1].measured


def test_it_looks_where_its_latent_node_is(asked, measuring):
    cue = measuring.place(20.0, 7.0)
    _, evidence = asked({"root": {}, "part": latent(), "m": "part"}, {"m": cue}, BOXES)
    np.testing.assert_array_equal(cue.asked[0][0], evidence.latent["part"].boxes)


# ------------------------------------------------------------------------------------ latent nodes


@pytest.mark.parametrize("draw", ["one", "kernel"])
def test_under_a_latent_node_of_particles_it_is_sampled(asked, measuring, draw):
    nodes = {"root": {"fuse": "product"}, "part": latent(draw=draw), "m": "part", "a": "root"}
    _, evidence = asked(nodes, {"m": measuring.place(20.0, 7.0), "a": values(OTHER)}, BOXES)
    assert not evidence.gaussians and evidence.sampled is None
    assert evidence.measured.keys() == {"m"}
    own = evidence.latent["part"]
    np.testing.assert_array_equal(evidence.messages["m"], measurement_message(evidence.measured["m"], own))


def cloud(n, seed=3, sd=20.0):
    rng = np.random.default_rng(seed)
    return np.column_stack([rng.normal(50.0, sd, (n, 2)), np.full((n, 2), 8.0)])


def test_a_gaussian_latent_node_widens_a_measurement_exactly(asked, measuring):
    """integral of N(c; h, 36) exp(-(c - z)^2 / (2 9)) dc is Gaussian with variance 45, whatever the draws."""
    nodes = {"root": {"fuse": "product"}, "part": latent("gaussian"), "m": "part", "a": "root"}
    boxes = cloud(300)
    sees = {"m": measuring.place(61.0, 42.0), "a": lambda p, h, r: -0.01 * (h.boxes[:, 0] + 99.0)}
    _, evidence = asked(nodes, sees, boxes)
    assert evidence.gaussians.keys() == {"part"}
    one = evidence.gaussians["part"]
    assert one.fields == ("x", "y") and one.floor == 0.0
    np.testing.assert_allclose(one.mean, [61.0, 42.0], rtol=1e-9)
    np.testing.assert_allclose(one.covariance, 45.0 * np.eye(2), rtol=1e-9, atol=1e-9)
    shape = measurement_message(one, Hypotheses(boxes))
    scale = evidence.messages["part"] - shape
    np.testing.assert_allclose(scale, scale[0], rtol=1e-9)
    np.testing.assert_allclose(evidence.sampled, -0.01 * (boxes[:, 0] + 99.0) + scale[0], rtol=1e-9)
    # the scale is the true integral's, |9 / 45|, up to the draws' error: few of them lie near
    assert abs(scale[0] - np.log(9.0 / 45.0)) < 4.0 / np.sqrt(300 * 9.0 / 436.0)


def test_measurements_below_multiply_in_information_form(asked, measuring):
    """A pool of two below the latent node, and the latent node itself in a pool above: 2/3 of its power."""
    nodes = {
        "root": {"fuse": {"pool": {"part": 2.0, "a": 1.0}}},
        "part": latent("gaussian"),
        "pool": {"parent": "part", "fuse": {"pool": {"m": 3.0, "k": 1.0}}},
        "m": "pool",
        "k": "pool",
        "a": "root",
    }
    sees = {
        "m": measuring.place(61.0, 42.0, 3.0, 0.01),
        "k": measuring.place(55.0, 44.0, 4.0, 0.02),
        "a": values(np.zeros(200)),
    }
    _, evidence = asked(nodes, sees, cloud(200))
    precision = np.array([0.75 / 9.0, 0.25 / 16.0])
    mean = (precision[0] * np.array([61.0, 42.0]) + precision[1] * np.array([55.0, 44.0])) / precision.sum()
    one = evidence.gaussians["part"]
    np.testing.assert_allclose(one.mean, mean, rtol=1e-9)
    np.testing.assert_allclose(
        one.covariance, 1.5 * (1.0 / precision.sum() + 36.0) * np.eye(2), rtol=1e-9, atol=1e-9
    )
    assert one.floor == pytest.approx((0.01**0.75 * 0.02**0.25) ** (2 / 3))


def test_gaussian_latent_nodes_one_below_the_other(asked, measuring):
    inner = {
        "parent": "part",
        "belief": "gaussian",
        "fuse": {"latent": {"given": {"sd_px": {"x": 2, "y": 4}}}},
    }
    nodes = {"root": {}, "part": latent("gaussian"), "inner": inner, "m": "inner"}
    _, evidence = asked(nodes, {"m": measuring.place(61.0, 42.0)}, cloud(200))
    assert evidence.gaussians.keys() == {"part"}
    np.testing.assert_allclose(
        evidence.gaussians["part"].covariance, np.diag([9.0 + 4 + 36, 9.0 + 16 + 36]), rtol=1e-9, atol=1e-9
    )


def test_moments_of_a_gaussian_likelihood_are_matched(asked, fakes):
    """A Gaussian likelihood of sd 9 about 11 px off, from 40 000 draws: its mean within 4 standard errors.

    Some share 81 / 436 of the draws is effective; precision is a difference, so its error grows a little.
    """
    n = 40_000
    nodes = {"root": {}, "part": latent("gaussian"), "a": "part"}
    _, evidence = asked(nodes, {"a": fakes.gaussian(61.0, 42.0, 9.0)}, cloud(n))
    one = evidence.gaussians["part"]
    error = 9.0 / np.sqrt(n * 81.0 / 436.0)
    assert abs(one.mean - [61.0, 42.0]).max() < 4.0 * 1.25 * error
    allowed = 4.0 * 81.0 * np.sqrt(2.0 / (n * 81.0 / 436.0)) * 1.5
    assert abs(np.diag(one.covariance) - (81.0 + 36.0)).max() < allowed
    assert abs(one.covariance[0, 1]) < allowed


def test_a_mixed_node_takes_the_measurement_exactly_and_the_rest_by_moments(asked, fakes, measuring):
    n = 20_000
    nodes = {"root": {}, "part": {**latent("gaussian")}, "m": "part", "a": "part"}
    sees = {"m": measuring.place(61.0, 42.0, 1.0), "a": fakes.gaussian(50.0, 50.0, 15.0)}
    _, evidence = asked(nodes, sees, cloud(n))
    precision = 1.0 + 1.0 / 225.0
    one = evidence.gaussians["part"]
    np.testing.assert_allclose(np.diag(one.covariance), 1.0 / precision + 36.0, rtol=1e-3)
    np.testing.assert_allclose(one.mean, [61.0 - 11.0 / 226, 42.0 + 8.0 / 226], atol=0.01)


def test_a_flat_or_bimodal_likelihood_stays_a_likelihood(asked, fakes):
    """The posterior is wider than the prior: the precision is kept from becoming negative."""
    nodes = {"root": {}, "part": latent("gaussian"), "a": "part"}

    def ring(planes, h, reference):
        away = np.hypot(h.boxes[:, 0] - 50.0, h.boxes[:, 1] - 50.0)
        return -0.5 * (away - 60.0) ** 2 / 25.0

    for see in (ring, fakes.flat(-2.0)):
        _, evidence = asked(nodes, {"a": see}, cloud(2000))
        assert not evidence.gaussians and evidence.sampled is None
        np.testing.assert_allclose(evidence.messages["part"], evidence.log_likelihood[0], rtol=1e-9)
        np.testing.assert_allclose(
            evidence.log_likelihood[0], np.log(np.mean(np.exp(evidence.messages["a"]))), rtol=1e-9
        )


def test_sizes_that_change_together_and_zero_weights(asked, fakes):
    """Noise in the logarithm of the size moves w and h as one; dead hypotheses carry no moments."""
    rng = np.random.default_rng(2)
    boxes = cloud(400)
    boxes[:, 2:] *= np.exp(rng.normal(0.0, 0.1, (400, 1)))
    beta = np.where(np.arange(400) < 100, -np.inf, -np.log(300))
    nodes = {"root": {}, "part": latent("gaussian", {**GIVEN, "sd_log": {"scale": 0.05}}), "a": "part"}

    def see(planes, h, reference):
        return -0.5 * (
            (h.boxes[:, 2] - 8.5) ** 2 / 0.3**2 + np.sum((h.boxes[:, :2] - 55) ** 2, axis=1) / 99.0
        )

    _, evidence = asked(nodes, {"a": see}, boxes, beta)
    one = evidence.gaussians["part"]
    assert one.fields == BOX_FIELDS
    assert np.linalg.eigvalsh(one.covariance).min() > 0
    assert abs(one.mean[2] - 8.5) < 0.3 and abs(one.mean[3] - 8.5) < 0.3
    assert np.isfinite(evidence.log_likelihood).all()


def test_no_draw_is_likely(asked, fakes):
    nodes = {"root": {"fuse": "product"}, "part": latent("gaussian"), "a": "part", "b": "part"}
    half = np.where(np.arange(40) < 20, -np.inf, 0.0)
    _, evidence = asked(nodes, {"a": values(half), "b": values(half[::-1])}, cloud(40))
    assert (evidence.log_likelihood == -np.inf).all() and not evidence.gaussians


# ------------------------------------------------------------------------------------ measures


def step_of(evidence, boxes, beta):
    prior = LogWeights.normalise(beta)[0]
    weights, log_evidence = prior.times(evidence.log_likelihood)
    posterior = ParticleSet(boxes, BOX_FIELDS, weights)
    return Step(posterior, log_evidence, posterior, prior, evidence, lambda: boxes[np.argmax(weights.log)])


def measures_of(fakes, asked, nodes, sees, active=None):
    plan, evidence = asked(nodes, sees, BOXES, active=active)
    step = step_of(evidence, BOXES, np.full(5, -np.log(5)))
    return measure(fakes.plate(nodes)[0], plan, step, 16.0), evidence


def test_measures_are_those_of_an_agent_that_scores_the_same(fakes, asked, measuring):
    """UD, KL, contribution, strength and fit cannot tell a measurement from the likelihood it stands for."""
    nodes = {"root": {"fuse": "product"}, **dict.fromkeys("mab", "root")}
    others = {"a": values(OTHER), "b": values(OTHER[::-1])}
    one, _ = measures_of(fakes, asked, nodes, {"m": measuring.place(20.0, 7.0, 9.0, 0.02), **others})
    log = np.log(0.02 + 0.98 * np.exp(squares(20.0, 7.0, 9.0)))
    other, _ = measures_of(fakes, asked, nodes, {"m": values(log), **others})
    for name in ("ud_px2", "agent_ud_px2", "kl", "contribution", "strength"):
        assert getattr(one, name) == pytest.approx(getattr(other, name), rel=1e-9), name
    assert one.fit == pytest.approx(other.fit, rel=1e-9)


def test_measures_of_an_agent_that_saw_nothing(fakes, asked, measuring):
    """It adds nothing: no strength, no contribution, the prior's own UD; the fit is that of the others."""
    nodes = {"root": {"fuse": "pool"}, **dict.fromkeys("mab", "root")}
    others = {"a": values(OTHER), "b": values(OTHER - 1.0)}
    measures, _ = measures_of(fakes, asked, nodes, {"m": measuring.nothing(), **others})
    alone, _ = measures_of(fakes, asked, nodes, {"m": measuring.nothing(), **others}, active="ab")
    assert measures.kl.keys() == {"m", "a", "b"}
    assert measures.contribution["m"] == pytest.approx(0.0, abs=1e-12)
    assert measures.strength["m"] == pytest.approx(0.0, abs=1e-12)
    uniform = np.mean(np.sum((BOXES - BOXES[0]) ** 2, axis=1))
    assert measures.agent_ud_px2["m"] == pytest.approx(uniform)
    belief = np.exp(OTHER) / np.exp(OTHER).sum()
    assert measures.kl["m"] == pytest.approx(float(belief @ np.log(belief * 5.0)))
    assert measures.fit == alone.fit == pytest.approx(np.exp(-0.5))
    for name in ("kl", "contribution", "strength"):
        for agent in "ab":
            assert getattr(measures, name)[agent] == pytest.approx(getattr(alone, name)[agent], rel=1e-9)


def test_when_nobody_sees_anything_nothing_fits(fakes, asked, measuring):
    measures, _ = measures_of(fakes, asked, {"root": {}, "m": "root"}, {"m": measuring.nothing()})
    assert measures.fit == 0.0 and measures.kl["m"] == pytest.approx(0.0, abs=1e-12)


def test_contribution_below_a_gaussian_latent_node(fakes, asked, measuring):
    """Without one of two measurements the node sends the other's alone, widened: by enumeration."""
    nodes = {"root": {}, "part": latent("gaussian"), "m": "part", "k": "part"}
    boxes = cloud(60)
    sees = {"m": measuring.place(61.0, 42.0), "k": measuring.place(55.0, 44.0, 4.0)}
    plan, evidence = asked(nodes, sees, boxes)
    beta = np.full(60, -np.log(60))
    left = without(plan, evidence, "k", Hypotheses(boxes), beta)["root"]
    expected = -0.5 * np.sum((boxes[:, :2] - [61.0, 42.0]) ** 2, axis=1) / 45.0
    np.testing.assert_allclose(left - left[0], expected - expected[0], rtol=1e-8, atol=1e-8)


def test_a_second_pass_of_other_hypotheses_draws_other_states_but_measures_once(fakes, asked, measuring):
    cue = measuring.place(61.0, 42.0)
    nodes = {"root": {}, "part": latent("gaussian"), "m": "part"}
    plan, _ = asked(nodes, {"m": cue}, cloud(50))
    observer = fakes.observer({"m": cue})
    cue.asked.clear()
    beta = np.full(50, -np.log(50))
    one, two = (evaluate(plan, observer, Hypotheses(cloud(50)), beta) for _ in range(2))
    assert len(cue.asked) == 1
    assert (one.latent["part"].boxes != two.latent["part"].boxes).any()
    np.testing.assert_allclose(one.gaussians["part"].covariance, two.gaussians["part"].covariance)
