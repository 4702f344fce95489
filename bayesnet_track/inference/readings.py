"""Measurements of quantities that are functions of the state: h(x) by the graph's expressions."""

from __future__ import annotations

from collections.abc import Mapping, MutableMapping
from dataclasses import replace

import numpy as np

from bayesnet_track.belief.motion.formulas import Undefined
from bayesnet_track.graph.checked import MeasuredAs
from bayesnet_track.graph.expressions.evaluate import values_of
from bayesnet_track.graph.expressions.terms import Call, Variable
from bayesnet_track.numerics.arrays import Floats
from bayesnet_track.observation.cue import Hypotheses, Measurement
from bayesnet_track.observation.planes import FramePair
from bayesnet_track.observation.protocols import BOX, Seen


def read_as(measured: Measurement, functions: MeasuredAs, frames: FramePair) -> Measurement:
    """The measurement with h: what its quantities would be of states in these frames."""
    frame, before = frames.current, frames.previous
    fixed = {
        "frame_width": float(frame.width),
        "frame_height": float(frame.height),
        "dt": 1.0 if before is None else frame.time - before.time,
        **functions.constants,
    }
    terms = [functions.terms.get(name, Variable(name)) for name in measured.fields]

    def seen(states: Mapping[str, Floats]) -> Floats:
        names = {**states, **fixed}
        size = len(states["x"])
        return np.stack([np.broadcast_to(values_of(term, names), (size,)) for term in terms], axis=1)

    circular = np.array([isinstance(term, Call) and term.function == "atan2" for term in terms])
    choices = tuple((weight, read_as(one, functions, frames)) for weight, one in measured.choices)
    return replace(measured, seen=Seen(seen, circular), choices=choices)


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
