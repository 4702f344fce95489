"""Checks of a motion by expressions: its fields, the names that are known, the beliefs that can hold it."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace

from bayesnet_track.graph.checks.joins import GraphCheck
from bayesnet_track.graph.checks.plates import Check, Plate
from bayesnet_track.graph.expressions.parse import parse
from bayesnet_track.graph.expressions.terms import ExpressionError, Term, names_in
from bayesnet_track.graph.expressions.vocabulary import FRAME_NAMES, WORDS
from bayesnet_track.graph.settings.motion import ByExpressions
from bayesnet_track.graph.spec import GraphSpec, InferenceNode
from bayesnet_track.graph.text.messages import GraphMessage, Path, Positions, nearest
from bayesnet_track.observation.protocols import BOX

MAY_BE_FIELDS = ("vx", "vy", "ax", "ay", "angle")
VELOCITIES = ("vx", "vy", "ax", "ay")
KEY: Path = ("motion", "expressions")


def fields_have_their_own_names(plate: Plate) -> Iterator[GraphMessage]:
    """Fields of a motion by expressions have names of their own."""
    for node, motion in _formulas(plate):
        for name in motion.fields:
            here = (*KEY, "fields", name)
            if (name in WORDS and name not in MAY_BE_FIELDS) or name == "carried":
                found, allowed = f"field {name!r}, which is a word of the language", "another name"
                yield plate.message(node, found, allowed, key=here, on_key=True)
            elif name in plate.constants:
                yield plate.message(
                    node, f"field {name!r}, which is a constant", "another name", key=here, on_key=True
                )


def formulas_can_be_read(plate: Plate) -> Iterator[GraphMessage]:
    """A motion's expressions are of its fields, the frame, `dt` and constants."""
    for node, motion in _formulas(plate):
        fields = (*BOX, *motion.fields)
        names = (*fields, *FRAME_NAMES, *plate.constants)
        for what, formulas in _parts(motion):
            for name, text in formulas.items():
                here = (*KEY, what, name)
                if name not in fields:
                    found = f"{what} of {name!r}, which is no field of the state"
                    yield plate.message(node, found, fields, key=here, word=name, on_key=True)
                try:
                    parse(str(text), names)
                except ExpressionError as error:
                    message = plate.message(node, error.found, error.allowed, key=here)
                    if error.word:
                        message = replace(message, nearest=nearest(error.word, error.near))
                    yield plate.at.inside(message, error.at)
        strange = [one for one in motion.fields if one not in VELOCITIES]
        if motion.borders is not None and strange:
            found = f"borders: reflect beside field {strange[0]!r}, which it cannot turn round"
            allowed = f"fields {', '.join(VELOCITIES)}, or no borders"
            yield plate.message(node, found, allowed, key=(*KEY, "borders"), on_key=True)


def beliefs_hold_the_formulas(plate: Plate) -> Iterator[GraphMessage]:
    """Of expressions a grid takes noise that is the same everywhere, and `kalman` none."""
    for node, motion in _formulas(plate):
        belief = plate.inference[node].belief
        if belief is None:
            continue
        if belief.gaussian is not None and belief.gaussian.filter == "kalman":
            found = "expressions beside filter: kalman, which is of linear motion"
            yield plate.message(node, found, "filter: extended or unscented", key=KEY, on_key=True)
        if belief.grid is not None:
            yield from _fits_grid(plate, node, motion)


def _fits_grid(plate: Plate, node: str, motion: ByExpressions) -> Iterator[GraphMessage]:
    if tuple(motion.fields) not in ((), ("vx", "vy")):
        found = f"a grid has no cells for {', '.join(motion.fields)}"
        yield plate.message(node, found, "fields vx, vy, in this order, or none", key=(*KEY, "fields"))
    for name, own in motion.fields.items():
        if own.start != 0:
            here = (*KEY, "fields", name, "start")
            yield plate.message(
                node, f"start of {name} on a grid, whose velocities start around 0", "0", key=here
            )
    for what, formulas in _parts(motion):
        for name, text in formulas.items():
            here = (*KEY, what, name)
            if name in ("w", "h"):
                found = f"{what} of {name}, and the sizes of a grid's cells do not move by expressions"
                yield plate.message(node, found, "x, y, vx, vy", key=here, on_key=True)
            elif what == "sd" and (read := _reads(str(text), (*BOX, *motion.fields))):
                found = f"sd that depends on {read}; on a grid the noise is the same everywhere"
                yield plate.message(node, found, "numbers, constants, dt, the frame's size", key=here)


def attached_motions_are_kinematic(spec: GraphSpec, at: Positions) -> Iterator[GraphMessage]:
    """What may be carried has no motion by expressions: being carried sets its velocity."""
    for number, join in enumerate(spec.joins):
        kind = (join.between or ("",))[-1]
        if join.attachment is None or kind not in spec.targets:
            continue
        for node in spec.targets[kind].nodes.values():
            if isinstance(node, InferenceNode) and node.motion is not None and node.motion.expressions:
                found = f"attachment of {kind}, whose motion is by expressions"
                yield at.message(("joins", number, "attachment"), found, "another motion", on_key=True)


def factors_of_pairs_can_be_read(spec: GraphSpec, at: Positions) -> Iterator[GraphMessage]:
    """A join's factor is an expression of the states of the two kinds, and shares no pixels."""
    for number, join in enumerate(spec.joins):
        path: Path = ("joins", number, "factor")
        if join.factor is None:
            if join.when.overlap == 0:
                found = "overlap 0, which joins all targets, without a factor"
                yield at.message(("joins", number, "when", "overlap"), found, "a number above 0")
            continue
        for other in ("exclusion", "occlusion", "attachment"):
            if getattr(join, other) is not None:
                yield at.message(path, f"factor beside {other}", "either of them", on_key=True)
        if join.between is None:
            yield at.message(path, "factor without between", "between: [a, b]", on_key=True)
            continue
        kinds = (join.between[0], join.between[-1])
        if any(kind not in spec.targets for kind in kinds):
            continue
        states = [
            f"{letter}.{name}"
            for letter, kind in zip("ab", kinds, strict=True)
            for name in (*BOX, *_fields_of(spec, kind))
        ]
        names = (*states, *(name for name in FRAME_NAMES if name != "dt"), *spec.constants)
        try:
            parse(join.factor, names)
        except ExpressionError as error:
            message = at.message(path, error.found, error.allowed)
            near = nearest(error.word, error.near) if error.word else ""
            yield at.inside(replace(message, nearest=near), error.at)


def _fields_of(spec: GraphSpec, kind: str) -> tuple[str, ...]:
    """Fields of the state of a kind of target, beside the box."""
    nodes = spec.targets[kind].nodes.values()
    root = next((one for one in nodes if isinstance(one, InferenceNode) and one.parent is None), None)
    if root is None or root.motion is None:
        return ()
    if root.motion.expressions is not None:
        return tuple(root.motion.expressions.fields)
    order = {"random_walk": 0, "constant_acceleration": 4}.get(root.motion.kind, 2)
    return (*VELOCITIES[:order], *(("angle",) if root.motion.settings.sd_angle_deg > 0 else ()))


def drift_of(motion: ByExpressions) -> Mapping[str, Term]:
    """Field -> the expression of its value after a step, of a motion that was checked."""
    return {name: parse(str(text)) for name, text in motion.drift.items()}


def sds_of(motion: ByExpressions) -> Mapping[str, Term]:
    """Field -> the expression of its noise."""
    return {name: parse(str(text)) for name, text in motion.sd.items()}


def _formulas(plate: Plate) -> Iterator[tuple[str, ByExpressions]]:
    for name, node in plate.inference.items():
        if node.motion is not None and node.motion.expressions is not None:
            yield name, node.motion.expressions


def _parts(motion: ByExpressions) -> tuple[tuple[str, Mapping[str, float | str]], ...]:
    return (("drift", motion.drift), ("sd", motion.sd))


def _reads(text: str, fields: tuple[str, ...]) -> str:
    """The first of the fields that an expression reads; empty when none, or when it cannot be read."""
    try:
        return next((name for name in names_in(parse(text)) if name in fields), "")
    except ExpressionError:
        return ""


FORMULA_CHECKS: tuple[Check, ...] = (
    fields_have_their_own_names,
    formulas_can_be_read,
    beliefs_hold_the_formulas,
)
FORMULA_JOIN_CHECKS: tuple[GraphCheck, ...] = (
    attached_motions_are_kinematic,
    factors_of_pairs_can_be_read,
)
