"""Let the detectors of a graph look at a frame: each once, however many plates ask, its faults contained."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence

import numpy as np

from bayesnet_track.adapt.lifecycle import TrackHistory, is_refusal_notable
from bayesnet_track.adapt.status import next_try
from bayesnet_track.engine.compiled import CompiledPlate, Engine
from bayesnet_track.engine.frame_context import FrameContext
from bayesnet_track.engine.lifecycle.sensing import Found
from bayesnet_track.journal.events.lives import MOST_DETECTIONS, DetectionsCut, DetectorFailed
from bayesnet_track.journal.net import Net
from bayesnet_track.journal.target_net import Fault
from bayesnet_track.numerics.arrays import Floats
from bayesnet_track.numerics.records import evolve
from bayesnet_track.observation.cue import FAULTS, LabelRule, said
from bayesnet_track.observation.detector import (
    Detections,
    Detector,
    DetectorState,
    LearningDetector,
    Scanner,
    check_detections,
    of_camera,
)
from bayesnet_track.observation.planes import FramePair
from bayesnet_track.sources.entrances.notices import notice

Seen = Mapping[str, Found]
"""Camera -> what a plate is given of its image; "" where there is one image."""


def look(
    work: FrameContext,
    history: TrackHistory,
    boxes: Callable[[Sequence[str]], Floats],
    list_live: Callable[[str], Sequence[str]],
) -> tuple[dict[str, Seen], TrackHistory, tuple[DetectorFailed | DetectionsCut, ...]]:
    """Detections of each plate that looks in this frame, the detectors' states, and what went wrong.

    Of several cameras those look that have a frame at this time, each with its own detector. One that has to
    be shown its target learns the first one of the plate that is held. One that raises, or returns anything
    but boxes of finite numbers with as many scores and labels, is out for a while, as an agent is.
    """
    engine, frame = work.engine, work.frame
    due = _due(work, history)
    detections: dict[str, Detections] = {}
    events: list[DetectorFailed | DetectionsCut] = []
    states = dict(history.detectors)
    for name in dict.fromkeys(due.values()):
        asking = [key for key in due if due[key] == name]
        plates, (first, camera) = [plate for plate, _ in asking], asking[0]
        detector, box, pair = engine.detectors[name], None, work.cache.frames.of(camera)
        assert pair is not None
        if hasattr(
            detector, "knows_target"
        ):  # else it has nothing to learn, and asking who is held takes long
            target = next((targets[0] for plate in plates if (targets := list_live(plate))), None)
            box = None if target is None else boxes([target])[0]
        try:
            answer, states[name] = _ask(detector, states.get(name), pair, box)
        except FAULTS as error:  # a detector is a guest's code: whatever it raises must not end the run
            next_frame, times = next_try(frame.index, history.failed.get(name))
            word = of_camera(_word(engine, first), camera)
            events.append(DetectorFailed(frame.index, word, said(error), next_frame, times))
            fault = Fault(times, frame.index, next_frame, True)
            history = evolve(history, failed={**history.failed, name: fault})
            continue
        if answer is None:
            continue
        detections[name] = answer
        if answer.cut:
            word = of_camera(_word(engine, first), camera)
            history, event = _count_cut(history, name, word, frame.index, answer)
            events += event
    by_plate: dict[str, dict[str, Found]] = {}
    for (plate, camera), name in due.items():
        if name in detections:
            by_plate.setdefault(plate, {})[camera] = _of_plate(engine, plate, detections[name])
    return dict(by_plate), evolve(history, detectors=states), tuple(events)


def _due(work: FrameContext, history: TrackHistory) -> dict[tuple[str, str], str]:
    """Plate and camera of those that look in this frame -> the detector."""
    due: dict[tuple[str, str], str] = {}
    for plate, compiled in work.engine.plates.items():
        birth = None if compiled.lifecycle is None else compiled.lifecycle.birth
        if birth is None or compiled.plate.inverses:
            continue  # sensors are no detectors of boxes: `scan`
        interval = frames_between_looks(compiled, work.net, history)
        for camera, name in compiled.detectors.items():
            image = work.frame.of(camera)
            is_due = image is not None and image.ordinal % interval == 0
            if is_due and _is_in(history, name, work.frame.index):
                due[plate, camera] = name
    return due


def frames_between_looks(compiled: CompiledPlate, net: Net, history: TrackHistory) -> int:
    """Frames between runs of the detector of a plate's births, by what there is after the last frame."""
    birth, plate = compiled.plate.spec.birth, compiled.plate.name
    assert birth is not None
    if birth.pace is None:
        return birth.every
    has_candidates = bool(history.candidates.get(plate))
    if (existence := compiled.plate.spec.existence) is not None and plate in history.detection_models:
        waiting = history.detection_models[plate].unconfirmed.existence
        has_candidates = bool((waiting >= existence.end).any())
    has_targets = any(target.template == plate for target in net.targets.values())
    return birth.frames_between(has_targets, has_candidates)


def scan(work: FrameContext, plate: str) -> dict[str, Found]:
    """Agent of a plate -> what it saw in this frame, of those whose sensor looked, the best first."""
    compiled = work.engine.plates[plate]
    scanner = work.engine.detectors[compiled.detectors[""]]
    assert isinstance(scanner, Scanner)
    detections = {}
    for agent, readings in scanner.scans(work.frame).items():
        if agent in compiled.sensors:
            order = np.argsort(-readings.scores, kind="stable")
            detections[agent] = Found(readings.values[order], readings.scores[order], order)
    return detections


def _count_cut(
    history: TrackHistory, name: str, word: str, frame: int, detections: Detections
) -> tuple[TrackHistory, list[DetectionsCut]]:
    """Frames in which a detector found more than it may give are counted, and told of by powers of ten."""
    count = history.cut.get(name, 0)
    counted = evolve(history, cut={**history.cut, name: count + 1})
    if not is_refusal_notable(count, count + 1):
        return counted, []
    return counted, [DetectionsCut(frame, word, len(detections), detections.cut, count + 1)]


def _is_in(history: TrackHistory, detector: str, frame: int) -> bool:
    """True if the detector is asked: it has not failed, or it is tried again."""
    fault = history.failed.get(detector)
    return fault is None or fault.until is None or fault.until <= frame


def _ask(
    detector: Detector, state: DetectorState | None, pair: FramePair, box: Floats | None
) -> tuple[Detections | None, DetectorState]:
    memory = detector.start() if state is None else state
    if box is not None and isinstance(detector, LearningDetector) and not detector.knows_target(memory):
        memory = detector.learn(pair, box, memory)
    detections, learnt = detector.detect(pair, memory)
    if detections is None:
        return None, learnt
    detections = check_detections(detections)
    if len(detections) <= MOST_DETECTIONS and (detections.scores[1:] <= detections.scores[:-1]).all():
        return detections, learnt
    order = np.argsort(-detections.scores, kind="stable")[:MOST_DETECTIONS]
    labels = tuple([detections.labels[k] for k in order.tolist()])
    cut = detections.cut + len(detections) - len(order)
    return Detections(detections.boxes[order], detections.scores[order], labels, cut), learnt


def _of_plate(engine: Engine, plate: str, detections: Detections) -> Found:
    compiled = engine.plates[plate]
    labels = () if (rules := compiled.lifecycle) is None or rules.birth is None else rules.birth.labels
    label_rules = [
        association.label
        for association in compiled.association_rules.values()
        if association.label is not None
    ]
    known_labels = tuple(detections.labels) if label_rules else ()
    for rule in label_rules:
        _say_unknown(rule, known_labels)
    everything = Found(detections.boxes, detections.scores, np.arange(len(detections)), known_labels)
    if not labels:
        return everything
    return everything.only(np.array([label in labels for label in detections.labels], dtype=bool))


def _say_unknown(rule: LabelRule, labels: Iterable[str]) -> None:
    allowed_labels = ", ".join(rule.labels)
    for label in sorted({*labels} - {*rule.labels, ""}):
        message = f"label {label!r} of detections says nothing of {rule.category}"
        notice(f"{message}: its confusion knows {allowed_labels}")


def _word(engine: Engine, plate: str) -> str:
    rules = engine.plates[plate].lifecycle
    assert rules is not None and rules.birth is not None
    return rules.birth.detector.detector
