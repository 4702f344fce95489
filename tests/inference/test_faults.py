"""Agents that fail: left out without a trace in what the others say, written down, tried again later."""

from __future__ import annotations

import sys

import numpy as np
import pytest

from bayesnet_track.journal.events.faults import Quarantined, Readmitted

GIVEN = {"sd_px": {"x": 5.0, "y": 5.0}}


def product():
    return {"root": {"fuse": "product"}, "a": "root", "b": "root"}


def pool(**more):
    weights = {"a": 0.3, "b": 1.7, **more}
    return {
        "root": {"fuse": "product"},
        "color": {"parent": "root", "fuse": {"pool": weights}},
        "a": "color",
        "b": "color",
        "c": "root",
    }


def latent(draw):
    return {
        "root": {"fuse": "product"},
        "part": {"parent": "root", "fuse": {"latent": {"given": GIVEN, "draw": draw}}},
        "a": "part",
        "b": "part",
        "c": "root",
    }


def small(nodes):
    return {**nodes, "root": {**nodes["root"], "belief": {"particles": {"size": 60}}}}


SHAPES = {
    "product": (product(), {**product(), "bad": "root"}),
    "pool": (pool(), {**pool(bad=2.1), "bad": "color"}),
    "one draw": (latent("one"), {**latent("one"), "bad": "part"}),
    "kernel": (latent("kernel"), {**latent("kernel"), "bad": "part"}),
}


def raising(planes, hypotheses, reference):
    raise ZeroDivisionError("nothing to divide by")


def meddling(planes, hypotheses, reference):
    """Writes into what it is given before it fails."""
    hypotheses.boxes[:] = 0.0
    raise KeyError("hue")


class Mute(Exception):
    def __str__(self):
        raise TypeError("nor does this")


def mute(planes, hypotheses, reference):
    raise Mute


def leaving(planes, hypotheses, reference):
    sys.exit(3)


def one(value):
    return lambda planes, h, reference: np.where(np.arange(len(h)) == 3, value, -1.0)


HOSTILE = {
    "raises": (raising, "raised ZeroDivisionError: nothing to divide by"),
    "meddles": (meddling, "raised KeyError: 'hue'"),
    "too short": (lambda p, h, r: np.zeros(len(h) - 1), "returned an array of shape (59,) for 60 hypotheses"),
    "two columns": (
        lambda p, h, r: np.zeros((len(h), 2)),
        "returned an array of shape (60, 2) for 60 hypotheses",
    ),
    "a number": (lambda p, h, r: 0.0, "returned an array of shape () for 60 hypotheses"),
    "mute": (mute, "raised Mute: (without a text: its __str__ raised TypeError)"),
    "leaves": (leaving, "raised SystemExit: 3"),
    **{
        name: (returned, f"returned a value of type {kind}, not 60 real numbers")
        for name, returned, kind in (
            ("nothing", lambda p, h, r: None, "NoneType"),
            ("words", lambda p, h, r: ["good"] * len(h), "array of <U4"),
            ("digits", lambda p, h, r: ["-1"] * len(h), "array of <U2"),
            ("complex", lambda p, h, r: np.full(len(h), -1.0 + 1j), "array of complex128"),
            ("objects", lambda p, h, r: np.full(len(h), -1.0).astype(object), "array of object"),
            ("masked", lambda p, h, r: np.ma.masked_less(np.full(len(h), -1.0), -2.0), "masked array"),
            ("truths", lambda p, h, r: np.zeros(len(h), bool), "array of bool"),
            ("times", lambda p, h, r: np.zeros(len(h), "m8[s]"), "array of timedelta64[s]"),
        )
    },
    "NaN": (one(np.nan), "returned a log-likelihood of nan, not at most 0, for 1 of 60 hypotheses"),
    "infinity": (one(np.inf), "returned a log-likelihood of inf, not at most 0, for 1 of 60 hypotheses"),
    "more than perfect": (
        one(0.5),
        "returned a log-likelihood of 0.5, not at most 0, for 1 of 60 hypotheses",
    ),
    "huge": (one(1e300), "returned a log-likelihood of 1e+300, not at most 0, for 1 of 60 hypotheses"),
    "zero likelihood": (
        lambda p, h, r: np.full(len(h), -np.inf),
        "returned a likelihood of zero for all 60 hypotheses",
    ),
}


@pytest.mark.slow
@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("fault", HOSTILE)
def test_a_fault_leaves_no_trace_but_its_quarantine(fakes, shape, fault):
    """Every number of every frame is, bit for bit, that of a net without the agent."""
    without, with_bad = SHAPES[shape]
    see, reason = HOSTILE[fault]
    sees = {"a": fakes.gaussian(52, 41, 9), "b": fakes.gaussian(49, 37, 14), "c": fakes.gaussian(50, 42, 20)}
    sees = {agent: see_ for agent, see_ in sees.items() if agent in without}
    clean, _ = fakes.engine(small(without), sees)
    dirty, _ = fakes.engine(small(with_bad), {**sees, "bad": see})
    expected, outcomes = fakes.play(clean, 4), fakes.play(dirty, 4)
    for k in (1, 2, 3, 4):
        assert outcomes[k].metrics == expected[k].metrics
        np.testing.assert_array_equal(outcomes[k].covariances["1"], expected[k].covariances["1"])
    events = [event for outcome in outcomes for event in outcome.events[outcome is outcomes[0] :]]
    assert events == [Quarantined(1, "1", "bad", reason, 11)]
    assert outcomes[-1].state.net.targets["1"].quarantined == {"bad"}


def test_a_plane_that_cannot_be_computed_costs_only_who_needs_it(fakes):
    sees = {"a": fakes.gaussian(52, 41, 9), "b": fakes.gaussian(49, 37, 14)}
    broken = fakes.Oracle(fakes.flat(), (fakes.BrokenPlane("lidar"),))
    clean, _ = fakes.engine(small(product()), sees)
    dirty, _ = fakes.engine(small({**product(), "bad": "root"}), {**sees, "bad": broken})
    expected, outcomes = fakes.play(clean, 3), fakes.play(dirty, 3)
    assert [o.metrics for o in outcomes[1:]] == [o.metrics for o in expected[1:]]
    # It could not learn either, so it is out from the start.
    assert outcomes[0].events[1] == Quarantined(
        0, "1", "bad", "raised OSError while learning: no such feature"
    )
    assert outcomes[0].metrics[0].active == ("a", "b")


def test_a_plane_that_breaks_later(fakes):
    class Flaky(fakes.Plane):
        def compute(self, frames, inputs, region):
            if frames.current.index == 2:
                raise OSError("gone")
            return super().compute(frames, inputs, region)

    sees = {"a": fakes.gaussian(52, 41, 9), "b": fakes.Oracle(fakes.flat(), (Flaky("lidar"),))}
    outcomes = fakes.play(fakes.engine(small(product()), sees)[0], 4)
    assert [o.metrics[0].active for o in outcomes] == [("a", "b"), ("a", "b"), ("a",), ("a",), ("a",)]
    assert outcomes[2].events == (Quarantined(2, "1", "b", "raised OSError: gone", 12),)


def test_a_partly_impossible_likelihood_is_no_fault(fakes):
    """-inf is a weight of zero: valid as long as one hypothesis is left."""
    outcomes = fakes.play(fakes.engine(small({"root": {}, "a": "root"}), {"a": one(-np.inf)})[0], 3)
    assert all(not outcome.events for outcome in outcomes[1:])


def test_agents_that_rule_each_other_out_leave_the_prediction(fakes):
    """Neither is at fault; the belief is the predicted prior, and it is written down."""
    left = lambda p, h, r: np.where(np.arange(len(h)) < 30, 0.0, -np.inf)  # noqa: E731
    right = lambda p, h, r: np.where(np.arange(len(h)) < 30, -np.inf, 0.0)  # noqa: E731
    outcomes = fakes.play(fakes.engine(small(product()), {"a": left, "b": right})[0], 4)
    assert [type(e).__name__ for e in outcomes[1].events] == ["DegenerateBelief"]
    assert outcomes[1].metrics[0].ess == pytest.approx(60.0)
    assert outcomes[1].metrics[0].active == ("a", "b")
    assert outcomes[4].state.net.targets["1"].status == "lost"


HOSTILE_VALUES = np.array(
    [
        np.nan,
        np.inf,
        -np.inf,
        0.0,
        -0.0,
        1e300,
        -1e300,
        1e-300,
        -1e-300,
        -1.7e308,
        690.0,
        -690.0,
        -1.0,
        5e-324,
    ]
)


def hostile_values(rng, size):
    """Any mix of the values above: few or many kinds, everywhere or at a few hypotheses."""
    kinds = rng.choice(HOSTILE_VALUES, rng.integers(1, 5))
    values = rng.choice(kinds, size)
    if rng.random() < 0.5:
        values = np.where(rng.random(size) < rng.choice([0.03, 0.5]), values, rng.uniform(-5.0, 0.0, size))
    return values


HOSTED = {
    "particles": {"particles": {"size": 40}},
    "grid": {
        "grid": {
            "cell_px": 8,
            "window": 16,
            "velocity_cells": 3,
            "scale_cells": 3,
            "reset": {"region": "image"},
        }
    },
    "gaussian": "gaussian",
}


def is_proper(belief):
    """Every number of a belief is finite, and what sums to 1 does."""
    if hasattr(belief, "weights"):
        total = belief.weights.weights.sum()
        return np.isfinite(belief.states).all() and not np.isnan(belief.weights.log).any() and total
    if hasattr(belief, "positions"):
        return np.isfinite(belief.positions).all() and belief.positions.sum()
    definite = np.linalg.eigvalsh(belief.covariance).min() > -1e-9
    return bool(np.isfinite(belief.mean).all() and definite) * 1.0


def assert_survives(fakes, belief, cases):
    """So many hostile answers of up to three agents; every second run has a valid agent beside them.

    Where both hostile agents are found out at once, the valid one's numbers are those that it has alone.
    """
    rng = np.random.default_rng(11)
    answers = 0

    def hostile(planes, hypotheses, reference):
        nonlocal answers
        answers += 1
        return hostile_values(rng, len(hypotheses))

    nodes = {
        "root": {"fuse": "product", "belief": HOSTED[belief]},
        "pool": {"parent": "root", "fuse": "pool"},
        **{"a": "pool", "b": "pool", "c": "root"},
    }
    alone = {"root": {**nodes["root"]}, "c": "root"}
    run, stopped, compared = 0, 0, 0
    while answers < cases:
        run += 1
        valid = run % 2 == 0
        good = fakes.gaussian(50.0, 40.0, 10.0)
        sees = {"a": hostile, "b": hostile, "c": good if valid else hostile}
        outcomes = fakes.play(fakes.engine(nodes, sees, seed=run)[0], 3)
        for outcome in outcomes[1:]:
            metrics = outcome.metrics[0]
            assert abs(is_proper(outcome.state.targets["1"].belief) - 1.0) < 1e-9
            numbers = [
                *metrics.centre_box,
                *metrics.map,
                *metrics.sd,
                metrics.ud_px2,
                metrics.score,
                metrics.ess,
            ]
            assert np.isfinite([*numbers, *metrics.agent_ud_px2.values()]).all()
            assert not np.isnan([*metrics.kl.values(), *metrics.contribution.values()]).any()
        out = outcomes[-1].state.net.targets["1"].quarantined
        assert not (valid and "c" in out)
        events = [e.node for outcome in outcomes for e in outcome.events if isinstance(e, Quarantined)]
        assert sorted(events) == sorted(out)
        stopped += len(out)
        if valid and {e.node for e in outcomes[1].events if isinstance(e, Quarantined)} == {"a", "b"}:
            clean = fakes.play(fakes.engine(alone, {"c": good}, seed=run)[0], 3)
            compared += 1
            for dirty, other in zip(outcomes[1:], clean[1:], strict=True):
                np.testing.assert_array_equal(dirty.covariances["1"], other.covariances["1"])
                assert (dirty.metrics[0].centre_box, dirty.metrics[0].log_evidence) == (
                    other.metrics[0].centre_box,
                    other.metrics[0].log_evidence,
                )
    assert stopped > cases / 4 and compared > cases / 100


@pytest.mark.parametrize("belief", HOSTED)
def test_hostile_likelihoods(fakes, belief):
    assert_survives(fakes, belief, 100)


@pytest.mark.reliability
@pytest.mark.parametrize("belief", HOSTED)
def test_ten_thousand_hostile_likelihoods(fakes, belief):
    """In all three beliefs together."""
    assert_survives(fakes, belief, 3_400)


def again(method, **settings):
    return {"particles": {"size": 120, "proposal": {method: settings}}}


LATER = {
    "second_pass": again("second_pass", above_kl=0),
    "iterated": again("iterated", above_kl=0),
    "prior_editing": again("prior_editing"),
    "auxiliary": again("auxiliary"),
    "likelihood_mixture": again("likelihood_mixture"),
    "size": {"particles": {"size": {"kld": {"bin_px": 0.5}}, "min": 120, "max": 2000}},
    "grid": {"grid": {"reset": {"region": "image"}}},
}


@pytest.mark.parametrize("belief", LATER)
def test_an_agent_that_fails_when_asked_again_in_a_frame_is_as_if_off(fakes, belief):
    """The frame is weighed anew without it, so that nothing of its first answer is left."""
    calls = []

    def at_the_second_call(planes, hypotheses, reference):
        calls.append(len(hypotheses))
        return raising(planes, hypotheses, reference) if len(calls) == 2 else np.full(len(hypotheses), -0.1)

    nodes = {**product(), "bad": "root"}
    nodes["root"] = {**nodes["root"], "belief": LATER[belief]}
    sees = {"a": fakes.gaussian(52, 41, 9), "b": fakes.gaussian(49, 37, 14)}
    outcomes = fakes.play(fakes.engine(nodes, {**sees, "bad": at_the_second_call})[0], 2)
    del nodes["bad"]
    without = fakes.play(fakes.engine(nodes, sees)[0], 2)
    assert Quarantined(1, "1", "bad", HOSTILE["raises"][1], 11) in outcomes[1].events
    assert len(calls) == 2
    assert [o.metrics for o in outcomes[1:]] == [o.metrics for o in without[1:]]


def test_an_agent_that_failed_is_tried_again_after_longer_and_longer_waits(fakes):
    """It fails whenever it is asked: 10 frames out, then 20, then 40; all numbers are those without it."""
    sees = {"a": fakes.gaussian(52, 41, 9), "b": fakes.gaussian(49, 37, 14)}
    without = fakes.play(fakes.engine(small(product()), sees)[0], 75)
    outcomes = fakes.play(fakes.engine(small({**product(), "bad": "root"}), {**sees, "bad": raising})[0], 75)
    events = [e for o in outcomes for e in o.events if isinstance(e, Quarantined | Readmitted)]
    reason = HOSTILE["raises"][1]
    assert events == [
        Quarantined(1, "1", "bad", reason, 11, 1),
        Readmitted(10, "1", "bad", True, 1, 10),
        Quarantined(11, "1", "bad", reason, 31, 2),
        Readmitted(30, "1", "bad", True, 2, 20),
        Quarantined(31, "1", "bad", reason, 71, 3),
        Readmitted(70, "1", "bad", True, 3, 40),
        Quarantined(71, "1", "bad", reason, 151, 4),
    ]
    assert [o.metrics for o in outcomes[1:]] == [o.metrics for o in without[1:]]


def test_an_agent_that_recovers_is_on_again_and_begins_anew(fakes):
    """It fails in frame 1, works from 11 on, ten times as long as it was out, and fails in 112."""
    frames = iter(range(1, 1000))

    def recovering(planes, hypotheses, reference):
        # Asked in 1, then from 11 on: the 102nd answer is that of frame 112.
        return raising(planes, hypotheses, reference) if next(frames) in (1, 103) else np.full(60, -0.1)

    nodes = small({**product(), "bad": "root"})
    sees = {"a": fakes.gaussian(52, 41, 9), "b": fakes.gaussian(49, 37, 14), "bad": recovering}
    outcomes = fakes.play(fakes.engine(nodes, sees)[0], 113)
    assert [o.metrics[0].active for o in outcomes[10:12]] == [("a", "b"), ("a", "b", "bad")]
    events = [(e.frame, e.times) for o in outcomes for e in o.events if isinstance(e, Quarantined)]
    assert events == [(1, 1), (112, 1)]


def test_with_every_agent_failing_the_target_is_lost_and_never_sure(fakes):
    nodes = {"root": {"fuse": "product", "belief": {"particles": {"size": 200}}}, "a": "root", "b": "root"}
    outcomes = fakes.play(fakes.engine(nodes, {"a": raising, "b": raising})[0], 9)
    ud = [o.metrics[0].ud_px2 for o in outcomes[1:]]
    assert ud == sorted(ud) and ud[-1] > 4 * ud[0]
    assert all(o.metrics[0].status == "lost" for o in outcomes[4:])
    assert all(o.metrics[0].score < 0.05 for o in outcomes[4:])
