"""The references of the targets of a table move toward their estimates: each agent learns of all at once."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from bayesnet_track.engine.frame_work import FrameWork
from bayesnet_track.engine.learning import follow_some
from bayesnet_track.engine.rows.particle_table import ParticleTable
from bayesnet_track.inference.learn import frames_between, largest_rate, over_frames
from bayesnet_track.numerics.arrays import Floats
from bayesnet_track.observation.cue import Reference
from bayesnet_track.observation.reference_rows import ReferenceRows


def follow_rows(
    work: FrameWork, table: ParticleTable, boxes: Floats, rates: Sequence[float]
) -> Mapping[str, Sequence[Reference]] | None:
    """Agent -> what it remembers of each target after learning in the boxes (T, 4); None where one fails.

    `rates` are T shares of each agent's largest rate.
    """
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
        known = table.shown(agent, None if whole else rows)
        found = follow_some(work, table.compiled.cues[agent], known, boxes[rows], own[rows])
        if found is None:
            return None
        after[agent] = found if whole else _replaced(table.references[agent], rows, found)
    return after


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
