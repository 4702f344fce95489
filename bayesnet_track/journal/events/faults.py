"""Events of agents that fail or give no answer, and of expressions without a value."""

from __future__ import annotations

from dataclasses import dataclass, replace

from bayesnet_track.journal.target_net import Fault, TargetNet
from bayesnet_track.journal.text.wording import plural


@dataclass(frozen=True)
class Quarantined:
    """An agent failed: it is paused, and tried again after a time that doubles with each failure in a row.

    Attributes:
        frame: frame at which it failed (its evidence is not used in this frame either).
        target: target id.
        node: the agent.
        reason: what it returned or raised.
        until: first frame in which it may work again; null when it stays off for the rest of the run, because
            it could not learn its first reference or needs colour and the source is gray.
        times: how many times in a row it has failed, this one included; the count starts again once the agent
            has worked ten times as long as it was paused.
    """

    frame: int
    target: str
    node: str
    reason: str
    until: int | None = None
    times: int = 1

    def describe(self) -> str:
        """`motion failed: raised ... → paused for 10 frames, tried again in frame 52`."""
        repeats = "" if self.times == 1 else f", the {_ordinal(self.times)} time in a row"
        failed = f"{self.node} failed{repeats}: {self.reason}"
        if self.until is None:
            return f"{failed} → off for the rest of the run"
        return (
            f"{failed} → paused for {plural(self.until - self.frame, 'frame')}, tried again in frame"
            f" {self.until}"
        )

    def shorten(self) -> str:
        """The switch in a word, for a summary."""
        return "failed"

    def change(self, net: TargetNet) -> TargetNet:
        """The net of the target after it."""
        fault = Fault(self.times, self.frame, self.until, self.node in net.active)
        return replace(
            net,
            active=net.active - {self.node},
            quarantined=net.quarantined | {self.node},
            faults={**net.faults, self.node: fault},
        )


@dataclass(frozen=True)
class Readmitted:
    """An agent that failed is tried again.

    Attributes:
        frame: frame at which its pause ended; it works from the next frame on.
        target: target id.
        node: the agent.
        on: whether it is switched on: because it was on when it failed, or by hand.
        times: how many times in a row it had failed.
        waited: for how many frames it was paused.
    """

    frame: int
    target: str
    node: str
    on: bool
    times: int
    waited: int

    def describe(self) -> str:
        """`motion was paused for 10 frames after failing once → on again`."""
        often = "failing" if self.times == 1 else f"failing {self.times} times in a row"
        waited = f"{self.node} was paused for {plural(self.waited, 'frame')} after {often}"
        return f"{waited} → {'on again' if self.on else 'may be switched on again'}"

    def shorten(self) -> str:
        """The switch in a word, for a summary."""
        return "on again" if self.on else "let in again"

    def change(self, net: TargetNet) -> TargetNet:
        """The net of the target after it."""
        return replace(
            net,
            active=net.active | {self.node} if self.on else net.active,
            quarantined=net.quarantined - {self.node},
        )


@dataclass(frozen=True)
class AgentMissed:
    """An agent gave no answer, through no fault of its own: its process died or hung, or the answer was late.

    It is left out of this frame as if it were switched off; the other agents are not affected.

    Attributes:
        frame: the frame.
        target: target id.
        node: the agent.
        reason: what happened to it.
        during: the request that got no answer and is left out: observing (and then all that follows in the
            frame), guarding, learning, blending or adapting its reference, starting a target, joining,
            claiming or recalling.
    """

    frame: int
    target: str
    node: str
    reason: str
    during: str = "observing"

    def describe(self) -> str:
        """`motion gave no answer: its process died → left out of this frame`."""
        phase = "" if self.during == "observing" else f" while {self.during}"
        return f"{self.node} gave no answer{phase}: {self.reason} → left out of this frame"


@dataclass(frozen=True)
class VerifierFailed:
    """A verifier of the score failed; it is not asked again, and its feature stays as it was.

    Attributes:
        frame: the frame.
        target: target id.
        verifier: its name in the graph.
        reason: what was wrong.
    """

    frame: int
    target: str
    verifier: str
    reason: str

    def describe(self) -> str:
        """The sentence of the event, without its frame."""
        return (
            f"verifier {self.verifier} {self.reason} → not asked again for this target; the score goes on "
            "with what it last said"
        )


def _ordinal(number: int) -> str:
    ending = {1: "st", 2: "nd", 3: "rd"}.get(number % 10 if number % 100 not in (11, 12, 13) else 0, "th")
    return f"{number}{ending}"


@dataclass(frozen=True)
class FactorFlawed:
    """A factor had no value for some hypotheses, or was zero for all; written in the first such frame.

    Attributes:
        frame: the frame.
        target: target id.
        node: the factor.
        undefined: hypotheses for which the expression has no value (0 / 0, the root of a negative number);
            they count as impossible.
        hypotheses: hypotheses of the frame's first evaluation.
        ignored: true when all were impossible: the factor was left out of the frame.
    """

    frame: int
    target: str
    node: str
    undefined: int
    hypotheses: int
    ignored: bool

    def describe(self) -> str:
        """A factor whose values are no densities."""
        remedy = "it is left out until it is above 0 for some"
        if not self.undefined:
            return f"factor {self.node} of target {self.target} is 0 for all hypotheses → {remedy}"
        flaw = f"no value for {self.undefined} of {self.hypotheses} hypotheses (such as 0 / 0)"
        effect = remedy if self.ignored else "they count as impossible"
        return f"factor {self.node} of target {self.target} has {flaw} → {effect}"


@dataclass(frozen=True)
class MotionFlawed:
    """An expression of the motion, or of a latent node, had no value for some hypotheses.

    Written in the first such frame.

    Attributes:
        frame: the frame.
        target: target id.
        part: drift or sd, and the field, `drift x`; or `given`, the node and the field, `given head.x`.
        undefined: hypotheses for which it has no value, or for which an sd is negative: the field stays as it
            is, or has no noise.
        hypotheses: hypotheses that were asked about first.
    """

    frame: int
    target: str
    part: str
    undefined: int
    hypotheses: int

    def describe(self) -> str:
        """The sentence of the event, without its frame."""
        undefined = f"{self.undefined} of {self.hypotheses} hypotheses"
        effect = {
            "sd": "these have no such noise",
            "given": "these have the value of the node above",
            "measures": "these are impossible",
        }.get(self.part.partition(" ")[0], "it stays as it is for these")
        return f"{self.part} of target {self.target} has no value for {undefined} (such as 0 / 0) → {effect}"


@dataclass(frozen=True)
class FlawEnded:
    """An expression is sound again; written in the first frame without a flaw.

    Attributes:
        frame: the frame.
        target: target id.
        what: the factor, or the part of the motion, such as `drift x`.
    """

    frame: int
    target: str
    what: str

    def describe(self) -> str:
        """The sentence of the event, without its frame."""
        return f"{self.what} of target {self.target} has a value for every hypothesis again"


@dataclass(frozen=True)
class PairFactorChanged:
    """The factor of two joined targets has no value for some pairs, or is zero for all; or no longer.

    Written in the first such frame, and in the first without.

    Attributes:
        frame: the frame.
        target: target id.
        other: the other target's id.
        undefined: pairs of hypotheses for which the expression has no value; they count as impossible.
        pairs: pairs that were looked at.
        ignored: true when all were impossible: the factor was left out of the frame.
    """

    frame: int
    target: str
    other: str
    undefined: int
    pairs: int
    ignored: bool

    def describe(self) -> str:
        """The sentence of the event, without its frame."""
        factor = f"the factor of target {self.target} and target {self.other}"
        remedy = "it is left out until it is above 0 for some"
        if self.undefined:
            flaw = f"no value for {self.undefined} of {self.pairs} pairs of hypotheses (such as 0 / 0)"
            return f"{factor} has {flaw} → {remedy if self.ignored else 'they count as impossible'}"
        if self.ignored:
            return f"{factor} is 0 for all pairs of hypotheses → {remedy}"
        return f"{factor} has a value again, and is above 0 for some pairs"
