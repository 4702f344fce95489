"""Checks of a motion: its expressions, its further settings, and the beliefs that can hold them."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from dataclasses import replace

from pydantic import ValidationError

from bayesnet_track.graph.checked import CheckedTarget
from bayesnet_track.graph.checks.cues import declares, plugin_parameters
from bayesnet_track.graph.checks.factors import with_nearest
from bayesnet_track.graph.checks.lifecycle import GraphCheck
from bayesnet_track.graph.checks.plates import (
    Check,
    Plate,
    discrete_fields,
    further_fields,
    names_of_inputs,
    numbers_of_kinds,
    root_of,
)
from bayesnet_track.graph.expressions.parse import parse, parse_value
from bayesnet_track.graph.expressions.terms import FRAME_NAMES, WORDS, ExpressionError, Term, names_in
from bayesnet_track.graph.settings.motion import BoxVelocity, ByExpressions, Motion, Moving
from bayesnet_track.graph.spec import GraphSpec, InferenceNode
from bayesnet_track.graph.text.explain import explain_errors
from bayesnet_track.graph.text.messages import GraphMessage, KeyPath, Positions, nearest
from bayesnet_track.observation.cue import CueDeclaration
from bayesnet_track.observation.detector import ENTRY_POINT_GROUP, installed_detectors
from bayesnet_track.observation.plugins import why_absent
from bayesnet_track.observation.protocols import BOX

_DETECTOR = ("relocalize", "by", "detector")


def _moving(plate: Plate) -> Iterator[tuple[str, KeyPath, Moving]]:
    """Node, key and settings of every motion of a root but those by expressions."""
    for name, node in plate.inference.items():
        if node.parent is None and node.motion is not None and isinstance(node.motion.settings, Moving):
            yield name, ("motion", node.motion.kind), node.motion.settings


def size_is_drawn_back_from_somewhere(plate: Plate) -> Iterator[GraphMessage]:
    """`size_reversion` bounds noise of the size in logarithms, and is wider than one step of it."""
    for name, key, settings in _moving(plate):
        reversion = settings.size_reversion
        if reversion is None:
            continue
        path = (*key, "size_reversion")
        limits = {"scale": reversion.sd_scale, "aspect": reversion.sd_aspect}
        if all(limit is None for limit in limits.values()):
            yield plate.message(name, "size_reversion without an sd", ["sd_scale", "sd_aspect"], key=path)
        for side in ("w", "h"):
            if getattr(settings.sd_px, side) > 0:
                fault = f"size_reversion beside sd_px.{side}, whose steps it does not bound"
                yield plate.message(name, fault, "size noise by sd_log alone", key=path, on_key=True)
        for part, limit in limits.items():
            step = getattr(settings.sd_log, part)
            if limit is not None and not 0 < step < limit:
                fault = f"sd_{part} is {limit:g}, and the step, sd_log.{part}, is {step:g}"
                remedy = f"sd_log.{part} above 0 and below sd_{part}"
                yield plate.message(name, fault, remedy, key=(*path, f"sd_{part}"))


def belief_holds_the_motion(plate: Plate) -> Iterator[GraphMessage]:
    """A grid takes no `camera`, `size_reversion` or `relocalize`; particles relocalize at a fixed size."""
    for name, key, settings in _moving(plate):
        belief = plate.inference[name].belief
        if belief is not None and belief.grid is not None:
            for word in ("size_reversion", "camera"):
                if getattr(settings, word) is not None:
                    fault = f"{word} beside a grid, whose cells all move alike"
                    yield plate.message(name, fault, "particles or gaussian", key=(*key, word), on_key=True)
        if settings.relocalize is None:
            continue
        path, lost = (*key, "relocalize"), plate.inference[name].lost
        if settings.relocalize.sudden is not None and (lost is None or lost.found_fit is None):
            fault = "sudden without lost.found_fit, by which it is known how well the target usually fits"
            yield plate.message(name, fault, "both, or none", key=(*path, "sudden"), on_key=True)
        if belief is not None and belief.grid is not None:
            fault = "relocalize beside grid, which cannot jump"
            yield plate.message(name, fault, "particles or gaussian", key=path, on_key=True)
        elif belief is not None and belief.particles is not None:
            particles = belief.particles
            if not isinstance(particles.size, int):
                fault, remedy = "relocalize beside an adaptive size", "a size that is a number"
                yield plate.message(name, fault, remedy, key=path, on_key=True)
            if particles.proposal.kind != "bootstrap":
                fault = f"relocalize beside proposal: {particles.proposal.kind}"
                yield plate.message(name, fault, "proposal: bootstrap", key=path, on_key=True)


def borders_can_be_met(plate: Plate) -> Iterator[GraphMessage]:
    """`borders: reflect` is for particles drawn from the motion, and for extended and unscented filters."""
    for name, node in plate.inference.items():
        belief = node.belief
        if node.motion is None or node.motion.settings.borders is None or belief is None:
            continue
        path = ("motion", node.motion.kind, "borders")
        if belief.grid is not None:
            fault = "borders: reflect beside a grid, whose cells all move alike"
            yield plate.message(name, fault, "particles or gaussian", key=path, on_key=True)
        elif belief.gaussian is not None and belief.gaussian.filter == "kalman":
            fault = "borders: reflect beside filter: kalman, which is of linear motion"
            yield plate.message(name, fault, "filter: extended or unscented", key=path, on_key=True)
        elif belief.particles is not None and belief.particles.proposal.kind != "bootstrap":
            fault = f"borders: reflect beside proposal: {belief.particles.proposal.kind}"
            yield plate.message(name, fault, "proposal: bootstrap", key=path, on_key=True)


def box_velocities_are_gaussian(plate: Plate) -> Iterator[GraphMessage]:
    """`box_velocity` is filtered by a Gaussian belief, and takes noise in px alone."""
    for name, key, settings in _moving(plate):
        if not isinstance(settings, BoxVelocity):
            continue
        belief = plate.inference[name].belief
        if belief is None or belief.gaussian is None:
            fault = f"box_velocity beside {'particles' if belief is None else belief.kind}"
            yield plate.message(name, fault, "belief: {gaussian: {filter: kalman}}", key=key, on_key=True)
        effective = {"sd_px", "start_sd_px", *BoxVelocity.model_fields.keys() - Moving.model_fields.keys()}
        for word in sorted(settings.model_fields_set - effective):
            fault = f"{word} has no effect on box_velocity"
            yield plate.message(name, fault, sorted(effective), key=(*key, word), on_key=True)


def angle_is_seen(plate: Plate) -> Iterator[GraphMessage]:
    """A grid has no cells for the angle; elsewhere some agent must read it."""
    for name, key, settings in _moving(plate):
        if settings.sd_angle_deg == 0:
            continue
        path = (*key, "sd_angle_deg")
        belief = plate.inference[name].belief
        if belief is not None and belief.grid is not None:
            fault = "sd_angle_deg beside a grid, which has no cells for angles"
            yield plate.message(name, fault, "particles or gaussian", key=path, on_key=True)
        cues = [plate.cues[node.agent.cue] for node in plate.agents.values() if node.agent.cue in plate.cues]
        if not any(cue.reads_angle for cue in cues):
            able = sorted(cue.name for cue in plate.cues.values() if cue.reads_angle)
            fault = "sd_angle_deg, and no agent reads the angle"
            yield plate.message(name, fault, able or "no sd_angle_deg", key=path, on_key=True)


def gaussians_are_looked_for(plate: Plate) -> Iterator[GraphMessage]:
    """Beside a Gaussian, `relocalize` takes `share` and `grow_box`; agents that are sure or not look."""
    for name, key, settings in _moving(plate):
        belief = plate.inference[name].belief
        if settings.relocalize is None or belief is None or belief.gaussian is None:
            continue
        path = (*key, "relocalize")
        for word in sorted(settings.relocalize.model_fields_set - {"share", "grow_box"}):
            fault = f"{word} beside gaussian, which has no hypotheses that could look"
            yield plate.message(name, fault, ["share", "grow_box"], key=(*path, word), on_key=True)
        if plate.inference[name].lost is None:
            fault = "relocalize beside gaussian without lost: only a target that can be lost is looked for"
            yield plate.message(name, fault, "both, or none", key=path, on_key=True)
        agents = [node for agent, node in plate.agents.items() if not _is_of_a_part(plate, agent)]
        if not any(declares(plate, node, CueDeclaration.can_search) for node in agents):
            fault = "relocalize beside gaussian, and no agent of the whole says how sure it is anywhere"
            yield plate.message(name, fault, "an agent such as siamese_box", key=path, on_key=True)


def _is_of_a_part(plate: Plate, agent: str) -> bool:
    """True if a latent node is above it (for a valid tree)."""
    ancestor: str | None = plate.agents[agent].parent
    while ancestor is not None:
        node = plate.inference[ancestor]
        if node.fuse is not None and node.fuse.latent is not None:
            return True
        ancestor = node.parent
    return False


def _still_axes(settings: Moving) -> list[str]:
    """Axes, of x and y, along which nothing drives a target."""
    drive = getattr(settings, "sd_velocity_px", getattr(settings, "sd_acceleration_px", 0.0))
    noises = (settings.sd_px, settings.sd_box)
    return [
        axis
        for axis in ("x", "y")
        if sum(getattr(noise, axis) for noise in noises) + getattr(drive, axis, drive) == 0
    ]


def describe_still_axes(target: CheckedTarget) -> Iterator[str]:
    """A sentence if the root's motion has noise of one of x and y and none of the other, unless it says 0."""
    motion = target.inference(target.root).motion
    if motion is None or not isinstance(motion.settings, Moving):
        return
    still = _still_axes(motion.settings)
    noises = (motion.settings.sd_px, motion.settings.sd_box)
    if len(still) == 1 and not any(still[0] in noise.model_fields_set for noise in noises):
        yield (
            f"{target.name}: {motion.kind} has no noise of {still[0]}, which stays as it is in the first "
            f"frame; give it an sd, or write {still[0]}: 0"
        )


def jumps_have_places(plate: Plate) -> Iterator[GraphMessage]:
    """`relocalize` needs noise of both x and y, and a detector that is installed and takes its parameters."""
    for name, key, settings in _moving(plate):
        if settings.relocalize is None:
            continue
        still = _still_axes(settings)
        if still:
            fault = f"relocalize without noise of {' and '.join(still)}"
            yield plate.message(name, fault, "noise of x and y", key=(*key, "relocalize"), on_key=True)
        for word in ("above", "usual"):
            if settings.relocalize.grow_box is not None and word in settings.relocalize.model_fields_set:
                fault = f"{word} beside grow_box, which searches only while the target is lost"
                yield plate.message(name, fault, f"no {word}", key=(*key, "relocalize", word), on_key=True)
        choice = settings.relocalize.by.detector
        if choice is None:
            continue
        detectors, path = installed_detectors([choice.detector]), (*key, *_DETECTOR, choice.detector)
        if choice.detector not in detectors:
            if (absent := why_absent(ENTRY_POINT_GROUP, choice.detector)) is not None:
                yield plate.message(name, f"detector {absent[0]}", absent[1], key=path, on_key=True)
                continue
            fault = f"unknown detector {choice.detector!r}"
            yield plate.message(name, fault, list(detectors), key=path, word=choice.detector, on_key=True)
            continue
        model = detectors[choice.detector].parameters
        try:
            plugin_parameters(choice, model)
        except ValidationError as error:
            full_path = ("targets", plate.name, "nodes", name, *path)
            yield from explain_errors(error, model, choice.parameters, plate.at, full_path)


MOTION_CHECKS: tuple[Check, ...] = (
    size_is_drawn_back_from_somewhere,
    belief_holds_the_motion,
    borders_can_be_met,
    box_velocities_are_gaussian,
    angle_is_seen,
    jumps_have_places,
)


MAY_BE_FIELDS = ("vx", "vy", "ax", "ay", "angle")
VELOCITIES = ("vx", "vy", "ax", "ay")


def fields_have_their_own_names(plate: Plate) -> Iterator[GraphMessage]:
    """Fields of a motion by expressions have names of their own."""
    for node, path, motion in _formulas(plate):
        for name in motion.own:
            key = (*path, "fields", name)
            if (name in WORDS and name not in MAY_BE_FIELDS) or name == "carried":
                fault, remedy = f"field {name!r}, which is a word of the language", "another name"
                yield plate.message(node, fault, remedy, key=key, on_key=True)
            elif name in (*plate.constants, *plate.frame_names):
                fault = f"field {name!r}, which is {'a constant' if name in plate.constants else 'an input'}"
                yield plate.message(node, fault, "another name", key=key, on_key=True)


def formulas_can_be_read(plate: Plate) -> Iterator[GraphMessage]:
    """A motion's expressions are of its fields, the frame, `dt` and constants."""
    for node, path, motion in _formulas(plate):
        fields = (*BOX, *motion.own)
        names = (*fields, *FRAME_NAMES, *plate.frame_names, *plate.constants)
        for part, formulas in _parts(motion):
            for name, text in formulas.items():
                key = (*path, part, name)
                if name not in fields:
                    fault = f"{part} of {name!r}, which is no field of the state"
                    yield plate.message(node, fault, fields, key=key, word=name, on_key=True)
                try:
                    parse_value(str(text), names)
                except ExpressionError as error:
                    message = plate.message(node, error.found, error.allowed, key=key)
                    yield plate.at.inside(with_nearest(message, error.word, error.near), error.at)
        strange = [field for field in motion.own if field not in VELOCITIES]
        if motion.borders is not None and strange:
            fault = f"borders: reflect beside field {strange[0]!r}, which it cannot turn round"
            remedy = f"fields {', '.join(VELOCITIES)}, or no borders"
            yield plate.message(node, fault, remedy, key=(*path, "borders"), on_key=True)


def beliefs_hold_the_formulas(plate: Plate) -> Iterator[GraphMessage]:
    """Of expressions a grid takes noise that is the same everywhere, and `kalman` none."""
    for node, path, motion in _formulas(plate):
        belief = plate.inference[node].belief
        if belief is None:
            continue
        if belief.gaussian is not None and belief.gaussian.filter == "kalman":
            fault = "expressions beside filter: kalman, which is of linear motion"
            yield plate.message(node, fault, "filter: extended or unscented", key=path, on_key=True)
        if belief.grid is not None:
            yield from _fits_grid(plate, (node, path), motion)


def constants_have_particles(plate: Plate) -> Iterator[GraphMessage]:
    """`static_discount` is for particles, and for fields that neither drift nor have noise."""
    for node, path, motion in _formulas(plate):
        if motion.static_discount is None:
            continue
        belief, key = plate.inference[node].belief, (*path, "static_discount")
        if belief is not None and belief.particles is None:
            fault = f"static_discount beside {belief.kind}, which keeps a constant's uncertainty by itself"
            yield plate.message(node, fault, "no static_discount, or particles", key=key, on_key=True)
        elif not _static_fields(motion, plate.inference[node].start):
            fault = "static_discount, and every field that is uncertain drifts or has noise"
            remedy = "a field with an sd at the start, no drift and no sd; or no static_discount"
            yield plate.message(node, fault, remedy, key=key, on_key=True)


def _static_fields(motion: ByExpressions, starts: Collection[str] = ()) -> list[str]:
    """Unknown constants: fields that are uncertain at the start, and neither drift nor have noise.

    `starts` are fields with a start prior beside the motion's.
    """
    return [
        name
        for name, field in motion.own.items()
        if (field.sd > 0 or name in starts)
        and str(motion.drift.get(name, name)).strip() == name
        and float_of(motion.sd.get(name, 0.0)) == 0.0
    ]


def float_of(value: float | str) -> float:
    """A number that may be written as text; not a number of another expression."""
    try:
        return float(value)
    except ValueError:
        return float("nan")


def _fits_grid(plate: Plate, place: tuple[str, KeyPath], motion: ByExpressions) -> Iterator[GraphMessage]:
    node, path = place
    if tuple(motion.own) not in ((), ("vx", "vy")):
        fault = f"a grid has no cells for {', '.join(motion.own)}"
        yield plate.message(node, fault, "fields vx, vy, in this order, or none", key=(*path, "fields"))
    for name, field in motion.own.items():
        if field.start != 0:
            key = (*path, "fields", name, "start")
            yield plate.message(
                node, f"start of {name} on a grid, whose velocities start around 0", "0", key=key
            )
    for part, formulas in _parts(motion):
        for name, text in formulas.items():
            key = (*path, part, name)
            if name in ("w", "h"):
                fault = f"{part} of {name}, and the sizes of a grid's cells do not move by expressions"
                yield plate.message(node, fault, "x, y, vx, vy", key=key, on_key=True)
            elif part == "sd" and (read := _reads(str(text), (*BOX, *motion.own))):
                fault = f"sd that depends on {read}; on a grid the noise is the same everywhere"
                yield plate.message(node, fault, "numbers, constants, dt, the frame's size", key=key)


def attached_motions_are_kinematic(spec: GraphSpec, positions: Positions) -> Iterator[GraphMessage]:
    """Kinds that may be carried have no motion by expressions: being carried sets its velocity."""
    for number, join in enumerate(spec.joins):
        kind = (join.between or ("",))[-1]
        if join.attachment is None or kind not in spec.targets:
            continue
        for node in spec.targets[kind].nodes.values():
            if isinstance(node, InferenceNode) and node.motion is not None and node.motion.expressions:
                fault = f"attachment of {kind}, whose motion is by expressions"
                yield positions.message(("joins", number, "attachment"), fault, "another motion", on_key=True)


def factors_of_pairs_can_be_read(spec: GraphSpec, positions: Positions) -> Iterator[GraphMessage]:
    """A join's factor is an expression of the states of the two kinds, and shares no pixels."""
    for number, join in enumerate(spec.joins):
        path: KeyPath = ("joins", number, "factor")
        if join.factor is None:
            if join.when.overlap == 0:
                fault = "overlap 0, which joins all targets, without a factor"
                yield positions.message(("joins", number, "when", "overlap"), fault, "a number above 0")
            continue
        for rival in ("exclusion", "occlusion", "attachment"):
            if getattr(join, rival) is not None:
                yield positions.message(path, f"factor beside {rival}", "either of them", on_key=True)
        if join.between is None:
            yield positions.message(path, "factor without between", "between: [a, b]", on_key=True)
            continue
        kinds = (join.between[0], join.between[-1])
        if any(kind not in spec.targets for kind in kinds):
            continue
        states = [
            f"{letter}.{name}"
            for letter, kind in zip("ab", kinds, strict=True)
            for name in (*BOX, *_fields_of(spec, kind))
        ]
        of_frame = (*(name for name in FRAME_NAMES if name != "dt"), *names_of_inputs(spec.inputs))
        names = (*states, *of_frame, *numbers_of_kinds(spec, kinds))
        try:
            parse(join.factor, names)
        except ExpressionError as error:
            message = positions.message(path, error.found, error.allowed)
            suggestion = nearest(error.word, error.near) if error.word else ""
            yield positions.inside(replace(message, nearest=suggestion), error.at)


def _fields_of(spec: GraphSpec, kind: str) -> tuple[str, ...]:
    """Fields of the state of a kind of target, beside the box, and what it is."""
    root = root_of(spec.targets[kind])
    return () if root is None else (*further_fields(root), *discrete_fields(root))


def drift_of(motion: ByExpressions) -> Mapping[str, Term]:
    """Field -> the expression of its value after a step, of a motion that was checked."""
    return {name: parse(str(text)) for name, text in motion.drift.items()}


def sds_of(motion: ByExpressions) -> Mapping[str, Term]:
    """Field -> the expression of its noise."""
    return {name: parse(str(text)) for name, text in motion.sd.items()}


def _formulas(plate: Plate) -> Iterator[tuple[str, KeyPath, ByExpressions]]:
    """Node, key and expressions of every motion by them, also of those of modes."""
    for name, node in plate.inference.items():
        motions: dict[KeyPath, Motion | None] = {("motion",): node.motion}
        motions |= {
            ("modes", mode, "motion"): settings.motion for mode, settings in (node.modes or {}).items()
        }
        for key, motion in motions.items():
            if motion is not None and motion.expressions is not None:
                yield name, (*key, "expressions"), motion.expressions


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
    constants_have_particles,
)
FORMULA_JOIN_CHECKS: tuple[GraphCheck, ...] = (
    attached_motions_are_kinematic,
    factors_of_pairs_can_be_read,
)
