"""The first half of the frame of rows with a Gaussian belief: all of a table are updated at once."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bayesnet_track.engine.frame_work import FrameWork
from bayesnet_track.engine.lifecycle.association import Given, image_of
from bayesnet_track.engine.rows.columns import GIVEN, GIVEN_NONE, Columns, Rows
from bayesnet_track.numerics.arrays import HYPOTHESES, Floats
from bayesnet_track.numerics.gaussian import ALONE


@dataclass(frozen=True, eq=False)
class FilteredGaussians:
    """Targets of a plate after they were predicted and weighed by the detections that they are given.

    Attributes:
        before: their rows before the frame.
        columns: what is known of them, but for the rules' memory and the status.
        numbers: (T, 8) what was measured, in the columns of `numerics.arrays`.
    """

    before: Rows
    columns: Columns
    numbers: Floats


def filter_gaussians(work: FrameWork, rows: Rows, given: Given) -> FilteredGaussians:
    """The rows of a table, updated by what each is given: the arrays of `given` are changed in place."""
    # Imported here: a graph is validated without compiling anything.
    from bayesnet_track.numerics.kernels.pair_kernels import measure_and_mix_rows
    from bayesnet_track.numerics.kernels.row_kernels import update_rows

    rule, started, frame = rows.rule, work.engine.clock(), work.frame
    mean, covariance, division = given.mean, given.covariance, given.division
    image = image_of(rule, frame.width, frame.height)
    if division is None:
        boxes = np.ascontiguousarray(given.own[:, :4])
        variances = rule.association.variances(boxes) * rule.temperature
        variances[~given.is_given] = 1.0
        numbers = update_rows(
            mean, covariance, boxes, given.is_given, variances, rule.floor, image, rule.counts, ALONE
        )
    else:
        starts = division.starts[: len(rows.ids) + 1]
        boxes = np.ascontiguousarray(given.boxes[division.columns[: starts[-1]]])
        numbers = measure_and_mix_rows(
            mean,
            covariance,
            starts,
            boxes,
            rule.association.variances(boxes) * rule.temperature,
            division.weights[: starts[-1]],
            division.missed[: len(rows.ids)],
            rule.floor,
            image,
            rule.counts,
            ALONE,
        )
    columns = rows.columns.changed(
        mean=mean,
        covariance=covariance,
        size=numbers[:, HYPOTHESES].astype(np.int64),
        own=given.own,
        given=np.where(given.is_given, GIVEN, GIVEN_NONE),
        existence=given.existence,
        observed=given.observed,
    )
    work.charge("belief", started)
    return FilteredGaussians(rows, columns, numbers)
