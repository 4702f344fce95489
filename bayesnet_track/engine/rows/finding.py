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
    targets, records = Targets.of(state.targets), state.history.records
    if state.previous is None:
        return targets, records
    nets = work.net.targets
    odd = {*work.by_hand, *(target for target, _, _ in work.availability.known)}
    is_plain = targets.gaussians and not (odd or targets.others or targets.particles)
    if is_plain and all(rows.checked is nets for rows in targets.gaussians):
        return targets, records
    tables: dict[str, Rows] = {}
    removed: dict[str, TargetState] = {}
    for rows in targets.gaussians:
        fitting = rows if rows.checked is nets and not odd else _kept(rows, nets, odd)
        if fitting is not rows:
            removed.update((target, targets[target]) for target in rows.ids if target not in fitting.index)
        if fitting.ids:
            tables[rows.rule.plate] = fitting
    singles = {**targets.others, **removed} if removed else targets.others
    if singles:
        counted = {target: records[target] for target in singles if target in records}
        able = {target: state for target, state in singles.items() if target not in odd}
        for plate, rows in rows_of(work.engine, nets, able, counted, state.previous.time).items():
            tables[plate] = tables[plate].extended(rows) if plate in tables else rows
    gaussians = [rows if rows.checked is nets else rows.changed(checked=nets) for rows in tables.values()]
    if not singles:
        return Targets(gaussians, targets.particles, {}, targets.order), Records(gaussians, {})
    placed = {target for rows in gaussians for target in rows.ids}
    singles = {target: target_state for target, target_state in singles.items() if target not in placed}
    order = [target for target in targets if target not in placed]
    single_records = {
        target: target_state for target, target_state in counted.items() if target not in placed
    }
    return Targets(gaussians, targets.particles, singles, order), Records(gaussians, single_records)


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
    tables = {}
    for plate, members in fit.items():
        rule = row_rule(engine, plate)
        assert rule is not None
        tables[plate] = make_rows(
            rule, members, records, [nets[target].status == "lost" for target in members], time
        )
    return tables
