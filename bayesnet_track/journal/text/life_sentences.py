"""How targets were born, recognised again and ended, as sentences."""

from __future__ import annotations

import math

from bayesnet_track.journal.events.life_events import BirthsRefused, CandidateConfirmed, DetectorFailed
from bayesnet_track.journal.net.life_decisions import (
    DuplicateEnded,
    Reacquired,
    Recognition,
    Returned,
    TargetDied,
)
from bayesnet_track.journal.text.wording import decimals, distinct_texts, plural, round_away


def confirmed(event: CandidateConfirmed) -> str:
    """`gray_level saw it in 3 of 4 looks ...  → target 3 is new`."""
    seen = f"{event.detector} saw it in {event.seen} of {plural(event.looks, 'look')}"
    since = f" since frame {event.first_frame}" if event.first_frame < event.frame else ""
    found = f"{seen}{since}, mean score {event.score:.2f} → target {event.target} is new"
    near = event.nearest
    if near is None:
        return found
    value, level = distinct_texts(near.probability, near.min_probability)
    if near.probability >= near.min_probability:
        return f"{found} (target {near.target} is taken for another detection)"
    turning = round_away(near.probability, decimals(near.probability, near.min_probability), up=False)
    return (
        f"{found}: it is target {near.target} with probability {value} < {level} ({_summands(near)}); "
        f"would have been target {near.target} at min_probability ≤ {turning}"
    )


def returned(event: Returned) -> str:
    """`a detection is target 3 with probability ... → target 3 is back`."""
    return _recognised(event.recognition, f"target {event.target} is back{_at(event.box)}", "a new target")


def reacquired(event: Reacquired) -> str:
    """`a detection is target 3 with probability ... → its belief starts again`."""
    then = f"target {event.target} found again{_at(event.box)}"
    return _recognised(event.recognition, then, "left alone")


def died(event: TargetDied) -> str:
    """`lost for 30 frames → target 3 ends`."""
    how = "lost" if event.reason == "lost" else "not detected"
    key = "lost_frames" if event.reason == "lost" else "unseen_frames"
    kept = ", remembered" if event.remembered else ""
    return (
        f"{how} for {plural(event.frames, 'frame')} → target {event.target} ends{kept}; "
        f"would have continued at {key} ≥ {event.frames + 1}"
    )


def duplicate_ended(event: DuplicateEnded) -> str:
    """`its belief overlaps that of target 1 ... → target 3, the younger, ends`."""
    digits = decimals(event.overlap, event.level)
    turning = min(1.0, float(round_away(event.overlap, digits, up=True)))
    value = round_away(event.overlap, digits, up=False)
    return (
        f"its belief overlaps that of target {event.kept} by {value} ≥ {event.level:g} for "
        f"{plural(event.frames, 'frame')} → target {event.target}, the younger, ends; would have continued "
        f"at overlap > {turning:g} or frames > {event.frames}"
    )


def births_refused(event: BirthsRefused) -> str:
    """`20 targets of square live, the most → births refused`."""
    so_far = f", {event.refused} so far" if event.refused > event.waiting else ""
    return (
        f"{plural(event.live, 'target')} of {event.template} live, the maximum → "
        f"{plural(event.waiting, 'birth')} refused{so_far}; would have been born at max_targets ≥ "
        f"{event.live + event.waiting}"
    )


def detector_failed(event: DetectorFailed) -> str:
    """`motion failed: ... → out for 10 frames, tried again in frame 14`."""
    out = "the rest of the run"
    if event.until is not None:
        waits = plural(event.until - event.frame, "frame")
        out = f"{waits} after {event.times} failures in a row" if event.times > 1 else waits
        out += f", tried again in frame {event.until}"
    return f"detector {event.detector} failed: {event.reason} → out for {out}"


def _recognised(by: Recognition, then: str, otherwise: str) -> str:
    value, level = distinct_texts(by.probability, by.min_probability)
    # As many digits as tell it from 1, and rounded up, so that the level named would have refused it.
    digits = max(2, math.ceil(-math.log10(max(1.0 - by.probability, 1e-7))))
    turning = float(round_away(by.probability, digits, up=True))
    but = f"; would have been {otherwise} at min_probability ≥ {turning:.9g}" if turning < 1 else ""
    relation = "≥" if by.probability > by.min_probability else "="
    rival = "a new target" if by.rival == "new" else f"target {by.rival}"
    return (
        f"a detection is target {by.target} with probability {value} {relation} {level} ({_summands(by)}; "
        f"next {rival}, {by.rival_probability:.2g}) → {then}{but}"
    )


def _summands(by: Recognition) -> str:
    """The log-odds' parts."""
    whom = f" by {', '.join(by.agents)}" if by.agents else ""
    return (
        f"{plural(by.away, 'frame')} away {by.fading:+.2f}, {by.distance_px:.0f} px off {by.place:+.2f}, "
        f"looks{whom} {by.appearance:+.2f} nats"
    )


def _at(box: tuple[float, float, float, float]) -> str:
    return f", centre {box[0]:.4g}, {box[1]:.4g}, {box[2]:.4g} x {box[3]:.4g} px"
