"""Checks of cameras, of their views, and of states on the ground, whose units are metres and seconds."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from hashlib import sha256
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import ValidationError

from bayesnet_track.graph.checked import BY_PLACE, CLOCK, RATE, Calibration, LastingError, NamedCamera
from bayesnet_track.graph.checks.cues import cue_parameters
from bayesnet_track.graph.checks.lifecycle import GraphCheck
from bayesnet_track.graph.checks.plates import Check, Plate, is_seen, written_name
from bayesnet_track.graph.checks.several_cameras import (
    SEVERAL_CHECKS,
    SEVERAL_GRAPH_CHECKS,
    without_remembered,
)
from bayesnet_track.graph.settings.base import Model, PluginChoice
from bayesnet_track.graph.settings.cameras import METRES, CameraSource
from bayesnet_track.graph.settings.motion import Motion
from bayesnet_track.graph.spec import AgentNode, FactorNode, GraphSpec, InferenceNode, Target
from bayesnet_track.graph.text.messages import GraphMessage, KeyPath, Positions
from bayesnet_track.graphs import graph_folder
from bayesnet_track.numerics.cameras import Camera
from bayesnet_track.observation.calibrations import read_calibration


class AnyCalibration(Mapping[str, Calibration]):
    """One for every name, of a camera that looks down: to show a graph, not run it."""

    def __getitem__(self, name: str) -> Calibration:
        """Of a camera one metre above the ground."""
        rotation = np.diag([1.0, -1.0, -1.0])
        return Calibration(
            Path(name), "", Camera(np.eye(3), np.zeros(0), rotation, np.array([0.0, 0.0, 1.0]))
        )

    def __iter__(self) -> Iterator[str]:
        """Nothing: there is one for every name."""
        return iter(())

    def __len__(self) -> int:
        """None that can be listed."""
        return 0


ON_GROUND = "state: {ground: {unit: m}}"


def calibrations_of(
    spec: GraphSpec, folder: Path, overrides: Mapping[str, Calibration] | None = None
) -> dict[str, Calibration | str]:
    """Path as written -> the calibration, or what is wrong with it; of `overrides` as it is given there.

    Others are looked for in `folder`, then among the installed graphs.
    """
    calibrations: dict[str, Calibration | str] = {}
    for source in spec.cameras.values():
        key = source.key
        if key not in calibrations:
            calibrations[key] = (
                overrides[key] if overrides is not None and key in overrides else _read(source, folder)
            )
    return calibrations


def _read(source: CameraSource, folder: Path) -> Calibration | str:
    name = source.calibration
    local, installed = folder / name, Path(graph_folder()) / name
    path = local if local.exists() or not installed.is_file() else installed
    try:
        return read_file(path, source.name)
    except (ValueError, OSError) as error:
        return str(error)[:500]


def read_file(path: Path, name: str | None) -> Calibration:
    """The calibration in a file; raises ValueError and OSError."""
    camera = read_calibration(path) if name is None else read_calibration(path, name)
    camera.boxes(np.array([[0.0, 0.0, 1.0, 1.0]]))  # refuses a homography that says nothing of heights
    return Calibration(path, sha256(path.read_bytes()).hexdigest(), camera, name)


def cameras_can_be_read(
    spec: GraphSpec, positions: Positions, calibrations: Mapping[str, Calibration | str]
) -> Iterator[GraphMessage]:
    """Every camera has a calibration that can be read, and a view."""
    viewed = {name for target in spec.targets.values() for _, node in _nodes(target) for name in node.seen_by}
    for name, source in spec.cameras.items():
        path: KeyPath = ("cameras", name)
        wrong = calibrations[source.key]
        if isinstance(wrong, str):
            fault, _, remedy = wrong.partition("; allowed: ")
            remedy = remedy or "a calibration file, its path from where the graph file is"
            yield positions.message((*path, "calibration"), f"calibration: {fault}", remedy)
        if name not in viewed:
            fault = f"camera {name!r}, which no view looks through"
            yield positions.message(
                path, fault, f"a node with camera: {name}, or no such camera", on_key=True
            )


def units_are_of_the_state(spec: GraphSpec, positions: Positions) -> Iterator[GraphMessage]:
    """A state in metres takes no key in pixels, and one in pixels none in metres."""
    for name, target in spec.targets.items():
        for node_name, node in _nodes(target):
            path: KeyPath = ("targets", name, "nodes", node_name)
            if target.is_ground and not is_seen(target, node_name):
                yield from _in_pixels(node, path, positions)
            elif not target.is_ground and node.motion is not None:
                yield from _in_metres(node.motion, (*path, "motion", node.motion.kind), positions)
    grounds = [name for name, target in spec.targets.items() if target.is_ground]
    for name, query in spec.queries.items():
        if len(query.kinds) == 1 and query.kinds[0] in grounds:
            for kind, settings in (("count", query.count), ("crosses", query.crosses)):
                if settings is not None and settings.point == "foot":
                    path = ("queries", name, kind, "point")
                    fault = "point: foot of targets on the ground, whose x, y is the foot point"
                    yield positions.message(path, fault, "no such key", on_key=True)
        if query.crosses is None or len(query.kinds) != 1:
            continue
        is_ground, written = query.kinds[0] in grounds, query.crosses.model_fields_set
        for key, unit in (("hysteresis_px", "pixels"), ("hysteresis", "metres")):
            if key in written and is_ground == (unit == "pixels"):
                path = ("queries", name, "crosses", key)
                right = "hysteresis" if is_ground else "hysteresis_px"
                state = "metres" if is_ground else "pixels"
                fault = f"{key}, which is in {unit}, and the state is in {state}"
                yield positions.message(path, fault, right, on_key=True)


def _in_pixels(value: Any, path: KeyPath, positions: Positions) -> Iterator[GraphMessage]:
    """Keys in pixels of a part of the graph that is about metres."""
    if isinstance(value, PluginChoice) or not isinstance(value, Model):
        return
    for key in sorted(value.model_fields_set):
        if key.endswith(("_px", "_px2")):
            right = METRES.get(key) or ("ud_box" if key == "ud_px2" else "no such key")
            fault = f"{key}, which is in pixels, and the state is in metres"
            yield positions.message((*path, key), fault, right, on_key=True)
        elif getattr(value, key) is not None:
            yield from _in_pixels(getattr(value, key), (*path, key), positions)


def _in_metres(motion: Motion, path: KeyPath, positions: Positions) -> Iterator[GraphMessage]:
    for pixels, metres in METRES.items():
        if motion.expressions is None and metres in motion.settings.model_fields_set:
            fault = f"{metres}, which is in metres, and the state is in pixels"
            yield positions.message((*path, metres), fault, f"{pixels}; or {ON_GROUND}", on_key=True)


def grounds_stand_alone(spec: GraphSpec, positions: Positions) -> Iterator[GraphMessage]:
    """All targets are on the ground, whose time is in seconds, or none is; and they are not joined."""
    grounds = [name for name, target in spec.targets.items() if target.is_ground]
    if not grounds:
        return
    for name, target in spec.targets.items():
        if not target.is_ground:
            fault = f"a state in pixels beside {grounds[0]}, which is on the ground: its time is in seconds"
            yield positions.message(
                ("targets", name), fault, f"{ON_GROUND}, or a graph of its own", on_key=True
            )
    if spec.joins:
        fault = "joins of targets on the ground, whose boxes depend on the camera"
        yield positions.message(("joins",), fault, "no joins", on_key=True)


def views_are_of_cameras(plate: Plate) -> Iterator[GraphMessage]:
    """A view is below the state, looks through a known camera, and through one that no other view has."""
    looked_through: dict[str, str] = {}
    for name, node in plate.inference.items():
        if node.camera is None:
            continue
        key, camera = ("camera",), node.seen_by[0]
        if not plate.spec.is_ground:
            fault = f"camera at a node of {plate.name}, whose state is in pixels"
            yield plate.message(name, fault, ON_GROUND, key=key, on_key=True)
            continue
        if node.parent is None:
            fault = "camera at a node without a parent: a view is below the node that has the state"
            yield plate.message(name, fault, "parent: the node that has the motion", key=key, on_key=True)
        elif camera not in plate.cameras:
            if name == written_name(name):  # else it is said of the list
                fault = f"unknown camera {camera!r}"
                remedy = [*plate.cameras] or f"cameras: {{{camera}: {{calibration: ..}}}}"
                yield plate.message(name, fault, remedy, key=key, word=camera)
        elif camera in looked_through:
            first_view = written_name(looked_through[camera])
            fault = (
                f"a second view of camera {camera!r}, after {first_view!r}: its evidence would count twice"
            )
            yield plate.message(name, fault, f"agents below {first_view}", key=key)
        else:
            looked_through[camera] = name
        ancestor = node.parent
        while ancestor in plate.inference:
            if plate.inference[ancestor].camera is not None:
                fault = f"a view below the view {ancestor!r}, whose boxes are in pixels already"
                yield plate.message(name, fault, "parent: the node that has the state", key=("parent",))
                break
            ancestor = plate.inference[ancestor].parent
        if node.fuse is not None and node.fuse.latent is not None:
            fault = "fuse: latent at a view, whose hypotheses are those of its parent"
            yield plate.message(name, fault, ["product", "pool"], key=("fuse", "latent"), on_key=True)


def grounds_are_seen(plate: Plate) -> Iterator[GraphMessage]:
    """Agents that look at boxes in the image stand below a view."""
    if not plate.spec.is_ground:
        return
    if not any(node.camera is not None for node in plate.inference.values()):
        fault = "a state on the ground, and no view of it"
        remedy = "a node {parent: .., camera: ..}, and agents below it"
        yield plate.at.message(("targets", plate.name, "state"), fault, remedy)
        return
    views = ", ".join(
        dict.fromkeys(written_name(name) for name, node in plate.inference.items() if node.seen_by)
    )
    for name, node in plate.spec.nodes.items():
        if is_seen(plate.spec, name):
            continue
        if isinstance(node, AgentNode):
            declaration = plate.cues.get(node.agent.cue)
            if declaration is None or (declaration.gives is not None and not declaration.reads_detection):
                continue
            fault = f"{node.agent.cue} at {node.parent}, which is in metres: it is about boxes in the image"
            yield plate.message(name, fault, f"parent: {views}", key=("parent",))
        elif isinstance(node, FactorNode) and node.mask is not None:
            fault = f"a mask at {node.parent}, which is in metres"
            yield plate.message(name, fault, f"parent: {views}", key=("parent",))
        elif isinstance(node, InferenceNode) and node.fuse is not None and node.fuse.latent is not None:
            fault = "fuse: latent at a node in metres"
            yield plate.message(
                name, fault, f"a node below {views}, or no latent", key=("fuse", "latent"), on_key=True
            )


_WITHOUT = ("modes", "category", "score", "localization_error", "distractors", "guarantee", "alarm")


def grounds_need_no_pixels(plate: Plate) -> Iterator[GraphMessage]:
    """Motion, belief and rules of a state in metres do not depend on the frame or on a box in it."""
    if not plate.spec.is_ground:
        return
    for name in plate.roots:
        node = plate.inference[name]
        for key in _WITHOUT:
            if getattr(node, key) is not None:
                fault = f"{key} of a target on the ground: it is of boxes in the image"
                yield plate.message(name, fault, "no such key", key=(key,), on_key=True)
        if node.start_texts:
            fault = "start of a target on the ground, which starts where its first box stands"
            remedy = "state: {ground: {width: .., height: ..}}"
            yield plate.message(name, fault, remedy, key=("start",), on_key=True)
        if node.motion is not None:
            yield from _moves_freely(plate, name, node.motion)
        if node.belief is None:
            continue
        if node.belief.grid is not None:
            fault = "a grid, whose cells are pixels, and the state is in metres"
            yield plate.message(name, fault, "particles or gaussian", key=("belief", "grid"), on_key=True)
        particles, gaussian = node.belief.particles, node.belief.gaussian
        if particles is not None and particles.proposal.kind != "bootstrap":
            fault = f"proposal: {particles.proposal.kind} of a state on the ground"
            yield plate.message(
                name, fault, "bootstrap", key=("belief", "particles", "proposal"), on_key=True
            )
        if gaussian is not None and gaussian.filter == "kalman":
            fault = "filter: kalman beside a view, whose boxes are not linear in the state"
            yield plate.message(
                name, fault, ["extended", "unscented"], key=("belief", "gaussian"), on_key=True
            )
    for key in ("merge_duplicates", "reidentify"):
        if getattr(plate.spec, key) not in (None, "never"):
            fault = f"{key} of targets on the ground, which compares boxes in one image"
            path = ("targets", plate.name, key)
            yield plate.at.message(path, fault, "never, or no such key", on_key=True)


def _moves_freely(plate: Plate, name: str, motion: Motion) -> Iterator[GraphMessage]:
    key: KeyPath = ("motion", motion.kind)
    if motion.box_velocity is not None:
        yield plate.message(name, "box_velocity on the ground", "constant_velocity", key=key, on_key=True)
        return
    if plate.spec.is_space and motion.expressions is not None:
        fault = "a motion by expressions of a state in space, whose z moves as x and y do"
        yield plate.message(name, fault, "constant_velocity", key=key, on_key=True)
    elif (
        not plate.spec.is_space and getattr(motion.settings, "sd", None) is not None and motion.settings.sd.z
    ):
        fault = "sd of z, and the state is on the ground"
        yield plate.message(name, fault, "state: {space: ..}", key=(*key, "sd", "z"), on_key=True)
    settings = motion.settings
    if not settings.is_plain or settings.borders is not None or settings.sd_angle_deg > 0:
        fault = "a motion that depends on the image, and the state is on the ground"
        yield plate.message(name, fault, "noise and kinematics alone", key=key, on_key=True)


def views_of_detections(plate: Plate) -> Iterator[GraphMessage]:
    """Detections below views are weighed by `existence`, by their density around what is expected."""
    if not plate.spec.is_ground:
        return
    for name, node in plate.agents.items():
        declaration = plate.cues.get(node.agent.cue)
        if declaration is None or not declaration.reads_detection:
            continue
        if plate.spec.existence is None:
            fault = "detections of targets on the ground without existence, which says what a false one is"
            remedy = f"existence: {{}} in targets.{plate.name}"
            yield plate.message(name, fault, remedy, key=("agent",), on_key=True)
        try:
            parameters: Any = cue_parameters(node.agent, declaration)
        except ValidationError:
            continue  # said where parameters are checked
        for key in _compares_boxes(parameters):
            fault = f"{key} compares boxes in the image from frame to frame, and the state is on the ground"
            path = ("agent", node.agent.cue, key)
            yield plate.message(name, fault, "no such key", key=path, on_key=True)


def slow_errors_are_on_the_ground(plate: Plate) -> Iterator[GraphMessage]:
    """Errors of detections that change slowly are fields of a Gaussian state on the ground."""
    for name, node in plate.agents.items():
        slow = _slow(plate, name)
        if not any(slow[:2]):
            continue
        key = ("agent", node.agent.cue, "sd_place_slow" if slow[0] else "sd_size_slow")
        root = next((plate.inference[root_name] for root_name in plate.roots), None)
        if not plate.spec.is_ground:
            reason = "of a target whose state is in pixels, where a slow error is one of the place itself"
            fault = f"{key[-1]} {reason}"
            yield plate.message(name, fault, f"no such key, or {ON_GROUND}", key=key, on_key=True)
        elif root is not None and (root.belief is None or root.belief.gaussian is None):
            fault = f"{key[-1]} beside particles, which weigh a detection as if errors were independent"
            yield plate.message(name, fault, "belief: {gaussian: ..}, or no such key", key=key, on_key=True)


def _slow(plate: Plate, agent: str) -> tuple[float, float, float]:
    """Sd of slow errors of place and size of an agent's detections, and the time that they last, s."""
    node = plate.agents[agent]
    declaration = plate.cues.get(node.agent.cue)
    if declaration is None or not declaration.reads_detection:
        return 0.0, 0.0, 0.0
    try:
        parameters: Any = cue_parameters(node.agent, declaration)
    except ValidationError:
        return 0.0, 0.0, 0.0  # said where parameters are checked
    place, size = (float(getattr(parameters, f"sd_{quantity}_slow", 0.0)) for quantity in ("place", "size"))
    return place, size, float(getattr(parameters, "slow_over_s", 0.0))


def read_lasting(plate: Plate) -> tuple[LastingError, ...]:
    """Errors that last, of the cameras and the detections of a plate that passed the checks."""
    errors = []
    for view, node in plate.inference.items():
        for bias in (plate.sources[camera].bias_px for camera in node.seen_by):
            if bias is None:
                continue
            errors += [LastingError(view, axis, bias.sd, bias.over_s, True) for axis in "xy"]
            if bias.sd_by_place:
                errors += [
                    LastingError(view, axis, bias.sd_by_place, bias.over_s, False) for axis in BY_PLACE
                ]
        for clock in (plate.sources[camera].clock for camera in node.seen_by):
            if clock is None:
                continue
            errors.append(LastingError(view, CLOCK, clock.offset_s.sd, math.inf, True))
            if clock.rate is not None:
                errors.append(LastingError(view, RATE, clock.rate.sd, math.inf, True))
    for agent in plate.agents:
        place, size, over_s = _slow(plate, agent)
        for axes, sd in (("xy", place), ("wh", size)):
            errors += [LastingError(agent, axis, sd, over_s, False) for axis in axes if sd > 0.0]
    return tuple(errors)


def _compares_boxes(parameters: Any) -> Iterator[str]:
    if getattr(parameters, "sd", None):
        yield "sd"
    for key, default in {
        "similarity": "density",
        "min_overlap": None,
        "continue_box": None,
        "recover": False,
        "re_update": False,
        "direction": 0.0,
        "first_score": 0.0,
    }.items():
        if getattr(parameters, key, default) not in (default, 0):
            yield key


def _nodes(target: Target) -> Iterator[tuple[str, InferenceNode]]:
    for name, node in target.nodes.items():
        if isinstance(node, InferenceNode):
            yield name, node


def in_units_of_the_state(target: Target) -> Target:
    """The target with its motions in one set of keys, those in pixels, whatever the state's unit is.

    From here on a number is in the unit of the state.
    """
    if not target.is_ground:
        return target
    nodes = dict(target.nodes)
    for name, node in _nodes(target):
        if node.motion is None or node.motion.expressions is not None:
            continue
        settings = node.motion.settings
        written = {
            pixels: value
            for pixels, metres in METRES.items()
            if (value := getattr(settings, metres, None)) is not None
        }
        motion = node.motion.model_copy(update={node.motion.kind: settings.model_copy(update=written)})
        nodes[name] = node.model_copy(update={"motion": without_remembered(motion)})
    return target.model_copy(update={"nodes": nodes})


def read_views(plate: Plate) -> dict[str, NamedCamera]:
    """View -> its camera, of a plate that passed the checks."""
    views = {}
    for name, node in plate.inference.items():
        for camera in node.seen_by:
            read = plate.cameras[camera]
            if isinstance(read, Calibration):
                views[name] = NamedCamera(camera, read.camera)
    return views


CAMERA_GRAPH_CHECKS: tuple[GraphCheck, ...] = (
    units_are_of_the_state,
    grounds_stand_alone,
    *SEVERAL_GRAPH_CHECKS,
)

CAMERA_CHECKS: tuple[Check, ...] = (
    views_are_of_cameras,
    grounds_are_seen,
    grounds_need_no_pixels,
    views_of_detections,
    *SEVERAL_CHECKS,
    slow_errors_are_on_the_ground,
)
