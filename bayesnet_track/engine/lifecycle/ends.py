"""Targets end: duplicates of others, those that were lost for too long, and those that hardly exist."""

from __future__ import annotations

import numpy as np

from bayesnet_track.adapt.lifecycle import AppearanceMemory, overlapping
from bayesnet_track.belief.motion.modes import moments_of
from bayesnet_track.engine.lifecycle.track_table import LiveTable
from bayesnet_track.graph.settings.lifecycle import LifeRules
from bayesnet_track.journal.events.lives import DuplicateEnded, TargetDied
from bayesnet_track.numerics.records import evolve
from bayesnet_track.observation.planes import Frame

REMEMBERED = 4
"""Dead targets that are remembered, in multiples of `birth.max_targets`."""


def end_duplicates(tracks: LiveTable, plate: str, rule: LifeRules, frame: Frame) -> None:
    """The younger of two nets whose beliefs hold one object ends; joined ones are known to be two."""
    if rule.merge_duplicates is None:
        return
    live, previous = tracks.held(plate), tracks.history.overlaps
    of_plate = set(tracks.of_plate(plate)) if previous else set()
    elsewhere = {pair: streak for pair, streak in previous.items() if not of_plate.intersection(pair)}
    streaks = overlapping(live, *tracks.beliefs(live), previous, rule.merge_duplicates)
    if not streaks and not previous:
        return
    joined = {frozenset(pair) for pair in tracks.net.joins}
    streaks = {pair: streak for pair, streak in streaks.items() if frozenset(pair) not in joined}
    ended: set[str] = set()
    for (younger, older), streak in list(streaks.items()):
        if not ended.intersection((younger, older)) and len(streak) >= rule.merge_duplicates.frames:
            tracks.end(
                DuplicateEnded(
                    frame.index,
                    younger,
                    older,
                    min(streak),
                    rule.merge_duplicates.overlap,
                    rule.merge_duplicates.frames,
                )
            )
            ended.add(younger)
    remaining = {pair: streak for pair, streak in streaks.items() if not ended.intersection(pair)}
    tracks.history = evolve(tracks.history, overlaps={**elsewhere, **remaining})


def end_lost(tracks: LiveTable, plate: str, rule: LifeRules, frame: Frame) -> None:
    """Nets of targets that were lost for too long, or hardly exist, end; what they knew is kept a while."""
    limit = None if rule.existence is None else rule.existence.end
    vanishing = (
        {} if limit is None else {**dict(tracks.vanishing(plate, limit)), **_outside(tracks, plate, limit)}
    )
    causes = {} if rule.death is None else dict(tracks.ending(plate, rule.death))
    for target in (*causes, *(name for name in vanishing if name not in causes)):
        unseen = tracks.record(target).unseen_frames
        why = causes.get(target, ("existence", unseen, 0))
        enough = None if rule.death is None else rule.death.unseen_frames
        is_too_long = why[0] == "lost" and enough is not None and unseen >= enough
        existence = vanishing.get(target)
        _end(
            tracks,
            plate,
            TargetDied(
                frame.index,
                target,
                *why,
                remembered=rule.reidentify is not None,
                existence=existence,
                end=None if existence is None else limit,
                unseen_frames=unseen if is_too_long else 0,
            ),
        )
    _forget(tracks, plate, rule, frame)


def _outside(tracks: LiveTable, plate: str, limit: float) -> dict[str, float]:
    """Targets that exist in the area of a plate with less probability than `limit`, and which."""
    views = tracks.engine.plates[plate].views
    if views is None or views.area is None:
        return {}
    states = {target: tracks.state(target) for target in tracks.of_plate(plate)}
    if not states:
        return {}
    means, covariances = zip(*(moments_of(state.belief) for state in states.values()), strict=True)
    shares = views.shares_in_area(np.array(means), np.array(covariances)).tolist()
    return {
        target: existence
        for (target, state), share in zip(states.items(), shares, strict=True)
        if (existence := share * (state.existence or 1.0)) < limit
    }


def _end(tracks: LiveTable, plate: str, died: TargetDied) -> None:
    """A net ends, and is remembered where the graph says so."""
    if died.remembered:
        remembered = memory_of(tracks, died.target, plate)
        tracks.history = evolve(tracks.history, dead=(*tracks.history.dead, remembered))
    tracks.end(died)


def _forget(tracks: LiveTable, plate: str, rule: LifeRules, frame: Frame) -> None:
    """Targets that ended long ago or are too many are forgotten, and overlaps of all that ended."""
    if rule.reidentify is not None and rule.birth is not None:
        dead = [entry for entry in tracks.history.dead if entry.template == plate]
        recent = [entry for entry in dead if frame.time - entry.time <= rule.reidentify.frames]
        gone = {entry.target for entry in dead} - {
            entry.target for entry in recent[-REMEMBERED * rule.birth.max_targets :]
        }
        if gone:
            remaining = tuple(entry for entry in tracks.history.dead if entry.target not in gone)
            tracks.history = evolve(tracks.history, dead=remaining)
    # A target that returns starts its overlaps anew.
    previous, live = tracks.history.overlaps, tracks.net.targets.keys()
    overlaps = {pair: streak for pair, streak in previous.items() if live >= {*pair}}
    if len(overlaps) < len(previous):
        tracks.history = evolve(tracks.history, overlaps=overlaps)
    births = tracks.history.births
    if len(births) > len(live):
        kept_births = {target: birth for target, birth in births.items() if target in live}
        tracks.history = evolve(tracks.history, births=kept_births)


def memory_of(tracks: LiveTable, target: str, plate: str) -> AppearanceMemory:
    """Memory by which a live target would be recognised."""
    record, birth = tracks.record(target), tracks.history.births[target]
    memory = record.mean, record.covariance, record.time, tracks.references(target)
    return AppearanceMemory(target, plate, *memory, birth, tracks.kinds(target, plate))
