"""Candidates, detected and no target yet, gather looks until they are confirmed: pure functions."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from bayesnet_track.adapt.association import NOBODY, distances, pair_up
from bayesnet_track.graph.settings.lifecycle import Birth, Confirm
from bayesnet_track.numerics.arrays import Floats
from bayesnet_track.numerics.records import changed

FOLLOW_BOX = 1.0
"""How far from where it is expected a candidate is looked for, in box sides."""


@dataclass(frozen=True, eq=False)
class Candidate:
    """Something detected that is no target yet.

    Attributes:
        box: (4,) centre box where it was last detected, or is expected since.
        step: (2,) its centre's last displacement per look, px.
        looks: for each of the last looks, its score there, or None when it was not seen.
        first_frame: frame in which it was first detected.
        birth: what its draws are keyed by once it is a target: its first detection.
        mean: (D,) of its belief, where the plate has `existence` or tentative tracks.
        covariance: (D, D) of its belief.
        existence: probability that it exists.
        observed: (H,) what is remembered of the detections of a tentative track (`adapt.observed`).
    """

    box: Floats
    step: Floats
    looks: tuple[float | None, ...]
    first_frame: int
    birth: str
    mean: Floats | None = None
    covariance: Floats | None = None
    existence: float | None = None
    observed: Floats | None = None

    @property
    def seen(self) -> int:
        """In how many of its looks it was seen."""
        return sum(score is not None for score in self.looks)

    @property
    def score(self) -> float:
        """Mean score of the looks in which it was seen."""
        scores = [score for score in self.looks if score is not None]
        return sum(scores) / len(scores)


def feed(
    candidates: Sequence[Candidate],
    boxes: Floats,
    scores: Floats,
    births: Sequence[str],
    frame: int,
    rule: Birth,
) -> tuple[Candidate, ...]:
    """The candidates after a look that found the boxes (N, 4), the best first, which are no live target's.

    A candidate goes on with the nearest box within `FOLLOW_BOX` of where it is expected. One that was missed
    too often to be confirmed by the looks it has left is dropped. No more than twice `rule.max_targets` (and
    8) are
    kept: those seen most often, then those with the best scores. `births` are what the draws of each box are
    keyed by if it is the first of a target.
    """
    confirm = rule.confirm
    expected = np.array([_move_on(one).box for one in candidates]).reshape(-1, 4)
    owner = pair_up(distances(boxes, expected), np.full((len(boxes), len(expected)), FOLLOW_BOX))
    found = {int(k): row for row, k in enumerate(owner) if k != NOBODY}
    kept = []
    for number, one in enumerate(candidates):
        row = found.get(number)
        if row is None:
            after = _add_look(_move_on(one), None, confirm)
        else:
            after = _add_look(one, float(scores[row]), confirm)
            after = changed(after, box=boxes[row].copy(), step=boxes[row, :2] - one.box[:2])
        if not _is_hopeless(after, confirm):
            kept.append(after)
    for new in np.flatnonzero(owner == NOBODY).tolist():
        kept.append(Candidate(boxes[new].copy(), np.zeros(2), (float(scores[new]),), frame, births[new]))
    return keep_best(kept, rule)


def look_again(
    candidate: Candidate, box: Floats | None, score: float | None, confirm: Confirm
) -> Candidate | None:
    """A tentative track after a look: seen in the centre box (4,) or not; None when it is given up."""
    after = _add_look(candidate, score, confirm)
    if box is not None:
        after = changed(after, box=box.copy(), step=box[:2] - candidate.box[:2])
    return None if _is_hopeless(after, confirm) else after


def keep_best(kept: Sequence[Candidate], rule: Birth) -> tuple[Candidate, ...]:
    """No more than twice `rule.max_targets` (and 8): those seen most often, then those of the best scores."""
    most = max(2 * rule.max_targets, 8)
    if len(kept) <= most:
        return tuple(kept)
    best = sorted(range(len(kept)), key=lambda k: (-kept[k].seen, -kept[k].score, k))
    chosen = sorted(best[:most])
    return tuple(kept[k] for k in chosen)


def is_confirmed(candidate: Candidate, confirm: Confirm) -> bool:
    """True when it is seen now and was often enough."""
    return candidate.looks[-1] is not None and candidate.seen >= confirm.hits


def _add_look(candidate: Candidate, score: float | None, confirm: Confirm) -> Candidate:
    return changed(candidate, looks=(*candidate.looks, score)[-confirm.of :])


def _move_on(candidate: Candidate) -> Candidate:
    box = candidate.box.copy()
    box[:2] += candidate.step
    return changed(candidate, box=box)


def _is_hopeless(candidate: Candidate, confirm: Confirm) -> bool:
    """True after so many misses on end that no look it has had can count toward a confirmation."""
    misses = 0
    for score in reversed(candidate.looks):
        if score is not None:
            break
        misses += 1
    return misses > confirm.of - confirm.hits


def is_refusal_notable(before: int, after: int) -> bool:
    """True when the number of refused births has reached 1, 10, 100, ... since it was `before`."""
    level = 1
    while level <= before:
        level *= 10
    return after >= level
