"""The engine's step: determinism, independent targets, loss, learning, time, and the log that rebuilds it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bayesnet_track.engine.step import State, start_target, step
from bayesnet_track.journal.events.beliefs import DegenerateBelief
from bayesnet_track.journal.events.faults import Quarantined
from bayesnet_track.journal.events.lives import TargetStarted
from bayesnet_track.journal.events.statuses import StatusChanged
from bayesnet_track.journal.events.switches import Activated, Deactivated, LocallyAdapted, SelfStopped
from bayesnet_track.journal.net import replay
from bayesnet_track.journal.target_net import FitCause
from bayesnet_track.observation.planes import region_of_boxes

TWO = {"root": {"fuse": "product", "ud_fields": ["x", "y"]}, "a": "root", "b": "root"}


def root(**settings_):
    """The net of two agents, with further settings at its root."""
    return {**TWO, "root": {**TWO["root"], **settings_}}


def decisions_of(outcomes):
    return [e for o in outcomes for e in o.events if not isinstance(e, DegenerateBelief)]


def following(fakes, sd=8.0, speed=2.0):
    """Sees a target that moves to the right from the start box."""
    return lambda planes, h, reference: fakes.gaussian(50.0 + speed * planes.frame.index, 40.0, sd)(
        planes, h, None
    )


# ------------------------------------------------------------------------------------ a run as a whole


def test_it_follows(fakes):
    outcomes = fakes.play(fakes.engine(TWO, {"a": following(fakes), "b": fakes.flat()})[0], 20)
    for frame, outcome in enumerate(outcomes):
        (metrics,) = outcome.metrics
        assert (metrics.frame, metrics.target, metrics.status) == (frame, "1", "tracking")
        # MAP of a posterior of sd 5.2 px per axis from 500 hypotheses: 3 sd of it are 16 px.
        assert np.hypot(metrics.map[0] - (50 + 2 * frame), metrics.map[1] - 40) < 16
        if frame:
            assert metrics.sd == pytest.approx(np.sqrt(np.diag(outcome.covariances["1"])), rel=1e-9)
            assert {"planes", "belief", "measure", "learn", "a", "b"} <= set(outcome.seconds)


def test_the_same_seed_gives_the_same_numbers_and_another_seed_others(fakes):
    def run(seed):
        sees = {"a": following(fakes), "b": fakes.gaussian(60, 45, 20)}
        nodes = root(
            adapt={
                "activate": {"above": {"ud_px2": 70.0}},
                "deactivate": {"below": {"ud_px2": 60.0}, "frames": 1},
            }
        )
        outcomes = fakes.play(fakes.engine(nodes, sees, seed)[0], 12)
        return [o.metrics for o in outcomes], [o.events for o in outcomes]

    first, other = run(3), run(4)
    assert first == run(3)
    assert first[0] != other[0]


def test_no_global_state_is_touched(fakes):
    before = np.random.get_state()  # noqa: NPY002
    fakes.play(fakes.engine(TWO, {"a": following(fakes), "b": fakes.flat()})[0], 3)
    assert all(np.array_equal(a, b) for a, b in zip(before, np.random.get_state(), strict=True))  # noqa: NPY002


def test_a_state_can_be_stepped_twice(fakes):
    """Steps are pure: the same state and frame give the same outcome again."""
    engine, _ = fakes.engine(
        root(learn={"below": {"ud_px2": 1e6}}, lost={"above": {"ud_px2": 1e9}}),
        {"a": following(fakes), "b": fakes.flat()},
    )
    state = fakes.play(engine, 3)[-1].state
    first, second = step(engine, state, fakes.frame(4)), step(engine, state, fakes.frame(4))
    assert first.metrics == second.metrics and first.events == second.events
    assert (
        step(engine, first.state, fakes.frame(5)).metrics
        == step(engine, second.state, fakes.frame(5)).metrics
    )


class Pair:
    """A plane that is 1 where there is a previous frame."""

    margin, inputs, is_points = 0, (), False

    def compute(self, frames, inputs, region):
        before = -1 if frames.previous is None else frames.previous.index
        return np.full((region.y1 - region.y0, region.x1 - region.x0), float(before))


def test_a_target_does_not_depend_on_another(fakes):
    """Numbers, references and decisions are the same with and without another target, whichever is first."""
    pair = Pair()

    def learn(planes, box):
        return {"before": np.array(planes[pair].mean()), "box": box}

    sees = {
        "a": fakes.Oracle(following(fakes), (pair,), reference=learn),
        "b": fakes.Oracle(
            lambda p, h, r: fakes.gaussian(*r["box"][:2], 15.0)(p, h, r), (pair,), reference=learn
        ),
    }
    nodes = root(
        learn={"below": {"ud_px2": 500.0}},
        lost={"above": {"ud_px2": 1e9}},
        adapt={
            "activate": {"above": {"ud_px2": 90.0}},
            "deactivate": {"below": {"ud_px2": 80.0}, "frames": 2},
        },
    )

    def run(starts):
        outcomes = fakes.play(fakes.engine(nodes, sees)[0], 10, starts)
        numbers = [m for o in outcomes for m in o.metrics if m.target == "x"]
        decided = [d for d in decisions_of(outcomes) if d.target == "x"]
        return numbers, decided, outcomes[-1].state.targets["x"].references

    alone = run({"x": fakes.START})
    for starts in (
        {"x": fakes.START, "y": (90.0, 60.0, 10.0, 10.0)},
        {"y": (90.0, 60.0, 10.0, 10.0), "x": fakes.START},
    ):
        together = run(starts)
        assert together[:2] == alone[:2]
        for agent, reference in alone[2].items():
            for name, values in reference.items():
                np.testing.assert_array_equal(together[2][agent][name], values)


def test_a_target_may_start_later(fakes):
    engine, _ = fakes.engine(TWO, {"a": following(fakes), "b": fakes.flat()})
    state = fakes.play(engine, 3)[-1].state
    born = start_target(engine, state, fakes.frame(4), "2", "plate", np.array([20.0, 20.0, 8.0, 8.0]))
    assert [type(event) for event in born.events] == [TargetStarted]
    assert set(born.state.net.targets) == {"1", "2"}
    assert born.metrics[0].centre_box == (20.0, 20.0, 8.0, 8.0)


# ----------------------------------------------------------------------------------- the log rebuilds the net


@st.composite
def runs(draw):
    """A graph with rules, and cues that are good, vague, or fail now and then."""
    rules = {
        "adapt": {
            "activate": {
                "above": {"ud_px2": draw(st.sampled_from([80.0, 150.0, 400.0]))},
                "frames": draw(st.integers(1, 3)),
                "which": draw(st.sampled_from(["all", "most_helpful"])),
            },
            "deactivate": {
                "below": {"ud_px2": draw(st.sampled_from([60.0, 75.0]))},
                "frames": draw(st.integers(1, 3)),
            },
            "keep": draw(st.integers(1, 2)),
        },
        "learn": {"below": {"ud_px2": 100.0}},
        "lost": {"above": {"ud_px2": draw(st.sampled_from([200.0, 1000.0]))}, "frames": 2},
    }
    checks = {
        a: {
            "above": {"ud_px2": draw(st.sampled_from([50.0, 300.0]))},
            "frames": draw(st.integers(1, 3)),
            "rest": 3,
        }
        for a in "abc"
        if draw(st.booleans())
    }
    moods = {
        a: draw(st.lists(st.sampled_from(["sharp", "vague", "flat"]), min_size=4, max_size=4)) for a in "abc"
    }
    breaks = {a: draw(st.sampled_from([0, 0, 0, 3, 9])) for a in "abc"}
    active = {a: a == "a" or draw(st.booleans()) for a in "abc"}
    return rules, checks, moods, breaks, active, draw(st.sampled_from(["observe", "learn", "adapt"]))


@pytest.mark.slow
@settings(max_examples=25)
@given(runs())
def test_folding_the_decisions_gives_the_net_of_every_frame(fakes, case):
    rules, checks, moods, breaks, active, place = case
    sds = {"sharp": 6.0, "vague": 15.0, "flat": 500.0}

    def cue(agent):
        now = {"frame": 0}

        def see(planes, h, reference):
            now["frame"] = planes.frame.index
            if place == "observe" and planes.frame.index == breaks[agent]:
                raise OSError("broken")
            return fakes.gaussian(50.0, 40.0, sds[moods[agent][planes.frame.index // 5 % 4]])(planes, h, None)

        def learn(planes, box):
            if place == "learn" and planes.frame.index == breaks[agent] != 0:
                raise OSError("broken")
            return {"box": box}

        def tune(reference, attempt):
            if place == "adapt" and breaks[agent]:
                raise OSError("broken")
            return reference if attempt < 3 else None

        return fakes.AdaptableOracle(see, reference=learn, tune=tune)

    nodes = {"root": {**TWO["root"], **rules}}
    for agent in "abc":
        nodes[agent] = {"parent": "root", "agent": agent, "active": active[agent]}
        if agent in checks:
            nodes[agent]["self_check"] = checks[agent]
    outcomes = fakes.play(fakes.engine(nodes, {agent: cue(agent) for agent in "abc"})[0], 20)
    decisions = decisions_of(outcomes)
    assert [d.frame for d in decisions] == sorted(d.frame for d in decisions)
    for frame, outcome in enumerate(outcomes):
        live = replay(decisions, frame).targets["1"]
        failed = {
            e.node for e in outcome.events if isinstance(e, Quarantined) and "raised OSError: " in e.reason
        }
        assert set(outcome.metrics[0].active) == live.active - failed
        assert outcome.metrics[0].status == live.status
        assert outcome.state.net.targets["1"] == replay(decisions, frame + 1).targets["1"]
        assert outcome.state.targets["1"].plan.active == outcome.state.net.targets["1"].active
    waits: dict[str, float] = {}
    for out in (d for d in decisions if isinstance(d, Quarantined)):
        assert out.frame >= waits.get(out.node, 0)  # not again while it is out
        waits[out.node] = float("inf") if out.until is None else out.until


# ------------------------------------------------------------------------------------ loss


def test_without_agents_there_is_prediction_only_and_the_target_is_lost(fakes):
    """A random walk of sd 8 spreads by 128 px^2 a frame; the variance of 500 samples has a relative sd of
    about 6 % per axis and the resampled ones follow it, so each frame's UD is well within 25 %.
    """

    def failing(planes, h, reference):
        if planes.frame.index >= 3:
            raise OSError("the lens is covered")
        return fakes.gaussian(50.0, 40.0, 1.0)(planes, h, None)

    nodes = root(learn={"below": {"ud_px2": 300.0}}, lost={"above": {"ud_px2": 1e9}})
    engine, cues = fakes.engine(nodes, {"a": fakes.Oracle(failing), "b": fakes.Oracle(failing)})
    outcomes = fakes.play(engine, 8)
    assert [e.node for e in outcomes[3].events if isinstance(e, Quarantined)] == ["a", "b"]
    (lost,) = [d for d in decisions_of(outcomes) if isinstance(d, StatusChanged)]
    assert (lost.frame, lost.status, lost.cause) == (5, "lost", None)
    assert lost.reason == "no agent is active, so the belief is prediction only"
    start = outcomes[2].metrics[0].ud_px2
    for frame in (3, 4, 5, 6):
        metrics = outcomes[frame].metrics[0]
        assert metrics.active == () and metrics.log_evidence == pytest.approx(0.0, abs=1e-9)
        assert metrics.ud_px2 == pytest.approx(start + 128.0 * (frame - 2), rel=0.25)
        assert metrics.score == 0.0 and metrics.learn_rate == 0.0
    assert outcomes[8].metrics[0].status == "lost"
    assert (
        max(frame for cue in cues.values() for frame, *_ in cue.learnt) < 3
    )  # nothing is learnt without evidence


def test_black_frames_lose_the_target_and_it_is_found_again(fakes):
    def see(planes, h, reference):
        bright = planes.frame.image.mean() > 0
        return (
            fakes.gaussian(50.0, 40.0, 6.0, floor=0.02)(planes, h, None)
            if bright
            else np.full(len(h), np.log(0.02))
        )

    engine, _ = fakes.engine(root(lost={"above": {"ud_px2": 4000.0}}), {"a": see, "b": see})
    frames = [fakes.frame(n, value=0 if 5 <= n < 12 else 200) for n in range(25)]
    outcomes = fakes.play(engine, frames)
    changes = [(d.frame, d.status, d.cause) for d in decisions_of(outcomes) if isinstance(d, StatusChanged)]
    assert changes[0][:2] == (7, "lost")  # 3 frames of which nothing fits
    assert changes[0][2] == FitCause(0.05, pytest.approx(0.02), 3, pytest.approx(0.02))
    assert changes[1][:2] == (14, "tracking") and len(changes) == 2
    assert outcomes[11].metrics[0].score < 0.05 < 0.5 < outcomes[20].metrics[0].score


def test_a_real_cue_loses_its_target_in_the_dark():
    from bayesnet_track import GraphSpec
    from bayesnet_track.engine.step import make_engine
    from bayesnet_track.graph.checks.run import check_graph
    from bayesnet_track.observation.planes import Frame

    spec = GraphSpec.model_validate(
        {
            "name": "dark",
            "targets": {
                "t": {
                    "nodes": {
                        "root": {"motion": {"random_walk": {"sd_px": {"x": 8.0, "y": 8.0}}}},
                        "color": {"parent": "root", "agent": "color_histogram"},
                    }
                }
            },
        }
    )
    engine = make_engine(check_graph(spec), 0)
    picture = np.full((100, 120, 3), 90, np.uint8)
    picture[30:50, 40:60] = (0, 140, 255)
    frames = [Frame(n, float(n), picture if n < 6 else np.zeros_like(picture)) for n in range(12)]
    outcome = start_target(engine, State(), frames[0], "1", "t", np.array([49.5, 39.5, 20.0, 20.0]))
    status = []
    for frame in frames[1:]:
        outcome = step(engine, outcome.state, frame)
        status.append(outcome.state.net.targets["1"].status)
    assert status[:5] == ["tracking"] * 5 and status[-1] == "lost"


# ------------------------------------------------------------------------------------ time


def test_a_gap_in_time_widens_the_belief(fakes):
    """Without evidence the variance grows with time: 5 intervals against 1. Each estimate of 1000 coordinates
    has a relative sd of sqrt(2 / 1000) = 4.5 %, and UD adds the distance to the MAP; 25 % is 4 sd.
    """
    engine, _ = fakes.engine(TWO, {"a": fakes.flat(), "b": fakes.flat()})
    near, far = (
        fakes.play(engine, [fakes.frame(0), fakes.frame(1, time)])[-1].metrics[0] for time in (1.0, 5.0)
    )
    assert near.ud_px2 == pytest.approx(128.0, rel=0.25)
    assert far.ud_px2 / near.ud_px2 == pytest.approx(5.0, rel=0.25)


@pytest.mark.parametrize("time", [3.0, 2.5, float("nan")])
def test_time_must_advance(fakes, time):
    engine, _ = fakes.engine(TWO, {"a": fakes.flat(), "b": fakes.flat()})
    state = fakes.play(engine, 3)[-1].state
    with pytest.raises(ValueError, match=r"frame 4 at time .* is not later than 3.0"):
        step(engine, state, fakes.frame(4, time))


# ------------------------------------------------------------------------------------ learning

SHARP = {"below": {"ud_px2": 1000.0}, "rate_max": 0.04}


def test_inactive_agents_learn_too_on_the_estimates_crop_only(fakes):
    plane = fakes.Plane("idle")
    nodes = {
        **root(learn=SHARP, lost={"above": {"ud_px2": 1e6}}),
        "b": {"parent": "root", "agent": "b", "active": False},
    }
    idle = fakes.Oracle(fakes.flat(), (plane,))
    engine, cues = fakes.engine(nodes, {"a": following(fakes, 3.0), "b": idle})
    outcomes = fakes.play(engine, 6)
    assert len(idle.learnt) == 7
    for outcome, (frame, region, box) in zip(outcomes, idle.learnt, strict=True):
        (metrics,) = outcome.metrics
        assert (frame, box) == (metrics.frame, metrics.centre_box)
        assert metrics.active == ("a",)
        assert region == region_of_boxes(np.array([box]), grow=1.0).within(fakes.frame(frame))
    assert plane.computed == [region for _, region, _ in idle.learnt]
    # The reference follows: old + rate (new - old), frame by frame.
    box = np.array(idle.learnt[0][2])
    for rate, (_, _, seen) in zip(idle.blended, idle.learnt[1:], strict=True):
        box = rate * np.array(seen) + (1 - rate) * box
    np.testing.assert_allclose(outcomes[-1].state.targets["1"].references["b"]["box"], box, rtol=1e-12)
    assert [learnt[0] for learnt in cues["a"].learnt] == [learnt[0] for learnt in idle.learnt]


def test_nothing_is_learnt_while_ud_is_high_or_the_target_lost(fakes):
    high = fakes.engine(root(learn={"below": {"ud_px2": 10.0}}), {"a": following(fakes), "b": fakes.flat()})
    outcomes = fakes.play(high[0], 4)
    assert [len(cue.learnt) for cue in high[1].values()] == [1, 1]
    assert all(o.metrics[0].learn_rate == 0.0 for o in outcomes[1:])
    nodes = root(
        learn={"below": {"ud_px2": 900.0}}, lost={"above": {"ud_px2": 1000.0}, "fit_below": 0.9, "frames": 2}
    )
    lost = fakes.engine(nodes, {"a": lambda p, h, r: np.full(len(h), -3.0), "b": fakes.flat()})
    rates = [o.metrics[0].learn_rate for o in fakes.play(lost[0], 6)]
    assert rates[1] > 0 and rates[3:] == [0.0] * 4


def test_the_rate_is_the_agents_then_the_cues_then_the_graphs(fakes):
    nodes = root(learn=SHARP, lost={"above": {"ud_px2": 1e6}})
    nodes |= {
        "b": {"parent": "root", "agent": "b", "learn_rate_max": 0.5},
        "c": {"parent": "root", "agent": "c", "learn_rate_max": 0.0},
        "d": "root",
    }
    sees = {agent: fakes.Oracle(fakes.gaussian(50, 40, 5)) for agent in "abcd"}

    def rates(**cue):
        for oracle in sees.values():
            oracle.blended.clear()
        outcomes = fakes.play(fakes.engine(nodes, sees, **cue)[0], 3)
        shares = [o.metrics[0].learn_rate for o in outcomes[1:]]
        assert all(0.5 < share < 1.0 for share in shares)
        assert sees["c"].blended == []
        return {a: np.array(sees[a].blended) / shares for a in "abd"}

    for agent, most in {"a": 0.04, "b": 0.5, "d": 0.04}.items():
        np.testing.assert_allclose(rates()[agent], most, rtol=1e-12)
    for agent, most in {"a": 1.0, "b": 0.5, "d": 1.0}.items():
        np.testing.assert_allclose(rates(rate_max=1.0)[agent], most, rtol=1e-12)


def bad_reference(when, value):
    def learn(planes, box):
        if planes.frame.index == when:
            if isinstance(value, Exception):
                raise value
            return {"box": np.full(4, value)}
        return {"box": box}

    return learn


@pytest.mark.parametrize(
    ("value", "reason"),
    [
        (np.nan, "made a reference whose 'box' is not finite"),
        (np.inf, "made a reference whose 'box' is not finite"),
        (MemoryError("too large"), "raised MemoryError while learning: too large"),
    ],
)
@pytest.mark.parametrize("active", [True, False])
def test_an_agent_that_fails_to_learn_is_out(fakes, value, reason, active):
    nodes = {
        **root(learn=SHARP, lost={"above": {"ud_px2": 1e6}}),
        "b": {"parent": "root", "agent": "b", "active": active},
    }
    for when in (0, 2):
        sees = {"a": following(fakes), "b": fakes.Oracle(fakes.flat(), reference=bad_reference(when, value))}
        outcomes = fakes.play(fakes.engine(nodes, sees)[0], 5)
        assert [d for d in decisions_of(outcomes) if isinstance(d, Quarantined)] == [
            Quarantined(when, "1", "b", reason, when + 10 if when else None)
        ]
        # Its evidence of that frame was good; from the next on it is out.
        assert ["b" in o.metrics[0].active for o in outcomes] == [
            active and n <= when and when > 0 for n in range(6)
        ]
        references = outcomes[-1].state.targets["1"].references
        assert all(np.isfinite(values).all() for r in references.values() for values in r.values())


def test_a_local_action_changes_the_reference_until_nothing_is_left(fakes):
    def tune(reference, attempt):
        return None if attempt > 2 else {"box": reference["box"] + 100.0 * attempt}

    nodes = {
        **TWO,
        "b": {"parent": "root", "agent": "b", "self_check": {"above": {"ud_px2": 1.0}, "frames": 5}},
    }
    sees = {"a": following(fakes), "b": fakes.AdaptableOracle(fakes.flat(), tune=tune)}
    outcomes = fakes.play(fakes.engine(nodes, sees)[0], 6)
    assert [(type(d), d.frame) for d in decisions_of(outcomes)[1:]] == [
        (LocallyAdapted, 1),
        (LocallyAdapted, 2),
        (SelfStopped, 5),
    ]
    np.testing.assert_allclose(
        outcomes[-1].state.targets["1"].references["b"]["box"], np.array(fakes.START) + 300.0
    )


@pytest.mark.parametrize("failure", [ValueError("no"), np.nan])
def test_a_local_action_that_fails(fakes, failure):
    def tune(reference, attempt):
        if isinstance(failure, Exception):
            raise failure
        return {"box": reference["box"] * failure}

    nodes = {
        **TWO,
        "b": {"parent": "root", "agent": "b", "self_check": {"above": {"ud_px2": 1.0}, "frames": 5}},
    }
    outcomes = fakes.play(
        fakes.engine(nodes, {"a": following(fakes), "b": fakes.AdaptableOracle(fakes.flat(), tune=tune)})[0],
        3,
    )
    reason = (
        "raised ValueError while adapting: no"
        if isinstance(failure, Exception)
        else "made a reference whose 'box' is not finite"
    )
    assert decisions_of(outcomes)[1:] == [Quarantined(1, "1", "b", reason, 11)]


# ------------------------------------------------------------------------------------ adaptation in the loop


def test_an_agent_is_called_when_the_target_splits_and_sent_away_after(fakes):
    """Colour sees two equal targets between frames 10 and 20, motion only the right one."""

    def color(planes, h, reference):
        right = fakes.gaussian(50.0, 40.0, 8.0, floor=0.02)(planes, h, None)
        wrong = fakes.gaussian(80.0, 40.0, 8.0, floor=0.02)(planes, h, None)
        return np.maximum(right, wrong) if 10 <= planes.frame.index < 20 else right

    nodes = root(
        adapt={
            "activate": {"above": {"ud_px2": 160.0}, "frames": 2},
            "deactivate": {"below": {"ud_px2": 110.0}, "frames": 4},
        },
    )
    nodes["b"] = {"parent": "root", "agent": "b", "active": False}
    nodes["root"]["motion"] = {"random_walk": {"sd_px": {"x": 14.0, "y": 8.0}}}
    outcomes = fakes.play(fakes.engine(nodes, {"a": color, "b": fakes.gaussian(50.0, 40.0, 10.0)})[0], 40)
    made = [d for d in decisions_of(outcomes) if isinstance(d, Activated | Deactivated)]
    assert type(made[0]) is Activated and made[0].node == "b" and 11 <= made[0].frame <= 19
    assert made[0].cause.value > 160.0 >= outcomes[5].metrics[0].ud_px2
    assert outcomes[30].metrics[0].active != ("a", "b")
    assert all(m.metrics[0].kl.keys() == set(m.metrics[0].active) for m in outcomes[1:])


def test_metrics_hold_what_was_measured(fakes):
    engine, _ = fakes.engine(TWO, {"a": following(fakes), "b": fakes.gaussian(60, 45, 30)})
    (metrics,) = fakes.play(engine, 2)[-1].metrics
    assert metrics.particles == 500 and 1.0 <= metrics.ess <= 500.0
    assert len(metrics.cloud) == 48 and all(len(box) == 4 for box in metrics.cloud)
    assert metrics.region90[0] < metrics.region50[0] < metrics.region50[1] < metrics.region90[1]
    assert metrics.ud_nodes == {"root": metrics.ud_px2}
    assert 0.0 < metrics.score < 1.0
    assert metrics == replace(metrics)


def test_targets_keep_the_order_in_which_they_started(fakes):
    starts = {str(n): (50.0, 40.0, 20.0, 20.0) for n in range(1, 12)}  # "10" comes before "2" in a dictionary
    engine, _ = fakes.engine({"root": {}, "a": "root"}, {"a": fakes.gaussian(50.0, 40.0, 3.0)})
    outcomes = fakes.play(engine, 3, starts)
    assert [[line.target for line in one.metrics] for one in outcomes] == [[*starts]] * 4
