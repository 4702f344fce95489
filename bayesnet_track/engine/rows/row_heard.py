"""Answers of the agents about the targets of a table: each made when it is asked for."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np

from bayesnet_track.belief.contract import BOX_FIELDS
from bayesnet_track.engine.metrics import Heard
from bayesnet_track.engine.rows.columns import GIVEN, Rows
from bayesnet_track.observation.cue import Measurement


class RowHeard(Mapping[str, Heard]):
    """Target -> what its agent measured: its own detection, unless several targets share it."""

    def __init__(self, rows: Rows) -> None:
        self._rows = rows

    def __getitem__(self, target: str) -> Heard:
        row, rule, now = self._rows.index[target], self._rows.rule, self._rows.columns
        is_shared = rule.crowd is not None and rule.crowd.is_marginal
        if is_shared or now.given[row] != GIVEN:
            return Heard()
        box = now.own[row, :4]
        noise = np.diag(rule.association.variances(box) * rule.temperature)
        return Heard(measured={rule.agent: Measurement(BOX_FIELDS, box, noise)})

    def __iter__(self) -> Iterator[str]:
        return iter(self._rows.ids)

    def __len__(self) -> int:
        return len(self._rows.ids)
