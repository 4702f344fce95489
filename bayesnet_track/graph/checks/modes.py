"""The checks of modes: a chain that is whole, modes that differ, and beliefs that hold them."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from math import isclose

from bayesnet_track.graph.checks.plates import Check, Plate
from bayesnet_track.graph.settings.motion import Mode, Motion
from bayesnet_track.graph.spec import GraphSpec, InferenceNode
from bayesnet_track.graph.text.messages import GraphMessage, KeyPath, Positions

WHOLE_TARGET = ("inflate", "size_reversion", "camera", "relocalize", "sd_angle_deg")
"""Settings of the node's motion that hold in every mode."""


_PLAIN = ("random_walk", "constant_velocity", "damped_velocity", "constant_acceleration")


def _with_modes(plate: Plate) -> Iterator[tuple[str, InferenceNode, Mapping[str, Mode]]]:
    for name, node in plate.inference.items():
        if node.modes is not None:
            yield name, node, node.modes


def modes_follow_each_other(plate: Plate) -> Iterator[GraphMessage]:
    """Every mode has a duration or a row of the transition matrix, all in one of the two ways."""
    for name, _, modes in _with_modes(plate):
        if len(modes) == 1:
            found, allowed = "one mode, which the target could never leave", "at least two modes"
            yield plate.message(name, found, allowed, key=("modes",), on_key=True)
        ways = {key for one in modes.values() for key in ("mean_frames", "next") if getattr(one, key)}
        if len(ways) == 2:
            found = "modes with mean_frames beside modes with next"
            yield plate.message(name, found, "mean_frames for all, or next for all", key=("modes",))
            continue
        for mode, one in modes.items():
            here = ("modes", mode)
            if one.mean_frames is None and one.next is None:
                found = f"mode {mode!r} without how long it lasts"
                yield plate.message(name, found, ["mean_frames", "next"], key=here)
            if one.then is not None and one.next is not None:
                found = "then beside next, which says it already"
                yield plate.message(name, found, "one of then, next", key=(*here, "then"), on_key=True)
            yield from _rows_name_modes(plate, name, modes, mode)


def _rows_name_modes(plate: Plate, name: str, modes: Mapping[str, Mode], mode: str) -> Iterator[GraphMessage]:
    one = modes[mode]
    for key, row in (("then", one.then), ("next", one.next)):
        for other in row or ():
            path = ("modes", mode, key, other)
            if other not in modes:
                found = f"no mode {other!r}"
                yield plate.message(name, found, list(modes), key=path, word=other, on_key=True)
            elif key == "then" and other == mode:
                found = f"then of {mode!r} names itself: mean_frames says how long it stays"
                yield plate.message(name, found, [m for m in modes if m != mode], key=path, on_key=True)
    if one.next is not None and not isclose(sum(one.next.values()), 1.0, abs_tol=1e-6):
        found = f"probabilities that sum to {sum(one.next.values()):.6g}"
        yield plate.message(name, found, "probabilities that sum to 1", key=("modes", mode, "next"))


def modes_differ(plate: Plate) -> Iterator[GraphMessage]:
    """The target can be seen in some mode, and no two are the same to look at."""
    for name, node, modes in _with_modes(plate):
        if all(one.hidden is not None for one in modes.values()):
            found = "every mode is hidden: the target could never be seen"
            yield plate.message(name, found, "at least one mode without hidden", key=("modes",), on_key=True)
        seen: list[tuple[str, Motion | None, bool]] = []
        for mode, one in modes.items():
            motion, hidden = one.motion or node.motion, one.hidden is not None
            same = [before for before, moved, was in seen if (moved, was) == (motion, hidden)]
            if same:
                found = f"mode {mode!r} cannot be distinguished from {same[0]!r}: they have the same motion"
                allowed = "a motion of its own, or hidden"
                yield plate.message(name, found, allowed, key=("modes", mode), on_key=True)
            seen.append((mode, motion, hidden))


def modes_move_plainly(plate: Plate) -> Iterator[GraphMessage]:
    """A mode's motion is noise and kinematics; what else is known of it holds for the whole target."""
    for name, node, modes in _with_modes(plate):
        motions: dict[KeyPath, Motion | None] = {("motion",): node.motion}
        motions |= {("modes", mode, "motion"): one.motion for mode, one in modes.items()}
        key: KeyPath
        for key_of_motion, motion in motions.items():
            if motion is not None and motion.expressions is not None:
                key = (*key_of_motion, "expressions")
                yield plate.message(name, "expressions beside modes", _PLAIN, key=key, on_key=True)
            elif motion is not None and motion.settings.borders is not None:
                key = (*key_of_motion, motion.kind, "borders")
                yield plate.message(name, "borders beside modes", "no borders", key=key, on_key=True)
        for mode, one in modes.items():
            if one.motion is None or one.motion.expressions is not None:
                continue
            for word in WHOLE_TARGET:
                if getattr(one.motion.settings, word):
                    key = ("modes", mode, "motion", one.motion.kind, word)
                    found = f"{word} in the motion of a mode"
                    yield plate.message(
                        name,
                        found,
                        f"{word} in the node's motion: it holds in every mode",
                        key=key,
                        on_key=True,
                    )


def beliefs_hold_modes(plate: Plate) -> Iterator[GraphMessage]:
    """Particles by bootstrap or Gaussians; no births; no latent node where it can be hidden."""
    for name, node, modes in _with_modes(plate):
        belief = node.belief
        if plate.spec.birth is not None:
            found = "modes of targets with birth: detections are associated by one way to move"
            yield plate.message(name, found, "no birth, or no modes", key=("modes",), on_key=True)
        if belief is not None and belief.grid is not None:
            found = "modes beside a grid, which has no cells for them"
            yield plate.message(name, found, "particles or gaussian", key=("modes",), on_key=True)
        if belief is not None and belief.particles is not None:
            kind = belief.particles.proposal.kind
            if kind != "bootstrap":
                found = f"modes beside proposal: {kind}, which knows one way to move"
                yield plate.message(name, found, "proposal: bootstrap", key=("modes",), on_key=True)
        if not any(one.hidden is not None for one in modes.values()):
            continue
        for other, below in plate.inference.items():
            if below.fuse is not None and below.fuse.latent is not None:
                found = "fuse: latent in a target that can be hidden"
                yield plate.message(other, found, "product or pool", key=("fuse", "latent"), on_key=True)


def noise_has_the_same_fields(plate: Plate) -> Iterator[GraphMessage]:
    """In every mode the same fields have noise: densities over others could not be compared."""
    for name, node, modes in _with_modes(plate):
        if node.belief is not None and node.belief.gaussian is not None:
            continue
        motions = [node.motion, *(one.motion for one in modes.values())]
        if node.motion is None or any(one is not None and one.expressions is not None for one in motions):
            continue
        usual = _noisy(node.motion)
        for mode, one in modes.items():
            own = usual if one.motion is None else _noisy(one.motion)
            if own != usual and one.motion is not None:
                found = (
                    f"mode {mode!r} has noise of {_listed(own)}, and the node's motion of {_listed(usual)}"
                )
                key = ("modes", mode, "motion", one.motion.kind)
                yield plate.message(name, found, "noise of the same fields", key=key)


def _listed(fields: tuple[str, ...]) -> str:
    return ", ".join(fields) or "nothing"


def _noisy(motion: Motion) -> tuple[str, ...]:
    """The fields of the box with noise."""
    settings = motion.settings
    driven = getattr(settings, "sd_velocity_px", 0.0) + getattr(settings, "sd_acceleration_px", 0.0) > 0
    px, box, log = settings.sd_px, settings.sd_box, settings.sd_log
    if log.scale > 0 or log.aspect > 0:
        sized = px.w > 0 or px.h > 0
        size = {"scale": sized or log.scale > 0, "aspect": sized or log.aspect > 0}
    else:
        size = {"w": px.w > 0, "h": px.h > 0}
    noisy = {"x": driven or px.x + box.x > 0, "y": driven or px.y + box.y > 0, **size}
    return tuple(field for field, has in noisy.items() if has)


def modes_are_not_joined(spec: GraphSpec, at: Positions) -> Iterator[GraphMessage]:
    """Targets with modes are in no joins."""
    for number, join in enumerate(spec.joins):
        for kind in join.between or tuple(spec.targets):
            target = spec.targets.get(kind)
            for name, node in () if target is None else target.nodes.items():
                if isinstance(node, InferenceNode) and node.modes is not None:
                    found = f"a join of {kind}, whose node {name} has modes"
                    yield at.message(("joins", number), found, "kinds without modes")


MODE_CHECKS: tuple[Check, ...] = (
    modes_follow_each_other,
    modes_differ,
    modes_move_plainly,
    beliefs_hold_modes,
    noise_has_the_same_fields,
)
