"""Ask a cue about a group of targets, here or elsewhere; agents that give no answer.

The engine hands over work whose pieces do not depend on each other (the agents that observe, those that
learn), so that where an agent runs changes no result. One piece is never split: an agent sees all its
hypotheses at once.

A cue is written for one target; `score` and `follow` lift it to T of them. Where it has a form for all at
once (`GroupCue`) that is asked; if it fails, one target after the other, so that others keep their answers.
"""

from __future__ import annotations

import cmath
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import chain
from operator import call
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from bayesnet_track.journal.events.faults import AgentMissed
from bayesnet_track.numerics.arrays import Floats, Ints
from bayesnet_track.observation.cue import (
    FAULTS,
    Hypotheses,
    Reference,
    Turnable,
    real_numbers,
    said,
    text_of,
)
from bayesnet_track.observation.likelihoods import ReferenceRows
from bayesnet_track.observation.planes import Planes, seal, shown

Key = tuple[str, str, str]


@dataclass(frozen=True)
class Missing:
    """No answer, and why."""

    reason: str


@dataclass(eq=False)
class Availability:
    """Agents that give no answer in one frame.

    An agent that was known to be missing is not asked, so that a run with the same inputs repeats.

    Attributes:
        frame: frame index.
        known: (target, agent, what it was asked for) -> why it gives none.
        reported: those of them that were to be asked, or were found out.
    """

    frame: int = 0
    known: dict[Key, str] = field(default_factory=dict)
    reported: dict[Key, str] = field(default_factory=dict)

    @staticmethod
    def of(frame: int, missed: Iterable[AgentMissed]) -> Availability:
        """The agents that are known to be missing in `frame`."""
        return Availability(frame, {(miss.target, miss.node, miss.during): miss.reason for miss in missed})

    def misses(self, target: str, agent: str, during: str) -> Missing | None:
        """The reason why the agent cannot be asked; None when it can."""
        key = (target, agent, during)
        if key not in self.known:
            return None
        self.reported[key] = self.known[key]
        return Missing(self.known[key])

    def note(self, target: str, agent: str, during: str, reason: str) -> None:
        """The agent was asked and gave no answer."""
        self.known[target, agent, during] = self.reported[target, agent, during] = reason

    def of_target(self, target: str, during: str) -> TargetAvailability:
        """The agents of one target, asked for one thing."""
        return TargetAvailability(self, target, during)

    @property
    def events(self) -> tuple[AgentMissed, ...]:
        """Events of the missed agents, in an order that does not depend on when they were found out."""
        if not self.reported:
            return ()
        return tuple(
            AgentMissed(self.frame, target, agent, reason, during)
            for (target, agent, during), reason in sorted(self.reported.items())
        )


@dataclass(frozen=True)
class TargetAvailability:
    """Agents of one target that give no answer, asked for one thing."""

    availability: Availability = field(default_factory=Availability)
    target: str = ""
    during: str = ""

    def misses(self, agent: str) -> Missing | None:
        """The reason why the agent cannot be asked; None when it can."""
        return self.availability.misses(self.target, agent, self.during)

    @property
    def missed(self) -> dict[str, str]:
        """Missing agents that were to be asked, or were found out -> the reason."""
        occasion = (self.target, self.during)
        return {
            agent: reason
            for (target, agent, during), reason in self.availability.reported.items()
            if (target, during) == occasion
        }

    def note(self, agent: str, missing: Missing) -> None:
        """The agent was asked and gave no answer."""
        self.availability.note(self.target, agent, self.during, missing.reason)


Piece = TypeVar("Piece")
Made = TypeVar("Made")
Wait = Callable[[], Made]
"""Waits for an answer that was asked for, and returns it."""


class AgentUnavailable(Exception):
    """An agent gave no answer for a reason outside of it: its process died, hangs, or is late.

    Its answer is missing in one frame; other than a fault of the cue it says nothing about the next one, and
    does not repeat when the run does.
    """


def is_elsewhere(cue: Any) -> bool:
    """True if a cue is at work in another process, and can be asked now and answer later (`ask_ahead`)."""
    return hasattr(cue, "ask_ahead")


def each_at_once(
    ask_ahead: Callable[[Piece], Wait[Made] | None],
    work: Callable[[Piece], Made],
    pieces: Iterable[Piece],
) -> Iterator[tuple[Piece, Made]]:
    """Every piece with what was made of it: first those that `work` makes here, then those from elsewhere.

    `ask_ahead` asks who is elsewhere and returns what waits for the answer; None for a piece to be done here.
    All are asked before anything is done here, and their answers collected after it. The work is done as
    pairs are collected, in the caller's frame, so that a stack shows who asks and who answers, and nothing
    between.

    >>> dict(each_at_once(lambda n: (lambda: -n) if n > 1 else None, lambda n: n, [1, 2, 0]))
    {1: 1, 0: 0, 2: -2}
    """
    waits: dict[Piece, Wait[Made]] = {}
    local: list[Piece] = []
    for piece in pieces:
        wait = ask_ahead(piece)
        if wait is None:
            local.append(piece)
        else:
            waits[piece] = wait
    return chain(
        zip(local, map(work, local), strict=True),
        zip(waits, map(call, waits.values()), strict=True),
    )


def defer_faults(ask: Callable[[], Wait[Made]], faults: tuple[type[BaseException], ...]) -> Wait[Made]:
    """The answer of `ask`; where it raises one of `faults`, an answer that raises it when waited for."""
    try:
        return ask()
    except faults as error:
        fault = error

    def raised() -> Made:
        raise fault

    return raised


Fault = str | Missing
"""What is wrong with an answer, or why there is none."""

ROUNDING = 1e-6
"""How far above 0, the value of a perfect match, a log-likelihood may end by rounding."""

ZERO_BELOW = -1e100
"""A log-likelihood below this is a likelihood of zero, so that sums of them stay finite."""


def score(
    cue: Any, planes: Sequence[Planes], hypotheses: Hypotheses, starts: Ints, references: Sequence[Reference]
) -> tuple[Floats, dict[int, Fault]]:
    """(N,) log-likelihoods of the hypotheses of T targets, and the faults of those targets that have none.

    Those of target t are `starts[t]` to `starts[t + 1] - 1`. The cue is given copies that it may write into.
    """
    copies = hypotheses.copied()
    size = len(copies)
    if len(references) > 1 and hasattr(cue, "log_likelihood_of_each"):
        try:
            values = real_numbers(cue.log_likelihood_of_each(planes, copies, starts, _shown(references)))
        except FAULTS:  # of whom is found out below
            values = ""
        if not isinstance(values, str) and values.shape == (size,) and _is_usual(values):
            return values, {}
        copies = hypotheses.copied()
    firsts, faults = starts.tolist(), dict[int, Fault]()
    values = np.zeros(size)
    for t, reference in enumerate(references):
        its = copies if len(references) == 1 else copies.part(firsts[t], firsts[t + 1])
        try:
            answer = real_numbers(cue.log_likelihood(planes[t], its, shown(reference)))
            checked: Floats | Fault = check_log_likelihood(answer, len(its))
        except FAULTS as error:  # a cue is a guest's code: whatever it raises must not end the run
            checked = fault_of(error)
        if isinstance(checked, str | Missing):
            faults[t] = checked
        else:
            values[firsts[t] : firsts[t + 1]] = checked
    return values, faults


def follow(
    cue: Any,
    planes: Sequence[Planes],
    boxes: Floats,
    references: Sequence[Reference],
    rates: Floats,
    angles: Floats | None = None,
) -> tuple[Sequence[Reference], dict[int, Fault]]:
    """T references, each blended at its rate with what is learnt in its centre box of (T, 4), and the faults.

    `angles` are the rotations of the targets, degrees. A target with a fault keeps its reference. Without a
    change of shapes, `ReferenceRows` stay rows.
    """
    if len(references) > 1 and angles is None and hasattr(cue, "follow_each"):
        try:
            rows = cue.follow_each(planes, boxes.copy(), _shown(references), rates)
            if len(rows) == len(references) and _are_finite(rows):
                return (rows if isinstance(rows, ReferenceRows) else [seal(learnt) for learnt in rows]), {}
        except FAULTS:  # of whom is found out below
            pass
    updated, faults = list[Reference](), dict[int, Fault]()
    for t, reference in enumerate(references):
        try:
            box_and_angle = boxes[t].copy(), 0.0 if angles is None else float(angles[t])
            checked = check_reference(
                _follow_one(cue, planes[t], box_and_angle, shown(reference), float(rates[t]))
            )
        except FAULTS as error:
            faults[t] = fault_of(error, " while learning")
            updated.append(reference)
            continue
        if isinstance(checked, str):
            faults[t] = checked
        updated.append(reference if isinstance(checked, str) else checked)
    return (ReferenceRows.of(updated) if isinstance(references, ReferenceRows) else updated), faults


def _follow_one(
    cue: Any, planes: Planes, box_and_angle: tuple[Floats, float], reference: Reference, rate: float
) -> Reference:
    """The reference blended with what the cue sees in a centre box (4,) that is turned by an angle."""
    box, angle = box_and_angle
    follow_itself = getattr(cue, "follow", None)
    updated: Reference
    if angle != 0.0 and isinstance(cue, Turnable):
        learnt = cue.learn_turned(planes, box, angle)
    elif follow_itself is not None:
        updated = follow_itself(planes, box, reference, rate)
        return updated
    else:
        learnt = cue.learn(planes, box)
    updated = cue.blend(reference, learnt, rate)
    return updated


def fault_of(error: BaseException, during: str = "") -> Fault:
    """Description of an exception of a cue."""
    if isinstance(error, AgentUnavailable):
        return Missing(str(error))
    return f"raised {type(error).__name__}{during}: {text_of(error)}" if during else f"raised {said(error)}"


def _shown(references: Sequence[Reference]) -> Sequence[Reference]:
    """References as a cue is given them: it can change nothing."""
    return (
        references
        if isinstance(references, ReferenceRows)
        else [shown(reference) for reference in references]
    )


def _is_usual(log_likelihood: Floats) -> bool:
    """True where nothing is NaN, above 0 or zero."""
    if not len(log_likelihood):
        return False
    return bool(log_likelihood.max() <= ROUNDING and log_likelihood.min() >= ZERO_BELOW)  # neither when NaN


def check_log_likelihood(log_likelihood: Floats | str, size: int) -> Floats | str:
    """Log-likelihoods that a cue returned for (size,) hypotheses, or in words what is wrong."""
    if isinstance(log_likelihood, str):
        return f"returned a value of type {log_likelihood}, not {size} real numbers"
    if log_likelihood.shape != (size,):
        return f"returned an array of shape {log_likelihood.shape} for {size} hypotheses"
    if _is_usual(log_likelihood):
        return log_likelihood
    wrong = np.isnan(log_likelihood) | (log_likelihood > ROUNDING)
    if wrong.any():
        value = f"a log-likelihood of {log_likelihood[wrong][0]:.6g}, not at most 0,"
        return f"returned {value} for {int(wrong.sum())} of {size} hypotheses"
    log_likelihood[log_likelihood < ZERO_BELOW] = -np.inf
    if not np.isfinite(log_likelihood).any():
        return f"returned a likelihood of zero for all {size} hypotheses"
    return log_likelihood


def check_reference(reference: Mapping[str, Any]) -> Reference | str:
    """Reference that a cue learnt, each array for reading only; or which of them is not finite."""
    for name, values in reference.items():
        array = np.asarray(values)
        if array.dtype.kind in "fc" and not _is_finite(array):
            return f"made a reference whose {name!r} is not finite"
    return seal(reference)


def _are_finite(references: Sequence[Reference]) -> bool:
    mappings = [references.columns] if isinstance(references, ReferenceRows) else references
    arrays = [np.asarray(values) for mapping in mappings for values in mapping.values()]
    return all(_is_finite(array) for array in arrays if array.dtype.kind in "fc")


def _is_finite(array: NDArray[Any]) -> bool:
    if array.ndim == 0:
        return cmath.isfinite(array.item())
    # What is not finite leaves no sum of squares that is; but so do large numbers.
    line = array.ravel()
    return cmath.isfinite(np.vdot(line, line)) or np.count_nonzero(np.isfinite(array)) == array.size
