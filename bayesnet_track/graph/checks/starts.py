"""Checks of start priors: how a root's state is distributed when a target starts."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from bayesnet_track.graph.checks.plates import Check, Plate, moving_fields
from bayesnet_track.graph.checks.sensors import sensors_of
from bayesnet_track.graph.expressions.distributions import (
    distribution_of,
    is_proper,
    moments,
    parameters_of,
)
from bayesnet_track.graph.expressions.parse import parse
from bayesnet_track.graph.expressions.terms import ExpressionError, Term, names_in
from bayesnet_track.graph.settings.motion import Motion
from bayesnet_track.graph.spec import InferenceNode
from bayesnet_track.graph.text.messages import GraphMessage, KeyPath, nearest
from bayesnet_track.observation.protocols import BOX

SDS_OF_KINEMATICS = {
    "start_velocity_sd_px": ("vx", "vy"),
    "start_acceleration_sd_px": ("ax", "ay"),
}
"""Keys of a motion that say how fields start."""


def _roots(plate: Plate) -> Iterator[tuple[str, InferenceNode]]:
    return ((name, node) for name, node in plate.inference.items() if node.parent is None)


def starts_can_be_read(plate: Plate) -> Iterator[GraphMessage]:
    """`start` is of fields of the state, by expressions of the start box and constants."""
    for name, node in _roots(plate):
        fields = (*BOX, *(one for one in moving_fields(node) if one != "angle"))
        for field, text in node.start.items():
            key = ("start", field)
            if field not in fields:
                found = f"start of {field!r}, which is no field of the state"
                if field == "angle":
                    found = "start of angle, which is that of the first frame: 0"
                yield plate.message(name, found, fields, key=key, word=field, on_key=True)
            try:
                term = parse(str(text), (*BOX, "pi", *plate.constants), draws=True)
            except ExpressionError as error:
                message = plate.message(name, error.found, error.allowed, key=key)
                if error.word in fields:
                    message = replace(message, found=f"{error.word!r}, which is no part of the start box")
                elif error.word:
                    message = replace(message, nearest=nearest(error.word, error.near))
                yield plate.at.inside(message, error.at)
                continue
            yield from _exists(plate, name, node, (field, term))


def _exists(plate: Plate, name: str, node: InferenceNode, start: tuple[str, Term]) -> Iterator[GraphMessage]:
    """A distribution whose parameters are numbers exists; a Gaussian belief needs its variance."""
    field, term = start
    key: KeyPath = ("start", field)
    function = distribution_of(term)
    reads_box = any(one in BOX for one in names_in(term))
    box = dict(zip(BOX, (100.0, 100.0, 50.0, 50.0), strict=True)) if reads_box else {}
    with np.errstate(all="ignore"):
        parameters = parameters_of(term, {**plate.constants, **box}, 1)
        spread = moments(function, parameters)[1]
    proper = is_proper(function, parameters)[0]
    if not reads_box and not proper:
        found = (
            f"{function or 'a value'} that does not exist: {', '.join(f'{v:g}' for v in parameters[:, 0])}"
        )
        allowed = "sds, scales and degrees above 0, low below high" if function else "a finite number"
        yield plate.message(name, found, allowed, key=key)
    elif proper and not np.isfinite(spread[0]) and node.belief is not None and node.belief.gaussian:
        found = f"belief: gaussian, and {function} of {field} has no variance"
        yield plate.message(name, found, "more than 2 degrees, or belief: particles", key=key)


def starts_are_said_once(plate: Plate) -> Iterator[GraphMessage]:
    """A field has one start prior; those of modes stand at the root."""
    for name, node in _roots(plate):
        if node.motion is None:
            continue
        for field in node.start:
            for key in _other_priors(node.motion, field):
                found = f"start of {field} beside {'.'.join(map(str, key[2:]))}, which says it, too"
                yield plate.message(name, found, "either of them", key=("start", field), on_key=True)
        for mode, one in (node.modes or {}).items():
            if one.motion is None:
                continue
            for key in _start_keys(one.motion, BOX):
                found = f"{key[-1]} in a mode: a target starts in no certain mode"
                allowed = f"start: {{x: normal(x, 5)}} of {name}, or the same key in its motion"
                yield plate.message(name, found, allowed, key=("modes", mode, *key), on_key=True)


def _other_priors(motion: Motion, field: str) -> Iterator[KeyPath]:
    """Keys of a motion by which a field starts, that are written."""
    yield from _start_keys(motion, (field,))
    for word, fields in SDS_OF_KINEMATICS.items():
        if motion.expressions is None and field in fields and word in motion.settings.model_fields_set:
            yield ("motion", motion.kind, word)


def _start_keys(motion: Motion, fields: tuple[str, ...]) -> Iterator[KeyPath]:
    if motion.expressions is not None:
        for field in fields:
            own = motion.expressions.fields.get(field)
            if own is not None and (own.sd > 0 or own.start != 0):
                yield ("motion", "expressions", "fields", field)
        return
    for field in fields:
        if field in BOX and getattr(motion.settings.start_sd_px, field) > 0:
            yield ("motion", motion.kind, "start_sd_px")
            return


def starts_are_held(plate: Plate) -> Iterator[GraphMessage]:
    """A grid starts in one cell; a detection of quantities places its target by itself."""
    for name, node in _roots(plate):
        keys: dict[str, KeyPath] = {field: ("start", field) for field in node.start}
        if node.motion is not None:
            keys |= {field: key for field in BOX for key in _start_keys(node.motion, (field,))}
        if node.belief is not None and node.belief.grid is not None:
            for key in dict.fromkeys(keys.values()):
                found = "a start prior beside a grid, which starts in the cell of the start box"
                yield plate.message(name, found, "particles or gaussian", key=key, on_key=True)
        sensors = sensors_of(plate)
        for field in (one for one in BOX if one in keys and sensors):
            found = f"start of {field}, and targets start with detections of {next(iter(sensors))}"
            allowed = "start of other fields: the sensor's sd says how well a detection places a target"
            yield plate.message(name, found, allowed, key=keys[field], on_key=True)


def fields_of_the_box_start_in_it(plate: Plate) -> Iterator[GraphMessage]:
    """Of x, y, w, h in `fields` only an sd is written: they start around the start box."""
    for name, node in plate.inference.items():
        if node.motion is None or node.motion.expressions is None:
            continue
        fields = node.motion.expressions.fields
        for field in (one for one in BOX if one in fields):
            if fields[field].start != 0:
                found = f"start of {field}, which is that of the start box"
                allowed = f"an sd alone; or start: {{{field}: normal({field} + 10, 5)}} of {name}"
                key: KeyPath = ("motion", "expressions", "fields", field, "start")
                yield plate.message(name, found, allowed, key=key, on_key=True)
        if len(node.motion.expressions.own) > 8:
            found = f"{len(node.motion.expressions.own)} fields beside the box"
            key = ("motion", "expressions", "fields")
            yield plate.message(name, found, "at most 8", key=key, on_key=True)


START_CHECKS: tuple[Check, ...] = (
    starts_can_be_read,
    starts_are_said_once,
    starts_are_held,
    fields_of_the_box_start_in_it,
)
