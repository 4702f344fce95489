"""Checks of a plate's life: installed detectors, parameters that these take, rules that can act."""

from __future__ import annotations

from collections.abc import Iterator

from pydantic import ValidationError

from bayesnet_track.graph.checks.cues import plugin_parameters
from bayesnet_track.graph.checks.plates import Check, Plate
from bayesnet_track.graph.text.explain import explain
from bayesnet_track.graph.text.messages import GraphMessage, Path
from bayesnet_track.observation.detector import ENTRY_POINT_GROUP, detectors_of_graphs
from bayesnet_track.observation.plugins import why_absent

DETECTOR = ("birth", "detector")


def detectors_are_installed(plate: Plate) -> Iterator[GraphMessage]:
    """Every `birth` names an installed detector, or `detections`; one of another package must be allowed."""
    birth = plate.spec.birth
    known = {} if birth is None else detectors_of_graphs([birth.detector.detector])
    if birth is not None and birth.detector.detector not in known:
        word = birth.detector.detector
        if (absent := why_absent(ENTRY_POINT_GROUP, word)) is not None:
            yield _message(plate, (*DETECTOR, word), f"detector {absent[0]}", absent[1], on_key=True)
            return
        yield _message(plate, (*DETECTOR, word), f"unknown detector {word!r}", list(known), word)


def parameters_fit_the_detector(plate: Plate) -> Iterator[GraphMessage]:
    """Every parameter is one that the detector declares, of its type and within its range."""
    birth = plate.spec.birth
    if birth is None:
        return
    word = birth.detector.detector
    declaration = detectors_of_graphs([word]).get(word)
    if declaration is None:
        return
    try:
        plugin_parameters(birth.detector, declaration.parameters)
    except ValidationError as error:
        path = ("targets", plate.name, *DETECTOR, declaration.name)
        yield from explain(error, declaration.parameters, birth.detector.parameters, plate.at, path)


def recall_has_a_detector(plate: Plate) -> Iterator[GraphMessage]:
    """`reidentify` needs `birth`: without detections there is nothing to recognise."""
    if plate.spec.reidentify is not None and plate.spec.birth is None:
        yield _message(
            plate, ("reidentify",), "reidentify without birth", "birth, too, or no such key", on_key=True
        )


def associating_agents_have_births(plate: Plate) -> Iterator[GraphMessage]:
    """An agent that measures by detections needs `birth`, whose detector gives them."""
    for name, node in plate.agents.items():
        declaration = plate.cues.get(node.agent.cue)
        if declaration is not None and declaration.reads_detection and plate.spec.birth is None:
            found = f"{node.agent.cue} without birth, whose detector would give it detections"
            yield plate.message(name, found, "birth, too", key=("agent",))


def tracks_are_gaussian(plate: Plate) -> Iterator[GraphMessage]:
    """Tentative tracks are given detections; they, and those filtered anew over a gap, are Gaussian."""
    birth, root = plate.spec.birth, plate.inference.get(plate.roots[0]) if plate.roots else None
    reading = [
        name
        for name, node in plate.agents.items()
        if node.agent.cue in plate.cues and plate.cues[node.agent.cue].reads_detection
    ]
    is_gaussian = root is not None and root.belief is not None and root.belief.gaussian is not None
    allowed = "belief: {gaussian: {filter: kalman}}"
    if birth is not None and birth.tentative:
        key = ("birth", "tentative")
        if not reading:
            found = "tentative without an agent that is given detections"
            yield _message(plate, key, found, "an agent: detection, too, or no tentative", on_key=True)
        elif not is_gaussian:
            yield _message(plate, key, "tentative beside a belief that is not gaussian", allowed, on_key=True)
    for name in reading:
        if plate.agents[name].agent.parameters.get("re_update") and not is_gaussian:
            found = "re_update beside a belief that is not gaussian"
            yield plate.message(name, found, allowed, key=("agent",))


def _message(
    plate: Plate,
    key: Path,
    found: str,
    allowed: str | list[str],
    word: str = "",
    on_key: bool = False,
) -> GraphMessage:
    path = ("targets", plate.name, *key)
    return plate.at.message(path, found, allowed, word=word, on_key=on_key or bool(word))


LIFE_CHECKS: tuple[Check, ...] = (
    detectors_are_installed,
    parameters_fit_the_detector,
    recall_has_a_detector,
    associating_agents_have_births,
    tracks_are_gaussian,
)
