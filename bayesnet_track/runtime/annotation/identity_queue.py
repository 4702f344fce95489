"""The identities of a finished run: questions by doubt, what answers say, and the tracks that they give."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, Literal

import numpy as np

from bayesnet_track.adapt.chains import LinkPosterior, infer, label_rows
from bayesnet_track.adapt.tracklets import Links, Tracklet, TrackPath, cut_paths, find_links, measure_spreads
from bayesnet_track.journal.blocks import courses
from bayesnet_track.journal.events.lives import Returned
from bayesnet_track.journal.events.statuses import IdentityDoubtful
from bayesnet_track.runtime.recording.run_reader import Run

Kind = Literal["keep", "swap", "new", "same", "skip", "undo"]
KINDS: tuple[Kind, ...] = ("keep", "swap", "new", "same", "skip", "undo")
SURE = 0.999
"""Probability from which on nobody is asked."""
MOST_ODDS = 4.6
"""Log odds that a settled meeting, or a recognition, may give: one in a hundred is something else."""


class IdentityAnswerError(ValueError):
    """An answer that is none of this run; the message is for the person who gave it."""


@dataclass(frozen=True)
class IdentityAnswer:
    """One answer.

    Attributes:
        answer: `keep`: the target is who it was; `swap`: it and `other` have each other's identities; `same`:
            it is who `other` was; `new`: it was not there before; `skip`: nobody can say; `undo`: the newest
            answer that is in force is not.
        frame: first frame of the start that is asked about; 0 of an undo.
        target: the run's target; empty of an undo.
        other: of `swap` and `same`.
    """

    answer: Kind
    frame: int = 0
    target: str = ""
    other: str = ""

    def as_dict(self) -> dict[str, Any]:
        """The answer as a line of the file."""
        if self.answer == "undo":
            return {"answer": "undo"}
        line: dict[str, Any] = {"frame": self.frame, "target": self.target, "answer": self.answer}
        return {**line, "other": self.other} if self.other else line


@dataclass(frozen=True)
class _Candidate:
    """Whom a start may continue.

    Attributes:
        target: the run's target whose end it is; `new` for nobody.
        probability: of it.
        frame: last frame of that end; None of `new`.
    """

    target: str
    probability: float
    frame: int | None


@dataclass(frozen=True)
class IdentityQuestion:
    """A start that a person should look at.

    Attributes:
        target: the run's target.
        frame: first frame in which it is plain again.
        candidates: whom it may continue, by falling probability.
        shown: the one that the tracks have now; a name of the run, or `new`.
        swap: the target that would be exchanged with it; empty where none would.
        doubt: probability that what the tracks have now is wrong, summed over the two of an exchange.
    """

    target: str
    frame: int
    candidates: tuple[_Candidate, ...]
    shown: str
    swap: str
    doubt: float

    def describe(self) -> str:
        """A line for a terminal."""
        shares = ", ".join(
            f"{entry.target if entry.frame is None else f'target {entry.target} until frame {entry.frame}'} "
            f"{entry.probability:.2f}"
            for entry in self.candidates[:3]
        )
        return f"frame {self.frame}, target {self.target}: who was it before? {shares}"


@dataclass(frozen=True, eq=False)
class Tracklets:
    """The pieces of a run, and how they may go on.

    Attributes:
        paths: of every target.
        pieces: tracklets of all paths.
        links: between them.
    """

    paths: tuple[TrackPath, ...]
    pieces: tuple[Tracklet, ...]
    links: Links

    @classmethod
    def of_run(cls, run: Run) -> Tracklets:
        """Cut the tracks of a run, and weigh their links by motion, and by what the run itself says."""
        by_target = courses(run.metrics, ("box", "status"))
        paths = tuple(
            TrackPath(
                target,
                np.asarray(course.frame, dtype=np.int64),
                np.asarray(course.block.columns["box"], dtype=np.float64).T,
                ~course.is_gone,
            )
            for target, course in by_target.items()
            if len(course)
        )
        return cls.of(paths, (run.started.width, run.started.height), run.events)

    @classmethod
    def of(cls, paths: Sequence[TrackPath], size: tuple[int, int], events: Iterable[Any] = ()) -> Tracklets:
        """The same of paths; `events` are those of the run."""
        pieces = cut_paths(paths)
        links = find_links(pieces, measure_spreads(paths, pieces), size)
        unweighed = cls(tuple(paths), tuple(pieces), links)
        return cls(unweighed.paths, unweighed.pieces, unweighed._weighed(events))

    @cached_property
    def starts(self) -> Mapping[tuple[str, int], int]:
        """Target and first clear frame -> its tracklet."""
        return {(self.target(k), piece.frames[0]): k for k, piece in enumerate(self.pieces)}

    @cached_property
    def of_target(self) -> Mapping[str, tuple[int, ...]]:
        """Target -> its tracklets in order."""
        numbers: dict[str, list[int]] = {}
        for k in range(len(self.pieces)):
            numbers.setdefault(self.target(k), []).append(k)
        return {target: tuple(tracklets) for target, tracklets in numbers.items()}

    def target(self, k: int) -> str:
        """The run's target of a tracklet."""
        return self.paths[self.pieces[k].path].target

    def before(self, k: int) -> int | None:
        """The tracklet of the same target before one."""
        return k - 1 if k and self.pieces[k - 1].path == self.pieces[k].path else None

    def end_of(self, target: str, frame: int) -> int | None:
        """The last tracklet of a target that ended before a frame."""
        ended = [k for k in self.of_target.get(target, ()) if self.pieces[k].frames[1] < frame]
        return ended[-1] if ended else None

    def _weighed(self, events: Iterable[Any]) -> Links:
        """The links, where the run itself has compared the two: by meetings and re-identification."""
        place = {
            pair: row
            for row, pair in enumerate(zip(self.links.ends.tolist(), self.links.starts.tolist(), strict=True))
        }
        log_odds = self.links.log_odds.copy()
        for event in events:
            if isinstance(event, IdentityDoubtful):
                ratio = np.log(max(event.probability, 1e-9)) - np.log(max(event.keeps, 1e-9))
                last_plain = event.since
            elif isinstance(event, Returned):
                share = event.recognition.probability
                ratio = np.log(max(event.recognition.rival_probability, 1e-9)) - np.log(max(share, 1e-9))
                last_plain = event.frame - 1
            else:
                continue
            rival = event.other if isinstance(event, IdentityDoubtful) else event.recognition.rival
            start = self._start_after(event.target, last_plain, event.frame)
            if start is None or (previous := self.before(start)) is None:
                continue
            end = self.end_of(rival, self.pieces[start].frames[0])
            row, cross = place[previous, start], place.get((end, start)) if end is not None else None
            if cross is not None:
                mutual = isinstance(event, IdentityDoubtful) and event.mutual
                ratio = float(np.clip(ratio, -MOST_ODDS, MOST_ODDS))
                log_odds[cross] = log_odds[row] + ratio / (2.0 if mutual else 1.0)
        return Links(self.links.ends, self.links.starts, log_odds, self.links.count)

    def _start_after(self, target: str, last_plain: int, frame: int) -> int | None:
        """The last start of a target that is plain after `last_plain`, and begun until `frame`."""
        tracklets = [
            k for k in self.of_target.get(target, ()) if last_plain < self.pieces[k].frames[0] <= frame + 2
        ]
        return tracklets[-1] if tracklets else None


@dataclass(eq=False)
class IdentityQueue:
    """Answers about a run, and what follows from them: a function of the run and the answers alone.

    Attributes:
        tracklets: of the run.
        answers: every one, in order, those that were taken back included.
    """

    tracklets: Tracklets
    answers: list[IdentityAnswer] = field(default_factory=list)
    _posterior: LinkPosterior | None = None

    @property
    def in_force(self) -> tuple[IdentityAnswer, ...]:
        """The answers that no undo took back."""
        standing: list[IdentityAnswer] = []
        for answer in self.answers:
            if answer.answer != "undo":
                standing.append(answer)
            elif standing:
                standing.pop()
        return tuple(standing)

    @property
    def posterior(self) -> LinkPosterior:
        """Posterior of who goes on as whom, given the answers."""
        if self._posterior is None:
            self._posterior = infer(self.tracklets.links, self._given())
        return self._posterior

    def give(self, message: Mapping[str, Any]) -> IdentityAnswer:
        """Take an answer; raises IdentityAnswerError where it is none of this run."""
        answer = self.read(message)
        if answer.answer == "undo" and not self.in_force:
            raise IdentityAnswerError("there is no answer to take back")
        self.answers.append(answer)
        self._posterior = None
        return answer

    def read(self, message: Mapping[str, Any]) -> IdentityAnswer:
        """The answer that a line or a page gives; without `other`, `swap` is with the most probable one."""
        kind = message.get("answer")
        if kind not in KINDS:
            raise IdentityAnswerError(f"answer {kind!r}: one of {', '.join(KINDS)} is needed")
        if kind == "undo":
            return IdentityAnswer("undo")
        frame, target, partner = (message.get(name, "") for name in ("frame", "target", "other"))
        if type(frame) is not int or not isinstance(target, str) or not isinstance(partner, str):
            raise IdentityAnswerError("frame is a whole number, target and other are texts")
        start = self.tracklets.starts.get((target, frame))
        if start is None:
            raise IdentityAnswerError(self._no_start(target, frame))
        previous = self.tracklets.before(start)
        if kind in ("keep", "swap") and previous is None:
            raise IdentityAnswerError(
                f"target {target} begins in frame {frame}: it is new, or the same as another one"
            )
        if kind == "swap" and not partner:
            partner = self._partner(start)
            if not partner:
                raise IdentityAnswerError(f"target {target}, frame {frame}: with whom? Name it as other")
        if kind not in ("swap", "same"):
            return IdentityAnswer(kind, frame, target)
        if self.tracklets.end_of(partner, frame) is None:
            raise IdentityAnswerError(
                f"other {partner!r}: no target of that name is there before frame {frame}"
            )
        if kind == "swap" and partner == target:
            raise IdentityAnswerError(f"target {target} cannot be exchanged with itself")
        return IdentityAnswer(kind, frame, target, partner)

    def _no_start(self, target: str, frame: int) -> str:
        tracklets = self.tracklets.of_target.get(target)
        if tracklets is None:
            return f"target {target!r}: the run has none of that name"
        frames = [self.tracklets.pieces[k].frames[0] for k in tracklets]
        nearest = min(frames, key=lambda number: abs(number - frame))
        return f"target {target}, frame {frame}: there is no question; the nearest one is of frame {nearest}"

    def _given(self) -> dict[int, int | None]:
        """Start -> end that it continues; a later answer takes the end from an earlier one."""
        continued: dict[int, int | None] = {}

        def give(start: int, end: int | None) -> None:
            for earlier, earlier_end in list(continued.items()):
                if end is not None and earlier_end == end and earlier != start:
                    del continued[earlier]
            continued[start] = end

        for answer in self.in_force:
            start = self.tracklets.starts.get((answer.target, answer.frame))
            if start is None or answer.answer == "skip":
                continue
            previous = self.tracklets.before(start)
            if answer.answer in ("new", "keep"):
                give(start, None if answer.answer == "new" else previous)
                continue
            end = self.tracklets.end_of(answer.other, answer.frame)
            if end is None:
                continue
            give(start, end)
            # The other one's next start is who this target was.
            if answer.answer == "swap" and previous is not None:
                following = end + 1
                if following < len(self.tracklets.pieces) and self.tracklets.before(following) == end:
                    give(following, previous)
        return continued

    def questions(self, limit: int | None = None) -> list[IdentityQuestion]:
        """The least certain decisions, the most doubtful first; what is answered or skipped is none."""
        posterior, pieces = self.posterior, self.tracklets.pieces
        answered = {self.tracklets.starts.get((answer.target, answer.frame)) for answer in self.in_force}
        rows: dict[int, list[int]] = {}
        for row, start in enumerate(posterior.links.starts.tolist()):
            rows.setdefault(start, []).append(row)
        follower = {end: start for start, end in posterior.chosen.items()}
        shares: dict[int, dict[int | None, float]] = {}
        doubt = np.zeros(len(pieces))
        for start, link_rows in rows.items():
            shares[start] = {
                **dict(
                    zip(
                        posterior.links.ends[link_rows].tolist(),
                        posterior.probability[link_rows].tolist(),
                        strict=True,
                    )
                ),
                None: float(posterior.new[start]),
            }
            doubt[start] = 1.0 - shares[start].get(posterior.chosen.get(start), 0.0)
        ranked = []
        for start, own_shares in shares.items():
            if start in answered or doubt[start] <= 1.0 - SURE:
                continue
            likeliest = posterior.chosen.get(start)
            rival = max(
                (end for end in own_shares if end != likeliest), key=own_shares.__getitem__, default=None
            )
            partner = follower.get(rival) if rival is not None else None
            joint = 0.0
            if partner is not None and partner != start:
                joint = doubt[partner] * min(own_shares[rival] / max(doubt[start], 1e-12), 1.0)
            ranked.append((doubt[start] + joint, start, partner))
        ranked.sort(key=lambda entry: (-entry[0], entry[1]))
        questions: list[IdentityQuestion] = []
        covered: set[int] = set()
        for value, start, partner in ranked:
            if start in covered:
                continue
            covered.update([start] if partner is None else [start, partner])
            questions.append(self._question(start, shares[start], float(value)))
            if limit is not None and len(questions) == limit:
                break
        return questions

    def _question(self, start: int, shares: Mapping[int | None, float], doubt: float) -> IdentityQuestion:
        ranked = sorted(shares.items(), key=lambda share: -share[1])
        candidates = tuple(
            _Candidate("new", share, None)
            if end is None
            else _Candidate(self.tracklets.target(end), share, self.tracklets.pieces[end].frames[1])
            for end, share in ranked
            if share >= 0.005
        )
        likeliest = self.posterior.chosen.get(start)
        shown_name = "new" if likeliest is None else self.tracklets.target(likeliest)
        return IdentityQuestion(
            self.tracklets.target(start),
            self.tracklets.pieces[start].frames[0],
            candidates,
            shown_name,
            self._partner(start),
            doubt,
        )

    def _partner(self, start: int) -> str:
        """The most probable other target that is there before and after; empty where none is."""
        previous = self.tracklets.before(start)
        if previous is None:
            return ""
        for end in self.posterior.of(start):
            if end is not None and self.tracklets.target(end) != self.tracklets.target(start):
                following = end + 1
                if following < len(self.tracklets.pieces) and self.tracklets.before(following) == end:
                    return self.tracklets.target(end)
        return ""

    def labels(self) -> list[list[str]]:
        """The identity of every row of every path; empty where two would have the same."""
        return label_rows(self.tracklets.paths, self.tracklets.pieces, self.posterior.chosen)

    @property
    def changed(self) -> int:
        """Starts that continue another target than their own."""
        ends = self.posterior.chosen
        return sum(
            end != self.tracklets.before(start) and self.tracklets.target(end) != self.tracklets.target(start)
            for start, end in ends.items()
        )
