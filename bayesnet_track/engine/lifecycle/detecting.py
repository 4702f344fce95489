"""Let the detectors of a graph look at a frame: each once, however many plates ask, its faults contained."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from bayesnet_track.adapt.lifecycle import TrackHistory, is_refusal_notable
from bayesnet_track.adapt.status import next_try
from bayesnet_track.engine.compiled import Engine
from bayesnet_track.engine.frame_context import FrameContext
from bayesnet_track.engine.lifecycle.sensing import Found
from bayesnet_track.journal.events.lives import MOST_DETECTIONS, DetectionsCut, DetectorFailed
from bayesnet_track.journal.net.target_net import Fault
from bayesnet_track.numerics.arrays import Floats
from bayesnet_track.numerics.records import evolve
from bayesnet_track.observation.cue import FAULTS, said
from bayesnet_track.observation.detector import (
    Detections,
    Detector,
    DetectorState,
    LearningDetector,
    Scanner,
    check_detections,
)
from bayesnet_track.observation.planes import FramePair


def look(
    work: FrameContext,
    history: TrackHistory,
    boxes: Callable[[Sequence[str]], Floats],
    held: Callable[[str], Sequence[str]],
) -> tuple[dict[str, Found], TrackHistory, tuple[DetectorFailed | DetectionsCut, ...]]:
    """What each plate that looks in this frame is given, the detectors' states, and what went wrong.

    A detector that has to be shown its target learns the first one of the plate that is held. One that
    raises, or returns anything but boxes of finite numbers with as many scores and labels, is out for a
    while, as an agent is.
    """
    engine, frame, pair = work.engine, work.frame, work.cache.frames
    due: dict[str, str] = {}
    for plate, compiled in engine.plates.items():
        if compiled.plate.inverses:
            continue  # its sensors are no detectors of boxes: `scan`
        birth = None if compiled.lifecycle is None else compiled.lifecycle.birth
        if (
            birth is not None
            and frame.ordinal % birth.every == 0
            and _is_in(history, compiled.detector, frame.index)
        ):
            due[plate] = compiled.detector
    found: dict[str, Detections] = {}
    events: list[DetectorFailed | DetectionsCut] = []
    states = dict(history.detectors)
    for name in dict.fromkeys(due.values()):
        plates = [plate for plate in due if due[plate] == name]
        detector, at = engine.detectors[name], None
        if hasattr(
            detector, "knows_target"
        ):  # else it has nothing to learn, and asking who is held takes long
            shown = next((targets[0] for plate in plates if (targets := held(plate))), None)
            at = None if shown is None else boxes([shown])[0]
        try:
            found[name], states[name] = _ask(detector, states.get(name), pair, at)
        except FAULTS as error:  # a detector is a guest's code: whatever it raises must not end the run
            until, times = next_try(frame.index, history.failed.get(name))
            word = _word(engine, plates[0])
            events.append(DetectorFailed(frame.index, word, said(error), until, times))
            fault = Fault(times, frame.index, until, True)
            history = evolve(history, failed={**history.failed, name: fault})
            continue
        if found[name].cut:
            history, event = _count_cut(history, name, _word(engine, plates[0]), frame.index, found[name])
            events += event
    given = {plate: _of_plate(engine, plate, found[name]) for plate, name in due.items() if name in found}
    return given, evolve(history, detectors=states), tuple(events)


def scan(work: FrameContext, plate: str) -> dict[str, Found]:
    """Agent of a plate -> what it saw in this frame, of those whose sensor looked, the best first."""
    compiled = work.engine.plates[plate]
    scanner = work.engine.detectors[compiled.detector]
    assert isinstance(scanner, Scanner)
    found = {}
    for agent, seen in scanner.scans(work.frame).items():
        if agent in compiled.sensors:
            best = np.argsort(-seen.scores, kind="stable")
            found[agent] = Found(seen.values[best], seen.scores[best], best)
    return found


def _count_cut(
    history: TrackHistory, name: str, word: str, frame: int, found: Detections
) -> tuple[TrackHistory, list[DetectionsCut]]:
    """Frames in which a detector found more than it may give are counted, and told of by powers of ten."""
    before = history.cut.get(name, 0)
    now = evolve(history, cut={**history.cut, name: before + 1})
    if not is_refusal_notable(before, before + 1):
        return now, []
    return now, [DetectionsCut(frame, word, len(found), found.cut, before + 1)]


def _is_in(history: TrackHistory, detector: str, frame: int) -> bool:
    """True if the detector is asked: it has not failed, or it is tried again."""
    fault = history.failed.get(detector)
    return fault is None or fault.until is None or fault.until <= frame


def _ask(
    detector: Detector, state: DetectorState | None, pair: FramePair, shown: Floats | None
) -> tuple[Detections, DetectorState]:
    now = detector.start() if state is None else state
    if shown is not None and isinstance(detector, LearningDetector) and not detector.knows_target(now):
        now = detector.learn(pair, shown, now)
    found, after = detector.detect(pair, now)
    found = check_detections(found)
    if len(found) <= MOST_DETECTIONS and (found.scores[1:] <= found.scores[:-1]).all():
        return found, after
    best = np.argsort(-found.scores, kind="stable")[:MOST_DETECTIONS]
    labels = tuple([found.labels[k] for k in best.tolist()])
    cut = found.cut + len(found) - len(best)
    return Detections(found.boxes[best], found.scores[best], labels, cut), after


def _of_plate(engine: Engine, plate: str, found: Detections) -> Found:
    rules = engine.plates[plate].lifecycle
    labels = () if rules is None or rules.birth is None else rules.birth.labels
    if not labels:
        return Found(found.boxes, found.scores, np.arange(len(found)))
    keep = np.array([label in labels for label in found.labels], dtype=bool)
    return Found(found.boxes[keep], found.scores[keep], np.flatnonzero(keep))


def _word(engine: Engine, plate: str) -> str:
    rules = engine.plates[plate].lifecycle
    assert rules is not None and rules.birth is not None
    return rules.birth.detector.detector
