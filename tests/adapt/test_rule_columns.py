"""What the rules remember of a target, and decide about it, does not depend on who else is in its group."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from bayesnet_track.adapt.memory import BASELINE_MINIMUM, BASELINE_WINDOW, Baseline, RuleMemory
from bayesnet_track.adapt.rule_inputs import Measures, RuleInputs
from bayesnet_track.journal.net import Net, apply
from bayesnet_track.journal.target_net import TargetNet

ADAPT = {
    "activate": {"above": {"ud_px2": 40.0}, "frames": 2},
    "deactivate": {"below": {"ud_baseline": 1.5}, "frames": 3, "drop": "min_information_per_ms"},
}
NETS = {
    "status by UD": ({"lost": {"above": {"ud_box": 0.1}, "fit_below": 0.3, "frames": 2}}, {}),
    "status by a baseline": ({"lost": {"above": {"ud_baseline": 2.0}, "frames": 2}}, {}),
    "status by a score": (
        {
            "score": {"logistic": {"bias": 0}},
            "lost": {"score_below": 0.3, "uncertain_below": 0.6, "frames": 2},
        },
        {},
    ),
    "switches": ({"adapt": ADAPT}, {}),
    "self-checks": ({}, {"self_check": {"above": {"ud_px2": 60.0}, "frames": 2, "rest": 3}}),
}
COUNT, FRAMES = 5, 80


def kind_of(now):
    """Equal for targets that make columns together."""
    known = now.score is None, now.existence is None, now.hiding is None
    return now.net.active, (*now.measures.contribution,), (*now.measures.parts,), known


def of_many(several, memories, decide_all):
    """As `decide`, of those together that the rules see alike."""
    found = {}
    for key in {kind_of(now) for now in several}:
        rows = [row for row, now in enumerate(several) if kind_of(now) == key]
        known = RuleMemory.join([memories[row] for row in rows])
        made, after = decide_all([several[row] for row in rows], known)
        found |= {row: (made.get(place, ()), after.take([place])) for place, row in enumerate(rows)}
    return [found[row] for row in range(len(several))]


def arrays_of(memory):
    baselines = sorted(memory.baselines.items(), key=lambda one: sorted(one[0][1]))
    own = [array for _, one in baselines if one.counts.any() for array in vars(one).values()]
    known = (memory.counts, memory.nats, memory.frames, memory.missed, *own)
    last = [memory.streak_values(streak) for streak in memory.layout.streaks]
    return [array.tobytes() for array in known], last, memory.worth


@pytest.mark.parametrize("rules", NETS)
def test_a_target_is_judged_as_if_it_were_alone(fakes, decide_one, decide_all, rules):
    root, agent = NETS[rules]
    nodes = {name: {"parent": "root", "agent": name, **agent} for name in "ab"}
    plate, _ = fakes.plate({"root": {"fuse": "product", **root}, **nodes})
    rng, decided = np.random.default_rng(7), 0
    nets = [Net({"1": TargetNet("plate", frozenset("ab"))}) for _ in range(COUNT)]
    alone, together = ([RuleMemory.empty(plate) for _ in range(COUNT)] for _ in range(2))
    for frame in range(FRAMES):
        several = []
        for net in nets:
            now = net.targets["1"]
            uds, nats = rng.choice([10.0, 30.0, 80.0], 3), rng.uniform(0, 1, 2)
            on = sorted(now.active)
            measures = Measures(
                {"root": uds[0]}, dict(zip(on, uds[1:], strict=False)), dict.fromkeys(on, 0.1),
                dict(zip(on, nats, strict=False)), {}, float(rng.choice([0.1, 0.9])), 400.0,
            )  # fmt: skip
            score = float(rng.uniform()) if "score" in root else None
            missed = {"a": "late"} if rng.random() < 0.1 else {}
            several.append(
                RuleInputs(
                    frame, "1", plate, now, measures, {"a": 1.0, "b": 2.0}, frozenset("a"),
                    float(rng.choice([0.0, 0.6])), score, missed,
                )
            )  # fmt: skip
        by_one = [decide_one(now, memory) for now, memory in zip(several, alone, strict=True)]
        by_all = of_many(several, together, decide_all)
        assert [made for made, _ in by_all] == [made for made, _ in by_one]
        alone, together = [memory for _, memory in by_one], [memory for _, memory in by_all]
        assert [arrays_of(memory) for memory in together] == [arrays_of(memory) for memory in alone]
        for row, (made, _) in enumerate(by_one):
            decided += len(made)
            for decision in made:
                nets[row] = apply(nets[row], decision)
    assert decided, "nothing was decided: nothing was tested"


@given(values=st.lists(st.floats(0, 1e6), min_size=1, max_size=70))
def test_a_baseline_is_the_median_of_the_last_values(values):
    known = Baseline.empty(2)
    for value in values:
        known = known.append(np.array([value, value]), np.array([True, False]))
    last = values[-BASELINE_WINDOW:]
    assert known.counts.tolist() == [len(last), 0]
    assert known.values[0, BASELINE_WINDOW - len(last) :].tolist() == last
    expected = np.median(last) if len(last) >= BASELINE_MINIMUM else np.nan
    np.testing.assert_array_equal(known.medians, [expected, np.nan])


def test_the_baseline_of_the_smallest_known_set_counts(fakes):
    plate, _ = fakes.plate({"root": {"fuse": "product"}, "a": "root", "b": "root"})
    a, both, nobody = frozenset("a"), frozenset("ab"), frozenset()
    few, many = (Baseline.empty(2) for _ in range(2))
    for k in range(BASELINE_MINIMUM):
        few = few.append(np.array([5.0, 5.0]), np.array([True, k > 0]))
        many = many.append(np.array([2.0, 3.0]), np.ones(2, np.bool_))
    empty = RuleMemory.empty(plate, 2)
    memory = RuleMemory(**{**vars(empty), "baselines": {("root", both): many, ("root", a): few}})
    assert memory.levels_px2("root", both).tolist() == [5.0, 3.0]
    assert memory.levels_px2("root", nobody).tolist() == [5.0, 3.0]
    np.testing.assert_array_equal(memory.levels_px2("root", a), [5.0, np.nan])
    assert memory.level_px2("other", both) is None
