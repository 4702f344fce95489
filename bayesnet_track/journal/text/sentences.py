"""An event as a sentence: what changed, the numbers that caused it, at which threshold it would not have."""

from __future__ import annotations

from typing import assert_never

from bayesnet_track.journal.events.basic import Event, RunEnded, RunStarted
from bayesnet_track.journal.events.belief_events import (
    BeliefReset,
    DegenerateBelief,
    MeasurementGated,
    ParticlesResized,
    ReferenceGuarded,
    SecondPass,
)
from bayesnet_track.journal.events.distractor_events import DistractorSeen, distractor_seen
from bayesnet_track.journal.events.inputs import AgentMissed, InputRefused
from bayesnet_track.journal.events.join_events import AttachmentChanged, OcclusionChanged, RingChanged
from bayesnet_track.journal.events.jump_events import Reappeared, reappeared
from bayesnet_track.journal.events.life_events import BirthsRefused, CandidateConfirmed, DetectorFailed
from bayesnet_track.journal.events.machine_events import MachineChanged
from bayesnet_track.journal.events.source_events import (
    FramesDropped,
    FrameSizeChanged,
    FramesMissing,
    SourceDamaged,
    SourceStalled,
)
from bayesnet_track.journal.net.hand_decisions import Released, Toggled
from bayesnet_track.journal.net.join_decisions import Joined, Parted
from bayesnet_track.journal.net.life_decisions import DuplicateEnded, Reacquired, Returned, TargetDied
from bayesnet_track.journal.net.net import (
    Decision,
    FitCause,
    LocallyAdapted,
    ParticlesLimited,
    Quarantined,
    Readmitted,
    ScoreCause,
    SelfStopped,
    Shed,
    TakenBack,
    TargetStarted,
)
from bayesnet_track.journal.net.rule_decisions import Activated, Deactivated, StatusChanged
from bayesnet_track.journal.text.belief_sentences import (
    belief_reset,
    measurement_gated,
    particles_resized,
    second_pass,
)
from bayesnet_track.journal.text.fault_sentences import (
    by_hand,
    missed,
    particles_limited,
    quarantined,
    readmitted,
    shed,
    taken_back,
)
from bayesnet_track.journal.text.join_sentences import (
    attachment_changed,
    joined,
    occlusion_changed,
    parted,
    ring_changed,
)
from bayesnet_track.journal.text.life_sentences import (
    births_refused,
    confirmed,
    detector_failed,
    died,
    duplicate_ended,
    reacquired,
    returned,
)
from bayesnet_track.journal.text.switch_sentences import activated, deactivated, guarded
from bayesnet_track.journal.text.wording import decimals, distinct_texts, held, plural, round_away, show_turn


def explain(event: Event, name_target: bool = False) -> str:
    """One sentence for an event.

    UD stands in the unit of its threshold, with px² beside it where that is another unit. "Would have" names
    the threshold, rounded away from the one that was set, at which the rule would not have fired.
    `name_target` says whose net it was, for runs of several targets.

    >>> from bayesnet_track.journal.net.causes import Cause
    >>> cause = Cause("ud_px2", 200.0, 212.4, 3, 212.4, 212.4, 1.0)
    >>> explain(Activated(29, "1", "motion", "square", cause))
    'frame 29: UD 212 px² > 200 for 3 frames → motion on; would have stayed off at activate ≥ 213'
    """
    match event:
        case RunStarted():
            return _run_started(event)
        case RunEnded():
            return _run_ended(event)
        case FramesMissing():
            gap = plural(event.missing, "frame interval")
            return f"frame {event.frame}: {gap} missing before it; the belief is predicted over the gap"
        case FrameSizeChanged():
            then = "the run stops" if event.action == "stop" else "they are scaled to the first frame's size"
            return f"frame {event.frame}: the frame size changes to {event.width}x{event.height}; {then}"
        case SourceDamaged():
            return f"frame {event.frame}: the source is damaged: {event.reason}"
        case MachineChanged():
            changes = "; ".join(event.changes)
            where = "the run continues on another machine or with other libraries"
            return f"frame {event.frame}: {where}: {changes}"
        case FramesDropped():
            dropped = plural(event.dropped, "frame")
            return f"frame {event.frame}: {dropped} dropped, because newer ones had arrived"
        case SourceStalled():
            silent = f"frame {event.frame}: no picture for {event.seconds:.1f} s: {event.reason}"
            return f"{silent}; connecting again, attempt {event.attempt}"
        case InputRefused():
            return f"frame {event.frame}: the request for {event.node} is refused: {event.reason}"
        case BirthsRefused():
            return f"frame {event.frame}: {births_refused(event)}"
        case DetectorFailed():
            return f"frame {event.frame}: {detector_failed(event)}"
        case _:
            sentence, target = happened(event), f"target {event.target}"
            whose = f", {target}" if name_target and target not in sentence else ""
            return f"frame {event.frame}{whose}: {sentence}"


def _run_started(event: RunStarted) -> str:
    colour = "" if event.has_color else " gray"
    length = "" if event.declared_frames is None else f", {plural(event.declared_frames, 'frame')}"
    rate = f"{1 / event.frame_interval_s:.4g} per second" if event.frame_interval_s > 0 else "no rate"
    return (
        f"run of {event.graph} ({event.graph_sha256[:12]}) on {event.source}: "
        f"{event.width}x{event.height}{colour}{length}, {rate}; seed {event.seed}"
    )


def _run_ended(event: RunEnded) -> str:
    declared = event.declared_frames
    whole = declared is None or declared == event.frames
    frames = plural(event.frames, "frame") if whole else f"{event.frames} of {declared} frames"
    how = "ended" if event.complete else "ended early"
    return f"run {how} after {frames}: {event.reason.replace('_', ' ')}"


def happened(
    event: Decision
    | AgentMissed
    | CandidateConfirmed
    | DegenerateBelief
    | MeasurementGated
    | BeliefReset
    | ParticlesResized
    | SecondPass
    | Reappeared
    | ReferenceGuarded
    | DistractorSeen
    | OcclusionChanged
    | AttachmentChanged
    | RingChanged,
) -> str:
    """The sentence without the frame it happened in."""
    match event:
        case TargetStarted():
            x, y, w, h = event.box
            active = ", ".join(event.active) or "no agent"
            return (
                f"target {event.target} starts as {event.template}, centre {x:.4g}, {y:.4g}, "
                f"{w:.4g} x {h:.4g} px → {active} on"
            )
        case Activated():
            return activated(event)
        case Deactivated():
            return deactivated(event)
        case LocallyAdapted():
            return f"{event.node}: its own {held(event.cause, '>')} → tuned itself, attempt {event.attempt}"
        case SelfStopped():
            return (
                f"{event.node}: its own {held(event.cause, '>')} → stopped itself; may be switched on again "
                f"from frame {event.rests_until}; would have gone on at self_check ≥ "
                f"{show_turn(event.cause, up=True)}"
            )
        case Quarantined():
            return quarantined(event)
        case Readmitted():
            return readmitted(event)
        case Shed():
            return shed(event)
        case TakenBack():
            return taken_back(event)
        case ParticlesLimited():
            return particles_limited(event)
        case AgentMissed():
            return missed(event)
        case Toggled() | Released():
            return by_hand(event)
        case StatusChanged():
            return _status(event)
        case MeasurementGated():
            return measurement_gated(event)
        case ParticlesResized():
            return particles_resized(event)
        case SecondPass():
            return second_pass(event)
        case Reappeared():
            return reappeared(event)
        case CandidateConfirmed():
            return confirmed(event)
        case Returned():
            return returned(event)
        case Reacquired():
            return reacquired(event)
        case TargetDied():
            return died(event)
        case DuplicateEnded():
            return duplicate_ended(event)
        case ReferenceGuarded():
            return guarded(event)
        case DistractorSeen():
            return distractor_seen(event)
        case Joined():
            return joined(event)
        case Parted():
            return parted(event)
        case OcclusionChanged():
            return occlusion_changed(event)
        case AttachmentChanged():
            return attachment_changed(event)
        case RingChanged():
            return ring_changed(event)
        case BeliefReset():
            return belief_reset(event)
        case DegenerateBelief():
            return f"no hypothesis of target {event.target} can be used: {event.reason}; the prediction stays"
        case _:
            assert_never(event)


def _status(event: StatusChanged) -> str:
    lost = event.status == "lost"
    result = f"target {event.target} {'lost' if lost else 'found again'}"
    if isinstance(event.cause, ScoreCause):
        return _by_score(event, event.cause)
    if isinstance(event.cause, FitCause):
        return _by_fit(event.cause, result)
    if event.cause is None:
        return f"{event.reason} → {result}" if event.reason else result
    if not lost:
        fits = f", and {event.reason}" if event.reason else ""
        return f"{held(event.cause, '≤')}{fits} → {result}"
    return (
        f"{held(event.cause, '>')} → {result}; would have stayed at lost ≥ {show_turn(event.cause, up=True)}"
    )


def _by_fit(cause: FitCause, result: str) -> str:
    fit, level = distinct_texts(cause.fit, cause.level)
    span = f"for {plural(cause.frames, 'frame')}"
    found = f"the best hypothesis has a likelihood of {fit} of a perfect match < fit_below {level} {span}"
    if cause.turning is None:
        return f"{found} → {result}; would have been lost by its UD at any fit_below"
    turning = round_away(cause.turning, decimals(cause.turning, cause.level), up=False)
    return f"{found} → {result}; would have stayed at fit_below ≤ {turning}"


def _by_score(event: StatusChanged, cause: ScoreCause) -> str:
    score, level = distinct_texts(cause.score, cause.level)
    span = f"for {plural(cause.frames, 'frame')}"
    found = f"score {score} {'<' if cause.fell else '≥'} {level} {span}"
    turning = round_away(cause.turning, decimals(cause.turning, cause.level), up=not cause.fell)
    key = "score_below" if event.status == "lost" else "uncertain_below"
    if cause.fell:
        return f"{found} → target {event.target} {event.status}; would have stayed at {key} ≤ {turning}"
    status = "found again" if event.status == "tracking" else event.status
    return f"{found} → target {event.target} {status}; would have stayed at a level > {turning}"
