"""One target's life as a short story, with runs of agents on call as one line."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass

from bayesnet_track.journal.codec import event_name
from bayesnet_track.journal.events import statuses
from bayesnet_track.journal.events.beliefs import Reappeared
from bayesnet_track.journal.events.event import Event
from bayesnet_track.journal.events.faults import VerifierFailed
from bayesnet_track.journal.events.joins import DetectionRefused
from bayesnet_track.journal.events.lives import (
    CandidateConfirmed,
    Continued,
    DuplicateEnded,
    Reacquired,
    Returned,
    TargetDied,
    TargetStarted,
)
from bayesnet_track.journal.events.statuses import FoundAgain, SceneCut, StatusChanged
from bayesnet_track.journal.events.switches import LocallyAdapted, Scheduled
from bayesnet_track.journal.metrics import FrameMetrics
from bayesnet_track.journal.net import Switch
from bayesnet_track.journal.text.sentences import explain, name_targets, narrate
from bayesnet_track.journal.text.wording import plural, round_away, show_turn


@dataclass(frozen=True)
class CallsFolded:
    """Runs of agents on call, among which nothing else happened to the target.

    Attributes:
        runs: in the order of their frames.
    """

    runs: tuple[Scheduled, ...]

    @property
    def frame(self) -> int:
        """The first frame."""
        return self.runs[0].frame

    @property
    def target(self) -> str:
        """The target's id."""
        return self.runs[0].target

    @property
    def ran(self) -> int:
        """In how many frames the agents ran, those between two runs with a gap of one frame included."""
        neighbours = zip(self.runs, self.runs[1:], strict=False)
        return len(self.runs) + sum(b.frame - a.frame - 1 for a, b in neighbours if a.gap == 1)

    def describe(self, whose: str = "") -> str:
        """One line: in how many frames they ran, why more than every few, and what would have been fewer."""
        first, final = self.runs[0], self.runs[-1]
        nodes = dict.fromkeys(node for call in self.runs for node in call.nodes)
        who, them = ", ".join(nodes), "it" if len(nodes) == 1 else "them"
        shares = [call.overlap for call in self.runs]
        low = sum(share < first.agree for share in shares)
        called = [call for call in self.runs if call.called is not None]
        text = (
            f"frames {first.frame} to {final.frame}{whose}: {who} on call, ran in {self.ran} of "
            f"{final.frame - first.frame + 1}; with and without {them} the boxes overlap by "
            f"{min(shares):.2f} to {max(shares):.2f}, in {low} of {len(shares)} below {first.agree:g}"
        )
        if called:
            level = show_turn(
                max((call.called for call in called if call.called), key=lambda c: c.turning), up=True
            )
            text += f"; {plural(len(called), 'time')} at once, would always have waited at above ≥ {level}"
        lowest = round_away(min(shares), 3, up=False)
        if low and lowest != "0" and not any(call.doubt or call.status == "lost" for call in self.runs):
            text += f"; would have rested each time at agree ≤ {lowest}"
        return text


def fold(events: Iterable[Event]) -> list[Event | CallsFolded]:
    """The events, runs of agents on call that follow each other folded into one where the first stood.

    Any other event of the same target, or of none, ends a fold.
    """
    groups: list[list[Event]] = []
    open_: dict[str, list[Event]] = {}
    for event in events:
        if isinstance(event, Scheduled):
            if event.target not in open_:
                groups.append(open_.setdefault(event.target, []))
            open_[event.target].append(event)
            continue
        target = getattr(event, "target", None)
        if target is None:
            open_.clear()
        open_.pop(target or "", None)
        groups.append([event])
    return [_folded(group) for group in groups]


def _folded(group: Sequence[Event]) -> Event | CallsFolded:
    runs = tuple(event for event in group if isinstance(event, Scheduled))
    return CallsFolded(runs) if len(runs) > 1 else group[0]


def narrate_all(events: Iterable[Event], kinds: Mapping[str, str], name_target: bool) -> Iterator[str]:
    """The sentences of events, their targets by type and number; runs of agents on call are folded."""
    for entry in fold(events):
        if isinstance(entry, CallsFolded):
            yield name_targets(entry.describe(f", target {entry.target}" if name_target else ""), kinds)
        else:
            yield narrate(entry, kinds, name_target)


CHAPTERS = (
    CandidateConfirmed,
    TargetStarted,
    Returned,
    SceneCut,
    DetectionRefused,
    StatusChanged,
    Reacquired,
    Continued,
    TargetDied,
    DuplicateEnded,
    # What limits the score or frees it, withholds the status, or finds the target: a status has a cause.
    statuses.DistractorSeen,
    statuses.DoubtEnded,
    statuses.Regained,
    statuses.AssuranceChanged,
    statuses.AlarmRaised,
    statuses.AlarmEnded,
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
    statuses = [line.status for line in metrics if line.target == target]
    return "\n".join([*lines, _ending(mine, statuses)])


def check_target(events: Iterable[Event], target: str) -> None:
    """Refuse a target that the run does not have.

    Raises:
        ValueError: no target of this id lives in the run.
    """
    starts = TargetStarted | Returned
    ids = dict.fromkeys(event.target for event in events if isinstance(event, starts))
    if target not in ids:
        raise ValueError(f"no target {target!r} in this run; there are {', '.join(ids) or 'none'}")


def _condense(events: Iterable[Event]) -> list[str]:
    """Summarise the time between two chapters: switches and counts in one line, agents on call in another."""
    events = list(events)
    calls = tuple(event for event in events if isinstance(event, Scheduled))
    lines = [CallsFolded(calls).describe()] if calls else []
    switches = [event for event in events if isinstance(event, Switch)]
    counted = Counter(_name(event) for event in events if not isinstance(event, Scheduled | Switch))
    frames = [getattr(event, "frame", 0) for event in events if not isinstance(event, Scheduled)]
    if not frames:
        return lines
    parts = []
    for node in dict.fromkeys(event.node for event in switches):
        node_switches = [event for event in switches if event.node == node]
        switched = ", ".join(f"{event.shorten()} at {event.frame}" for event in node_switches[:3])
        parts.append(f"{node} {switched}{_more_text(node_switches)}")
    parts += [f"{name} {plural(count, 'time')}" for name, count in counted.items()]
    first, end = min(frames), max(frames)
    span = f"frame {first}" if first == end else f"frames {first} to {end}"
    return [f"{span}: {'; '.join(parts)}", *lines]


def _name(event: Event) -> str:
    """The name under which an event is counted: its kind, as `--kind` takes it."""
    return f"{event.node} adapted itself" if isinstance(event, LocallyAdapted) else event_name(type(event))


def _more_text(switches: Sequence[Event]) -> str:
    return f" and {len(switches) - 3} more" if len(switches) > 3 else ""


def _ending(mine: Sequence[Event], statuses: Sequence[str]) -> str:
    """The last line: how long it lived, how long it was lost, and how it is left."""
    lost = statuses.count("lost")
    hidden = f", hidden in {statuses.count('hidden')}" if "hidden" in statuses else ""
    chapters = [event for event in mine if isinstance(event, CHAPTERS)]
    state = (
        "ended" if isinstance(chapters[-1], TargetDied | DuplicateEnded) else "alive at the end of the run"
    )
    if state != "ended" and statuses[-1:] in (["lost"], ["hidden"]):
        state = f"{statuses[-1]} at the end of the run"
    return f"summary: {plural(len(statuses), 'frame')}, lost in {lost}{hidden}; {state}"
