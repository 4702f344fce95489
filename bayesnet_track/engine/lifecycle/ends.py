"""Targets end: duplicates of others, those that were lost for too long, and those that hardly exist."""

from __future__ import annotations

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
    held, before = tracks.held(plate), tracks.history.overlaps
    own = set(tracks.of_plate(plate)) if before else set()
    others = {pair: streak for pair, streak in before.items() if not own.intersection(pair)}
    streaks = overlapping(held, *tracks.beliefs(held), before, rule.merge_duplicates)
    if not streaks and not before:
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
    left = {pair: streak for pair, streak in streaks.items() if not ended.intersection(pair)}
    tracks.history = evolve(tracks.history, overlaps={**others, **left})


def end_lost(tracks: LiveTable, plate: str, rule: LifeRules, frame: Frame) -> None:
    """Nets of targets that were lost for too long, or hardly exist, end; what they knew is kept a while."""
    least = None if rule.existence is None else rule.existence.end
    vanishing = (
        {} if least is None else {**dict(tracks.vanishing(plate, least)), **_outside(tracks, plate, least)}
    )
    causes = {} if rule.death is None else dict(tracks.ending(plate, rule.death))
    for target in (*causes, *(one for one in vanishing if one not in causes)):
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
                end=None if existence is None else least,
                unseen_frames=unseen if is_too_long else 0,
            ),
        )
    _forget(tracks, plate, rule, frame)


def _outside(tracks: LiveTable, plate: str, least: float) -> dict[str, float]:
    """Targets that exist in the area of a plate with less probability than `least`, and which."""
    views = tracks.engine.plates[plate].views
    if views is None or views.area is None:
        return {}
    found: dict[str, float] = {}
    for target in tracks.of_plate(plate):
        state = tracks.state(target)
        share = views.share_in_area(*moments_of(state.belief)) * (state.existence or 1.0)
        if share < least:
            found[target] = share
    return found


def _end(tracks: LiveTable, plate: str, died: TargetDied) -> None:
    """A net ends, and is remembered where the graph says so."""
    if died.remembered:
        remembered = remember(tracks, died.target, plate)
        tracks.history = evolve(tracks.history, dead=(*tracks.history.dead, remembered))
    tracks.end(died)


def _forget(tracks: LiveTable, plate: str, rule: LifeRules, frame: Frame) -> None:
    """Targets that ended long ago or are too many are forgotten, and overlaps of all that ended."""
    if rule.reidentify is not None and rule.birth is not None:
        own = [one for one in tracks.history.dead if one.template == plate]
        kept = [one for one in own if frame.time - one.time <= rule.reidentify.frames]
        gone = {one.target for one in own} - {
            one.target for one in kept[-REMEMBERED * rule.birth.max_targets :]
        }
        if gone:
            left = tuple(one for one in tracks.history.dead if one.target not in gone)
            tracks.history = evolve(tracks.history, dead=left)
    # A target that returns starts its overlaps anew.
    before, live = tracks.history.overlaps, tracks.net.targets.keys()
    overlaps = {pair: streak for pair, streak in before.items() if live >= {*pair}}
    if len(overlaps) < len(before):
        tracks.history = evolve(tracks.history, overlaps=overlaps)
    births = tracks.history.births
    if len(births) > len(live):
        kept_births = {target: birth for target, birth in births.items() if target in live}
        tracks.history = evolve(tracks.history, births=kept_births)


def remember(tracks: LiveTable, target: str, plate: str) -> AppearanceMemory:
    """What a live target would be remembered by."""
    record, birth = tracks.record(target), tracks.history.births[target]
    memory = record.mean, record.covariance, record.time, tracks.references(target)
    return AppearanceMemory(target, plate, *memory, birth, tracks.kinds(target, plate))
