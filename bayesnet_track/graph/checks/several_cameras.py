"""Views of several cameras: a node for each, with copies of what stands below it; and their checks."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import TypeVar

from bayesnet_track.graph.checks.lifecycle import GraphCheck, agents_of_detections
from bayesnet_track.graph.checks.plates import Check, Plate, camera_above
from bayesnet_track.graph.settings.base import Choice
from bayesnet_track.graph.settings.net import InferenceNode, Node
from bayesnet_track.graph.spec import GraphSpec, Target
from bayesnet_track.graph.text.messages import GraphMessage, Positions
from bayesnet_track.observation.detector import GIVEN


def per_camera(target: Target, cameras: Sequence[str]) -> Target:
    """The target with a view for each camera that a node names in a list, and what is below it for each.

    `view` with ``camera: [north, south]`` becomes `view.north` and `view.south`, an agent `seen` below it
    `seen.north` and `seen.south`. They stand in the order of `cameras`, those of the graph, however the list
    has them: the order in which cameras are taken into account.
    """
    lists = {
        name: [camera for camera in (*cameras, *node.seen_by) if camera in node.seen_by]
        for name, node in target.nodes.items()
        if isinstance(node, InferenceNode) and isinstance(node.camera, tuple)
    }
    if not lists:
        return target
    copies = {
        name: list(dict.fromkeys(lists[view])) for name in target.nodes if (view := _list_above(target, name))
    }
    nodes: dict[str, Node] = {}
    for name, node in target.nodes.items():
        for camera in copies.get(name, ("",)):
            nodes[_copy_name(name, camera)] = _renamed(node, camera, copies)
    return target.model_copy(update={"nodes": nodes})


def _list_above(target: Target, name: str) -> str | None:
    """The node with a list of cameras at a node or above it."""
    passed: set[str] = set()
    while name in target.nodes and name not in passed:
        passed.add(name)
        node = target.nodes[name]
        if isinstance(node, InferenceNode) and isinstance(node.camera, tuple):
            return name
        if node.parent is None:
            return None
        name = node.parent
    return None


def _copy_name(name: str, camera: str) -> str:
    return f"{name}.{camera}" if camera else name


def _renamed(node: Node, camera: str, copies: Mapping[str, Sequence[str]]) -> Node:
    """A node of one camera, or of none; the nodes that it names are copies."""

    def known_as(name: str) -> list[str]:
        if name not in copies:
            return [name]
        return [_copy_name(name, copy_camera) for copy_camera in ((camera,) if camera else copies[name])]

    update: dict[str, object] = {}
    if node.parent is not None and node.parent in copies:
        update["parent"] = _copy_name(node.parent, camera)
    if isinstance(node, InferenceNode):
        if isinstance(node.camera, tuple):
            update |= {"camera": camera, "parent": node.parent}
        if node.adapt is not None and node.adapt.agents is not None:
            agents = tuple(copy for name in node.adapt.agents for copy in known_as(name))
            update["adapt"] = node.adapt.model_copy(update={"agents": agents})
        if node.fuse is not None and isinstance(node.fuse.pool, Mapping):
            shares = {copy: share for name, share in node.fuse.pool.items() for copy in known_as(name)}
            update["fuse"] = without_remembered(node.fuse.model_copy(update={"pool": shares}))
    return node.model_copy(update=update)


Chosen = TypeVar("Chosen", bound=Choice)


def without_remembered(choice: Chosen) -> Chosen:
    """A changed copy without what was remembered of the choice as it was written."""
    for key in ("kind", "settings"):
        choice.__dict__.pop(key, None)
    return choice


def lists_name_cameras(spec: GraphSpec, positions: Positions) -> Iterator[GraphMessage]:
    """A list of cameras has each camera of the graph once at most, and no other."""
    for plate, target in spec.targets.items():
        for name, node in target.nodes.items():
            if not isinstance(node, InferenceNode) or not isinstance(node.camera, tuple):
                continue
            path = ("targets", plate, "nodes", name, "camera")
            for number, camera in enumerate(node.camera):
                if camera not in spec.cameras:
                    remedy = [*spec.cameras] or f"cameras: {{{camera}: {{calibration: ..}}}}"
                    yield positions.message(
                        (*path, number), f"unknown camera {camera!r}", remedy, word=camera
                    )
                elif camera in node.camera[:number]:
                    fault = f"camera {camera!r} twice: its evidence would count twice"
                    yield positions.message((*path, number), fault, "each camera once")


def cameras_are_different(spec: GraphSpec, positions: Positions) -> Iterator[GraphMessage]:
    """No two cameras have the same calibration: one stream under two names would count twice."""
    nodes = [node for target in spec.targets.values() for node in target.nodes.values()]
    viewed = {name for node in nodes if isinstance(node, InferenceNode) for name in node.seen_by}
    first: dict[str, str] = {}
    for name, source in spec.cameras.items():
        earlier = first.setdefault(source.key, name) if name in viewed else name
        if earlier != name:
            fault = f"the calibration of {earlier!r} at camera {name!r}: its evidence would count twice"
            yield positions.message(
                ("cameras", name, "calibration"), fault, "the calibration of another camera"
            )


def births_by_several_cameras_are_given(plate: Plate) -> Iterator[GraphMessage]:
    """Births of targets that several cameras see are by detections of each camera, which are given."""
    if len(plate.cameras) < 2 or not plate.spec.is_ground:
        return
    names = ", ".join(plate.cameras)
    birth = plate.spec.birth
    if birth is not None and birth.detector.detector != GIVEN:
        path = ("targets", plate.name, "birth", "detector")
        fault = f"births by {birth.detector.detector} beside several cameras ({names})"
        yield plate.at.message(path, fault, f"{GIVEN}: those of each camera are given")
    if birth is not None and not agents_of_detections(plate):
        fault = (
            f"targets that several cameras see ({names}) without an agent whose free detections start them"
        )
        remedy = "agent: detection below the view, beside those that look at the image"
        yield plate.at.message(("targets", plate.name), fault, remedy, on_key=True)
    for name, node in plate.inference.items():
        if node.fuse is not None and node.fuse.latent is not None and camera_above(plate.spec, name):
            fault = f"fuse: latent below one of several cameras ({names})"
            yield plate.message(name, fault, ["product", "pool"], key=("fuse", "latent"), on_key=True)


def first_clock_is_that_of_the_run(spec: GraphSpec, positions: Positions) -> Iterator[GraphMessage]:
    """The first camera has no clock to learn: all others are compared with it."""
    first = next(iter(spec.cameras), None)
    if first is not None and spec.cameras[first].clock is not None:
        fault = f"clock of {first!r}, the first camera, whose clock is that of the run"
        remedy = "clock at the other cameras; the first one is the reference"
        yield positions.message(("cameras", first, "clock"), fault, remedy, on_key=True)


def clocks_can_be_learnt(plate: Plate) -> Iterator[GraphMessage]:
    """A clock shows by what moves: states have velocities, and beliefs covariances with the offset."""
    late = [name for node in plate.inference.values() for name in node.seen_by if _has_clock(plate, name)]
    if not late or not plate.spec.is_ground:
        return
    for name in plate.roots:
        node = plate.inference[name]
        if node.motion is not None and node.motion.kind != "constant_velocity":
            fault = f"{node.motion.kind} beside the clock of {late[0]}, which shows by velocities"
            yield plate.message(
                name, fault, "constant_velocity", key=("motion", node.motion.kind), on_key=True
            )
        if node.belief is None or node.belief.gaussian is None:
            fault = f"a belief by particles beside the clock of {late[0]}, which all targets share"
            yield plate.message(name, fault, "belief: {gaussian: ..}, or no clock", key=("belief",))


def _has_clock(plate: Plate, camera: str) -> bool:
    return camera in plate.sources and plate.sources[camera].clock is not None


def cameras_can_be_switched(spec: GraphSpec, positions: Positions) -> Iterator[GraphMessage]:
    """Cameras are switched where several see targets that have an existence; else they have no cost."""
    costs = [name for name, source in spec.cameras.items() if "cost" in source.model_fields_set]
    if spec.adapt is None:
        for name in costs:
            fault = f"cost of camera {name!r}, and all cameras are on"
            yield positions.message(
                ("cameras", name, "cost"), fault, "adapt: {cost_per_step: ..}, or no cost", on_key=True
            )
        return
    nodes = [node for target in spec.targets.values() for node in target.nodes.values()]
    viewed = {name for node in nodes if isinstance(node, InferenceNode) for name in node.seen_by}
    if len(viewed) < 2:
        fault = f"adapt of cameras, and views by {', '.join(sorted(viewed)) or 'none'}"
        yield positions.message(("adapt",), fault, "views by two cameras or more", on_key=True)
    for plate, target in spec.targets.items():
        if target.is_ground and target.existence is None:
            fault = f"adapt of cameras, and no probability that a target of {plate} exists"
            yield positions.message(("targets", plate), fault, "existence: {}", on_key=True)


SEVERAL_GRAPH_CHECKS: tuple[GraphCheck, ...] = (
    lists_name_cameras,
    cameras_are_different,
    first_clock_is_that_of_the_run,
    cameras_can_be_switched,
)

SEVERAL_CHECKS: tuple[Check, ...] = (births_by_several_cameras_are_given, clocks_can_be_learnt)
