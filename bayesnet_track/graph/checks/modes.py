"""The checks of modes: a chain that is whole, modes that differ, and beliefs that hold them."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from math import isclose

from bayesnet_track.graph.checks.plates import Check, Plate, fields_of_motion
from bayesnet_track.graph.settings.motion import Mode, Motion
from bayesnet_track.graph.spec import InferenceNode
from bayesnet_track.graph.text.messages import GraphMessage, KeyPath

KINEMATIC = ("inflate", "size_reversion", "camera")
"""Settings that change the noise or the drift of a kinematic motion."""

WHOLE_TARGET = (*KINEMATIC, "relocalize", "sd_angle_deg", "borders")
"""Settings of the node's motion that hold in every mode."""


def _with_modes(plate: Plate) -> Iterator[tuple[str, InferenceNode, Mapping[str, Mode]]]:
    for name, node in plate.inference.items():
        if node.modes is not None:
            yield name, node, node.modes


def modes_follow_each_other(plate: Plate) -> Iterator[GraphMessage]:
    """Every mode has a duration or a row of the transition matrix, all in one of the two ways."""
    for name, _, modes in _with_modes(plate):
        if len(modes) == 1:
            fault, remedy = "one mode, which the target could never leave", "at least two modes"
            yield plate.message(name, fault, remedy, key=("modes",), on_key=True)
        ways = {
            key for settings in modes.values() for key in ("mean_frames", "next") if getattr(settings, key)
        }
        if len(ways) == 2:
            fault = "modes with mean_frames beside modes with next"
            yield plate.message(name, fault, "mean_frames for all, or next for all", key=("modes",))
            continue
        for mode, settings in modes.items():
            path = ("modes", mode)
            if settings.mean_frames is None and settings.next is None:
                fault = f"mode {mode!r} without how long it lasts"
                yield plate.message(name, fault, ["mean_frames", "next"], key=path)
            if settings.then is not None and settings.next is not None:
                fault = "then beside next, which says it already"
                yield plate.message(name, fault, "one of then, next", key=(*path, "then"), on_key=True)
            yield from _rows_name_modes(plate, name, modes, mode)


def _rows_name_modes(plate: Plate, name: str, modes: Mapping[str, Mode], mode: str) -> Iterator[GraphMessage]:
    settings = modes[mode]
    for key, row in (("then", settings.then), ("next", settings.next)):
        for successor in row or ():
            path = ("modes", mode, key, successor)
            if successor not in modes:
                fault = f"no mode {successor!r}"
                yield plate.message(name, fault, list(modes), key=path, word=successor, on_key=True)
            elif key == "then" and successor == mode:
                fault = f"then of {mode!r} names itself: mean_frames says how long it stays"
                yield plate.message(name, fault, [m for m in modes if m != mode], key=path, on_key=True)
    if settings.next is not None and not isclose(sum(settings.next.values()), 1.0, abs_tol=1e-6):
        fault = f"probabilities that sum to {sum(settings.next.values()):.6g}"
        yield plate.message(name, fault, "probabilities that sum to 1", key=("modes", mode, "next"))


def modes_differ(plate: Plate) -> Iterator[GraphMessage]:
    """The target can be seen in some mode, and no two are the same to look at."""
    for name, node, modes in _with_modes(plate):
        if all(settings.hidden is not None for settings in modes.values()):
            fault = "every mode is hidden: the target could never be seen"
            yield plate.message(name, fault, "at least one mode without hidden", key=("modes",), on_key=True)
        earlier: list[tuple[str, Motion | None, bool]] = []
        for mode, settings in modes.items():
            motion, hidden = settings.motion or node.motion, settings.hidden is not None
            same = [name for name, other_motion, was in earlier if (other_motion, was) == (motion, hidden)]
            if same:
                fault = f"mode {mode!r} cannot be distinguished from {same[0]!r}: they have the same motion"
                remedy = "a motion of its own, or hidden"
                if hidden:
                    fault = f"{fault.partition(':')[0]}: both are hidden, with the same motion"
                    remedy = f"one of {same[0]}, {mode}; or a motion of its own"
                yield plate.message(name, fault, remedy, key=("modes", mode), on_key=True)
            earlier.append((mode, motion, hidden))


def modes_move_by_themselves(plate: Plate) -> Iterator[GraphMessage]:
    """A mode's motion is noise and kinematics, or expressions; the rest holds for the whole target."""
    for name, node, modes in _with_modes(plate):
        for mode, settings in modes.items():
            if settings.motion is None:
                continue
            path: KeyPath = ("modes", mode, "motion", settings.motion.kind)
            for word in WHOLE_TARGET:
                if getattr(settings.motion.settings, word, None):
                    fault = f"{word} in the motion of a mode"
                    remedy = f"{word} in the node's motion: it holds in every mode"
                    yield plate.message(name, fault, remedy, key=(*path, word), on_key=True)
            if settings.motion.expressions is not None and node.motion is not None:
                yield from _expressions_move_alone(plate, name, mode, node.motion)
            if settings.motion.box_velocity is not None and (
                node.belief is None or node.belief.gaussian is None
            ):
                fault = f"box_velocity beside {'particles' if node.belief is None else node.belief.kind}"
                yield plate.message(
                    name, fault, "belief: {gaussian: {filter: kalman}}", key=path, on_key=True
                )


def _expressions_move_alone(plate: Plate, name: str, mode: str, motion: Motion) -> Iterator[GraphMessage]:
    """No setting that changes a kinematic motion stands beside one by expressions."""
    for word in KINEMATIC:
        if getattr(motion.settings, word, None):
            fault = f"{word}, which does not reach mode {mode!r}: that moves by expressions"
            remedy = f"no {word}; or a motion of {mode!r} without expressions"
            yield plate.message(name, fault, remedy, key=("motion", motion.kind, word), on_key=True)
    mode_motion = (plate.inference[name].modes or {})[mode].motion
    fields = () if mode_motion is None or mode_motion.expressions is None else mode_motion.expressions.own
    strange = [field for field in fields if field not in ("vx", "vy", "ax", "ay")]
    if motion.settings.borders is not None and strange:
        fault = f"borders: reflect, and mode {mode!r} has field {strange[0]!r}, which it cannot turn round"
        remedy = "fields vx, vy, ax, ay, or no borders"
        yield plate.message(name, fault, remedy, key=("motion", motion.kind, "borders"), on_key=True)


def beliefs_hold_modes(plate: Plate) -> Iterator[GraphMessage]:
    """Particles by bootstrap or Gaussians; no latent node below a Gaussian that a mode can hide."""
    for name, node in plate.inference.items():
        if node.modes is None and node.category is None:
            continue
        belief = node.belief
        key = "category" if node.modes is None else "modes"
        yield from _detections_are_not_filtered_anew(plate, name, key)
        if belief is not None and belief.grid is not None:
            fault = f"{key} beside a grid, which has no cells for {'it' if node.modes is None else 'them'}"
            yield plate.message(name, fault, "particles or gaussian", key=(key,), on_key=True)
        if belief is not None and belief.particles is not None:
            kind = belief.particles.proposal.kind
            if kind != "bootstrap":
                fault = f"{key} beside proposal: {kind}, which knows one way to move"
                yield plate.message(name, fault, "proposal: bootstrap", key=(key,), on_key=True)
        hides = any(mode.hidden is not None for mode in (node.modes or {}).values())
        if not hides or belief is None or belief.gaussian is None:
            continue
        for inner, inner_node in plate.inference.items():
            if inner_node.fuse is not None and inner_node.fuse.latent is not None:
                fault = (
                    "fuse: latent in a Gaussian target that can be hidden, whose draws say too little of how "
                    "probable that is"
                )
                remedy = "product or pool; or belief: particles at the root"
                yield plate.message(inner, fault, remedy, key=("fuse", "latent"), on_key=True)


def _detections_are_not_filtered_anew(plate: Plate, name: str, key: str) -> Iterator[GraphMessage]:
    for agent, node in plate.agents.items():
        if node.agent.parameters.get("re_update"):
            fault = f"{key} of {name} beside re_update, which filters a gap anew in one mode"
            yield plate.message(agent, fault, f"no re_update, or no {key}", key=("agent",))


def noise_has_the_same_fields(plate: Plate) -> Iterator[GraphMessage]:
    """In every mode the same fields have noise: densities over others could not be compared."""
    for name, node, modes in _with_modes(plate):
        if node.belief is not None and node.belief.gaussian is not None:
            continue
        if node.motion is None:
            continue
        motions = [
            node.motion,
            *(settings.motion for settings in modes.values() if settings.motion is not None),
        ]
        if any(motion.box_velocity is not None for motion in motions):
            continue
        fields = {
            field: sd for motion in reversed(sorted(motions, key=_length)) for field, sd in _starts(motion)
        }
        node_fields = _noisy(node.motion, fields)
        for mode, settings in modes.items():
            if settings.motion is None or (mode_fields := _noisy(settings.motion, fields)) == node_fields:
                continue
            fault = (
                f"mode {mode!r} has noise of {_listed(mode_fields)}, "
                f"and the node's motion of {_listed(node_fields)}"
            )
            key = ("modes", mode, "motion", settings.motion.kind)
            still = [field for field in node_fields if field not in mode_fields]
            give = f"; give {', '.join(still)} an sd in mode {mode!r}, as small as you like"
            mended = give if still and settings.motion.expressions is not None else ""
            yield plate.message(name, fault, f"noise of the same fields{mended}", key=key)


def _listed(fields: tuple[str, ...]) -> str:
    return ", ".join(fields) or "nothing"


def _length(motion: Motion) -> int:
    return -len(fields_of_motion(motion))


def _starts(motion: Motion) -> Iterator[tuple[str, float]]:
    """The fields beside the box, with their sds when the target starts."""
    if motion.expressions is not None:
        yield from ((name, field.sd) for name, field in motion.expressions.own.items())
        return
    sds = {"v": "start_velocity_sd_px", "a": "start_acceleration_sd_px"}
    for name in fields_of_motion(motion):
        yield name, float(getattr(motion.settings, sds.get(name[0], ""), 0.0) if name != "angle" else 0.0)


def _noisy(motion: Motion, starts: Mapping[str, float]) -> tuple[str, ...]:
    """The fields with noise; one that the motion does not have is drawn anew, by its sd at the start."""
    fields = fields_of_motion(motion)
    anew = [name for name, sd in starts.items() if name not in fields and sd > 0]
    if motion.expressions is not None:
        noise = {"x": False, "y": False, "w": False, "h": False} | {
            name: str(sd) not in ("0", "0.0") for name, sd in motion.expressions.sd.items()
        }
        driven_fields = [name for name, has in noise.items() if has]
    else:
        settings = motion.settings
        driven = getattr(settings, "sd_velocity_px", 0.0) + getattr(settings, "sd_acceleration_px", 0.0) > 0
        px, box, log = settings.sd_px, settings.sd_box, settings.sd_log
        if log.scale > 0 or log.aspect > 0:
            sized = px.w > 0 or px.h > 0
            size = {"scale": sized or log.scale > 0, "aspect": sized or log.aspect > 0}
        else:
            size = {"w": px.w > 0, "h": px.h > 0}
        noise = {"x": driven or px.x + box.x > 0, "y": driven or px.y + box.y > 0, **size}
        driven_fields = [name for name, has in noise.items() if has]
        driven_fields += [name for name in fields if name != "angle" and driven]
    order = ("x", "y", "w", "h", "scale", "aspect", *starts)
    return tuple(name for name in order if name in driven_fields or name in anew)


MODE_CHECKS: tuple[Check, ...] = (
    modes_follow_each_other,
    modes_differ,
    modes_move_by_themselves,
    beliefs_hold_modes,
    noise_has_the_same_fields,
)
