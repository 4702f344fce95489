"""The references of the targets of a table move toward their estimates: each agent learns of all at once."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from bayesnet_track.engine.frame_work import FrameWork
from bayesnet_track.engine.rows.particle_table import ParticleTable
from bayesnet_track.engine.rows.shared_planes import planes_of_each
from bayesnet_track.inference.asking import follow
from bayesnet_track.inference.learn import frames_between, largest_rate, over_frames
from bayesnet_track.numerics.arrays import Floats
from bayesnet_track.observation.cue import FAULTS, Reference, context_of
from bayesnet_track.observation.likelihoods import ReferenceRows


def follow_rows(
    work: FrameWork, table: ParticleTable, boxes: Floats, rates: Sequence[float]
) -> tuple[Mapping[str, Sequence[Reference]], set[int]]:
    """Agent -> what it remembers of each target after learning in the boxes (T, 4); the rows where one fails.

    `rates` are T shares of each agent's largest rate.
    """
    failed: set[int] = set()
    after, plate = dict(table.references), table.compiled.plate
    rule = plate.inference(plate.root).learn
    every, ages = frames_between(rule, {}), [work.frame.since(one.started) for one in table.base]
    for agent, largest in table.compiled.rate_max.items():
        own = np.array(
            [
                over_frames(rate * largest_rate(rule, largest, age), every)
                for rate, age in zip(rates, ages, strict=True)
            ]
        )
        rows = np.flatnonzero(own > 0.0)
        if not len(rows):
            continue
        whole = len(rows) == len(rates)
        known, cue = table.remembered(agent, None if whole else rows), table.compiled.cues[agent]
        share = hasattr(cue, "follow_each")
        try:
            starts = np.arange(len(rows) + 1)
            planes = planes_of_each(work, cue.needs, boxes[rows], starts, context_of(cue), share)
        except FAULTS:  # whose is found out where each target learns by itself
            return after, set(range(len(rates)))
        found, faults = follow(cue, planes, boxes[rows], known, own[rows])
        for t, fault in faults.items():
            failed.add(int(rows[t]))
            work.note_fault(table.ids[rows[t]], "learning", agent, fault)
        after[agent] = found if whole else _replaced(table.references[agent], rows, found)
    return after, failed


def _replaced(
    known: Sequence[Reference], rows: NDArray[np.intp], found: Sequence[Reference]
) -> Sequence[Reference]:
    """What is known, with what was found in some rows."""
    if isinstance(known, ReferenceRows) and isinstance(found, ReferenceRows):
        together = known.replaced(rows, found)
        if together is not None:
            return together
    after = list(known)
    for row, reference in zip(rows.tolist(), found, strict=True):
        after[row] = reference
    return after
