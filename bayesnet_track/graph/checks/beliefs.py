"""Checks of the beliefs' settings, of start priors, and of errors of measurements that are expressions."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from bayesnet_track.graph.checks.cues import noises_of
from bayesnet_track.graph.checks.factors import explain_name, latent_above, names_of_measures
from bayesnet_track.graph.checks.plates import Check, Plate, moving_fields
from bayesnet_track.graph.checks.sensors import sensors_of
from bayesnet_track.graph.expressions.distributions import distribution_of, is_proper, moments, parameters_of
from bayesnet_track.graph.expressions.evaluate import log_values
from bayesnet_track.graph.expressions.parse import parse, parse_value
from bayesnet_track.graph.expressions.terms import DRAWN, ExpressionError, Term, names_in
from bayesnet_track.graph.settings.beliefs import AdaptiveSize, EssBelow, NormalSize, Particles
from bayesnet_track.graph.settings.motion import Motion, Noise
from bayesnet_track.graph.spec import InferenceNode
from bayesnet_track.graph.text.messages import GraphMessage, KeyPath, nearest
from bayesnet_track.observation.protocols import BOX


def kalman_moves_linearly(plate: Plate) -> Iterator[GraphMessage]:
    """The `kalman` filter is exact, so it takes no noise but that in px; the others approximate the rest."""
    for name, node in plate.inference.items():
        gaussian = node.belief.gaussian if node.belief is not None else None
        if gaussian is None or gaussian.filter != "kalman" or node.motion is None:
            continue
        if node.motion.expressions is not None:
            continue
        motions: dict[KeyPath, Motion] = {("belief", "gaussian", "filter"): node.motion}
        for mode, settings in (node.modes or {}).items():
            if settings.motion is not None and settings.motion.expressions is None:
                motions["modes", mode, "motion"] = settings.motion
        for key, motion in motions.items():
            yield from _linear(plate, name, key, motion.settings)


def _linear(plate: Plate, name: str, key: KeyPath, noise: Noise) -> Iterator[GraphMessage]:
    nonlinear = [
        f"{part}.{field}"
        for part in ("sd_box", "sd_log")
        for field in type(getattr(noise, part)).model_fields
        if getattr(getattr(noise, part), field) > 0
    ]
    nonlinear += ["heavy_tail"] if noise.heavy_tail is not None else []
    if nonlinear:
        fault = f"filter: kalman with {', '.join(nonlinear)}, which is not Gaussian noise in px"
        remedy = "filter: extended or unscented, or noise by sd_px alone"
        yield plate.message(name, fault, remedy, key=key)


def gaussian_settings_have_effect(plate: Plate) -> Iterator[GraphMessage]:
    """`samples` and `sigma` stand only where they are used."""
    for name, node in plate.inference.items():
        gaussian = node.belief.gaussian if node.belief is not None else None
        if gaussian is None or node.parent is not None:
            continue
        unused = {
            "samples": ("likelihood", "samples"),
            "sigma": ("filter", "unscented"),
        }
        for key, (setting, needed) in unused.items():
            value = getattr(gaussian, setting)
            if key in gaussian.model_fields_set and value != needed:
                fault = f"{key} has no effect beside {setting}: {value}"
                remedy = f"{setting}: {needed}, or no {key}"
                yield plate.message(name, fault, remedy, key=("belief", "gaussian", key), on_key=True)


def grid_holds_the_motion(plate: Plate) -> Iterator[GraphMessage]:
    """Cells cover position, velocity and scale: no acceleration, no change of aspect, no size noise in px."""
    for name, node in plate.inference.items():
        if node.belief is None or node.belief.grid is None or node.motion is None:
            continue
        if node.motion.expressions is not None:
            continue
        kind, settings = node.motion.kind, node.motion.settings
        if kind == "constant_acceleration":
            fault = "a grid has no cells for accelerations"
            remedy = "random_walk, constant_velocity, damped_velocity"
            yield plate.message(name, fault, remedy, key=("motion", kind), on_key=True)
        sized = [f"sd_px.{side}" for side in ("w", "h") if getattr(settings.sd_px, side) > 0]
        if settings.sd_log.aspect > 0:
            sized.append("sd_log.aspect")
        if sized:
            fault = f"a grid has no cells for {', '.join(sized)}"
            remedy = "size noise by sd_log.scale alone, or none"
            yield plate.message(name, fault, remedy, key=("motion", kind))


def grid_resets_at_one_level(plate: Plate) -> Iterator[GraphMessage]:
    """`reset` has a threshold of gamma or a rate of false resets, not both."""
    for name, node in plate.inference.items():
        reset = node.belief.grid.reset if node.belief is not None and node.belief.grid is not None else None
        if reset is not None and reset.below is not None and reset.false_rate is not None:
            fault, remedy = "reset with both below and false_rate", "one of below, false_rate"
            yield plate.message(name, fault, remedy, key=("belief", "grid", "reset"))


def sizes_in_order(plate: Plate) -> Iterator[GraphMessage]:
    """An adaptive size has its bounds in order, one error, and new parents at every frame; a fixed one has no
    bounds, and every setting an effect.
    """
    for name, node in plate.inference.items():
        particles = None if node.belief is None else node.belief.particles
        if particles is None:
            continue
        if isinstance(particles.size, AdaptiveSize):
            yield from _adaptive(plate, name, particles, particles.size)
        else:
            for key in ("min", "max"):
                if getattr(particles, key) is not None:
                    fault = f"{key} beside a size of {particles.size}, which is fixed"
                    remedy = f"an adaptive size ({', '.join(AdaptiveSize.model_fields)}), or no {key}"
                    yield plate.message(name, fault, remedy, key=(*_KEY, key), on_key=True)
            if isinstance(particles.when, EssBelow) and particles.proposal.kind in _REDRAWN:
                fault = f"when: ess_below beside proposal: {particles.proposal.kind}, which draws new parents"
                yield plate.message(name, fault, "when: every_frame", key=(*_KEY, "when"))
        adaptive = particles.proposal.second_pass
        if adaptive is not None and adaptive.by == "fitted" and "neighbours" in adaptive.model_fields_set:
            key_of_pass = (*_KEY, "proposal", "second_pass", "neighbours")
            fault = "neighbours has no effect beside by: fitted"
            yield plate.message(name, fault, "by: parents, or no neighbours", key=key_of_pass, on_key=True)


def _adaptive(plate: Plate, name: str, particles: Particles, size: AdaptiveSize) -> Iterator[GraphMessage]:
    if particles.least > particles.most:
        low = f"min is {particles.least}{'' if particles.min is not None else ' by default'}"
        high = f"max, {particles.most}{'' if particles.max is not None else ' by default'}"
        key = "max" if particles.min is None else "min"
        remedy = f"at least {particles.least}" if key == "max" else f"at most {particles.most}"
        yield plate.message(name, f"{low}, above {high}", remedy, key=(*_KEY, key))
    if isinstance(particles.when, EssBelow):
        fault = "when: ess_below beside an adaptive size, which changes by drawing new parents"
        yield plate.message(name, fault, "when: every_frame", key=(*_KEY, "when"))
    if particles.proposal.kind in _REDRAWN:
        fault = f"proposal: {particles.proposal.kind} beside an adaptive size"
        remedy = "bootstrap, second_pass, iterated or prior_editing; or a size that is a number"
        yield plate.message(name, fault, remedy, key=(*_KEY, "proposal"))
    if isinstance(size.settings, NormalSize):
        errors = [key for key in ("error_px", "error_sd") if getattr(size.settings, key) is not None]
        if len(errors) != 1:
            fault = "asymptotic_normal with both error_px and error_sd" if errors else "no error to keep"
            key_of_size = (*_KEY, "size", "asymptotic_normal")
            yield plate.message(name, fault, "exactly one of error_px, error_sd", key=key_of_size)


_KEY = ("belief", "particles")
_REDRAWN = ("auxiliary", "likelihood_mixture")
"""Importance functions that draw a fixed number of new parents at every frame."""


def what_cannot_be_sent_stays(plate: Plate) -> Iterator[GraphMessage]:
    """A cue whose state cannot be stored cannot be sent to a worker process, either."""
    for name, node in plate.agents.items():
        declaration = plate.cues.get(node.agent.cue)
        if node.on == "process" and declaration is not None and declaration.opaque:
            fault = f"{node.agent.cue} keeps what cannot be sent to another process"
            yield plate.message(name, fault, "on: engine, or no such key", key=("on",))


PLACE_CHECKS: tuple[Check, ...] = (what_cannot_be_sent_stays,)


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
        fields = (*BOX, *(field for field in moving_fields(node) if field != "angle"))
        for field, text in node.start.items():
            key = ("start", field)
            if field not in fields:
                fault = f"start of {field!r}, which is no field of the state"
                if field == "angle":
                    fault = "start of angle, which is that of the first frame: 0"
                yield plate.message(name, fault, fields, key=key, word=field, on_key=True)
            try:
                term = parse(str(text), (*BOX, "pi", *plate.constants), draws=True)
            except ExpressionError as error:
                message = plate.message(name, error.found, error.allowed, key=key)
                if error.word in fields:
                    message = replace(message, found=f"{error.word!r}, which is no part of the start box")
                elif error.word in plate.frame_names:
                    message = replace(message, found=f"{error.word!r}, which a start prior does not know")
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
    reads_box = any(variable in BOX for variable in names_in(term))
    box = dict(zip(BOX, (100.0, 100.0, 50.0, 50.0), strict=True)) if reads_box else {}
    with np.errstate(all="ignore"):
        parameters = parameters_of(term, {**plate.constants, **box}, 1)
        spread = moments(function, parameters)[1]
    proper = is_proper(function, parameters)[0]
    if not reads_box and not proper:
        fault = (
            f"{function or 'a value'} that does not exist: {', '.join(f'{v:g}' for v in parameters[:, 0])}"
        )
        remedy = "sds, scales and degrees above 0, low below high" if function else "a finite number"
        yield plate.message(name, fault, remedy, key=key)
    elif proper and not np.isfinite(spread[0]) and node.belief is not None and node.belief.gaussian:
        fault = f"belief: gaussian, and {function} of {field} has no variance"
        yield plate.message(name, fault, "more than 2 degrees, or belief: particles", key=key)


def starts_are_said_once(plate: Plate) -> Iterator[GraphMessage]:
    """A field has one start prior; those of modes stand at the root."""
    for name, node in _roots(plate):
        if node.motion is None:
            continue
        for field in node.start:
            for key in _other_priors(node.motion, field):
                fault = f"start of {field} beside {'.'.join(map(str, key[2:]))}, which says it, too"
                yield plate.message(name, fault, "either of them", key=("start", field), on_key=True)
        for mode, settings in (node.modes or {}).items():
            if settings.motion is None:
                continue
            for key in _start_keys(settings.motion, BOX):
                fault = f"{key[-1]} in a mode: a target starts in no certain mode"
                remedy = f"start: {{x: normal(x, 5)}} of {name}, or the same key in its motion"
                yield plate.message(name, fault, remedy, key=("modes", mode, *key), on_key=True)


def _other_priors(motion: Motion, field: str) -> Iterator[KeyPath]:
    """Keys of a motion by which a field starts, that are written."""
    yield from _start_keys(motion, (field,))
    for word, fields in SDS_OF_KINEMATICS.items():
        if motion.expressions is None and field in fields and word in motion.settings.model_fields_set:
            yield ("motion", motion.kind, word)


def _start_keys(motion: Motion, fields: tuple[str, ...]) -> Iterator[KeyPath]:
    if motion.expressions is not None:
        for field in fields:
            declaration = motion.expressions.fields.get(field)
            if declaration is not None and (declaration.sd > 0 or declaration.start != 0):
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
                fault = "a start prior beside a grid, which starts in the cell of the start box"
                yield plate.message(name, fault, "particles or gaussian", key=key, on_key=True)
        sensors = sensors_of(plate)
        for field in (coordinate for coordinate in BOX if coordinate in keys and sensors):
            fault = f"start of {field}, and targets start with detections of {next(iter(sensors))}"
            remedy = "start of other fields: the sensor's sd says how well a detection places a target"
            yield plate.message(name, fault, remedy, key=keys[field], on_key=True)


def fields_of_the_box_start_in_it(plate: Plate) -> Iterator[GraphMessage]:
    """Of x, y, w, h in `fields` only an sd is written: they start around the start box."""
    for name, node in plate.inference.items():
        if node.motion is None or node.motion.expressions is None:
            continue
        fields = node.motion.expressions.fields
        for field in (coordinate for coordinate in BOX if coordinate in fields):
            if fields[field].start != 0:
                fault = f"start of {field}, which is that of the start box"
                remedy = f"an sd alone; or start: {{{field}: normal({field} + 10, 5)}} of {name}"
                key: KeyPath = ("motion", "expressions", "fields", field, "start")
                yield plate.message(name, fault, remedy, key=key, on_key=True)
        if len(node.motion.expressions.own) > 8:
            fault = f"{len(node.motion.expressions.own)} fields beside the box"
            key = ("motion", "expressions", "fields")
            yield plate.message(name, fault, "at most 8", key=key, on_key=True)


START_CHECKS: tuple[Check, ...] = (
    starts_can_be_read,
    starts_are_said_once,
    starts_are_held,
    fields_of_the_box_start_in_it,
)


def noises_can_be_read(plate: Plate) -> Iterator[GraphMessage]:
    """The sd of an error, or its distribution, is an expression of the state and exists."""
    for name, node in plate.agents.items():
        for quantity, text in noises_of(plate, node).items():
            key: KeyPath = ("agent", node.agent.cue, "sd", quantity)
            try:
                term = parse_value(text, names_of_measures(plate, node), error=True)
            except ExpressionError as error:
                message = plate.message(name, error.found, error.allowed, key=key)
                yield plate.at.inside(explain_name(message, error.word, error.near), error.at)
                continue
            fixed = {
                constant: plate.constants[constant]
                for constant in names_in(term)
                if constant in plate.constants
            }
            read = [
                variable
                for variable in names_in(term)
                if variable not in fixed and variable not in (DRAWN, "pi")
            ]
            if not read and not math.isfinite(float(log_values(term, {**fixed, DRAWN: np.zeros(1)})[0])):
                remedy = "an sd, a scale and degrees above 0"
                yield plate.message(name, f"{quantity} is {text!r}", remedy, key=key)


def noises_fit_the_belief(plate: Plate) -> Iterator[GraphMessage]:
    """A Gaussian learns nothing of a field that only noise reads, and `kalman` takes no such noise."""
    root = plate.inference[plate.roots[0]]
    for name, node in plate.agents.items():
        noises = noises_of(plate, node)
        if not noises or root.belief is None or root.belief.particles is not None:
            continue
        key: KeyPath = ("agent", node.agent.cue, "sd")
        if root.belief.gaussian is not None and root.belief.gaussian.filter == "kalman":
            fault = "an sd by an expression beside filter: kalman, which is of Gaussian noise that is known"
            yield plate.message(name, fault, "filter: extended or unscented", key=key, on_key=True)
        if latent_above(plate, node.parent) is not None and root.belief.gaussian is not None:
            fault = "an sd by an expression below a latent node, and belief: gaussian"
            yield plate.message(name, fault, "belief: particles, or a number", key=key, on_key=True)
        for quantity, text in noises.items():
            unread = [
                field for field in _read_by(text) if root.belief.gaussian and _is_noise_alone(plate, field)
            ]
            if unread:
                fault = f"belief: gaussian learns nothing of {unread[0]}, which only noise reads"
                yield plate.message(name, fault, "belief: particles", key=(*key, quantity))


def _read_by(text: str) -> list[str]:
    try:
        return names_in(parse(text, error=True))
    except ExpressionError:
        return []


def _is_noise_alone(plate: Plate, field: str) -> bool:
    """True of a field of the root's own that no drift of another one and no measurement reads."""
    root = plate.inference[plate.roots[0]]
    motions = [root.motion, *(mode.motion for mode in (root.modes or {}).values())]
    texts = [text for node in plate.agents.values() for text in node.measures.values()]
    owned = False
    for motion in motions:
        if motion is not None and motion.expressions is not None:
            owned = owned or field in motion.expressions.own
            texts += [str(text) for name, text in motion.expressions.drift.items() if name != field]
    texts += [factor.expression for factor in plate.factors.values()]
    quantities = [
        quantity
        for node in plate.agents.values()
        if (cue := plate.cues.get(node.agent.cue)) is not None and cue.gives is not None
        for quantity in noises_of(plate, node)
    ]
    return owned and field not in quantities and not any(field in _read_by(text) for text in texts)


NOISE_CHECKS: tuple[Check, ...] = (noises_can_be_read, noises_fit_the_belief)
