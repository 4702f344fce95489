"""Events of agents: switched by rules, run when due, tuned or stopped by their own checks."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace

from bayesnet_track.journal.target_net import Cause, Concentration, RuleCause, TargetNet, Turn
from bayesnet_track.journal.text.wording import (
    cause_text,
    decimals,
    distinct_texts,
    plural,
    round_away,
    show_turn,
)


@dataclass(frozen=True)
class Activated:
    """An inference node switched an agent on.

    Attributes:
        frame: frame whose numbers caused it; it works from the next frame on.
        target: target id.
        node: the agent.
        governor: the inference node whose rule fired.
        cause: the numbers; None when it was switched on because no agent was active.
        helpfulness: mean contribution (nats) over the frames in which it was active; None when never measured
            or when the rule does not use it.
        expected: agent -> expected information per declared cost, nats per ms, for every inactive agent it
            was chosen among by `information_per_ms`; infinite for one that was never active; else empty.
    """

    frame: int
    target: str
    node: str
    governor: str
    cause: Cause | Concentration | None
    helpfulness: float | None = None
    expected: Mapping[str, float] = field(default_factory=dict)

    def describe(self) -> str:
        """`... → motion on (...); would have stayed off at ...`."""
        if self.cause is None:
            return f"no agent was active → {self.node} on"
        helped = "" if self.helpfulness is None else f" (helped most so far: {self.helpfulness:.2f} nats)"
        why = _expected_most(self) if self.expected else helped
        if isinstance(self.cause, Concentration):
            stay = f"share ≤ {round_away(self.cause.turning, _share_digits(self.cause), up=False)}"
            evidence = _describe_concentration(self.cause, sure=False)
            return f"{evidence} → {self.node} on{why}; would have stayed off at {stay}"
        stay = f"activate ≥ {show_turn(self.cause, up=True)}"
        return f"{cause_text(self.cause, '>')} → {self.node} on{why}; would have stayed off at {stay}"

    def shorten(self) -> str:
        """The switch in a word, for a summary."""
        return "on"

    def change(self, net: TargetNet) -> TargetNet:
        """The net of the target after it."""
        return replace(net, active=net.active | {self.node}, shed=net.shed_without(self.node))


@dataclass(frozen=True)
class Deactivated:
    """An inference node switched an agent off.

    Attributes:
        frame: frame whose numbers caused it.
        target: target id.
        node: the agent.
        governor: the inference node whose rule fired.
        cause: the numbers.
        drop: which index chose it: largest_kl, min_contribution_per_ms, min_information_per_ms,
            most_expensive_redundant or most_expensive.
        index: agent -> that index, for every active agent it was chosen among.
        sample_every: it is still evaluated in one of so many tracked frames; 0 when it is not.
    """

    frame: int
    target: str
    node: str
    governor: str
    cause: Cause | Concentration
    drop: str
    index: Mapping[str, float] = field(default_factory=dict)
    sample_every: int = 0

    def describe(self) -> str:
        """`... → motion off (...); would have stayed on at ...`."""
        return (
            f"{_well(self.cause)} → {self.node} off{_chosen_among(self)}{_sampled(self)}; "
            f"would have stayed on at {_not_well(self.cause)}"
        )

    def shorten(self) -> str:
        """The switch in a word, for a summary."""
        return "off"

    def change(self, net: TargetNet) -> TargetNet:
        """The net of the target after it."""
        sampled = {**net.sampled, self.node: self.sample_every} if self.sample_every else net.sampled
        return replace(net, active=net.active - {self.node}, sampled=sampled)


@dataclass(frozen=True)
class Scheduled:
    """Agents on call ran, and their next run was fixed; not written while they run in every frame.

    Attributes:
        frame: frame in which they ran.
        target: target id.
        nodes: the agents.
        governor: the inference node whose rule it is.
        overlap: overlap (IoU) of the estimate without them and with them.
        agree: threshold of it.
        gap: frames to the next run; 1 when they run in every frame from now on.
        due: frame of the next run.
        was_due: frame for which this run had been fixed.
        called: UD without them, above the threshold, where that made them run before they were due.
        doubt: UD with them, above the threshold, where that kept the gap from growing.
        status: of the target; they run in every frame while it is lost.
    """

    frame: int
    target: str
    nodes: tuple[str, ...]
    governor: str
    overlap: float
    agree: float
    gap: int
    due: int
    was_due: int
    called: Cause | None = None
    doubt: Cause | None = None
    status: str = "tracking"

    def describe(self) -> str:
        """The sentence of the event, without its frame."""
        who = ", ".join(self.nodes)
        agreed = self.overlap >= self.agree
        overlap, agree = distinct_texts(self.overlap, self.agree)
        why = f"with and without {who} the boxes overlap by {overlap} {'≥' if agreed else '<'} {agree}"
        low, high = round_away(self.overlap, 3, up=False), round_away(self.overlap, 3, up=True)
        conditions = [] if agreed else [f"agree ≤ {low}"]
        if self.doubt is not None:
            why = f"{why}; {cause_text(self.doubt, '>')} with {who}"
            conditions.append(f"above ≥ {show_turn(self.doubt, up=True)}")
        lost = self.status == "lost"
        why = f"{why}; the target is lost" if lost else why
        needs = [
            *(["while not lost"] if lost else []),
            *([f"at {' and '.join(conditions)}"] if conditions else []),
        ]
        would = f"would have rested {', '.join(needs)}"
        if not agreed and low == "0":  # `agree` lies between 0 and 1
            would = "would have rested at no value of agree"
        elif self.gap > 1:
            would = f"would have run in the next one at agree > {high}"
            would = "would have rested at any value of agree" if high == "1" else would
        effect = (
            f"again in {plural(self.gap, 'frame')}, frame {self.due}" if self.gap > 1 else "in every frame"
        )
        if self.called is not None:
            why = f"without {who} {cause_text(self.called, '>')}; {why}"
            effect = f"at once, not in frame {self.was_due}, and {effect}"
            would = f"would have waited at above ≥ {show_turn(self.called, up=True)}"
        return f"{why} → {who} {effect}; {would}"

    def change(self, net: TargetNet) -> TargetNet:
        """The net of the target after it."""
        return replace(net, turn=Turn(self.due, self.gap) if self.gap > 1 else None)


def _expected_most(event: Activated) -> str:
    """The reason for this agent and no other: what is expected of it against the runner-up."""
    expected = event.expected[event.node]
    rivals = {name: value for name, value in event.expected.items() if name != event.node}
    text = f"{expected:.3g} nats per ms expected" if math.isfinite(expected) else "never tried"
    if not rivals:
        return f" ({text})"
    second = max(rivals, key=lambda name: rivals[name])
    behind = f"{rivals[second]:.3g}" if math.isfinite(rivals[second]) else "never tried either"
    return f" ({text} against {second} {behind})"


def _describe_concentration(cause: Concentration, sure: bool) -> str:
    """The result of the test, and whether it can say that the belief lies around one mode."""
    exact = not math.isfinite(cause.trials)
    sample = "exactly" if exact else f"of {_count_text(cause.trials)} effective hypotheses"
    vouched, share = distinct_texts(cause.vouched, cause.share)
    evidence = f"{100 * cause.inside:.3g} % within {cause.radius_px:.3g} px of the mode, {sample}"
    if exact:
        return f"{evidence}: {vouched} {'≥' if sure else '<'} {share} for {plural(cause.frames, 'frame')}"
    says = f"at {100 * cause.confidence:.4g} % confidence at least {vouched} lies there"
    return f"{evidence}: {says}, {'≥' if sure else '<'} {share} for {plural(cause.frames, 'frame')}"


def _well(cause: Cause | Concentration) -> str:
    """The reason why an agent could be switched off."""
    return (
        _describe_concentration(cause, sure=True)
        if isinstance(cause, Concentration)
        else cause_text(cause, "<")
    )


def _not_well(cause: Cause | Concentration) -> str:
    """The level at which it would not have been."""
    if isinstance(cause, Concentration):
        return f"share > {round_away(cause.turning, _share_digits(cause), up=True)}"
    return f"deactivate ≤ {show_turn(cause, up=False)}"


def _share_digits(cause: Concentration) -> int:
    """Decimals that tell the turning share from the one that was set, at least three."""
    gap = abs(cause.turning - cause.share)
    return min(max(3, 1 - math.floor(math.log10(gap))), 12) if gap > 0 else 3


def _count_text(trials: float) -> str:
    return f"{trials:.0f}" if trials >= 10 else f"{trials:.2g}"


def _sampled(event: Deactivated) -> str:
    return f", still evaluated every {event.sample_every} frames" if event.sample_every else ""


def _px2(value: float) -> str:
    """An uncertainty, to three digits at least."""
    return f"{value:.{decimals(value)}f} px²"


def _chosen_among(event: Deactivated) -> str:
    """The reason for this agent and no other: its index against that of the runner-up."""
    index = event.index.get(event.node)
    rivals = {name: value for name, value in event.index.items() if name != event.node}
    if index is not None and event.drop == "most_expensive_redundant":
        needed = max(rivals, key=lambda name: rivals[name], default=None)
        rival = ""
        if needed is not None and index < rivals[needed] < math.inf:
            rival = f", {_px2(rivals[needed])} without {needed}"
        return f" (most expensive redundant agent: UD {_px2(index)} without it{rival})"
    if index is not None and event.drop == "most_expensive":
        return f" (most expensive cue: {index:.3g} ms)"
    if index is None or not rivals:
        return ""
    largest = event.drop == "largest_kl"
    second = (min if not largest else max)(rivals, key=lambda name: rivals[name])
    criterion = event.drop.replace("_", " ").replace("kl", "KL")
    return f" ({criterion} {index:.2f} against {second} {rivals[second]:.2f})"


def _stop_evidence(cause: Cause | RuleCause) -> str:
    """The condition of an agent's own rule in numbers."""
    if isinstance(cause, Cause):
        return f"own {cause_text(cause, '>')}"
    value, level = distinct_texts(cause.value, cause.level)
    span = plural(cause.frames, "frame")
    return f"{cause.quantity} {value}{cause.unit} {cause.relation} {level} for {span}"


def _own_turn(cause: Cause | RuleCause) -> str:
    """The key of an agent's own rule, and the level at which it would not have fired."""
    if isinstance(cause, Cause):
        return f"self_check ≥ {show_turn(cause, up=True)}"
    is_above = cause.relation == ">"
    turn = round_away(cause.turning, decimals(cause.turning, cause.level), is_above)
    return f"{cause.rule} {'≥' if is_above else '≤'} {turn}{cause.unit}"


@dataclass(frozen=True)
class LocallyAdapted:
    """An agent whose own likelihood was too wide sharpened it instead of stopping.

    Attributes:
        frame: frame whose numbers caused it.
        target: target id.
        node: the agent.
        attempt: how often it has tried in this episode, from 1.
        cause: the numbers (the agent's own UD, or of another rule).
    """

    frame: int
    target: str
    node: str
    attempt: int
    cause: Cause | RuleCause

    def describe(self) -> str:
        """The sentence of the event, without its frame."""
        return f"{self.node}: its {_stop_evidence(self.cause)} → adapted itself, attempt {self.attempt}"

    def change(self, net: TargetNet) -> TargetNet:
        """The net of the target after it."""
        return net


@dataclass(frozen=True)
class SelfStopped:
    """An agent whose own likelihood stayed too wide stopped itself.

    Attributes:
        frame: frame whose numbers caused it.
        target: target id.
        node: the agent.
        cause: the numbers (the agent's own UD, or of another rule).
        rests_until: first frame at which it may be switched on again.
    """

    frame: int
    target: str
    node: str
    cause: Cause | RuleCause
    rests_until: int

    def describe(self) -> str:
        """The sentence of the event, without its frame."""
        return (
            f"{self.node}: its {_stop_evidence(self.cause)} → stopped itself; may be switched on again "
            f"from frame {self.rests_until}; would have continued at {_own_turn(self.cause)}"
        )

    def shorten(self) -> str:
        """The switch in a word, for a summary."""
        return "stopped itself"

    def change(self, net: TargetNet) -> TargetNet:
        """The net of the target after it."""
        return replace(
            net,
            active=net.active - {self.node},
            rests_until={**net.rests_until, self.node: self.rests_until},
            rest_count={**net.rest_count, self.node: net.rest_count.get(self.node, 0) + 1},
        )


@dataclass(frozen=True)
class ReferenceGuarded:
    """An agent's reference and its slow one diverged, or agree again: learning stopped, or goes on.

    Attributes:
        frame: the frame.
        target: target id.
        node: the agent.
        parted: true when they diverged in this frame, false when they agree again.
        own: log-likelihood of the estimate by the agent's own reference, nats.
        slow: the same by its slow reference.
        apart_nats: difference from which on they count as diverged.
        pull: share of the slow reference that is mixed into the agent's own per frame while they differ.
        frames: for how many learning frames they had diverged; 0 when they diverge.
    """

    frame: int
    target: str
    node: str
    parted: bool
    own: float
    slow: float
    apart_nats: float
    pull: float
    frames: int

    def describe(self) -> str:
        """The sentence of the event, without its frame."""
        gap, level = distinct_texts(self.own - self.slow, self.apart_nats)
        reference, slow = f"{self.own:.2f} nats by its reference", f"{self.slow:.2f} by its slow one"
        scored = f"{self.node}: the estimate scores {reference}, {slow}"
        if not self.parted:
            lasted = plural(self.frames, "frame")
            return f"{scored}: {gap} ≤ {level} apart after {lasted} → learns again"
        turning = round_away(self.own - self.slow, decimals(self.own - self.slow, self.apart_nats), up=True)
        return (
            f"{scored}: {gap} > {level} apart → stops learning, pulled back by {self.pull:g} a frame; "
            f"would have learnt at apart_nats ≥ {turning}"
        )
