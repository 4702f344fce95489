"""Tracks between answers, the annotations that they give, and the frame to ask about next."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import islice, pairwise
from typing import Literal, Protocol

import numpy as np

from bayesnet_track.graph.checked import CheckedGraph
from bayesnet_track.numerics.arrays import Image
from bayesnet_track.runtime.annotation.answers import Answer, Box
from bayesnet_track.runtime.tracker import Tracker
from bayesnet_track.sources.entrances.boxes import usable

Key = tuple[int, Box, int]
"""Frame and box that a run starts with, and 1 forward or -1 backward."""

AT_ONCE = 8
"""Trackers that are kept ready to go on: each holds frames."""


class Frames(Protocol):
    """The frames of a video, in any order."""

    def __len__(self) -> int:
        """The number of frames."""

    def image(self, frame: int) -> Image:
        """A frame (H, W, 3) uint8, BGR."""


@dataclass(frozen=True)
class TrackedBox:
    """A box that was found in a frame, and its probability.

    Attributes:
        probability: of being on target, IoU above 0.5.
        sd: standard deviations of the centre, px.
        status: tracking, uncertain or lost.
    """

    box: Box
    probability: float
    sd: tuple[float, float]
    status: str


class Runs(Protocol):
    """Boxes of a target in `frame`, found by a run that starts with `box` in `start`."""

    def at(self, start: int, box: Box, frame: int) -> TrackedBox:
        """Forward where `frame` is later than `start`, else backward."""


@dataclass
class TrackerRuns:
    """Runs of the tracker, each as far as it was asked for. They are kept: the same question costs nothing.

    A run begins with references learnt from its own box, so that a correction is what is learnt from; and
    it depends on nothing but its start, so that taking an answer back gives what there was before.
    """

    graph: CheckedGraph
    frames: Frames
    seed: int = 0
    max_side: int | None = None
    _runs: dict[Key, _Run] = field(default_factory=dict)
    _live: list[Key] = field(default_factory=list)

    def at(self, start: int, box: Box, frame: int) -> TrackedBox:
        """See `Runs`."""
        step = 1 if frame > start else -1
        key = (start, box, step)
        run = self._runs.setdefault(key, _Run(partial(self._find, start, box, step)))
        if not run.reaches(abs(frame - start) - 1):
            self._live = [live for live in self._live if live != key] + [key]
            for idle in self._live[:-AT_ONCE]:
                self._runs[idle].rest()
            self._live = self._live[-AT_ONCE:]
        return run.at(abs(frame - start) - 1)

    def _find(self, start: int, box: Box, step: int) -> Iterator[TrackedBox]:
        tracker = Tracker(self.graph, self.seed, max_side=self.max_side)
        tracker.init(self.frames.image(start), box)
        tracked = TrackedBox(box, 1.0, (0.0, 0.0), "tracking")
        end = len(self.frames) if step > 0 else -1
        for frame in range(start + step, end, step):
            tracker.update(self.frames.image(frame))
            yield (tracked := _found(tracker, tracked))


def _found(tracker: Tracker, previous: TrackedBox) -> TrackedBox:
    try:
        line = tracker.metrics
    except RuntimeError:  # it has ended: a person corrects the box where it was last
        return replace(previous, probability=0.0, status="lost")
    x, y, w, h = (float(value) for value in line.xywh)
    return TrackedBox((x, y, w, h), line.score, (float(line.sd[0]), float(line.sd[1])), tracker.status)


class _Run:
    def __init__(self, begin: Callable[[], Iterator[TrackedBox]]) -> None:
        self._begin, self._found = begin, list[TrackedBox]()
        self._ahead: Iterator[TrackedBox] | None = None

    def reaches(self, number: int) -> bool:
        return len(self._found) > number

    def at(self, number: int) -> TrackedBox:
        if self._ahead is None and not self.reaches(number):
            self._ahead = islice(self._begin(), len(self._found), None)
        try:
            while self._ahead is not None and not self.reaches(number):
                self._found.append(next(self._ahead))
        except BaseException:
            self.rest()  # an iterator that raised gives nothing more
            raise
        return self._found[number]

    def rest(self) -> None:
        """Let go of the tracker; to go on it has to begin anew."""
        self._ahead = None


How = Literal["given", "tracked", "interpolated", "gone"]

AGREE_IOU = 0.5
"""Two boxes that overlap by more are the same finding."""

BY_CHANCE = 0.1
"""Probability that two runs that are both off target agree."""

LEAST_TRACKED = 0.5
"""Below this probability of the better run, the straight line between the given boxes is taken."""


@dataclass(frozen=True)
class BoxMark:
    """A target in a frame of the annotations.

    Attributes:
        box: None where it is gone.
        how: given by a person (drawn or confirmed), tracked, interpolated between two given boxes, or gone.
        probability: of being on target (IoU above 0.5): 1 where given.
    """

    frame: int
    box: Box | None
    how: How
    probability: float = 1.0


def iou(first: Box, second: Box) -> float:
    """Intersection over union of two corner boxes."""
    wide = min(first[0] + first[2], second[0] + second[2]) - max(first[0], second[0])
    tall = min(first[1] + first[3], second[1] + second[3]) - max(first[1], second[1])
    if wide <= 0 or tall <= 0:
        return 0.0
    common = wide * tall
    return common / (first[2] * first[3] + second[2] * second[3] - common)


def _box_between(first: Box, second: Box, share: float) -> Box:
    """The box at `share` of the way from one to the other."""
    x, y, w, h = ((1.0 - share) * a + share * b for a, b in zip(first, second, strict=True))
    return x, y, w, h


def fuse(frame: int, forward: TrackedBox, backward: TrackedBox, line: Box) -> BoxMark:
    """The more probable box of the two runs, or their mean where they agree.

    Of two runs that disagree at most one is on target; where they agree, either both are, or both went
    wrong alike, by chance. `line` is the straight line between the two given boxes: it is taken if no run
    is probable.
    """
    p, q = forward.probability, backward.probability
    if iou(forward.box, backward.box) > AGREE_IOU:
        right, wrong = p * q, BY_CHANCE * (1.0 - p) * (1.0 - q)
        box = _box_between(forward.box, backward.box, q / (p + q) if p + q > 0 else 0.5)
        return BoxMark(frame, box, "tracked", _share(right, wrong))
    of_forward, of_backward, of_none = p * (1.0 - q), q * (1.0 - p), (1.0 - p) * (1.0 - q)
    larger = max(of_forward, of_backward)
    probability = _share(larger, of_forward + of_backward + of_none - larger)
    if probability < LEAST_TRACKED:
        return BoxMark(frame, line, "interpolated", probability)
    return BoxMark(frame, (forward if of_forward >= of_backward else backward).box, "tracked", probability)


def _share(part: float, complement: float) -> float:
    return part / (part + complement) if part + complement > 0 else 0.0


THRESHOLD, PATIENCE = 0.8, 20
"""Chosen on 13 videos: docs/benchmarks/annotate.md has the figures, and those of 12 others."""


@dataclass(frozen=True)
class Asking:
    """Settings of when to ask.

    Attributes:
        threshold: probability of being on target below which a box is doubtful.
        patience: how many frames in a row may be doubtful before it asks, when it runs ahead. If the box
            that is then given explains them, looking backward, nobody is asked about them.
    """

    threshold: float = THRESHOLD
    patience: int = PATIENCE


@dataclass(frozen=True)
class FrameQuestion:
    """A frame that a person should look at.

    Attributes:
        shown: what the tracker would say.
        reason: why it is asked, with numbers.
        is_failure: the target cannot be tracked until it is answered.
    """

    target: str
    frame: int
    shown: BoxMark
    reason: str
    is_failure: bool = False


@dataclass(frozen=True)
class Annotations:
    """Boxes and open questions of each target so far.

    Attributes:
        marks: target -> frame -> its mark. Frames after a question that is open may be missing.
        questions: what is to be asked, at most one of a target; the first one first.
    """

    marks: Mapping[str, Mapping[int, BoxMark]] = field(default_factory=dict)
    questions: tuple[FrameQuestion, ...] = ()

    @property
    def failures(self) -> tuple[FrameQuestion, ...]:
        """Questions because of which a target is not tracked."""
        return tuple(question for question in self.questions if question.is_failure)


def annotate_video(
    answers: Mapping[str, Sequence[Answer]], runs: Runs, frames: int, asking: Asking | None = None
) -> Annotations:
    """The annotations that the answers (target -> answers by frame) give."""
    asking = asking or Asking()
    marks: dict[str, Mapping[int, BoxMark]] = {}
    questions = []
    for target, of_target in answers.items():
        target_marks, question = annotate_target(target, of_target, runs, frames, asking)
        marks[target] = target_marks
        questions += [] if question is None else [question]
    return Annotations(marks, tuple(questions))


def annotate_target(
    target: str, answers: Sequence[Answer], runs: Runs, frames: int, asking: Asking
) -> tuple[dict[int, BoxMark], FrameQuestion | None]:
    """The marks of one target by frame, and what to ask about it first."""
    marks = {answer.frame: _given(answer) for answer in answers}
    questions = []
    for answer, following in pairwise(answers):
        marks |= {mark.frame: mark for mark in _between(answer, following, runs)}
        question = _doubt_between(target, answer, following, marks, asking)
        questions += [] if question is None else [question]
    if answers and not questions:
        remaining = range(answers[-1].frame + 1, frames)
        question = _run_ahead(target, answers[-1], runs, remaining, marks, asking)
        questions += [] if question is None else [question]
    return dict(sorted(marks.items())), next(iter(questions), None)


def fail(
    target: str, answers: Sequence[Answer], frame: int, reason: str
) -> tuple[dict[int, BoxMark], FrameQuestion]:
    """The marks of a target that cannot be tracked, the given ones, and the question that says why.

    A box with which nothing can be computed is none of them.
    """
    marks = {
        answer.frame: _given(answer)
        for answer in answers
        if answer.box is None or usable(np.array([answer.box], dtype=np.float64))[0]
    }
    mark = marks.get(frame, BoxMark(frame, None, "gone", 0.0))
    return marks, FrameQuestion(target, frame, mark, f"not tracked: {reason}", True)


def _given(answer: Answer) -> BoxMark:
    return BoxMark(answer.frame, answer.box, "gone" if answer.box is None else "given")


def _between(answer: Answer, following: Answer, runs: Runs) -> Iterator[BoxMark]:
    for frame in range(answer.frame + 1, following.frame):
        if answer.box is None:
            yield BoxMark(frame, None, "gone")
            continue
        forward = runs.at(answer.frame, answer.box, frame)
        if following.box is None:
            yield BoxMark(frame, forward.box, "tracked", forward.probability)
            continue
        backward = runs.at(following.frame, following.box, frame)
        share = (frame - answer.frame) / (following.frame - answer.frame)
        yield fuse(frame, forward, backward, _box_between(answer.box, following.box, share))


def _doubt_between(
    target: str, answer: Answer, following: Answer, marks: Mapping[int, BoxMark], asking: Asking
) -> FrameQuestion | None:
    """The most doubtful frame between two answers; of equals the one in the middle of the gap."""
    middle = (answer.frame + following.frame) / 2
    doubtful = [
        marks[frame]
        for frame in range(answer.frame + 1, following.frame)
        if marks[frame].probability < asking.threshold
    ]
    if not doubtful:
        return None
    worst = min(doubtful, key=lambda mark: (round(mark.probability, 2), abs(mark.frame - middle)))
    compared = f"probability of being on target {worst.probability:.2f} < {asking.threshold:.2f}"
    how = (
        f"tracked forward from frame {answer.frame}, before it is gone"
        if following.box is None
        else f"tracked forward from frame {answer.frame} and backward from frame {following.frame}"
    )
    return FrameQuestion(target, worst.frame, worst, f"{compared}, {how}")


def _run_ahead(
    target: str, answer: Answer, runs: Runs, remaining: range, marks: dict[int, BoxMark], asking: Asking
) -> FrameQuestion | None:
    """Track on from the last answer until a frame is to be asked about: the last one, if none before it.

    What follows the last answer is tracked in one direction alone: a sure run may be wrong, and only one back
    from the end of the video shows it.
    """
    doubtful = 0
    mark: BoxMark | None = None
    for frame in remaining:
        if answer.box is None:
            marks[frame] = BoxMark(frame, None, "gone")
            continue
        tracked = runs.at(answer.frame, answer.box, frame)
        mark = marks[frame] = BoxMark(frame, tracked.box, "tracked", tracked.probability)
        doubtful = doubtful + 1 if mark.probability < asking.threshold else 0
        if doubtful >= asking.patience or (doubtful and frame == remaining[-1]):
            duration = "" if doubtful == 1 else f" for {doubtful} frames"
            status = "" if tracked.status == "tracking" else f", status {tracked.status}"
            reason = (
                f"probability of being on target {mark.probability:.2f} < {asking.threshold:.2f}{duration}, "
                f"{frame - answer.frame} frames after the last answer; standard deviation "
                f"{tracked.sd[0]:.0f} x {tracked.sd[1]:.0f} px{status}"
            )
            return FrameQuestion(target, frame, mark, reason)
    if mark is None:
        return None
    reason = (
        f"the last frame: nothing is in doubt since frame {answer.frame}, but that was tracked forward "
        "alone; from here it is tracked backward, too"
    )
    return FrameQuestion(target, mark.frame, mark, reason)
