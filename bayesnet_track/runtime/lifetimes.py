"""Kept beliefs of a finished run, target by target."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

from bayesnet_track.journal.events.lives import Returned, TargetStarted
from bayesnet_track.journal.events.runs import RunEnded
from bayesnet_track.observation.settings import setting
from bayesnet_track.runtime.recording.beliefs import KeptBelief, read_beliefs
from bayesnet_track.runtime.recording.run_reader import Run


class KeptBeliefsError(ValueError):
    """A run whose beliefs were not kept, or are not those of its journal."""


def kept_lifetimes(run: Run) -> Iterator[list[KeptBelief]]:
    """The beliefs of each target between its start and its end; one that returns begins anew.

    Raises:
        KeptBeliefsError: the run kept no beliefs, or has been smoothed, or one is of an unknown target, or
            those of the last frames of a finished run are missing.
        JournalError: beliefs.jsonl is damaged.
    """
    if run.started.smoothed:
        raise KeptBeliefsError(f"{run.name}: it has been smoothed; use the run that it was made from")
    if not run.directory.beliefs.is_file():
        raise KeptBeliefsError(
            f"{run.name}: it kept no beliefs; run it again with `{setting('--keep-beliefs')}`"
        )
    started = TargetStarted | Returned
    births = {(event.target, event.frame) for event in run.events if isinstance(event, started)}
    open_lives: dict[str, list[KeptBelief]] = {}
    last: dict[str, int] = {}
    for kept in read_beliefs(run.directory.beliefs):
        if kept.target not in run.kinds:
            raise KeptBeliefsError(
                f"{run.directory.beliefs}: target {kept.target!r} never starts in the journal"
            )
        last[kept.target] = kept.frame
        life = open_lives.get(kept.target)
        if life is None or (kept.target, kept.frame) in births:
            if life is not None:
                yield life
            open_lives[kept.target] = [kept]
        else:
            life.append(kept)
    if isinstance(run.events[-1], RunEnded):
        _check_whole(run, last)
    yield from open_lives.values()


def _check_whole(run: Run, last: Mapping[str, int]) -> None:
    """Refuse a file that ends before its run does; `last` has the last frame of each target in the file."""
    frames = {line.target: line.frame for line in run.metrics}
    for target, frame in frames.items():
        if last.get(target, -1) < frame and not _is_start(run, target, frame):
            kept = f"frame {last[target]}" if target in last else "no frame"
            raise KeptBeliefsError(
                f"{run.directory.beliefs}: of target {target!r} it has {kept} last, the run frame {frame}; "
                f"it was cut short: `bayesnet-track verify {run.directory.path}` says what else has changed"
            )


def _is_start(run: Run, target: str, frame: int) -> bool:
    """Whether the target started in that frame, of which no belief is kept."""
    started = TargetStarted | Returned
    return any(isinstance(one, started) and (one.target, one.frame) == (target, frame) for one in run.events)
