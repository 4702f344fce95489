"""Targets end: duplicates of others, those that were lost for too long, and those that hardly exist."""

from __future__ import annotations

from bayesnet_track.adapt.duplicates import overlapping
from bayesnet_track.adapt.lifecycle import AppearanceMemory
from bayesnet_track.engine.lifecycle.track_table import LiveTable
from bayesnet_track.graph.settings.lifecycle import LifeRules
from bayesnet_track.journal.events.endings import DuplicateEnded, TargetDied
from bayesnet_track.numerics.records import changed
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
    tracks.history = changed(tracks.history, overlaps={**others, **left})


def end_lost(tracks: LiveTable, plate: str, rule: LifeRules, frame: Frame) -> None:
    """Nets of targets that were lost for too long end; what they knew is kept for a while."""
    for target, why in [] if rule.death is None else tracks.ending(plate, rule.death):
        if rule.reidentify is not None:
            tracks.history = changed(
                tracks.history, dead=(*tracks.history.dead, remember(tracks, target, plate))
            )
        tracks.end(TargetDied(frame.index, target, *why, remembered=rule.reidentify is not None))
    _end_vanishing(tracks, plate, rule, frame)
    if rule.reidentify is not None and rule.birth is not None:
        own = [one for one in tracks.history.dead if one.template == plate]
        kept = [one for one in own if frame.time - one.time <= rule.reidentify.frames]
        gone = {one.target for one in own} - {
            one.target for one in kept[-REMEMBERED * rule.birth.max_targets :]
        }
        if gone:
            left = tuple(one for one in tracks.history.dead if one.target not in gone)
            tracks.history = changed(tracks.history, dead=left)
    # A target that returns starts its overlaps anew.
    before, live = tracks.history.overlaps, tracks.net.targets.keys()
    overlaps = {pair: streak for pair, streak in before.items() if live >= {*pair}}
    if len(overlaps) < len(before):
        tracks.history = changed(tracks.history, overlaps=overlaps)


def _end_vanishing(tracks: LiveTable, plate: str, rule: LifeRules, frame: Frame) -> None:
    """Nets of targets that hardly exist end."""
    if rule.existence is None:
        return
    for target, value in tracks.vanishing(plate, rule.existence.end):
        if rule.reidentify is not None:
            remembered = remember(tracks, target, plate)
            tracks.history = changed(tracks.history, dead=(*tracks.history.dead, remembered))
        unseen = tracks.record(target).unseen_frames
        tracks.end(
            TargetDied(
                frame.index,
                target,
                "existence",
                unseen,
                0,
                rule.reidentify is not None,
                value,
                rule.existence.end,
            )
        )


def remember(tracks: LiveTable, target: str, plate: str) -> AppearanceMemory:
    """What a live target would be remembered by."""
    record = tracks.record(target)
    references = tracks.state(target).references
    return AppearanceMemory(target, plate, record.mean, record.covariance, record.time, references)
