"""The second half of a target's frame: its belief is measured, decided on, learnt from and described.

Between the two halves (`filtering.filter_target`, `finish_target`) the beliefs of several targets can be
joined. Both are functions of the target's state and the frame; time is read for the timings only.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Mapping
from functools import partial

import numpy as np

from bayesnet_track.adapt.memory import RuleMemory
from bayesnet_track.adapt.rule_columns import RuleColumns
from bayesnet_track.adapt.rule_inputs import Measures, Situation
from bayesnet_track.adapt.rules import decide
from bayesnet_track.belief.contract import estimate
from bayesnet_track.belief.particles.belief import find_maps
from bayesnet_track.engine.filtering import Filtered
from bayesnet_track.engine.findings import Decided, Learnt, Measured, TargetResult, heard
from bayesnet_track.engine.frame_metrics import frame_metrics
from bayesnet_track.engine.frame_work import FrameWork
from bayesnet_track.engine.learning import learn_all
from bayesnet_track.engine.modes import with_modes
from bayesnet_track.engine.rows.filtered_rows import Together
from bayesnet_track.engine.rows.plain_rows import Described, Results, finish_rows
from bayesnet_track.engine.scoring.assurance import judge_alarm, judge_assurance, with_evidence, with_recent
from bayesnet_track.engine.scoring.confidences import confidences
from bayesnet_track.engine.scoring.distractors import find_distractor, follow_distractor, with_distractor
from bayesnet_track.engine.scoring.encounters import Place
from bayesnet_track.engine.scoring.reacquisition import Look, follow_fit
from bayesnet_track.engine.scoring.score import Scored, extent_beyond, most, probability
from bayesnet_track.engine.scoring.verifying import HELD, Verification
from bayesnet_track.engine.state import TargetState, inside_frame
from bayesnet_track.engine.summaries import Summary, find_covariances, find_summaries
from bayesnet_track.graph.spec import Distractors, InferenceNode
from bayesnet_track.inference.guard import changes
from bayesnet_track.inference.measure import measure
from bayesnet_track.inference.measure_rows import StepArrays, is_flat, measure_rows
from bayesnet_track.journal.events.beliefs import DegenerateBelief, Reappeared
from bayesnet_track.journal.events.event import Event
from bayesnet_track.journal.events.faults import FactorFlawed, FlawEnded, MotionFlawed
from bayesnet_track.journal.events.statuses import DistractorSeen, DoubtEnded, FoundAgain
from bayesnet_track.journal.metrics import FrameMetrics
from bayesnet_track.journal.net.net import apply_decisions
from bayesnet_track.numerics.arrays import Floats
from bayesnet_track.numerics.log_weights import kl
from bayesnet_track.numerics.records import changed
from bayesnet_track.observation.planes import FramePair, PlaneCache


def finish_target(work: FrameWork, filtered: Filtered) -> TargetResult:
    """As `finish_targets`, of one."""
    return finish_targets(work, {filtered.target: filtered})[filtered.target]


def finish_targets(work: FrameWork, filtered: Mapping[str, Filtered]) -> Results:
    """Measure the beliefs, decide what changes, let the agents learn, and describe them: target -> result.

    One thing after the other for all targets: the code that a processor keeps at hand then serves them all.
    """
    started = work.engine.clock()
    groups = filtered.groups if isinstance(filtered, Together) else ()
    for group in groups:
        group.find_maps()
    find_maps(one.step for one in (filtered.others if isinstance(filtered, Together) else filtered).values())
    work.charge("belief", started)
    bare = changed(work, cache=PlaneCache(FramePair(work.frame, None)))  # lines may be asked for much later
    spreads = find_covariances(filtered)
    described = Described(bare, spreads, find_summaries(bare, filtered, spreads))
    finished = [done for group in groups if (done := finish_rows(work, group, described)) is not None]
    names = [*filtered]
    together = {target for done in finished for target in done.rows}
    left = {target: filtered[target] for target in names if target not in together}
    results: dict[str, TargetResult] = {}
    states = {target: estimate_target(work, one) for target, one in left.items()}
    boxes = {target: inside_frame(state[:4], work.frame) for target, state in states.items()}
    started = work.engine.clock()
    measures = measure_all(work, left, boxes)
    measured = {
        target: measure_target(work, one, states[target], boxes[target], measures[target])
        for target, one in left.items()
    }
    decided = decide_all(work, left, measured)
    started = work.charge("measure", started)
    learnt = learn_all(work, left, measured, decided)
    work.charge("learn", started)
    for target, one in left.items():
        found = measured[target], decided[target], learnt[target]
        line = partial(_line, bare, one, found, described.summaries)
        results[target] = describe_target(work, one, found, line, partial(spreads.__getitem__, target))
    return Results(finished, results, names)


def estimate_target(work: FrameWork, filtered: Filtered) -> Floats:
    """(D,) the state that stands for the belief."""
    plate = work.plate_of(filtered.target).plate
    return estimate(plate.inference(plate.root).estimate, filtered.step)


def measure_all(
    work: FrameWork, filtered: Mapping[str, Filtered], boxes: Mapping[str, Floats]
) -> dict[str, Measures]:
    """Target -> UD, KL, ... of its belief, its estimate in `boxes` (4,); those of flat nets by groups."""
    alike: dict[Hashable, list[str]] = {}
    found: dict[str, Measures] = {}
    areas = {target: float(boxes[target][2] * boxes[target][3]) for target in filtered}
    for target, one in filtered.items():
        plate = work.plate_of(target).plate
        if is_flat(plate) and not one.step.evidence.latent:
            alike.setdefault((plate.name, StepArrays.key(one.plan, one.step)), []).append(target)
        else:
            found[target] = measure(plate, one.plan, one.step, areas[target])
    for targets in alike.values():
        plan, plate = filtered[targets[0]].plan, work.plate_of(targets[0]).plate
        steps = StepArrays.of(plate, plan, [filtered[target].step for target in targets])
        rows = measure_rows(plate, plan, steps, [areas[target] for target in targets])
        found.update((target, rows.of(row)) for row, target in enumerate(targets))
    return found


def measure_target(
    work: FrameWork, filtered: Filtered, state: Floats, box: Floats, measures: Measures
) -> Measured:
    """How sure it is to hold the target with the estimate `state` (D,), whose `box` is inside the frame."""
    compiled = work.plate_of(filtered.target)
    root = compiled.plate.inference(compiled.plate.root)
    by_hand = work.by_hand.get(filtered.target, ())
    net = apply_decisions(work.net, (*filtered.faults, *by_hand)).targets[filtered.target]
    if out := filtered.missed.keys() | filtered.resting:
        net = changed(net, active=net.active - out)
    scored = filtered.before.scored
    if root.score is None:
        return Measured(state, box, net, measures, scored)
    rule, distractor, ended = root.score.settings, None, None
    unfit = measures.fit < rule.full_fit
    verification = Verification(compiled.verifiers, work.cache, filtered.target, box)
    verified = verification.verify(scored.references, unfit or scored.unfit or not scored.smooth)
    ud_px2 = None if unfit or _is_sought(work, filtered) else measures.ud_px2[compiled.plate.root]
    further = {**verified.values, **confidences(rule, filtered.step.evidence)}
    further["border"] = extent_beyond(box, work.frame)
    scored = scored.after(rule, measures, filtered.step, ud_px2, further)
    if root.distractors is not None:
        scored, distractor, ended = _follow_distractors(
            work, filtered, root.distractors, box, measures, scored
        )
    bound = most(rule, measures.fit, scored.doubt)
    if filtered.modes is not None and filtered.modes.hidden is not None:
        bound = min(bound, 1.0 - filtered.modes.hidden)
    score = min(probability(rule, scored.features(rule)), bound)
    found: FoundAgain | None = None
    if root.lost is not None and root.lost.found_fit is not None:
        look = _look(work, filtered, box, score, measures.fit)
        scored, most_now, found = follow_fit(scored, root.lost, look)
        bound = min(bound, most_now)
        score = min(score, bound)
    scored, notices = _follow(root, filtered.before.scored, scored, score, work.frame.index, filtered.target)
    notices = (*notices, *(one for one in (found, ended) if one is not None))
    if score >= HELD and not unfit:
        verified = verification.follow(verified)
    scored, notices = changed(scored, references=verified.references), (*notices, *verified.failed)
    return Measured(state, box, net, measures, scored, score, bound, distractor, notices)


def _is_sought(work: FrameWork, filtered: Filtered) -> bool:
    """Whether the target is lost, or found by a search in this frame: the belief is as wide as the search."""
    frame, target = work.frame.index, filtered.target
    events = (report(frame, target) for report in filtered.step.reports)
    return work.net.targets[target].status == "lost" or any(isinstance(one, Reappeared) for one in events)


def _follow_distractors(
    work: FrameWork,
    filtered: Filtered,
    rule: Distractors,
    box: Floats,
    measures: Measures,
    scored: Scored,
) -> tuple[Scored, DistractorSeen | None, DoubtEnded | None]:
    """With what looks like the target beside it, or the end of the doubt that this raised."""
    frame, target = work.frame.index, filtered.target
    able = work.plate_of(target).cues.keys() - work.net.targets[target].quarantined
    if not able <= measures.kl.keys():  # it takes all of them to tell things apart
        return scored, None, None
    seen = find_distractor(rule, frame, target, filtered.step, measures)
    if measures.fit < rule.fit or _is_sought(work, filtered):  # its estimate shows no motion
        return with_distractor(scored, seen, rule.frames), seen, None
    place, side = Place(frame, float(box[0]), float(box[1])), float(np.sqrt(max(measures.area_px2, 1.0)))
    scored, ended = follow_distractor(scored, seen, rule.frames, target, place, side)
    return scored, seen, ended


def _with_turn(seen: DistractorSeen, scored: Scored) -> DistractorSeen:
    """With the largest level that would not have raised this doubt: all of its frames count."""
    return seen if scored.encounter is None else changed(seen, turning_nats=scored.encounter.behind_nats)


def _look(work: FrameWork, filtered: Filtered, box: Floats, score: float, fit: float) -> Look:
    """What the frame shows of a target whose estimate is `box` (4,)."""
    target, (x, y, w, h) = filtered.target, box.tolist()
    surprise = kl(filtered.step.support.weights.log, filtered.step.prior.log)
    status = work.net.targets[target].status
    return Look(work.frame.index, target, status, score, fit, surprise, x, y, float(np.sqrt(w * h)))


def _follow(
    root: InferenceNode, before: Scored, scored: Scored, score: float, frame: int, target: str
) -> tuple[Scored, tuple[Event, ...]]:
    """What guarantee and alarm remember after a frame, and what they give to write down."""
    notices: list[Event | None] = []
    if root.guarantee is not None:
        scored = with_recent(scored, score, root.guarantee)
        notices.append(judge_assurance(before, scored, root.guarantee, frame, target))
    if root.alarm is not None:
        scored, notice = judge_alarm(before, with_evidence(scored, score, frame), root.alarm, frame, target)
        notices.append(notice)
    return scored, tuple(notice for notice in notices if notice is not None)


def decide_all(
    work: FrameWork, filtered: Mapping[str, Filtered], measured: Mapping[str, Measured]
) -> dict[str, Decided]:
    """Target -> what the rules choose: for those together that the rules see alike."""
    alike: dict[Hashable, list[str]] = {}
    seen = {target: _see(work, one, measured[target]) for target, one in filtered.items()}
    for target, now in seen.items():
        alike.setdefault(RuleColumns.key(now), []).append(target)
    found: dict[str, Decided] = {}
    for targets in alike.values():
        known = RuleMemory.join([filtered[target].before.memory for target in targets])
        columns = RuleColumns.of([seen[target] for target in targets], known.layout.checked)
        chosen, memory = decide(columns, known)
        root = columns.plate.root
        levels = memory.levels_px2(root, columns.plate.below[root] & columns.active).tolist()
        for row, (target, level) in enumerate(zip(targets, levels, strict=True)):
            own = memory if len(targets) == 1 else memory.take([row])
            baseline = None if level != level else level
            found[target] = Decided(chosen.get(row, ()), own, baseline, seen[target])
    return {target: found[target] for target in filtered}


def _see(work: FrameWork, filtered: Filtered, measured: Measured) -> Situation:
    """What the rules of a target see."""
    compiled = work.plate_of(filtered.target)
    return Situation(
        work.frame.index,
        filtered.target,
        compiled.plate,
        measured.net,
        measured.measures,
        compiled.costs_ms,
        compiled.adaptable,
        filtered.hidden,
        measured.score,
        filtered.missed,
        filtered.before.existence,
        None if filtered.modes is None else filtered.modes.hiding,
        filtered.call,
        work.frame.stride,
    )


def describe_target(
    work: FrameWork,
    filtered: Filtered,
    done: tuple[Measured, Decided, Learnt],
    line: Callable[[], FrameMetrics],
    covariance: Callable[[], Floats],
) -> TargetResult:
    """The state for the next frame, and all that is written down of this one."""
    measured, decided, learnt = done
    compiled, frame, target = work.plate_of(filtered.target), work.frame, filtered.target
    before, stepped, measures = filtered.before, filtered.step, measured.measures
    ud_px2 = measures.ud_px2[compiled.plate.root]
    after = TargetState(
        stepped.posterior,
        learnt.references,
        decided.memory,
        before.plan,
        frame.time,
        learnt.watched,
        filtered.predicted.after(ud_px2, measures.area_px2, decided.quiet_px2, measured.held),
        measured.scored,
        frozenset({*filtered.flaws, *filtered.undefined}),
        before.existence,
        before.started,
    )
    changed = None if filtered.modes is None else filtered.modes.change(frame.index, target)
    events: list[Event] = [
        *filtered.predicted.events,
        *(() if changed is None else (changed,)),
        *(report(frame.index, target) for report in stepped.reports),
    ]
    events += _report_flaws(filtered, frame.index, after.flawed)
    if stepped.degenerate is not None:
        events.append(DegenerateBelief(frame.index, target, stepped.degenerate))
    if measured.distractor is not None and measured.scored.doubt > 0 and not before.scored.doubt:
        events.append(_with_turn(measured.distractor, measured.scored))
    events += measured.notices
    events += changes(frame.index, target, before.watched, learnt.watched, learnt.judged, compiled.guard)
    decisions = (*filtered.faults, *work.by_hand.get(target, ()), *learnt.decisions)
    said = partial(heard, stepped, filtered.plan.active)
    return TargetResult(after, measured.box, line, decisions, tuple(events), covariance, said)


def _line(
    work: FrameWork,
    filtered: Filtered,
    done: tuple[Measured, Decided, Learnt],
    summaries: Mapping[str, Summary],
) -> FrameMetrics:
    measured, decided, learnt = done
    line = frame_metrics(work, filtered, measured, decided.quiet_px2, learnt, summaries[filtered.target])
    return with_modes(line, filtered.modes, measured.score is not None)


def _report_flaws(filtered: Filtered, frame: int, now: frozenset[str]) -> list[Event]:
    """What is written of expressions that begin to have no value in this frame, and of those that end to."""
    target, before = filtered.target, filtered.before.flawed
    return [
        *(
            FactorFlawed(frame, target, factor, flaw.undefined, flaw.hypotheses, flaw.ignored)
            for factor, flaw in filtered.flaws.items()
            if factor not in before
        ),
        *(
            MotionFlawed(frame, target, part, one.states, one.asked)
            for part, one in filtered.undefined.items()
            if part not in before
        ),
        *(FlawEnded(frame, target, what) for what in sorted(before - now)),
    ]
