"""What is wrong with the expressions of a graph: written when it begins, and when it ends."""

from __future__ import annotations

from dataclasses import dataclass


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
        out = "it is left out until it is above 0 for some"
        if not self.undefined:
            return f"factor {self.node} of target {self.target} is 0 for all hypotheses → {out}"
        of = f"{self.undefined} of {self.hypotheses} hypotheses"
        then = out if self.ignored else "they count as impossible"
        return f"factor {self.node} of target {self.target} has no value for {of} (such as 0 / 0) → {then}"


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
        of = f"{self.undefined} of {self.hypotheses} hypotheses"
        then = {
            "sd": "these have no such noise",
            "given": "these have the value of the node above",
            "measures": "these are impossible",
        }.get(self.part.partition(" ")[0], "it stays as it is for these")
        return f"{self.part} of target {self.target} has no value for {of} (such as 0 / 0) → {then}"


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
        out = "it is left out until it is above 0 for some"
        if self.undefined:
            of = f"{self.undefined} of {self.pairs} pairs of hypotheses (such as 0 / 0)"
            return f"{factor} has no value for {of} → {out if self.ignored else 'they count as impossible'}"
        if self.ignored:
            return f"{factor} is 0 for all pairs of hypotheses → {out}"
        return f"{factor} has a value again, and is above 0 for some pairs"


Events = FactorFlawed | MotionFlawed | FlawEnded | PairFactorChanged
