"""Measurements of quantities that are functions of the state: h(x) by the graph's expressions."""

from __future__ import annotations

from collections.abc import Mapping, MutableMapping, Sequence
from dataclasses import replace

import numpy as np

from bayesnet_track.belief.motion.formulas import Undefined
from bayesnet_track.graph.checked import MeasuredAs
from bayesnet_track.graph.expressions.evaluate import values_of
from bayesnet_track.graph.expressions.periods import period_of
from bayesnet_track.graph.expressions.terms import Variable
from bayesnet_track.numerics.arrays import Floats
from bayesnet_track.observation.cue import Hypotheses, Measurement
from bayesnet_track.observation.planes import FramePair
from bayesnet_track.observation.protocols import BOX, Seen


def read_as(measured: Measurement, functions: MeasuredAs, frames: FramePair) -> Measurement:
    """The measurement with h: what its quantities would be of states in these frames."""
    seen = seen_by(measured.fields, functions, frames)
    choices = tuple((weight, replace(one, seen=seen)) for weight, one in measured.choices)
    return replace(measured, seen=seen, choices=choices)


def seen_by(quantities: Sequence[str], functions: MeasuredAs, frames: FramePair) -> Seen:
    """h: what quantities would be of states in these frames."""
    frame, before = frames.current, frames.previous
    fixed = {
        "frame_width": float(frame.width),
        "frame_height": float(frame.height),
        "dt": 1.0 if before is None else frame.time - before.time,
        **functions.constants,
    }
    terms = [functions.terms.get(name, Variable(name)) for name in quantities]

    def values(states: Mapping[str, Floats]) -> Floats:
        names = {**states, **fixed}
        size = len(next(iter(states.values())))
        return np.stack([np.broadcast_to(values_of(term, names), (size,)) for term in terms], axis=1)

    return Seen(values, np.array([period_of(term, functions.constants) for term in terms]))


def note_undefined(
    agent: str, measured: Measurement, hypotheses: Hypotheses, found: MutableMapping[str, Undefined]
) -> None:
    """Write down of which quantities hypotheses have no value."""
    if measured.seen is None:
        return
    states = {**{name: hypotheses.boxes[:, k] for k, name in enumerate(BOX)}, **hypotheses.fields}
    unknown = (~np.isfinite(measured.seen.function(states))).sum(axis=0)
    for name, count in zip(measured.fields, unknown.tolist(), strict=True):
        if count:
            found.setdefault(f"measures {agent}.{name}", Undefined(count, len(hypotheses)))
