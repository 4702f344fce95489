"""Scores, widened regions and temperatures in the engine; without their keys nothing changes."""

from __future__ import annotations

import numpy as np
import pytest

from bayesnet_track.belief.contract import BOX_FIELDS
from bayesnet_track.belief.particles.belief import ParticleSet
from bayesnet_track.engine.scoring.score import blur_regions, extent_beyond, probability
from bayesnet_track.graph.settings.scores import FEATURES
from bayesnet_track.graph.spec import HeavyTail, Localization, Logistic
from bayesnet_track.journal.codec import from_json, to_json
from bayesnet_track.journal.events.statuses import StatusChanged
from bayesnet_track.numerics.log_weights import LogWeights

TWO = {"root": {"fuse": "product", "ud_fields": ["x", "y"]}, "a": "root", "b": "root"}
GONE = 15


def nodes(**settings):
    return {**TWO, "root": {**TWO["root"], **settings}}


def seen_until(fakes, last):
    """Sees a target at rest, and nothing like it after frame `last`."""

    def see(planes, h, reference):
        shown = planes.frame.index <= last
        return (
            fakes.gaussian(50.0, 40.0, 3.0, floor=1e-3)(planes, h, None) if shown else np.full(len(h), -7.0)
        )

    return see


def run(fakes, frames=30, agent_nodes=None, **settings):
    described = {**nodes(**settings), **(agent_nodes or {})}
    engine, cues = fakes.engine(described, {"a": seen_until(fakes, GONE), "b": fakes.flat()})
    return fakes.play(engine, frames), cues


SCORE = {"logistic": {"bias": 6.0, "log_fit": 2.0, "memory_frames": 0}}


def test_the_score_is_the_logistic_of_the_features(fakes):
    never = {"score_below": 1e-9, "uncertain_below": 1e-8}  # the UD of a lost target is left out
    outcomes, _ = run(
        fakes,
        score={"logistic": {"bias": 0.5, "evidence": 0.3, "log_ud_box": -0.2, "memory_frames": 4}},
        lost=never,
    )
    rule = Logistic(bias=0.5, evidence=0.3, log_ud_box=-0.2, memory_frames=4)
    lines = [one.metrics[0] for one in outcomes[1:]]
    assert all(set(line.features) == {*FEATURES, "most"} for line in lines)
    assert [line.score for line in lines] == pytest.approx(
        [probability(rule, line.features) for line in lines]
    )
    # The filter: the raw features are those of a run without memory.
    raw = [
        one.metrics[0].features
        for one in run(fakes, score={"logistic": {"bias": 0, "memory_frames": 0}}, lost=never)[0][1:]
    ]
    smooth, gain = dict(raw[0]), 1 - np.exp(-1 / 4)
    for line, found in zip(lines, raw, strict=True):
        smooth = {name: value + gain * (found[name] - value) for name, value in smooth.items()}
        assert dict(line.features) == pytest.approx(smooth, abs=1e-9)


def test_the_ud_of_a_lost_target_is_left_out(fakes):
    lost = {"score_below": 0.3, "uncertain_below": 0.9, "frames": 2}
    lines = [one.metrics[0] for one in run(fakes, score=SCORE, lost=lost)[0][GONE:]]
    status, widths = [line.status for line in lines], [line.features["log_ud_box"] for line in lines]
    first = status.index("lost")
    assert set(status[first:]) == {"lost"} and len(set(widths[first:])) == 1
    assert len(set(widths[:first])) == first
    assert lines[-1].ud_px2 > 2.0 * lines[first].ud_px2  # the belief goes on to grow


def test_features_of_a_flat_frame_have_their_exact_values(fakes):
    outcomes, _ = run(fakes, score=SCORE)
    before, after = (outcomes[k].metrics[0].features for k in (GONE, GONE + 1))
    assert before["log_fit"] == pytest.approx(0.0, abs=0.05)
    # a says -7 of every hypothesis, b nothing: geometric mean -3.5, and each agent agrees with itself.
    assert after["log_fit"] == pytest.approx(-3.5)
    assert after["agreement"] == 0.0
    # Evidence of a: -7 against its median so far; that of b is 0 as ever.
    assert after["evidence"] < -2.0
    assert after["log_ud_box"] == pytest.approx(
        np.log(outcomes[GONE + 1].metrics[0].ud_px2 / np.prod(outcomes[GONE + 1].metrics[0].centre_box[2:]))
    )


@pytest.mark.parametrize(
    ("box", "extent"),
    [
        ((50.0, 50.0, 20.0, 10.0), 0.0),
        ((9.5, 50.0, 20.0, 10.0), 0.0),  # its left side is that of the image
        ((9.3, 50.0, 20.0, 10.0), 0.1),
        ((8.5, 50.0, 20.0, 10.0), 0.5),
        ((0.0, 50.0, 20.0, 10.0), 1.0),
        ((110.5, 50.0, 20.0, 10.0), 0.5),
        ((50.0, 4.0, 20.0, 10.0), 0.5),
        ((50.0, 95.0, 20.0, 10.0), 0.5),
        ((110.5, 95.2, 20.0, 10.0), 0.7),  # the larger one counts
    ],
)
def test_a_box_extends_beyond_the_image_by_a_share_of_its_side(fakes, box, extent):
    assert extent_beyond(np.array(box), fakes.frame(0)) == pytest.approx(extent, abs=1e-9)


def leaving(fakes, frames, **logistic):
    """The lines of a target that moves right, out of the image, by 3 px a frame."""

    def see(planes, h, reference):
        return fakes.gaussian(50.0 + 3.0 * planes.frame.index, 40.0, 3.0, floor=1e-3)(planes, h, None)

    engine, _ = fakes.engine(nodes(score={"logistic": logistic}), {"a": see, "b": fakes.flat()})
    return [one.metrics[0] for one in fakes.play(engine, frames)[1:]]


def test_the_score_of_a_target_that_leaves_the_image_falls_at_its_border(fakes):
    lines = leaving(fakes, 22, bias=3.0, border=-4.0, memory_frames=0)
    x, w = (np.array([line.centre_box[k] for line in lines]) for k in (0, 2))
    border = np.clip((x + w / 2 - 119.5) / w / 0.1, 0.0, 1.0)
    assert border[0] == 0.0 and border[-1] == 1.0
    assert [line.score for line in lines] == pytest.approx(1.0 / (1.0 + np.exp(4.0 * border - 3.0)))


def test_the_border_is_remembered_where_nothing_fits(fakes):
    """Only what the evidence was in such a frame is forgotten."""
    plain = leaving(fakes, 22, bias=3.0, border=-4.0, memory_frames=4)
    unfit = leaving(fakes, 22, bias=3.0, border=-4.0, memory_frames=4, full_fit=1.0)
    assert 0.0 < plain[-1].features["border"] < 1.0
    assert [line.features["border"] for line in unfit] == [line.features["border"] for line in plain]


def test_while_uncertain_nothing_is_learnt_and_lost_is_said(fakes):
    lost = {"score_below": 0.3, "uncertain_below": 0.9, "frames": 2}
    outcomes, cues = run(fakes, score=SCORE, lost=lost, learn={"below": {"ud_px2": 1e6}})
    said = [e for o in outcomes for e in o.events if isinstance(e, StatusChanged)]
    assert [(e.status, e.frame) for e in said] == [("lost", GONE + 2)]
    assert [m.learn_rate > 0 for o in outcomes[1:] for m in o.metrics] == [
        k <= GONE + 2 for k in range(1, 31)
    ]
    lost = {"score_below": 1e-6, "uncertain_below": 0.9, "frames": 2}
    outcomes, cues = run(fakes, score=SCORE, lost=lost, learn={"below": {"ud_px2": 1e6}})
    assert outcomes[-1].metrics[0].status == "uncertain"
    assert outcomes[-1].metrics[0].learn_rate == 0.0
    assert max(frame for frame, *_ in cues["a"].learnt) == GONE + 2


@pytest.mark.parametrize(("least", "learns"), [(None, False), (0.5, True), (0.99, False)])
def test_references_learn_while_uncertain_where_the_score_is_above_a_level(fakes, least, learns):
    learn = {"below": {"ud_px2": 1e6}} | ({} if least is None else {"score_above": least})
    lost = {"score_below": 0.3, "uncertain_below": 0.95, "frames": 2}
    score = {"logistic": {"bias": 2.0, "memory_frames": 0}}  # 0.88 in every frame
    outcomes, _ = run(fakes, 8, score=score, lost=lost, learn=learn)
    lines = [one.metrics[0] for one in outcomes[4:]]
    assert {line.status for line in lines} == {"uncertain"}
    assert [line.learn_rate > 0 for line in lines] == [learns] * len(lines)


def test_a_calibrated_line_survives_the_journal(fakes):
    outcomes, _ = run(fakes, 3, score=SCORE, localization_error={"sd_box": 0.1})
    line = outcomes[-1].metrics[0]
    again = from_json(to_json(line))
    assert dict(again.features) == pytest.approx(dict(line.features))
    assert "features" not in to_json(run(fakes, 3)[0][-1].metrics[0])


def test_slack_touches_only_what_is_told(fakes):
    plain, _ = run(fakes)
    wide, _ = run(fakes, localization_error={"sd_box": 0.5})
    for one, other in zip(plain[1:], wide[1:], strict=True):
        a, b = one.metrics[0], other.metrics[0]
        assert (a.centre_box, a.ud_px2, a.cloud, a.score, a.status) == (
            b.centre_box,
            b.ud_px2,
            b.cloud,
            b.score,
            b.status,
        )
        added = (0.5**2) * a.centre_box[2] * a.centre_box[3]
        assert b.sd == pytest.approx(
            [np.hypot(a.sd[0], added**0.5), np.hypot(a.sd[1], added**0.5), *a.sd[2:]]
        )
        assert b.region90[0] < a.region90[0] and b.region90[3] > a.region90[3]


@pytest.mark.parametrize("tail", [None, HeavyTail(weight=0.3, factor=6)])
@pytest.mark.parametrize("score", [0.2, 0.7, 1.0])
def test_a_widened_region_holds_what_it_says(score, tail):
    """True centres drawn from the mixture of localization_error lie in the regions as often as they say."""
    rng = np.random.default_rng(4)
    boxes = np.column_stack([rng.normal(100, 3, 400), rng.normal(50, 2, 400), np.full((400, 2), 20.0)])
    belief = ParticleSet(boxes, BOX_FIELDS, LogWeights.uniform(400))
    found = blur_regions(belief, Localization(sd_box=0.1, lost_sd_box=4.0, heavy_tail=tail), score, 20.0)
    n = 20_000
    near = 2.0 if tail is None else np.where(rng.random(n) < tail.weight, tail.factor * 2.0, 2.0)
    noise = np.where(rng.random(n) < score, near, 80.0)[:, None] * rng.normal(size=(n, 2))
    truth = boxes[rng.integers(400, size=n), :2] + noise
    for region, share in ((found.region50, 0.5), (found.region90, 0.9)):
        for axis in (0, 1):
            low, high = region[2 * axis : 2 * axis + 2]
            inside = np.mean((low <= truth[:, axis]) & (truth[:, axis] <= high))
            # Sd of the share below 0.004: four of them; 32 quantiles for 400 points cost as much.
            assert inside == pytest.approx(share, abs=0.016 + 0.016)


def test_a_temperature_divides_the_log_likelihood(fakes):
    """Two agents that say the same, one at temperature 2, are as one at the power of one and a half."""
    same = fakes.gaussian(55.0, 40.0, 6.0)
    hot = {"b": {"parent": "root", "agent": "b", "temperature": 2.0}}
    engine, _ = fakes.engine({**nodes(), **hot}, {"a": same, "b": same})
    halved = lambda p, h, r: 0.5 * same(p, h, r)  # noqa: E731
    plain, _ = fakes.engine(nodes(), {"a": same, "b": halved})
    for one, other in zip(fakes.play(engine, 5), fakes.play(plain, 5), strict=True):
        assert one.metrics[0].centre_box == other.metrics[0].centre_box
        assert one.metrics[0].strength == other.metrics[0].strength


def test_the_probability_does_not_overflow():
    rule = Logistic(bias=0, log_fit=1e6)
    assert probability(rule, dict.fromkeys(FEATURES, -20.0)) == 0.0
    assert probability(rule, dict.fromkeys(FEATURES, 20.0)) == 1.0
