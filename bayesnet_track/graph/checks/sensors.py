"""Checks of sensors whose detections are quantities, of how targets start with them, and of point states."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from pydantic import ValidationError

from bayesnet_track.graph.checked import ANCHORED, Anchor, Inverse
from bayesnet_track.graph.checks.cues import cue_parameters
from bayesnet_track.graph.checks.factors import latent_above, names_at
from bayesnet_track.graph.checks.plates import Check, Plate
from bayesnet_track.graph.expressions.distributions import period_of
from bayesnet_track.graph.expressions.evaluate import values_of
from bayesnet_track.graph.expressions.parse import parse, parse_value
from bayesnet_track.graph.expressions.terms import FRAME_NAMES, ExpressionError, Term, Variable, names_in
from bayesnet_track.graph.settings.cameras import WorldState
from bayesnet_track.graph.spec import AgentNode
from bayesnet_track.graph.text.messages import GraphMessage, nearest
from bayesnet_track.numerics.arrays import Floats
from bayesnet_track.numerics.lenses import Less, shorter_way, solutions
from bayesnet_track.observation.detector import GIVEN
from bayesnet_track.observation.protocols import BOX

PLACES = 3
"""Places that a message names where several have the same values."""


def sensors_of(plate: Plate) -> dict[str, Any]:
    """The agents of a plate that are given detections of quantities -> their typed parameters."""
    sensors = {}
    for name, node in plate.agents.items():
        declaration = plate.cues.get(node.agent.cue)
        if declaration is None or not declaration.reads_detection or declaration.gives is None:
            continue
        try:
            parameters = cue_parameters(node.agent, declaration)
        except ValidationError:
            continue  # said where parameters are checked
        if declaration.gives(parameters):
            sensors[name] = parameters
    return sensors


def sensors_share_detections(plate: Plate) -> Iterator[GraphMessage]:
    """Detections of quantities are weighed by `existence`, at the root, and not beside those of boxes."""
    sensors, birth = sensors_of(plate), plate.spec.birth
    for name, parameters in sensors.items():
        if plate.spec.existence is None:
            fault = "detections of quantities without existence, which says what a false one is"
            yield plate.message(
                name, fault, f"existence: {{}} in targets.{plate.name}", key=("agent",), on_key=True
            )
        if not parameters.within:
            first = next(iter(parameters.sd))
            fault = "detections of quantities without within, which says how dense false ones are"
            remedy = f"within: {{{first}: [least, largest], ...}}"
            yield plate.message(name, fault, remedy, key=("agent",), on_key=True)
        parent = plate.agents[name].parent
        if parent not in plate.roots or latent_above(plate, parent) is not None:
            fault = f"detections of quantities at {parent}, which is not the root"
            yield plate.message(name, fault, f"parent: {plate.roots[0]}", key=("parent",))
    if not sensors:
        return
    for name, above_all in plate.inference.items():
        for key in ("modes", "category"):
            if getattr(above_all, key) is not None:
                fault = f"{key} beside detections of quantities, which one Gaussian of each target weighs"
                remedy = f"no {key}, or detections of boxes"
                yield plate.message(name, fault, remedy, key=(key,), on_key=True)
    for name, node in plate.agents.items():
        declaration = plate.cues.get(node.agent.cue)
        if declaration is not None and declaration.reads_detection and name not in sensors:
            fault = f"detections of boxes beside those of quantities, of {next(iter(sensors))}"
            yield plate.message(name, fault, "sd in both, or boxes alone", key=("agent",), on_key=True)
    if birth is None:
        return
    path = ("targets", plate.name, "birth")
    if birth.detector.detector != GIVEN or birth.detector.parameters:
        fault = f"births by {birth.detector.detector}, and the agents measure detections of quantities"
        yield plate.at.message((*path, "detector"), fault, f"detector: {GIVEN}, without parameters")
    for key, is_usual in {
        "labels": not birth.labels,
        "every": birth.every == 1,
        "pace": birth.pace is None,
        "tentative": not birth.tentative,
        "min_score": birth.min_score == 0.0,
    }.items():
        if not is_usual:
            fault = f"birth.{key} has no effect on detections of quantities"
            yield plate.at.message((*path, key), fault, "no such key", on_key=True)


def inverses_can_be_read(plate: Plate) -> Iterator[GraphMessage]:
    """`inverse` gives fields of the state by the quantities of a sensor."""
    sensors = sensors_of(plate)
    for name, node in plate.agents.items():
        if not node.inverse:
            continue
        if name not in sensors:
            fault = f"inverse of {node.agent.cue}, whose detections are no quantities"
            yield plate.message(
                name, fault, "sd in a detection agent, or no inverse", key=("inverse",), on_key=True
            )
            continue
        state = _state(plate, node)
        needed = ANCHORED if plate.spec.state == "point" else BOX
        missing = [field for field in needed if field not in node.inverse]
        if missing:
            fault = f"inverse without {', '.join(missing)}"
            remedy = f"an expression of each of {', '.join(needed)}"
            yield plate.message(name, fault, remedy, key=("inverse",), on_key=True)
        names = (*sensors[name].sd, *plate.constants)
        for written, text in node.inverse.items():
            key = ("inverse", written)
            if written not in state:
                fault = f"inverse of {written!r}, which is no field of the state"
                yield plate.message(name, fault, state, key=key, word=written, on_key=True)
            try:
                parse_value(text, names)
            except ExpressionError as error:
                message = plate.message(name, error.found, error.allowed, key=key)
                if error.word:
                    message = replace(message, nearest=nearest(error.word, error.near))
                yield plate.at.inside(message, error.at)


def sensors_can_start_targets(plate: Plate) -> Iterator[GraphMessage]:
    """Without `inverse` one state has the values of a detection; one sensor at least can start targets."""
    sensors = sensors_of(plate)
    wholes = {
        name: parameters
        for name, parameters in sensors.items()
        if parameters.within and _can_be_evaluated(plate, name, parameters)
    }
    starts = any(plate.agents[name].inverse for name in sensors)
    for name, parameters in wholes.items():
        if plate.agents[name].inverse:
            continue
        if plate.spec.state == "box":
            fault = "a detection of quantities has no size, and the state is a box"
            remedy = "state: point for the target, or inverse: {x: .., y: .., w: .., h: ..}"
            yield plate.message(name, fault, remedy, key=("agent",), on_key=True)
            starts = True
            continue
        if len(parameters.sd) < len(ANCHORED):
            continue
        places = _places(plate, name, parameters)
        starts = starts or len(places) == 1
        if len(places) == 1:
            continue
        remedy = "inverse: {x: .., y: ..}, expressions of " + ", ".join(parameters.sd)
        if not len(places):
            fault = "measures that have the middle of within at no x, y that was found"
        else:
            examples = ", ".join(f"({x:.6g}, {y:.6g})" for x, y in places[:PLACES].tolist())
            fault = f"measures with the same values at several places, such as {examples}"
        yield plate.message(
            name, fault, remedy, key=("measures",) if plate.agents[name].measures else ("agent",)
        )
        starts = True
    if wholes and not starts:
        first = next(iter(wholes))
        fault = "no sensor that can start a target: each measures less than a place"
        remedy = "a sensor of two quantities, or inverse of one"
        yield plate.message(first, fault, remedy, key=("agent",), on_key=True)


def _can_be_evaluated(plate: Plate, name: str, parameters: Any) -> bool:
    node = plate.agents[name]
    try:
        terms = [parse(node.measures[quantity], names_at(plate, node.parent)) for quantity in node.measures]
    except ExpressionError:
        return False
    state = _state(plate, node)
    covered = all(quantity in node.measures or quantity in state for quantity in parameters.sd)
    of_frames = {*FRAME_NAMES, *plate.frame_names}
    return covered and not any(word in of_frames for term in terms for word in names_in(term))


def _state(plate: Plate, node: AgentNode) -> tuple[str, ...]:
    """The fields of the state at the agent's parent."""
    names = names_at(plate, node.parent)
    return tuple(name for name in names if name not in (*FRAME_NAMES, *plate.frame_names, *plate.constants))


def _places(plate: Plate, name: str, parameters: Any) -> Floats:
    """(S, 2) the x, y at which the quantities have the middle of `within`."""
    middle = np.array([sum(parameters.within[quantity]) / 2 for quantity in parameters.sd])
    function, less = _function(plate, name, parameters)
    return solutions(function, less, middle, np.array([*parameters.sd.values()]) ** 2)


def _function(plate: Plate, name: str, parameters: Any) -> tuple[Any, Less]:
    node = plate.agents[name]
    terms = [
        parse(node.measures[quantity]) if quantity in node.measures else Variable(quantity)
        for quantity in parameters.sd
    ]
    other_fields = _other_fields(plate, node)

    def function(places: Floats) -> Floats:
        names = {**plate.constants, **other_fields, "x": places[:, 0], "y": places[:, 1]}
        return np.stack([np.broadcast_to(values_of(term, names), (len(places),)) for term in terms], axis=1)

    return function, shorter_way(np.array([period_of(term, plate.constants) for term in terms]))


def _other_fields(plate: Plate, node: AgentNode) -> Mapping[str, float]:
    """The other fields of a state that starts."""
    root = plate.inference[plate.roots[0]]
    fields = {} if root.motion is None or root.motion.expressions is None else root.motion.expressions.own
    starts = {name: float(field.start) for name, field in fields.items()}
    return {name: starts.get(name, 1.0 if name in BOX else 0.0) for name in _state(plate, node)}


def read_inverses(plate: Plate) -> dict[str, Inverse]:
    """Start of a target with a detection of each sensor, of a plate that passed the checks."""
    inverses = {}
    for name, parameters in sensors_of(plate).items():
        terms: dict[str, Term] = {field: parse(text) for field, text in plate.agents[name].inverse.items()}
        words = {word for term in terms.values() for word in names_in(term)}
        constants = {constant: value for constant, value in plate.constants.items() if constant in words}
        anchor = None
        if not terms and len(parameters.sd) >= len(ANCHORED):
            (place,) = _places(plate, name, parameters)
            anchor = Anchor(place, _function(plate, name, parameters)[0](place[None])[0])
        inverses[name] = Inverse(terms, constants, anchor)
    return inverses


def points_have_no_size(plate: Plate) -> Iterator[GraphMessage]:
    """Nothing of a point's net is about a size, a frame, or looks at a box."""
    if plate.spec.state != "point":
        return
    sensors = sensors_of(plate)
    for name, node in plate.agents.items():
        declaration = plate.cues.get(node.agent.cue)
        if (
            name not in sensors
            and declaration is not None
            and (declaration.gives is None or declaration.reads_detection)
        ):
            fault = f"{node.agent.cue}, which is about a box, beside state: point"
            remedy = "agents of quantities: detection with sd, readings; or state: box"
            yield plate.message(name, fault, remedy, key=("agent",), on_key=True)
    if plate.agents and not sensors:
        path = ("targets", plate.name, "state")
        fault = "state: point without an agent that is given detections, with which a point starts"
        yield plate.at.message(path, fault, "an agent detection with sd, or state: box")
    for name, inference_node in plate.inference.items():
        if inference_node.parent is not None:
            continue
        if "ud_fields" in inference_node.model_fields_set and set(inference_node.ud_fields) - set(ANCHORED):
            fault = "ud_fields of a size, which a point does not have"
            yield plate.message(name, fault, "x, y", key=("ud_fields",), on_key=True)
        lost, motion = inference_node.lost, inference_node.motion
        if (
            lost is not None
            and lost.existence_rule is None
            and lost.score_below is None
            and lost.above.kind == "ud_box"
        ):
            fault = "lost.above in boxes, and the state is a point"
            yield plate.message(
                name, fault, "existence_below, or above: {ud_px2: ..}", key=("lost",), on_key=True
            )
        if inference_node.belief is not None and inference_node.belief.grid is not None:
            fault = "a grid, whose cells lie on the frame, and the state is a point"
            yield plate.message(name, fault, "gaussian or particles", key=("belief",), on_key=True)
        if motion is not None:
            yield from _points_move(plate, name, motion)


def _points_move(plate: Plate, name: str, motion: Any) -> Iterator[GraphMessage]:
    settings, kind = motion.settings, motion.kind
    if kind == "box_velocity":
        yield plate.message(
            name, "box_velocity of a point", "constant_velocity", key=("motion",), on_key=True
        )
        return
    if not settings.is_plain or settings.borders is not None:
        fault = "a motion that depends on the frame or on a size, and the state is a point"
        yield plate.message(name, fault, "noise and kinematics alone", key=("motion", kind), on_key=True)
    if motion.expressions is not None:
        wrong = [field for field in (*settings.drift, *settings.sd) if field in ("w", "h")]
        if wrong:
            fault = f"a motion of {wrong[0]}, which a point does not have"
            yield plate.message(name, fault, "x, y and fields of its own", key=("motion", kind), on_key=True)
        return
    sized = settings.sd_px.w or settings.sd_px.h or "sd_box" in settings.model_fields_set
    if sized or "sd_log" in settings.model_fields_set:
        fault = "noise of a size, which a point does not have"
        yield plate.message(name, fault, "sd_px: {x: .., y: ..}", key=("motion", kind), on_key=True)


def points_in_images_have_a_place(plate: Plate) -> Iterator[GraphMessage]:
    """Points in an image are of states in metres, with a prior of what they do not say."""
    state = plate.spec.state
    for name, node in plate.agents.items():
        declaration = plate.cues.get(node.agent.cue)
        if declaration is None or not declaration.reads_detection:
            continue
        parameters: Any = cue_parameters(node.agent, declaration)
        if not getattr(parameters, "points", False):
            continue
        fault, remedy = "points of a target whose state is in pixels", "state: {space: ..} or {ground: ..}"
        if isinstance(state, WorldState):
            priors = {"width": state.ground.width, "height": state.ground.height} if state.ground else {}
            if state.space is not None:
                priors = {axis: getattr(state.space, axis) for axis in "xyz"}
            missing = [key for key, prior in priors.items() if prior is None]
            if not missing:
                continue
            fault = f"points, which have no size, of targets without a prior of {', '.join(missing)}"
            kind = "ground" if state.space is None else "space"
            remedy = f"state: {{{kind}: {{{missing[0]}: {{mean: .., sd: ..}}, ..}}}}"
        yield plate.message(name, fault, remedy, key=("agent", node.agent.cue, "points"), on_key=True)


def sensors_fit(plate: Plate) -> Iterator[GraphMessage]:
    """All of these checks, where the parameters of the agents that are given detections are sound."""
    for node in plate.agents.values():
        declaration = plate.cues.get(node.agent.cue)
        if declaration is None or not declaration.reads_detection:
            continue
        try:
            cue_parameters(node.agent, declaration)
        except ValidationError:
            return  # said where parameters are checked
    yield from sensors_share_detections(plate)
    yield from inverses_can_be_read(plate)
    yield from sensors_can_start_targets(plate)
    yield from points_have_no_size(plate)
    yield from points_in_images_have_a_place(plate)


SENSOR_CHECKS: tuple[Check, ...] = (sensors_fit,)
