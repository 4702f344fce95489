"""Events of targets near each other: joint nodes and their pairs, and detections that one was refused."""

from __future__ import annotations

import math
from dataclasses import dataclass

from bayesnet_track.journal.text.wording import decimals, distinct_texts, plural, round_away


@dataclass(frozen=True)
class Joined:
    """Two targets came so near that their beliefs depend on each other: a joint node is added above them.

    Attributes:
        frame: frame whose numbers caused it; they are joined from the next frame on.
        target: target id; by an attachment, the one that may carry.
        other: the other target's id.
        kinds: plates of the two.
        rule: index of the join in the graph, from 0.
        overlap: overlap of the beliefs' reaches, as a share of the smaller one.
        above: overlap from which on they are joined.
    """

    frame: int
    target: str
    other: str
    kinds: tuple[str, str]
    rule: int
    overlap: float
    above: float

    def describe(self) -> str:
        """`the beliefs of targets 1 and 2 overlap by 0.12 ≥ 0.05 → joined; ...`."""
        value, level = distinct_texts(self.overlap, self.above)
        turning = round_away(self.overlap, decimals(self.overlap, self.above), up=True)
        kinds = " and ".join(dict.fromkeys(self.kinds))
        return (
            f"the beliefs of target {self.target} and target {self.other} ({kinds}) overlap by {value} "
            f"≥ {level} → joined; would have stayed on their own at overlap > {turning}"
        )


@dataclass(frozen=True)
class Parted:
    """Two targets were apart for long enough: each keeps its marginal of the joint belief.

    Attributes:
        frame: frame whose numbers caused it; they are on their own from the next frame on.
        target: target id.
        other: the other target's id.
        overlap: overlap of the beliefs' reaches at this frame.
        below: overlap below which they count as apart.
        frames: consecutive frames in which they were.
        turning: largest overlap in these frames: with a threshold at or below it they would have stayed
            joined.
        together: frames for which they were joined.
    """

    frame: int
    target: str
    other: str
    overlap: float
    below: float
    frames: int
    turning: float
    together: int

    def describe(self) -> str:
        """`the beliefs of targets 1 and 2 overlap by 0 < 0.05 for 5 frames → parted; ...`."""
        value, level = distinct_texts(self.overlap, self.below)
        turning = round_away(self.turning, decimals(self.turning, self.below), up=False)
        stay = (
            f"overlap ≤ {turning} or apart_frames > {self.frames}"
            if float(turning)
            else f"apart_frames > {self.frames}"
        )
        return (
            f"the beliefs of target {self.target} and target {self.other} overlap by {value} < {level} "
            f"for {plural(self.frames, 'frame')} → parted, after {plural(self.together, 'frame')} together; "
            f"would have stayed joined at {stay}"
        )


@dataclass(frozen=True)
class OcclusionChanged:
    """A joined target went behind another, or came out again.

    Attributes:
        frame: the frame.
        target: target id of the one behind.
        other: the one in front.
        hidden: true when most of it is hidden from this frame on, false when most of it is visible again.
        share: expected share of its box that is hidden.
        above: share above which it counts as hidden.
        in_front: probability that the other is in front.
        frames: for how many frames it was hidden; 0 when it goes behind.
    """

    frame: int
    target: str
    other: str
    hidden: bool
    share: float
    above: float
    in_front: float
    frames: int

    def describe(self) -> str:
        """`target 1 is in front (probability 0.97) and hides 0.62 > 0.5 of target 2 → ...`."""
        value, level = distinct_texts(self.share, self.above)
        if self.hidden:
            return (
                f"target {self.other} is in front with probability {self.in_front:.2f} and hides {value} "
                f"> {level} of target {self.target} → target {self.target} hidden, does not learn"
            )
        return (
            f"target {self.other} hides {value} ≤ {level} of target {self.target} "
            f"→ target {self.target} visible again after {plural(self.frames, 'frame')}"
        )


@dataclass(frozen=True)
class AttachmentChanged:
    """A joined target is carried by another, or no longer.

    Attributes:
        frame: the frame.
        target: target id of the one that is carried.
        other: the one that carries.
        attached: true when it is more probably carried than not from this frame on.
        probability: probability that it is carried, by all evidence so far.
        frames: for how many frames it was carried; 0 when it is picked up.
    """

    frame: int
    target: str
    other: str
    attached: bool
    probability: float
    frames: int

    def describe(self) -> str:
        """`target 2 moves as target 1 does, with probability 0.93 → carried`."""
        if self.attached:
            return (
                f"target {self.target} moves as target {self.other} does with probability "
                f"{self.probability:.2f} → carried by target {self.other}"
            )
        return (
            f"target {self.target} moves as target {self.other} does with probability "
            f"{self.probability:.2f} → no longer carried, after {plural(self.frames, 'frame')}"
        )


@dataclass(frozen=True)
class RingChanged:
    """Joins formed a ring. Joint beliefs need a tree, so the pair that overlaps least is left out.

    Each of the two still takes the other's own belief into account: their joint belief is an approximation
    until the ring opens.

    Attributes:
        frame: the frame.
        target: target id.
        other: the other target's id.
        left_out: true when the pair is left out from this frame on, false when it is included again.
        overlap: overlap of the two beliefs' reaches.
        group: all targets that are connected by joins.
    """

    frame: int
    target: str
    other: str
    left_out: bool
    overlap: float
    group: tuple[str, ...]

    def describe(self) -> str:
        """`targets 1, 2, 3 are joined in a ring → the pair 1, 3 is left out`."""
        pair = f"target {self.target} and target {self.other}"
        if not self.left_out:
            return f"no ring is closed by {pair} any more → their joint belief is of the tree again"
        group = ", ".join(self.group)
        return (
            f"targets {group} are joined in a ring → {pair}, with an overlap of {self.overlap:.2g} the "
            "least, are left out: each receives only the other's own belief"
        )


NO_GATE = 1e-12
"""A gate that leaves out less than this share of correct detections is no gate: none is named."""
MOST_CONTINUE_BOX = 10.0
"""Largest `continue_box` of a graph."""
USUAL_D2 = 4.0
"""Mean squared distance of correct detections: their number of measured values."""
LARGE = 1.5
"""A detection is of another size where a side is this many times the expected one, or the reverse."""


@dataclass(frozen=True)
class Refusal:
    """A detection that no target had, and what kept it from being a certain target's.

    Attributes:
        missed_frame: frame of the detection.
        agent: the agent that measures by it.
        box: centre box x, y, w, h in px of the detection.
        expected: that of the target, as it was predicted.
        gap: frames since the last detection of the target.
        d2: squared Mahalanobis distance of the two boxes; null where the association has no gate.
        place_d2: that of the centres alone.
        d2_limit: the largest of a detection of the target.
        gate: the share of correct detections within that limit.
        overlap: intersection over union of the two boxes.
        min_overlap: the least of a detection of the target.
        distance_box: the detection's distance from where the target was last seen or should have been by now,
            the smaller, in box sides a frame.
        continue_box: within how many the target could have gone on with later detections; 0: not at all.
        is_shared: whether detections are shared by probability, so that one within the bounds may still be
            more probably a false alarm or another target's.
    """

    missed_frame: int
    agent: str
    box: tuple[float, float, float, float]
    expected: tuple[float, float, float, float]
    gap: int
    d2: float | None
    place_d2: float
    d2_limit: float
    gate: float
    overlap: float
    min_overlap: float
    distance_box: float
    continue_box: float
    is_shared: bool = False

    @property
    def excess(self) -> float:
        """By what factor it was beyond the bounds."""
        gate = 1.0 if self.d2 is None else self.d2 / self.d2_limit
        return max(gate, 1.0) + max(self.min_overlap - self.overlap, 0.0)

    @property
    def distance_px(self) -> float:
        """From the expected centre to that of the detection."""
        return math.hypot(self.box[0] - self.expected[0], self.box[1] - self.expected[1])

    @property
    def is_beyond_gate(self) -> bool:
        """True if the gate refused it."""
        return self.d2 is not None and self.d2 > self.d2_limit

    @property
    def overlaps_too_little(self) -> bool:
        """True if `min_overlap` refused it."""
        return self.overlap < self.min_overlap

    def needed(self) -> dict[str, float] | None:
        """Settings of the agent, and values at which it would have been the target's; None: none would do.

        Without any bound that refused it, it is what the target looks like that did, or another origin is
        more probable.
        """
        settings: dict[str, float] = {}
        if self.d2 is not None and self.is_beyond_gate:
            gate = needed_gate(self.d2)
            if gate is None:
                return None
            settings["gate"] = gate
        if self.overlaps_too_little:
            digits = decimals(self.overlap, self.min_overlap)
            settings["min_overlap"] = float(round_away(self.overlap, digits, up=False))
        if self.is_shared:
            return settings or None
        return settings or {"appearance": 0.0}

    def bounds(self) -> list[str]:
        """The bounds that refused it, each with its value and level."""
        bounds = list[str]()
        if self.d2 is not None and self.is_beyond_gate:
            value, level = distinct_texts(self.d2, self.d2_limit)
            mostly = ", mostly by its size" if self.d2 > 2.0 * self.place_d2 else ""
            bounds.append(f"d² {value} > {level}{mostly} (gate {self.gate:.9g})")
        if self.overlaps_too_little:
            value, level = distinct_texts(self.overlap, self.min_overlap)
            bounds.append(f"overlap {value} < {level} (min_overlap)")
        if self.is_shared and not bounds:
            return [f"it is more probably a false alarm or another's, d² {self.d2:.1f}"]
        return bounds or ["the target looks different (appearance)"]

    def needed_continue_box(self) -> float | None:
        """The `continue_box` at which the target would have gone on with it; None where that is not why."""
        value = float(round_away(self.distance_box, 2, up=True))
        is_bound = self.d2 is not None and self.continue_box < self.distance_box
        return value if is_bound and value <= MOST_CONTINUE_BOX else None


def needed_gate(d2: float) -> float | None:
    """The gate, with few digits, within which a squared distance of 4 degrees of freedom lies; None: none.

    >>> needed_gate(20.0), needed_gate(31.2), needed_gate(200.0)
    (0.9996, 0.999998, None)
    """
    tail = math.exp(-0.5 * d2) * (1.0 + 0.5 * d2)
    if tail < NO_GATE:
        return None
    digits = math.ceil(-math.log10(tail))
    return round(1.0 - math.floor(tail * 10.0**digits) / 10.0**digits, digits)


@dataclass(frozen=True)
class DetectionRefused:
    """A target that is lost or ends had no detection while one that no target had was beside it.

    Attributes:
        frame: frame in which it is lost or ends.
        target: target id.
        refusal: the first such detection since its last one, or a far nearer one.
    """

    frame: int
    target: str
    refusal: Refusal

    def describe(self) -> str:
        """`in frame 26 a detection 16 px away was no target's: d² 31.2 > 18.5 (gate) → ...`."""
        refusal = self.refusal
        size = ""
        if any(not 1 / LARGE <= refusal.box[k] / max(refusal.expected[k], 1e-9) <= LARGE for k in (2, 3)):
            (w, h), (width, height) = refusal.box[2:], refusal.expected[2:]
            size = f", {w:.4g} x {h:.4g} px where {width:.4g} x {height:.4g} px was expected,"
        delay = f", {plural(refusal.gap, 'frame')} after its last one" if refusal.gap > 1 else ""
        target, bounds = f"target {self.target}", " and ".join(refusal.bounds())
        miss = f"in frame {refusal.missed_frame} a detection {refusal.distance_px:.0f} px from {target}{size}"
        return f"{miss} went to no target: {bounds} → {target} had none{delay}; {self._otherwise()}"

    def _otherwise(self) -> str:
        refusal, ways = self.refusal, list[str]()
        settings = refusal.needed()
        if settings == {"appearance": 0.0}:
            ways.append("a smaller appearance")
        elif settings is not None:
            relation = {"gate": "≥", "min_overlap": "≤"}
            ways.append(
                " and ".join(f"{key} {relation[key]} {value:.12g}" for key, value in settings.items())
            )
        continue_box = refusal.needed_continue_box()
        if continue_box is not None:
            ways.append(f"continue_box ≥ {continue_box:g}")
        if ways:
            return f"{'could' if refusal.is_shared else 'would'} have been its own at {', or '.join(ways)}"
        assert refusal.d2 is not None
        expected = refusal.d2_limit if refusal.is_beyond_gate else USUAL_D2
        factor = round_away(max(math.sqrt(refusal.d2 / expected), 1.0), 1, up=True)
        return f"its motion is {factor} times as large as expected: no gate below 1 would have kept it"
