"""The annotations that answers give, and the frame to ask about next: pure functions."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np

from bayesnet_track.runtime.annotation.answers import Answer
from bayesnet_track.runtime.annotation.fusing import Mark, between, fuse
from bayesnet_track.runtime.annotation.tracked import Runs
from bayesnet_track.sources.entrances.boxes import usable

THRESHOLD, PATIENCE = 0.8, 20
"""Chosen on 13 videos: docs/annotate.md has the figures, and those of 12 others."""


@dataclass(frozen=True)
class Asking:
    """When to ask.

    Attributes:
        threshold: probability of being on target below which a box is doubtful.
        patience: how many frames in a row may be doubtful before it asks, when it runs ahead. If the box
            that is then given explains them, looking backward, nobody is asked about them.
    """

    threshold: float = THRESHOLD
    patience: int = PATIENCE


@dataclass(frozen=True)
class Question:
    """A frame that a person should look at.

    Attributes:
        shown: what the tracker would say.
        reason: why it is asked, with numbers.
        is_failure: the target cannot be tracked until it is answered.
    """

    target: str
    frame: int
    shown: Mark
    reason: str
    is_failure: bool = False


@dataclass(frozen=True)
class Annotations:
    """What is known of each target so far.

    Attributes:
        marks: target -> frame -> its mark. Frames after a question that is open may be missing.
        questions: what is to be asked, at most one of a target; the first one first.
    """

    marks: Mapping[str, Mapping[int, Mark]] = field(default_factory=dict)
    questions: tuple[Question, ...] = ()

    @property
    def failures(self) -> tuple[Question, ...]:
        """Those questions because of which a target is not tracked."""
        return tuple(one for one in self.questions if one.is_failure)


def annotate(
    answers: Mapping[str, Sequence[Answer]], runs: Runs, frames: int, asking: Asking | None = None
) -> Annotations:
    """The annotations that the answers (target -> answers by frame) give."""
    asking = asking or Asking()
    marks: dict[str, Mapping[int, Mark]] = {}
    questions = []
    for target, own in answers.items():
        found, question = annotate_target(target, own, runs, frames, asking)
        marks[target] = found
        questions += [] if question is None else [question]
    return Annotations(marks, tuple(questions))


def annotate_target(
    target: str, answers: Sequence[Answer], runs: Runs, frames: int, asking: Asking
) -> tuple[dict[int, Mark], Question | None]:
    """The marks of one target by frame, and what to ask about it first."""
    marks = {one.frame: _given(one) for one in answers}
    questions = []
    for one, then in pairwise(answers):
        marks |= {mark.frame: mark for mark in _between(one, then, runs)}
        question = _doubt_between(target, one, then, marks, asking)
        questions += [] if question is None else [question]
    if answers and not questions:
        ahead = range(answers[-1].frame + 1, frames)
        question = _run_ahead(target, answers[-1], runs, ahead, marks, asking)
        questions += [] if question is None else [question]
    return dict(sorted(marks.items())), next(iter(questions), None)


def fail(target: str, answers: Sequence[Answer], frame: int, reason: str) -> tuple[dict[int, Mark], Question]:
    """The marks of a target that cannot be tracked, the given ones, and the question that says why.

    A box with which nothing can be computed is none of them.
    """
    marks = {
        one.frame: _given(one)
        for one in answers
        if one.box is None or usable(np.array([one.box], dtype=np.float64))[0]
    }
    shown = marks.get(frame, Mark(frame, None, "gone", 0.0))
    return marks, Question(target, frame, shown, f"not tracked: {reason}", True)


def _given(answer: Answer) -> Mark:
    return Mark(answer.frame, answer.box, "gone" if answer.box is None else "given")


def _between(one: Answer, then: Answer, runs: Runs) -> Iterator[Mark]:
    for frame in range(one.frame + 1, then.frame):
        if one.box is None:
            yield Mark(frame, None, "gone")
            continue
        forward = runs.at(one.frame, one.box, frame)
        if then.box is None:
            yield Mark(frame, forward.box, "tracked", forward.probability)
            continue
        backward = runs.at(then.frame, then.box, frame)
        share = (frame - one.frame) / (then.frame - one.frame)
        yield fuse(frame, forward, backward, between(one.box, then.box, share))


def _doubt_between(
    target: str, one: Answer, then: Answer, marks: Mapping[int, Mark], asking: Asking
) -> Question | None:
    """The most doubtful frame between two answers; of equals the one in the middle of the gap."""
    middle = (one.frame + then.frame) / 2
    doubtful = [
        marks[frame]
        for frame in range(one.frame + 1, then.frame)
        if marks[frame].probability < asking.threshold
    ]
    if not doubtful:
        return None
    worst = min(doubtful, key=lambda mark: (round(mark.probability, 2), abs(mark.frame - middle)))
    compared = f"probability of being on target {worst.probability:.2f} < {asking.threshold:.2f}"
    how = (
        f"tracked forward from frame {one.frame}, before it is gone"
        if then.box is None
        else f"tracked forward from frame {one.frame} and backward from frame {then.frame}"
    )
    return Question(target, worst.frame, worst, f"{compared}, {how}")


def _run_ahead(
    target: str, last: Answer, runs: Runs, ahead: range, marks: dict[int, Mark], asking: Asking
) -> Question | None:
    """Track on from the last answer until a frame is to be asked about: the last one, if none before it.

    What follows the last answer is tracked in one direction alone: a sure run may be wrong, and only one back
    from the end of the video shows it.
    """
    doubtful = 0
    mark: Mark | None = None
    for frame in ahead:
        if last.box is None:
            marks[frame] = Mark(frame, None, "gone")
            continue
        found = runs.at(last.frame, last.box, frame)
        mark = marks[frame] = Mark(frame, found.box, "tracked", found.probability)
        doubtful = doubtful + 1 if mark.probability < asking.threshold else 0
        if doubtful >= asking.patience or (doubtful and frame == ahead[-1]):
            since = "" if doubtful == 1 else f" for {doubtful} frames"
            status = "" if found.status == "tracking" else f", status {found.status}"
            reason = (
                f"probability of being on target {mark.probability:.2f} < {asking.threshold:.2f}{since}, "
                f"{frame - last.frame} frames after the last answer; standard deviation "
                f"{found.sd[0]:.0f} x {found.sd[1]:.0f} px{status}"
            )
            return Question(target, frame, mark, reason)
    if mark is None:
        return None
    reason = (
        f"the last frame: nothing is in doubt since frame {last.frame}, but that was tracked forward alone; "
        "from here it is tracked backward, too"
    )
    return Question(target, mark.frame, mark, reason)
