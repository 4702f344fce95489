"""Runs of agents on call, which come every few frames, as one line."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass

from bayesnet_track.journal.events.event import Event
from bayesnet_track.journal.events.switches import Scheduled
from bayesnet_track.journal.text.naming import name_targets, narrate
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
        after = zip(self.runs, self.runs[1:], strict=False)
        return len(self.runs) + sum(b.frame - a.frame - 1 for a, b in after if a.gap == 1)

    def describe(self, whose: str = "") -> str:
        """One line: in how many frames they ran, why more than every few, and what would have been fewer."""
        first, last = self.runs[0], self.runs[-1]
        nodes = dict.fromkeys(node for one in self.runs for node in one.nodes)
        who, them = ", ".join(nodes), "it" if len(nodes) == 1 else "them"
        shares = [one.overlap for one in self.runs]
        low = sum(share < first.agree for share in shares)
        called = [one for one in self.runs if one.called is not None]
        text = (
            f"frames {first.frame} to {last.frame}{whose}: {who} on call, ran in {self.ran} of "
            f"{last.frame - first.frame + 1}; with and without {them} the boxes overlap by "
            f"{min(shares):.2f} to {max(shares):.2f}, in {low} of {len(shares)} below {first.agree:g}"
        )
        if called:
            level = show_turn(
                max((one.called for one in called if one.called), key=lambda c: c.turning), up=True
            )
            text += f"; {plural(len(called), 'time')} at once, would always have waited at above ≥ {level}"
        least = round_away(min(shares), 3, up=False)
        if low and least != "0" and not any(one.doubt or one.status == "lost" for one in self.runs):
            text += f"; would have rested each time at agree ≤ {least}"
        return text


def fold(events: Iterable[Event]) -> list[Event | CallsFolded]:
    """The events, runs of agents on call that follow each other folded into one where the first stood.

    Any other event of the same target, or of none, ends a fold.
    """
    found: list[list[Event]] = []
    open_: dict[str, list[Event]] = {}
    for event in events:
        if isinstance(event, Scheduled):
            if event.target not in open_:
                found.append(open_.setdefault(event.target, []))
            open_[event.target].append(event)
            continue
        target = getattr(event, "target", None)
        if target is None:
            open_.clear()
        open_.pop(target or "", None)
        found.append([event])
    return [_folded(group) for group in found]


def _folded(group: Sequence[Event]) -> Event | CallsFolded:
    runs = tuple(one for one in group if isinstance(one, Scheduled))
    return CallsFolded(runs) if len(runs) > 1 else group[0]


def narrate_all(events: Iterable[Event], kinds: Mapping[str, str], name_target: bool) -> Iterator[str]:
    """The sentences of events, their targets by type and number; runs of agents on call are folded."""
    for one in fold(events):
        if isinstance(one, CallsFolded):
            yield name_targets(one.describe(f", target {one.target}" if name_target else ""), kinds)
        else:
            yield narrate(one, kinds, name_target)
