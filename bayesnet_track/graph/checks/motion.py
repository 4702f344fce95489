"""Checks of a motion: its expressions, its further settings, and the beliefs that can hold them."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from dataclasses import replace

from pydantic import ValidationError

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
from bayesnet_track.graph.expressions.parse import parse
from bayesnet_track.graph.expressions.terms import FRAME_NAMES, WORDS, ExpressionError, Term, names_in
from bayesnet_track.graph.settings.motion import BoxVelocity, ByExpressions, Motion, Moving
from bayesnet_track.graph.spec import GraphSpec, InferenceNode
from bayesnet_track.graph.text.explain import explain
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
        kept = settings.size_reversion
        if kept is None:
            continue
        here = (*key, "size_reversion")
        limits = {"scale": kept.sd_scale, "aspect": kept.sd_aspect}
        if all(limit is None for limit in limits.values()):
            yield plate.message(name, "size_reversion without an sd", ["sd_scale", "sd_aspect"], key=here)
        for side in ("w", "h"):
            if getattr(settings.sd_px, side) > 0:
                found = f"size_reversion beside sd_px.{side}, whose steps it does not bound"
                yield plate.message(name, found, "size noise by sd_log alone", key=here, on_key=True)
        for part, limit in limits.items():
            step = getattr(settings.sd_log, part)
            if limit is not None and not 0 < step < limit:
                found = f"sd_{part} is {limit:g}, and the step, sd_log.{part}, is {step:g}"
                allowed = f"sd_log.{part} above 0 and below sd_{part}"
                yield plate.message(name, found, allowed, key=(*here, f"sd_{part}"))


def belief_holds_the_motion(plate: Plate) -> Iterator[GraphMessage]:
    """A grid takes no `camera`, `size_reversion` or `relocalize`; particles relocalize at a fixed size."""
    for name, key, settings in _moving(plate):
        belief = plate.inference[name].belief
        if belief is not None and belief.grid is not None:
            for word in ("size_reversion", "camera"):
                if getattr(settings, word) is not None:
                    found = f"{word} beside a grid, whose cells all move alike"
                    yield plate.message(name, found, "particles or gaussian", key=(*key, word), on_key=True)
        if settings.relocalize is None:
            continue
        here, lost = (*key, "relocalize"), plate.inference[name].lost
        if settings.relocalize.sudden is not None and (lost is None or lost.found_fit is None):
            found = "sudden without lost.found_fit, by which it is known how well the target usually fits"
            yield plate.message(name, found, "both, or none", key=(*here, "sudden"), on_key=True)
        if belief is not None and belief.grid is not None:
            found = "relocalize beside grid, which cannot jump"
            yield plate.message(name, found, "particles or gaussian", key=here, on_key=True)
        elif belief is not None and belief.particles is not None:
            particles = belief.particles
            if not isinstance(particles.size, int):
                found, allowed = "relocalize beside an adaptive size", "a size that is a number"
                yield plate.message(name, found, allowed, key=here, on_key=True)
            if particles.proposal.kind != "bootstrap":
                found = f"relocalize beside proposal: {particles.proposal.kind}"
                yield plate.message(name, found, "proposal: bootstrap", key=here, on_key=True)


def borders_can_be_met(plate: Plate) -> Iterator[GraphMessage]:
    """`borders: reflect` is for particles drawn from the motion, and for extended and unscented filters."""
    for name, node in plate.inference.items():
        belief = node.belief
        if node.motion is None or node.motion.settings.borders is None or belief is None:
            continue
        here = ("motion", node.motion.kind, "borders")
        if belief.grid is not None:
            found = "borders: reflect beside a grid, whose cells all move alike"
            yield plate.message(name, found, "particles or gaussian", key=here, on_key=True)
        elif belief.gaussian is not None and belief.gaussian.filter == "kalman":
            found = "borders: reflect beside filter: kalman, which is of linear motion"
            yield plate.message(name, found, "filter: extended or unscented", key=here, on_key=True)
        elif belief.particles is not None and belief.particles.proposal.kind != "bootstrap":
            found = f"borders: reflect beside proposal: {belief.particles.proposal.kind}"
            yield plate.message(name, found, "proposal: bootstrap", key=here, on_key=True)


def box_velocities_are_gaussian(plate: Plate) -> Iterator[GraphMessage]:
    """`box_velocity` is filtered by a Gaussian belief, and takes noise in px alone."""
    for name, key, settings in _moving(plate):
        if not isinstance(settings, BoxVelocity):
            continue
        belief = plate.inference[name].belief
        if belief is None or belief.gaussian is None:
            found = f"box_velocity beside {'particles' if belief is None else belief.kind}"
            yield plate.message(name, found, "belief: {gaussian: {filter: kalman}}", key=key, on_key=True)
        own = {"sd_px", "start_sd_px", *BoxVelocity.model_fields.keys() - Moving.model_fields.keys()}
        for word in sorted(settings.model_fields_set - own):
            found = f"{word} has no effect on box_velocity"
            yield plate.message(name, found, sorted(own), key=(*key, word), on_key=True)


def angle_is_seen(plate: Plate) -> Iterator[GraphMessage]:
    """A grid has no cells for the angle; elsewhere some agent must read it."""
    for name, key, settings in _moving(plate):
        if settings.sd_angle_deg == 0:
            continue
        here = (*key, "sd_angle_deg")
        belief = plate.inference[name].belief
        if belief is not None and belief.grid is not None:
            found = "sd_angle_deg beside a grid, which has no cells for angles"
            yield plate.message(name, found, "particles or gaussian", key=here, on_key=True)
        known = [plate.cues[node.agent.cue] for node in plate.agents.values() if node.agent.cue in plate.cues]
        if not any(cue.reads_angle for cue in known):
            able = sorted(cue.name for cue in plate.cues.values() if cue.reads_angle)
            found = "sd_angle_deg, and no agent reads the angle"
            yield plate.message(name, found, able or "no sd_angle_deg", key=here, on_key=True)


def gaussians_are_looked_for(plate: Plate) -> Iterator[GraphMessage]:
    """Beside a Gaussian, `relocalize` takes `share` and `grow_box`; agents that are sure or not look."""
    for name, key, settings in _moving(plate):
        belief = plate.inference[name].belief
        if settings.relocalize is None or belief is None or belief.gaussian is None:
            continue
        here = (*key, "relocalize")
        for word in sorted(settings.relocalize.model_fields_set - {"share", "grow_box"}):
            found = f"{word} beside gaussian, which has no hypotheses that could look"
            yield plate.message(name, found, ["share", "grow_box"], key=(*here, word), on_key=True)
        if plate.inference[name].lost is None:
            found = "relocalize beside gaussian without lost: only a target that can be lost is looked for"
            yield plate.message(name, found, "both, or none", key=here, on_key=True)
        whole = [node for agent, node in plate.agents.items() if not _is_of_a_part(plate, agent)]
        if not any(declares(plate, node, CueDeclaration.can_search) for node in whole):
            found = "relocalize beside gaussian, and no agent of the whole says how sure it is anywhere"
            yield plate.message(name, found, "an agent such as siamese_box", key=here, on_key=True)


def _is_of_a_part(plate: Plate, agent: str) -> bool:
    """True if a latent node is above it (for a valid tree)."""
    above: str | None = plate.agents[agent].parent
    while above is not None:
        node = plate.inference[above]
        if node.fuse is not None and node.fuse.latent is not None:
            return True
        above = node.parent
    return False


def jumps_have_places(plate: Plate) -> Iterator[GraphMessage]:
    """`relocalize` needs noise of both x and y, and a detector that is installed and takes its parameters."""
    for name, key, settings in _moving(plate):
        if settings.relocalize is None:
            continue
        driven = getattr(settings, "sd_velocity_px", getattr(settings, "sd_acceleration_px", 0.0)) > 0
        still = [
            axis
            for axis in ("x", "y")
            if not driven and getattr(settings.sd_px, axis) + getattr(settings.sd_box, axis) == 0
        ]
        if still:
            found = f"relocalize without noise of {' and '.join(still)}"
            yield plate.message(name, found, "noise of x and y", key=(*key, "relocalize"), on_key=True)
        for word in ("above", "usual"):
            if settings.relocalize.grow_box is not None and word in settings.relocalize.model_fields_set:
                found = f"{word} beside grow_box, which searches only while the target is lost"
                yield plate.message(name, found, f"no {word}", key=(*key, "relocalize", word), on_key=True)
        chosen = settings.relocalize.by.detector
        if chosen is None:
            continue
        known, path = installed_detectors([chosen.detector]), (*key, *_DETECTOR, chosen.detector)
        if chosen.detector not in known:
            if (absent := why_absent(ENTRY_POINT_GROUP, chosen.detector)) is not None:
                yield plate.message(name, f"detector {absent[0]}", absent[1], key=path, on_key=True)
                continue
            found = f"unknown detector {chosen.detector!r}"
            yield plate.message(name, found, list(known), key=path, word=chosen.detector, on_key=True)
            continue
        model = known[chosen.detector].parameters
        try:
            plugin_parameters(chosen, model)
        except ValidationError as error:
            whole = ("targets", plate.name, "nodes", name, *path)
            yield from explain(error, model, chosen.parameters, plate.at, whole)


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
            here = (*path, "fields", name)
            if (name in WORDS and name not in MAY_BE_FIELDS) or name == "carried":
                found, allowed = f"field {name!r}, which is a word of the language", "another name"
                yield plate.message(node, found, allowed, key=here, on_key=True)
            elif name in plate.constants:
                yield plate.message(
                    node, f"field {name!r}, which is a constant", "another name", key=here, on_key=True
                )


def formulas_can_be_read(plate: Plate) -> Iterator[GraphMessage]:
    """A motion's expressions are of its fields, the frame, `dt` and constants."""
    for node, path, motion in _formulas(plate):
        fields = (*BOX, *motion.own)
        names = (*fields, *FRAME_NAMES, *plate.frame_names, *plate.constants)
        for what, formulas in _parts(motion):
            for name, text in formulas.items():
                here = (*path, what, name)
                if name not in fields:
                    found = f"{what} of {name!r}, which is no field of the state"
                    yield plate.message(node, found, fields, key=here, word=name, on_key=True)
                try:
                    parse(str(text), names)
                except ExpressionError as error:
                    message = plate.message(node, error.found, error.allowed, key=here)
                    yield plate.at.inside(with_nearest(message, error.word, error.near), error.at)
        strange = [one for one in motion.own if one not in VELOCITIES]
        if motion.borders is not None and strange:
            found = f"borders: reflect beside field {strange[0]!r}, which it cannot turn round"
            allowed = f"fields {', '.join(VELOCITIES)}, or no borders"
            yield plate.message(node, found, allowed, key=(*path, "borders"), on_key=True)


def beliefs_hold_the_formulas(plate: Plate) -> Iterator[GraphMessage]:
    """Of expressions a grid takes noise that is the same everywhere, and `kalman` none."""
    for node, path, motion in _formulas(plate):
        belief = plate.inference[node].belief
        if belief is None:
            continue
        if belief.gaussian is not None and belief.gaussian.filter == "kalman":
            found = "expressions beside filter: kalman, which is of linear motion"
            yield plate.message(node, found, "filter: extended or unscented", key=path, on_key=True)
        if belief.grid is not None:
            yield from _fits_grid(plate, (node, path), motion)


def constants_have_particles(plate: Plate) -> Iterator[GraphMessage]:
    """`static_discount` is for particles, and for fields that neither drift nor have noise."""
    for node, path, motion in _formulas(plate):
        if motion.static_discount is None:
            continue
        belief, key = plate.inference[node].belief, (*path, "static_discount")
        if belief is not None and belief.particles is None:
            found = f"static_discount beside {belief.kind}, which keeps a constant's uncertainty by itself"
            yield plate.message(node, found, "no static_discount, or particles", key=key, on_key=True)
        elif not static_fields(motion, plate.inference[node].start):
            found = "static_discount, and every field that is uncertain drifts or has noise"
            allowed = "a field with an sd at the start, no drift and no sd; or no static_discount"
            yield plate.message(node, found, allowed, key=key, on_key=True)


def static_fields(motion: ByExpressions, starts: Collection[str] = ()) -> list[str]:
    """Unknown constants: fields that are uncertain at the start, and neither drift nor have noise.

    `starts` are fields with a start prior beside the motion's.
    """
    return [
        name
        for name, own in motion.own.items()
        if (own.sd > 0 or name in starts)
        and str(motion.drift.get(name, name)).strip() == name
        and float_of(motion.sd.get(name, 0.0)) == 0.0
    ]


def float_of(value: float | str) -> float:
    """A number that may be written as text; not a number of another expression."""
    try:
        return float(value)
    except ValueError:
        return float("nan")


def _fits_grid(plate: Plate, at: tuple[str, KeyPath], motion: ByExpressions) -> Iterator[GraphMessage]:
    node, path = at
    if tuple(motion.own) not in ((), ("vx", "vy")):
        found = f"a grid has no cells for {', '.join(motion.own)}"
        yield plate.message(node, found, "fields vx, vy, in this order, or none", key=(*path, "fields"))
    for name, own in motion.own.items():
        if own.start != 0:
            here = (*path, "fields", name, "start")
            yield plate.message(
                node, f"start of {name} on a grid, whose velocities start around 0", "0", key=here
            )
    for what, formulas in _parts(motion):
        for name, text in formulas.items():
            here = (*path, what, name)
            if name in ("w", "h"):
                found = f"{what} of {name}, and the sizes of a grid's cells do not move by expressions"
                yield plate.message(node, found, "x, y, vx, vy", key=here, on_key=True)
            elif what == "sd" and (read := _reads(str(text), (*BOX, *motion.own))):
                found = f"sd that depends on {read}; on a grid the noise is the same everywhere"
                yield plate.message(node, found, "numbers, constants, dt, the frame's size", key=here)


def attached_motions_are_kinematic(spec: GraphSpec, at: Positions) -> Iterator[GraphMessage]:
    """Kinds that may be carried have no motion by expressions: being carried sets its velocity."""
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
        path: KeyPath = ("joins", number, "factor")
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
        of_frame = (*(name for name in FRAME_NAMES if name != "dt"), *names_of_inputs(spec.inputs))
        names = (*states, *of_frame, *numbers_of_kinds(spec, kinds))
        try:
            parse(join.factor, names)
        except ExpressionError as error:
            message = at.message(path, error.found, error.allowed)
            near = nearest(error.word, error.near) if error.word else ""
            yield at.inside(replace(message, nearest=near), error.at)


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
        motions |= {("modes", mode, "motion"): one.motion for mode, one in (node.modes or {}).items()}
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
