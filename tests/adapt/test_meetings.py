"""The posterior over who is who, against sums over every association of every frame."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import multivariate_normal

from bayesnet_track.adapt import meetings
from bayesnet_track.adapt.identities import Entangled, compose, keep_live
from bayesnet_track.adapt.meetings import (
    MOST_MEMBERS,
    RECENT,
    Meeting,
    MeetingDetections,
    Placing,
    SensorRates,
    advance,
    assignments,
    join_meetings,
    open_meeting,
    place_tracks,
)
from bayesnet_track.numerics.arrays import Floats
from bayesnet_track.numerics.records import evolve

MOVE = np.eye(6)
MOVE[0, 4] = MOVE[1, 5] = 1.0
NOISE = np.diag([2.0, 2.0, 0.5, 0.5, 0.3, 0.3])
VARIANCES = np.array([1.0, 1.0, 2.0, 2.0])


def predicted(meeting: Meeting) -> Meeting:
    covariance = MOVE @ meeting.covariance @ MOVE.T + NOISE
    return evolve(meeting, mean=meeting.mean @ MOVE.T, covariance=covariance)


def beliefs(count: int, rng: np.random.Generator) -> tuple[Floats, Floats]:
    mean = np.array([50.0, 50.0, 20.0, 30.0, 1.0, 0.0]) + rng.normal(0, 2.0, (count, 6))
    return mean, np.tile(np.diag([3.0, 3.0, 1.0, 1.0, 0.5, 0.5]), (count, 1, 1))


def frames_of(count: int, found: int, rng: np.random.Generator, frames: int) -> list[MeetingDetections]:
    return [
        MeetingDetections(
            np.array([51.0 + step, 50.0, 20.0, 30.0]) + rng.normal(0, 2.5, (found, 4)),
            np.tile(VARIANCES, (found, 1)),
            rng.normal(-1.0, 0.5, (count, found)),
            np.full(found, -14.0),
        )
        for step in range(frames)
    ]


def enumerated(
    mean: Floats, covariance: Floats, frames: list[MeetingDetections], rates: SensorRates
) -> dict[tuple[int, ...], float]:
    """Assignment of the last frame -> its probability: a sum over all sequences, a filter for each."""
    count, total = len(mean), dict[tuple[int, ...], float]()
    h = np.eye(4, 6)

    def go_on(step: int, log: float, states: list[tuple[Floats, Floats, int]], last: tuple[int, ...]) -> None:
        if step == len(frames):
            total[last] = total.get(last, 0.0) + float(np.exp(log))
            return
        sighting = frames[step]
        moved = [(MOVE @ m, MOVE @ p @ MOVE.T + NOISE, unseen + 1) for m, p, unseen in states]
        gains = np.empty((count, len(sighting.boxes) + 1))
        for member, (m, p, unseen) in enumerate(moved):
            chance = rates.detection if unseen == 1 else min(rates.detection, 0.5)
            gains[member, -1] = np.log(1.0 - chance)
            for column, box in enumerate(sighting.boxes):
                spread = h @ p @ h.T + np.diag(sighting.variances[column])
                density = multivariate_normal.logpdf(box, h @ m, spread)
                look = sighting.looks[member, column] - sighting.log_else[column]
                gains[member, column] = np.log(chance) + density + look
        for choice in assignments(count, len(sighting.boxes)).tolist():
            after = []
            for (m, p, unseen), column in zip(moved, choice, strict=True):
                if column < len(sighting.boxes):
                    spread = h @ p @ h.T + np.diag(sighting.variances[column])
                    gain = p @ h.T @ np.linalg.inv(spread)
                    after.append((m + gain @ (sighting.boxes[column] - h @ m), p - gain @ h @ p, 0))
                else:
                    after.append((m, p, unseen))
            more = sum(gains[member, column] for member, column in enumerate(choice))
            go_on(step + 1, log + more, after, tuple(choice))

    go_on(0, 0.0, [(*one, 0) for one in zip(mean, covariance, strict=True)], ())
    whole = sum(total.values())
    return {key: share / whole for key, share in total.items()}


UNSCALED = SensorRates()


@pytest.mark.parametrize(("count", "found", "frames"), [(2, 2, 4), (2, 3, 3), (3, 2, 3), (4, 3, 1)])
def test_the_posterior_is_that_of_all_associations_of_all_frames(count: int, found: int, frames: int) -> None:
    rng = np.random.default_rng(count + found)
    mean, covariance = beliefs(count, rng)
    seen = frames_of(count, found, rng, frames)
    meeting = open_meeting([str(k) for k in range(count)], 5, mean, covariance)
    for sighting in seen:
        meeting = advance(predicted(meeting), sighting, UNSCALED)
    expected = enumerated(mean, covariance, seen, UNSCALED)
    first = meeting.count - found
    shares: dict[tuple[int, ...], float] = {}
    for weight, recent in zip(meeting.weights, meeting.recent[..., -1], strict=True):
        key = tuple(int(n - first - 1) if n > first else found for n in recent)
        shares[key] = shares.get(key, 0.0) + float(weight)
    assert len(expected) > 1 and max(expected.values()) < 0.99  # else nothing is doubtful
    for key, share in expected.items():
        assert shares.get(key, 0.0) == pytest.approx(share, abs=2e-3)


def test_merging_old_histories_hardly_moves_the_posterior(monkeypatch: pytest.MonkeyPatch) -> None:
    def straight(seed: int) -> float:
        rng = np.random.default_rng(seed)
        mean, covariance = beliefs(2, rng)
        meeting = open_meeting(["1", "2"], 0, mean, covariance)
        for sighting in frames_of(2, 2, rng, 8):
            meeting = advance(predicted(meeting), evolve(sighting, log_else=np.full(2, -60.0)), UNSCALED)
        return float(meeting.weights[meeting.recent[:, 0, -1] == meeting.count - 1].sum())

    merged = [straight(seed) for seed in range(12)]
    monkeypatch.setattr(meetings, "RECENT", 8)
    monkeypatch.setattr(meetings, "MOST_HYPOTHESES", 1 << 14)
    exact = [straight(seed) for seed in range(12)]
    assert np.ptp(exact) > 0.5
    assert np.abs(np.subtract(merged, exact)).max() < 0.05


def test_members_that_were_apart_are_independent_until_they_meet() -> None:
    rng = np.random.default_rng(3)
    mean, covariance = beliefs(2, rng)
    one, other = (
        open_meeting([name], 2, mean[k : k + 1], covariance[k : k + 1]) for k, name in enumerate("ab")
    )
    joined, together = join_meetings(one, other), open_meeting(["a", "b"], 2, mean, covariance)
    sighting = frames_of(2, 2, rng, 1)[0]
    left, right = (advance(predicted(meeting), sighting, UNSCALED) for meeting in (joined, together))
    assert left.members == right.members
    assert sorted(left.weights) == pytest.approx(sorted(right.weights))


def test_tracks_are_named_by_where_the_hypotheses_have_their_members() -> None:
    mean = np.zeros((2, 6))
    mean[:, :2] = [[20.0, 50.0], [80.0, 50.0]]
    covariance = np.tile(np.eye(6), (2, 1, 1))
    meeting = open_meeting(["4", "9"], 0, mean, covariance)
    swapped = evolve(
        meeting,
        mean=np.concatenate([mean[None], mean[None, ::-1]]),
        covariance=np.tile(covariance, (2, 1, 1, 1)),
        log_weight=np.log([0.78, 0.22]),
        looks=np.array([1.8, 0.0]),
        recent=np.zeros((2, 2, RECENT), dtype=np.int64),
        unseen=np.zeros((2, 2), dtype=np.int64),
    )
    placing = place_tracks(swapped, ["4", "9"], mean, covariance)
    assert placing.named()[:2] == [("4", "9"), ("9", "4")]
    assert placing.probability[:2] == pytest.approx([0.777, 0.223], abs=1e-3)  # but for the share of lapses
    assert placing.looks[:2] == pytest.approx([1.8, 0.0], abs=1e-3)
    far = np.array([[500.0, 500.0, 0, 0, 0, 0]])
    new = place_tracks(swapped, ["12"], far, covariance[:1])
    assert new.named()[0] == ("12",) and new.probability[0] > 0.4  # nobody's place: it is itself


def swap(first: str, second: str, probability: float) -> Placing:
    choices = np.array([[0, 1], [1, 0]])
    return Placing(
        (first, second), (first, second), choices, np.array([1 - probability, probability]), np.zeros(2)
    )


def test_meetings_one_after_the_other_are_composed() -> None:
    known = compose((), swap("4", "9", 0.3))
    assert known[0].of("4") == pytest.approx({"4": 0.7, "9": 0.3})
    twice = compose(known, swap("4", "9", 0.3))
    assert twice[0].of("4") == pytest.approx({"4": 0.58, "9": 0.42})  # .7 .7 + .3 .3
    third = compose(known, swap("9", "11", 0.5))
    assert third[0].of("11") == pytest.approx({"11": 0.5, "9": 0.35, "4": 0.15})
    assert third[0].of("4") == pytest.approx({"4": 0.7, "9": 0.3})
    left = keep_live(third, frozenset(("9", "11")), 0.99)
    assert left[0].tracks == ("9", "11")
    assert left[0].of("9") == pytest.approx({"11": 0.5, "9": 0.35, "4": 0.15})


def test_a_sure_parting_leaves_no_doubt() -> None:
    assert compose((), swap("4", "9", 0.004)) == ()
    apart = compose(compose((), swap("1", "2", 0.4)), swap("7", "8", 0.3))
    assert [one.tracks for one in apart] == [("1", "2"), ("7", "8")]
    assert isinstance(apart[0], Entangled)


def test_there_are_as_many_assignments_as_rook_placements() -> None:
    assert [len(assignments(n, n)) for n in range(1, MOST_MEMBERS + 1)] == [2, 7, 34, 209]


def test_innovations_that_are_smaller_than_the_errors_named_are_learnt_as_such() -> None:
    rates, rng = SensorRates(), np.random.default_rng(0)
    for _ in range(200):
        d2 = 0.25 * rng.chisquare(2, (10, 2)) / 2.0
        rates = rates.learn(d2, np.ones(10, dtype=np.int64), (9, 10), 0)
    assert rates.scale2[0] == pytest.approx([0.25, 0.25], rel=0.15)
    assert rates.scale2[3] == pytest.approx(rates.scale2[0], rel=0.5)  # no gap was seen: as without one
    assert rates.detection == pytest.approx(0.9, abs=0.01)
