"""How fast references follow the target at which uncertainty: equation 2.16 of the thesis, value by value."""

from __future__ import annotations

import math

import pytest

from bayesnet_track.adapt.rule_inputs import largest_rate, learning_rate
from bayesnet_track.graph.spec import Learn, Level

SHARES = {0.0: 0.982014, 0.25: 0.952574, 0.5: 0.880797, 0.75: 0.731059, 0.9: 0.598688}
"""UD as a share of theta -> (1 - tanh(2 (UD - theta) / theta)) / 2, from a table of tanh."""


@pytest.mark.parametrize(
    ("level", "theta_px2"),
    [(Level(ud_px2=80.0), 80.0), (Level(ud_box=0.05), 200.0), (Level(ud_baseline=1.5), 75.0)],
)
def test_the_rate_at_each_uncertainty(level: Level, theta_px2: float) -> None:
    rule, area_px2, quiet_px2 = Learn(below=level), 4000.0, 50.0
    for share, rate in SHARES.items():
        assert learning_rate(rule, share * theta_px2, area_px2, quiet_px2) == pytest.approx(rate, abs=1e-6)
    assert learning_rate(rule, (1.0 - 1e-9) * theta_px2, area_px2, quiet_px2) == pytest.approx(0.5)
    for share in (1.0 + 1e-9, 1.5, 100.0, math.inf):
        assert learning_rate(rule, share * theta_px2, area_px2, quiet_px2) == 0.0


def test_nothing_is_learnt_without_a_rule_or_while_the_quiet_level_is_unknown() -> None:
    assert learning_rate(None, 0.0, 400.0, 50.0) == 0.0
    assert learning_rate(Learn(below=Level(ud_baseline=1.5)), 10.0, 400.0, None) == 0.0


def test_every_frame_of_a_run_learns_by_that_rate_times_the_largest(fakes) -> None:
    theta, rate_max = 95.0, 0.2
    root = {
        "fuse": "product",
        "ud_fields": ["x", "y"],
        "learn": {"below": {"ud_px2": theta}, "rate_max": rate_max},
    }
    seen = fakes.Oracle(fakes.gaussian(50.0, 40.0, 9.0))
    engine, _ = fakes.engine({"root": root, "a": "root"}, {"a": seen})
    metrics = [outcome.metrics[0] for outcome in fakes.play(engine, 30)][1:]
    shares = [1.0 / (1.0 + math.exp(4.0 * (m.ud_px2 / theta - 1.0))) for m in metrics]  # the same, otherwise
    expected = [share if m.ud_px2 < theta else 0.0 for share, m in zip(shares, metrics, strict=True)]
    assert [m.learn_rate for m in metrics] == pytest.approx(expected)
    assert seen.blended == pytest.approx([rate_max * share for share in expected if share])
    assert min(expected) == 0.0 and max(expected) - min(e for e in expected if e) > 0.1  # UD varies enough


def test_it_learns_in_every_third_frame_as_much_as_in_three(fakes) -> None:
    root = {"fuse": "product", "ud_fields": ["x", "y"]}
    learn = {"below": {"ud_px2": 95.0}, "rate_max": 0.2}

    def shares(**every: int) -> tuple[list[float], list[float]]:
        seen = fakes.Oracle(fakes.gaussian(50.0, 40.0, 9.0))
        engine, _ = fakes.engine({"root": {**root, "learn": learn | every}, "a": "root"}, {"a": seen})
        return [outcome.metrics[0].learn_rate for outcome in fakes.play(engine, 30)], seen.blended

    (all_frames, _), (some, blended) = shares(), shares(every=3)
    due = [frame % 3 == 0 for frame in range(len(some))]
    assert some[1:] == [share if now else 0.0 for share, now in zip(all_frames, due, strict=True)][1:]
    expected = [1.0 - (1.0 - 0.2 * share) ** 3 for share in some[1:] if share > 0.0]
    assert blended == pytest.approx(expected) and len(blended) > 5


@pytest.mark.parametrize("early_rate", [0.0, 0.5, 1.0])
def test_early_references_are_means(fakes, early_rate: float) -> None:
    learn = {"below": {"ud_px2": 1e9}, "rate_max": 0.1, "early_rate": early_rate}
    seen = fakes.Oracle(fakes.gaussian(50.0, 40.0, 9.0))
    root = {"fuse": "product", "ud_fields": ["x", "y"], "learn": learn}
    engine, _ = fakes.engine({"root": root, "a": "root"}, {"a": seen})
    share = fakes.play(engine, 20)[-1].metrics[0].learn_rate
    assert share == pytest.approx(0.982, abs=1e-3)  # UD is far below its level
    rates = [max(0.1, early_rate / frame) for frame in range(2, 2 + len(seen.blended))]
    assert len(rates) >= 19 and seen.blended == pytest.approx([share * rate for rate in rates])


def test_at_an_early_rate_of_one_a_reference_is_the_mean_of_all_that_was_seen() -> None:
    rule, samples = Learn(below=Level(ud_px2=1.0), early_rate=1.0), [3.0, 1.0, 4.0, 1.0, 5.0]
    known = samples[0]
    for age, sample in enumerate(samples[1:], 1):
        known += largest_rate(rule, 1e-6, age) * (sample - known)
    assert known == pytest.approx(sum(samples) / len(samples))
    assert largest_rate(rule, 0.0, 1) == 0.0 and largest_rate(None, 0.3, 1) == 0.3
