"""Two runs side by side, on journals made by hand: pairs, partings, distances, figures, and their words."""

from dataclasses import dataclass, field, replace

import pytest

from bayesnet_track.journal.compare import compare
from bayesnet_track.journal.compare_measures import Total
from bayesnet_track.journal.events.lives import CandidateConfirmed, TargetStarted
from bayesnet_track.journal.events.statuses import StatusChanged
from bayesnet_track.journal.events.switches import Activated, Deactivated
from bayesnet_track.journal.metrics import FrameMetrics
from bayesnet_track.journal.target_net import Cause
from bayesnet_track.journal.text.compare_text import compare_text

BOX = (50.0, 40.0, 20.0, 10.0)


@dataclass
class Record:
    name: str
    events: list
    metrics: list
    seconds: dict = field(default_factory=dict)
    costs_ms: dict = field(default_factory=lambda: {("plate", "color"): 0.5, ("plate", "motion"): 2.0})


def line(frame, target="1", box=BOX, ud=10.0, active=("color",), status="tracking"):
    return FrameMetrics(
        frame=frame, time_s=frame / 25, target=target, centre_box=box, map=box, sd=(1.0,) * 4, ud_px2=ud,
        ud_nodes={}, quiet_px2=None, status=status, score=0.5, log_evidence=0.0, surprise=0.0, ess=90.0,
        particles=100, active=active, kl={}, contribution={}, agent_ud_px2={}, strength={}, learn_rate=0.0,
        region50=(0.0,) * 4, region90=(0.0,) * 4, cloud=(),
    )  # fmt: skip


def start(target="1", box=BOX):
    return TargetStarted(0, target, "plate", box, ("color",))


def on(frame, ud=210.0, target="1"):
    return Activated(frame, target, "motion", "root", Cause("ud_px2", 200.0, ud, 1, ud, ud, 1.0))


def off(frame, target="1"):
    cause = Cause("ud_px2", 100.0, 90.0, 1, 90.0, 90.0, 1.0)
    return Deactivated(frame, target, "motion", "root", cause, "largest_kl", {})


def record(name, decisions=(), count=40, **settings):
    return Record(name, [start(), *decisions], [line(frame, **settings) for frame in range(count)])


def test_a_run_never_parts_from_itself():
    one = record("a", [on(5), off(9)])
    found = compare(one, one)
    assert (found.agreed, found.moments, found.first_apart) == (3, (), None)
    assert all(total.first == total.second for total in found.totals)
    text = compare_text(one, one, found, [])
    assert "their decisions never diverge: 3 decisions taken by both in the same frame; the estimates" in text


def test_the_same_decision_a_little_later_is_one_moment_and_far_later_two():
    found = compare(record("a", [on(5), off(9)]), record("b", [on(8, 230.0), off(30)]))
    assert [(m.frame, len(m.first), len(m.second)) for m in found.moments] == [
        (5, 1, 1),
        (9, 1, 0),
        (30, 0, 1),
    ]
    assert found.moments[0].second[0].frame == 8
    assert found.agreed == 1  # the start


def test_numbers_alone_are_no_parting():
    found = compare(record("a", [on(5, 210.0)]), record("b", [on(5, 220.0)]))
    assert found.moments == () and found.agreed == 2


def test_both_sides_of_the_first_parting_are_told_with_their_causes():
    a, b = record("a", [on(5)]), record("b", [on(25, 230.0)])
    text = compare_text(a, b, compare(a, b), ["seed: 0 → 1"])
    assert "they first diverge at frame 5, motion" in text
    assert (
        "A  frame 5: UD 210 px² > 200 for 1 frame → motion on; would have stayed off at activate ≥ 210"
        in text
    )
    assert "B  frame 5: no such decision, motion is off at UD 10 px²; frame 25: UD 230 px² > 200" in text
    assert "  seed: 0 → 1" in text


def test_a_status_parts_by_what_it_becomes():
    lost = StatusChanged(7, "1", "lost", Cause("ud_box", 1.0, 2.0, 1, 2.0, 200.0, 100.0))
    found = compare(record("a", [lost]), record("b", [replace(lost, status="uncertain")]))
    assert [(m.node, len(m.first), len(m.second)) for m in found.moments] == [("", 1, 1)]


def test_distances_are_of_centres_and_boxes():
    moved = (53.0, 44.0, 20.0, 10.0)
    found = compare(record("a"), record("b", box=moved))
    apart = found.distances["1", "1"]
    shared = 17.0 * 6.0
    assert (apart.px[3], apart.iou[3]) == (5.0, pytest.approx(shared / (400.0 - shared)))
    assert found.first_apart == 0


def test_figures():
    a = record("a", [on(5), off(9)])
    a.metrics[10:20] = [line(f, active=("color", "motion"), status="lost") for f in range(10, 20)]
    a.seconds = {0: 9.0, 1: 0.002, 2: 0.004, 3: 0.012}
    b = record("b")
    figures = {total.name: (total.first, total.second) for total in compare(a, b).totals}
    assert figures["agents per frame"] == (1.25, 1.0)
    assert figures["declared ms per frame"] == (pytest.approx((40 * 0.5 + 10 * 2.0) / 40), 0.5)
    assert figures["measured ms per frame"] == (pytest.approx(6.0), None)  # without the first
    assert figures["measured ms, median frame"] == (pytest.approx(4.0), None)
    assert figures["reconfigurations"] == (2, 0)
    assert figures["frames lost"] == (10, 0)


def test_a_cost_that_is_not_declared_is_not_taken_for_nothing():
    a = record("a")
    a.costs_ms = {}
    figures = {total.name: total.first for total in compare(a, a).totals}
    assert figures["declared ms per frame"] is None


LEFT, RIGHT, FAR = (30.0, 40.0, 20.0, 20.0), (90.0, 40.0, 20.0, 20.0), (200.0, 9.0, 8.0, 8.0)


def crowd(name, places, decisions=()):
    """Targets that were born by detection, each at its place."""
    events, metrics = [], []
    for target, box in places.items():
        events += [CandidateConfirmed(0, target, "plate", "d", 0, 1, 1, 1.0, None), start(target, box)]
        metrics += [line(frame, target, box) for frame in range(20)]
    return Record(name, [*events, *decisions], sorted(metrics, key=lambda one: one.frame))


def test_born_targets_are_paired_by_where_they_are_not_by_id():
    found = compare(crowd("a", {"1": LEFT, "2": RIGHT}), crowd("b", {"1": RIGHT, "2": LEFT, "3": FAR}))
    assert found.pairs == (("1", "2"), ("2", "1"))
    assert found.alone == ((), ("3",))
    assert found.first_apart is None
    # The start of the third is the only decision that one of them took alone.
    assert [(m.target, len(m.first), len(m.second)) for m in found.moments] == [("3", 0, 1)]


def test_a_target_that_only_one_run_has_is_never_taken_for_another_one_of_that_id():
    a = crowd("a", {"1": LEFT, "2": RIGHT}, [on(5, target="2")])
    b = crowd("b", {"1": LEFT, "2": FAR, "3": RIGHT}, [on(5, target="2")])
    found = compare(a, b)
    assert found.pairs == (("1", "1"), ("2", "3")) and found.alone == ((), ("2",))
    parted = [(m.frame, m.pair, len(m.first), len(m.second)) for m in found.moments]
    assert parted == [(0, ("", "2"), 0, 1), (5, ("", "2"), 0, 1), (5, ("2", "3"), 1, 0)]
    text = compare_text(a, b, found, [])
    assert "they first diverge at frame 0, target 2 of B\n  A  frame 0: it has no such target\n" in text
    assert "frame 5, target 2 of A, 3 of B, motion\n    A  frame 5: UD 210" in text


def with_evidence(name, *frames):
    """Frames as (log-evidence, agents that gave it)."""
    lines = [
        replace(line(n), log_evidence=value, kl=dict.fromkeys(agents, 0.1))
        for n, (value, agents) in enumerate(frames)
    ]
    return Record(name, [start()], lines)


def test_evidence_counts_where_the_same_agents_gave_it():
    one = with_evidence("a", (0.0, ()), (-3.0, ("color",)), (-4.0, ("color", "motion")), (-5.0, ("color",)))
    other = with_evidence("b", (0.0, ()), (-2.0, ("color",)), (-9.0, ("color",)), (float("-inf"), ("color",)))
    found = compare(one, other).evidence
    assert (found.name, found.first, found.second) == ("log-evidence, nats (1 of 3 frames)", -3.0, -2.0)
    assert found.less_is_better is None


def test_the_larger_evidence_is_better_where_most_frames_have_it():
    one, other = (
        with_evidence(name, *[(value, ("color",))] * 9, (0.0, ()))
        for name, value in (("a", -3.0), ("b", -2.0))
    )
    found = compare(one, other).evidence
    assert (found.name, found.first, found.second) == ("log-evidence, nats (9 of 9 frames)", -27.0, -18.0)
    assert found.less_is_better is False


def test_without_a_frame_of_the_same_agents_there_is_no_evidence():
    one, other = with_evidence("a", (-3.0, ("color",))), with_evidence("b", (-3.0, ("motion",)))
    found = compare(one, other).evidence
    assert found == Total("log-evidence, nats", None, None)
