"""The checks of a motion's further settings: beliefs that can hold them, and what each needs to act on."""

from __future__ import annotations

from collections.abc import Iterator

from pydantic import ValidationError

from bayesnet_track.graph.checks.cues import declares, plugin_parameters
from bayesnet_track.graph.checks.plates import Check, Plate
from bayesnet_track.graph.settings.motion import BoxVelocity, Moving
from bayesnet_track.graph.text.explain import explain
from bayesnet_track.graph.text.messages import GraphMessage, Path
from bayesnet_track.observation.cue import CueDeclaration
from bayesnet_track.observation.detector import ENTRY_POINT_GROUP, installed_detectors
from bayesnet_track.observation.plugins import why_absent

_DETECTOR = ("relocalize", "by", "detector")


def _moving(plate: Plate) -> Iterator[tuple[str, Path, Moving]]:
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
        own = {"sd_px", *BoxVelocity.model_fields.keys() - Moving.model_fields.keys()}
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
    """Whether a latent node is above it (for a valid tree)."""
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
