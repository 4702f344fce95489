"""Sentences of what happens to beliefs: reset, resized, gated, drawn a second time."""

from __future__ import annotations

import math

from bayesnet_track.journal.events.belief_events import (
    BeliefReset,
    MeasurementGated,
    ParticlesResized,
    SecondPass,
)
from bayesnet_track.journal.text.wording import decimals, distinct_texts, plural, round_away


def belief_reset(event: BeliefReset) -> str:
    """A belief that was reset."""
    gamma, below = distinct_texts(event.gamma, event.below)
    over = "the belief's bounding box" if event.region == "belief" else "the image"
    then = (
        f"the belief of target {event.target} starts again from the frame's likelihood"
        if event.action == "reset"
        else "the frame's evidence is ignored"
    )
    turning = round_away(event.gamma, decimals(event.gamma, event.below), up=False)
    return f"γ {gamma} < {below} over {over} ({event.region_px2:.0f} px²) → {then}; not at below ≤ {turning}"


def particles_resized(event: ParticlesResized) -> str:
    """How many hypotheses are asked for, and why."""
    settings = f"{event.method}, {event.setting} {event.level:g}"
    by = "this frame's evidence" if event.early else "the last frame's evidence"
    asked = f"{_why_so_many(event)}: {by} asks for {event.need:.0f} hypotheses ({settings})"
    held = {"max": ", held by max", "min": ", held by min", "ess": ", too few effective to save any"}
    number = f"{event.particles}{held.get(event.limit, '')}, {event.before} before"
    return f"{asked} → {number}{_not_resized(event)}"


def _why_so_many(event: ParticlesResized) -> str:
    """The numbers that the need was computed from."""
    parts = []
    if event.bins is not None and event.bin_px is not None:
        parts.append(f"{event.field} spans {plural(event.bins, 'bin')} of {event.bin_px:g} px")
    if event.sd_px is not None:
        parts.append(f"{event.field} has an sd of {event.sd_px:.3g} px")
    if event.worth is not None and event.method != "kld":
        parts.append(f"{event.worth:.3g} hypotheses are worth one of the posterior's")
    return ", ".join([*parts, f"{event.ess:.0f} effective"])


def _not_resized(event: ParticlesResized) -> str:
    """What would have prevented it: a larger error asks for fewer, a larger threshold for more."""
    if event.turning is None:
        return ""
    up = (event.particles > event.before) == (event.setting != "threshold")
    turning = round_away(event.turning, decimals(event.turning, event.level), up)
    return f"; would have stayed near {event.before} at {event.setting} {'≥' if up else '≤'} {turning}"


def measurement_gated(event: MeasurementGated) -> str:
    """A measurement that is taken for another object."""
    d2, limit = distinct_texts(event.d2, event.limit)
    of = plural(event.degrees, "degree")
    then = "" if event.used else "; nothing else was measured near the prediction"
    # Rounded up, so that the gate named does let it pass.
    digits = min(max(2, math.ceil(-math.log10(max(1.0 - event.turning, 1e-300)))), 12)
    turning = math.ceil(event.turning * 10.0**digits) / 10.0**digits
    gate = f"gate ≥ {turning:.12g}" if turning < 1 else "gate: 1"
    return (
        f"{event.node} measured d² {d2} > {limit} from the prediction (gate {event.gate:g}, {of} of freedom) "
        f"→ not used{then}; would have been used at {gate}"
    )


def second_pass(event: SecondPass) -> str:
    """Hypotheses drawn a second time."""
    found, level = distinct_texts(event.kl, event.above_kl)
    how = "" if event.method == "second_pass" else f", by {event.method}"
    turning = round_away(event.kl, decimals(event.kl, event.above_kl), up=True)
    return (
        f"KL(posterior, prior) {found} nats > {level} → second pass of {event.particles} hypotheses{how}, "
        f"{event.ess_first:.0f} effective before, {event.ess:.0f} after; "
        f"no second pass at above_kl ≥ {turning}"
    )
