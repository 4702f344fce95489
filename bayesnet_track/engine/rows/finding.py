"""Whether a frame's targets go as rows: the one place where that is decided."""

from __future__ import annotations

from bayesnet_track.engine.frame_work import FrameWork
from bayesnet_track.engine.outcome import State
from bayesnet_track.engine.rows.columns import RowRecords, Rows, RowStates, make_rows
from bayesnet_track.engine.rows.fitting import nets_fit, row_rule, states_fit


def find_rows(work: FrameWork, state: State) -> Rows | None:
    """The live targets as rows of a table, or None where some of them have to go one by one in this frame.

    They do where nothing came from outside, all are of one plate that fits, and nothing was decided about any
    that a row has no place for.
    """
    nets, before = work.net.targets, state.targets
    if not before or work.by_hand or work.availability.known or state.net.joins:
        return None
    if isinstance(before, RowStates):
        records = state.history.records
        if not isinstance(records, RowRecords) or records.rows is not before.rows:
            return None
        rows = before.rows
        if rows.checked is nets:
            return rows
        fits = nets_fit(rows.rule, (nets[target] for target in rows.ids))
        return rows.with_nets(nets) if fits else None
    plates = {nets[target].template for target in before}
    rule = row_rule(work.engine, plates.pop()) if len(plates) == 1 else None
    if rule is None or state.previous is None or not nets_fit(rule, (nets[target] for target in before)):
        return None
    if not states_fit(rule, before, state.previous.time):
        return None
    lost = [nets[target].status == "lost" for target in before]
    rows = make_rows(rule, before, state.history.records, lost, state.previous.time)
    return rows.with_nets(nets)
