"""One target's life as a short story: where it came from, what its net did, why it was lost, its end."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence

from bayesnet_track.journal.codec import event_name
from bayesnet_track.journal.events import distractors, guarantees
from bayesnet_track.journal.events.births import CandidateConfirmed, TargetStarted
from bayesnet_track.journal.events.endings import DuplicateEnded, TargetDied
from bayesnet_track.journal.events.event import Event
from bayesnet_track.journal.events.faults import VerifierFailed
from bayesnet_track.journal.events.jumps import Reappeared
from bayesnet_track.journal.events.reidentification import Reacquired, Returned
from bayesnet_track.journal.events.self_checks import LocallyAdapted
from bayesnet_track.journal.events.statuses import FoundAgain, SceneCut, StatusChanged
from bayesnet_track.journal.events.switches import Scheduled
from bayesnet_track.journal.metrics import FrameMetrics
from bayesnet_track.journal.net.net import Switch
from bayesnet_track.journal.text.folding import CallsFolded
from bayesnet_track.journal.text.sentences import explain
from bayesnet_track.journal.text.wording import plural

CHAPTERS = (
    CandidateConfirmed,
    TargetStarted,
    Returned,
    SceneCut,
    StatusChanged,
    Reacquired,
    TargetDied,
    DuplicateEnded,
    # What limits the score or frees it, withholds the status, or finds the target: a status has a cause.
    distractors.DistractorSeen,
    distractors.DoubtEnded,
    guarantees.AssuranceChanged,
    guarantees.AlarmRaised,
    guarantees.AlarmEnded,
    FoundAgain,
    Reappeared,
    VerifierFailed,
)
"""What is told in full; everything between two of them is condensed."""


def describe_life(events: Sequence[Event], metrics: Iterable[FrameMetrics], target: str) -> str:
    """The story of one target, a line per chapter; `metrics` are the run's.

    Raises:
        ValueError: as `check_target`.
    """
    check_target(events, target)
    mine = [event for event in events if getattr(event, "target", None) == target]
    lines: list[str] = []
    between: list[Event] = []
    for event in mine:
        if isinstance(event, CHAPTERS):
            lines += _condense(between)
            between = []
            lines.append(explain(event))
        else:
            between.append(event)
    lines += _condense(between)
    own = [line for line in metrics if line.target == target]
    return "\n".join([*lines, _ending(mine, own)])


def check_target(events: Iterable[Event], target: str) -> None:
    """Refuse a target that the run does not have.

    Raises:
        ValueError: no target of this id lives in the run.
    """
    started = TargetStarted | Returned
    ids = dict.fromkeys(event.target for event in events if isinstance(event, started))
    if target not in ids:
        raise ValueError(f"no target {target!r} in this run; there are {', '.join(ids) or 'none'}")


def _condense(events: Iterable[Event]) -> list[str]:
    """What happened between two chapters: switches and counts in one line, agents on call in another."""
    events = list(events)
    calls = tuple(event for event in events if isinstance(event, Scheduled))
    told = [CallsFolded(calls).describe()] if calls else []
    switches = [event for event in events if isinstance(event, Switch)]
    counted = Counter(_name(event) for event in events if not isinstance(event, Scheduled | Switch))
    frames = [getattr(event, "frame", 0) for event in events if not isinstance(event, Scheduled)]
    if not frames:
        return told
    parts = []
    for node in dict.fromkeys(event.node for event in switches):
        done = [event for event in switches if event.node == node]
        switched = ", ".join(f"{event.shorten()} at {event.frame}" for event in done[:3])
        parts.append(f"{node} {switched}{_more(done)}")
    parts += [f"{name} {plural(count, 'time')}" for name, count in counted.items()]
    first, last = min(frames), max(frames)
    span = f"frame {first}" if first == last else f"frames {first} to {last}"
    return [f"{span}: {'; '.join(parts)}", *told]


def _name(event: Event) -> str:
    """How an event is counted: by its kind, as `--kind` takes it."""
    return f"{event.node} adapted itself" if isinstance(event, LocallyAdapted) else event_name(type(event))


def _more(done: Sequence[Event]) -> str:
    return f" and {len(done) - 3} more" if len(done) > 3 else ""


def _ending(mine: Sequence[Event], lines: Sequence[FrameMetrics]) -> str:
    """The last line: how long it lived, how long it was lost, and how it is left."""
    lost = sum(line.status == "lost" for line in lines)
    chapters = [event for event in mine if isinstance(event, CHAPTERS)]
    left = "ended" if isinstance(chapters[-1], TargetDied | DuplicateEnded) else "alive at the end of the run"
    if left != "ended" and lines and lines[-1].status == "lost":
        left = "lost at the end of the run"
    return f"summary: {plural(len(lines), 'frame')}, lost in {lost}; {left}"
