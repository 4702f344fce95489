"""How targets were joined, hidden, carried and parted, as sentences."""

from __future__ import annotations

from bayesnet_track.journal.events.join_events import AttachmentChanged, OcclusionChanged, RingChanged
from bayesnet_track.journal.net.join_decisions import Joined, Parted
from bayesnet_track.journal.text.wording import decimals, distinct_texts, plural, round_away


def joined(event: Joined) -> str:
    """`the beliefs of targets 1 and 2 overlap by 0.12 ≥ 0.05 → joined; ...`."""
    value, level = distinct_texts(event.overlap, event.above)
    turning = round_away(event.overlap, decimals(event.overlap, event.above), up=True)
    kinds = " and ".join(dict.fromkeys(event.kinds))
    return (
        f"the beliefs of target {event.target} and target {event.other} ({kinds}) overlap by {value} "
        f"≥ {level} → joined; would have stayed on their own at overlap > {turning}"
    )


def parted(event: Parted) -> str:
    """`the beliefs of targets 1 and 2 overlap by 0 < 0.05 for 5 frames → parted; ...`."""
    value, level = distinct_texts(event.overlap, event.below)
    turning = round_away(event.turning, decimals(event.turning, event.below), up=False)
    stay = (
        f"overlap ≤ {turning} or apart_frames > {event.frames}"
        if float(turning)
        else f"apart_frames > {event.frames}"
    )
    return (
        f"the beliefs of target {event.target} and target {event.other} overlap by {value} < {level} "
        f"for {plural(event.frames, 'frame')} → parted, after {plural(event.together, 'frame')} together; "
        f"would have stayed joined at {stay}"
    )


def occlusion_changed(event: OcclusionChanged) -> str:
    """`target 1 is in front (probability 0.97) and hides 0.62 > 0.5 of target 2 → ...`."""
    value, level = distinct_texts(event.share, event.above)
    if event.hidden:
        return (
            f"target {event.other} is in front with probability {event.in_front:.2f} and hides {value} "
            f"> {level} of target {event.target} → target {event.target} hidden, does not learn"
        )
    return (
        f"target {event.other} hides {value} ≤ {level} of target {event.target} "
        f"→ target {event.target} seen again after {plural(event.frames, 'frame')}"
    )


def attachment_changed(event: AttachmentChanged) -> str:
    """`target 2 moves as target 1 does, with probability 0.93 → carried`."""
    if event.attached:
        return (
            f"target {event.target} moves as target {event.other} does with probability "
            f"{event.probability:.2f} → carried by target {event.other}"
        )
    return (
        f"target {event.target} moves as target {event.other} does with probability "
        f"{event.probability:.2f} only → carried no longer, after {plural(event.frames, 'frame')}"
    )


def ring_changed(event: RingChanged) -> str:
    """`targets 1, 2, 3 are joined in a ring → the pair 1, 3 is left out`."""
    pair = f"target {event.target} and target {event.other}"
    if not event.left_out:
        return f"no ring is closed by {pair} any more → their joint belief is of the tree again"
    group = ", ".join(event.group)
    return (
        f"targets {group} are joined in a ring → {pair}, with an overlap of {event.overlap:.2g} the least, "
        "are left out: each receives only the other's own belief"
    )
