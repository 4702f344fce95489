"""Live targets as rows of the tables that they fit; the others stay an object each."""

from __future__ import annotations

from collections.abc import Collection, Mapping

import numpy as np

from bayesnet_track.adapt.lifecycle import TrackRecord
from bayesnet_track.engine.compiled import Engine
from bayesnet_track.engine.frame_context import FrameContext
from bayesnet_track.engine.outcome import State
from bayesnet_track.engine.rows.columns import Rows, make_rows
from bayesnet_track.engine.rows.fitting import net_fits, row_rule, state_fits
from bayesnet_track.engine.state import TargetState
from bayesnet_track.engine.targets import Records, Targets
from bayesnet_track.journal.target_net import TargetNet


def arrange(work: FrameContext, state: State) -> tuple[Targets, Mapping[str, TrackRecord]]:
    """The live targets and their records, those that fit as rows of their plate's table.

    A target that a person switches, that an agent gives no answer for, or about which more than its status
    was decided, is an object for as long as that lasts.
    """
    before, records = Targets.of(state.targets), state.history.records
    if state.previous is None:
        return before, records
    nets = work.net.targets
    odd = {*work.by_hand, *(target for target, _, _ in work.availability.known)}
    is_plain = before.gaussians and not (odd or before.others or before.particles)
    if is_plain and all(rows.checked is nets for rows in before.gaussians):
        return before, records
    tables: dict[str, Rows] = {}
    left: dict[str, TargetState] = {}
    for rows in before.gaussians:
        kept = rows if rows.checked is nets and not odd else _kept(rows, nets, odd)
        if kept is not rows:
            left.update((one, before[one]) for one in rows.ids if one not in kept.index)
        if kept.ids:
            tables[rows.rule.plate] = kept
    others = {**before.others, **left} if left else before.others
    if others:
        known = {target: records[target] for target in others if target in records}
        able = {target: one for target, one in others.items() if target not in odd}
        for plate, rows in rows_of(work.engine, nets, able, known, state.previous.time).items():
            tables[plate] = tables[plate].extended(rows) if plate in tables else rows
    gaussians = [rows if rows.checked is nets else rows.changed(checked=nets) for rows in tables.values()]
    if not others:
        return Targets(gaussians, before.particles, {}, before.order), Records(gaussians, {})
    placed = {target for rows in gaussians for target in rows.ids}
    others = {target: one for target, one in others.items() if target not in placed}
    order = [target for target in before if target not in placed]
    apart = {target: one for target, one in known.items() if target not in placed}
    return Targets(gaussians, before.particles, others, order), Records(gaussians, apart)


def _kept(rows: Rows, nets: Mapping[str, TargetNet], odd: Collection[str]) -> Rows:
    """The rows that still fit."""
    keep = [target not in odd and net_fits(rows.rule, nets[target]) for target in rows.ids]
    return rows.changed(checked=nets) if all(keep) else rows.take(np.array(keep, dtype=np.bool_))


def rows_of(
    engine: Engine,
    nets: Mapping[str, TargetNet],
    states: Mapping[str, TargetState],
    records: Mapping[str, TrackRecord],
    time: float,
) -> dict[str, Rows]:
    """Plate -> the rows of those of the states, of that time, that fit."""
    fit: dict[str, dict[str, TargetState]] = {}
    for target, state in states.items():
        net = nets[target]
        rule = row_rule(engine, net.template)
        if rule is not None and net_fits(rule, net) and state_fits(rule, state, time):
            fit.setdefault(net.template, {})[target] = state
    found = {}
    for plate, several in fit.items():
        rule = row_rule(engine, plate)
        assert rule is not None
        found[plate] = make_rows(
            rule, several, records, [nets[one].status == "lost" for one in several], time
        )
    return found
