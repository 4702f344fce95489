"""The life of targets in one frame: detections become targets, lost ones are found, nets end.

`manage_tracks` comes after every live target is finished. Detectors look; live targets are given what they
hold; what is left is compared with the lost, gathers looks, and becomes a target, an old one when it is
recognised. Then the younger of two nets that hold one object ends, and those that were lost for too long. All
of it is a function of the engine, what is remembered and the frame.
"""

from __future__ import annotations

from bayesnet_track.engine.compiled import CompiledPlate
from bayesnet_track.engine.frame_context import FrameContext
from bayesnet_track.engine.lifecycle.association import Associated, associate_new
from bayesnet_track.engine.lifecycle.births import give_birth, give_birth_by_existence
from bayesnet_track.engine.lifecycle.confirming import Births
from bayesnet_track.engine.lifecycle.detecting import look
from bayesnet_track.engine.lifecycle.ends import end_duplicates, end_lost
from bayesnet_track.engine.lifecycle.refusing import report_refusals
from bayesnet_track.engine.lifecycle.sensing import Found
from bayesnet_track.engine.lifecycle.track_table import LiveTable
from bayesnet_track.engine.outcome import Outcome
from bayesnet_track.graph.settings.lifecycle import LifeRules
from bayesnet_track.journal.events.event import Event
from bayesnet_track.numerics.records import evolve


def manage_tracks(work: FrameContext, outcome: Outcome, associated: Associated | None = None) -> Outcome:
    """The outcome after the frame's births, returns and deaths; as it is where no plate has any.

    `associated` holds what the detectors found, and whose it is, where they looked before targets were
    weighed.
    """
    frame, plates, start = work.frame, work.engine.plates, work.engine.clock()
    rules = {
        plate: compiled.lifecycle for plate, compiled in plates.items() if compiled.lifecycle is not None
    }
    if not rules:
        return outcome
    tracks = LiveTable.of(work.engine, outcome)
    if associated is None:
        detections, tracks.history, looked_by = look(work, tracks.history, tracks.boxes, tracks.held)
        events: tuple[Event, ...] = looked_by
    else:
        detections, events = associated.found, associated.events
        looked = associated.history
        tracks.history = evolve(
            tracks.history,
            detectors=looked.detectors,
            failed=looked.failed,
            detection_models=looked.detection_models,
            candidates=looked.candidates,
            refusals=looked.refusals,
            watches=looked.watches,
        )
    looks = {plate: _is_looked(rule, plates[plate], plate in detections) for plate, rule in rules.items()}
    tracks.count(looks, frame)
    tracks.events += events
    for plate, rule in rules.items():
        if rule.birth is None:
            continue
        births = Births(work, tracks, plate, rule, rule.birth)
        owners = None if associated is None else associated.owners.get(plate)
        if plates[plate].plate.inverses or not plates[plate].has_one_image:
            # Detections are no boxes in one image, which could be compared with others.
            if associated is None:
                tracks.history, owners = associate_new(work, plate, tracks.history, detections), ()
            give_birth_by_existence(births, Found.none(), owners)
        elif plate in detections:
            give = give_birth if rule.existence is None else give_birth_by_existence
            (answer,) = detections[plate].values()
            give(births, answer, owners)
    for plate, rule in rules.items():
        end_duplicates(tracks, plate, rule, frame)
        end_lost(tracks, plate, rule, frame)
    happened = (*outcome.events, *tracks.events)
    tracks.history, refused = report_refusals(tracks.history, frame.index, happened, tracks.net.targets)
    tracks.events += refused
    work.charge("life", start)
    return evolve(tracks.outcome(outcome, frame), seconds=work.seconds)


def _is_looked(rule: LifeRules, compiled: CompiledPlate, has_looked: bool) -> bool:
    """True where targets of a plate that claim no detection in the frame are unseen: somebody looked."""
    return has_looked or rule.birth is None or bool(compiled.plate.inverses)
