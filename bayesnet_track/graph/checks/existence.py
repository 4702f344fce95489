"""Checks of existence and association: what has to stand beside them, and settings that have an effect."""

from __future__ import annotations

from collections.abc import Iterator

from bayesnet_track.graph.checks.plates import Check, Plate
from bayesnet_track.graph.settings.lifecycle import Confirm
from bayesnet_track.graph.text.messages import GraphMessage


def existence_has_detections(plate: Plate) -> Iterator[GraphMessage]:
    """`existence` stands beside `birth`, without `confirm`, and an agent that measures by detections."""
    if plate.spec.existence is None:
        return
    path = ("targets", plate.name, "existence")
    birth = plate.spec.birth
    if birth is None:
        allowed = "birth, too, or no such key"
        yield plate.at.message(path, "existence without birth", allowed, on_key=True)
    if not _measuring(plate):
        found = "existence without an agent that measures by detections"
        yield plate.at.message(path, found, "agent: detection in a node, or no such key", on_key=True)
    if birth is not None and birth.confirm != Confirm():
        key = ("targets", plate.name, "birth", "confirm")
        found = "birth.confirm has no effect: existence.confirm says when a target is born"
        yield plate.at.message(key, found, "one of existence, birth.confirm", on_key=True)


def marginal_association_has_mixtures(plate: Plate) -> Iterator[GraphMessage]:
    """`associate: marginal` needs `existence`, a Gaussian belief, and detections measured at its root."""
    if plate.spec.associate != "marginal":
        return
    path = ("targets", plate.name, "associate")
    if plate.spec.existence is None:
        allowed = "existence, too (existence: {}), or associate: assignment"
        yield plate.at.message(path, "associate: marginal without existence", allowed)
    for name, node in plate.inference.items():
        if node.parent is None and (node.belief is None or node.belief.kind != "gaussian"):
            found = "associate: marginal with a belief that is not Gaussian"
            allowed = "belief: {gaussian: {filter: kalman}} at the root, or associate: assignment"
            yield plate.message(name, found, allowed, key=("belief",) if node.belief else ())
    for name in _measuring(plate):
        above = plate.agents[name].parent
        if above not in plate.roots:
            found = f"associate: marginal with an agent that measures by detections below {above}"
            yield plate.message(name, found, f"parent: {plate.roots[0]}", key=("parent",))


def lost_by_existence_has_existence(plate: Plate) -> Iterator[GraphMessage]:
    """`lost.existence_below` needs `existence`, lies above `existence.end`, and is the only rule."""
    rule = plate.spec.existence
    for name, node in plate.inference.items():
        level = None if node.lost is None else node.lost.existence_below
        if node.lost is None or level is None:
            continue
        key = ("lost", "existence_below")
        if rule is None:
            found = "lost.existence_below without existence"
            yield plate.message(name, found, "existence for the target, or no such key", key=key, on_key=True)
        elif level <= rule.end:
            found = f"lost.existence_below is {level:g}, not above existence.end, {rule.end:g}"
            yield plate.message(name, found, f"above {rule.end:g}", key=key)
        others = {"above", "fit_below", "score_below"} & node.lost.model_fields_set
        for other in sorted(others):
            found = f"lost.{other} has no effect: with existence_below existence alone says what is lost"
            allowed = f"one of {other}, existence_below"
            yield plate.message(name, found, allowed, key=("lost", other), on_key=True)


def _measuring(plate: Plate) -> list[str]:
    """The agents that measure by detections."""
    declared = {name: plate.cues.get(node.agent.cue) for name, node in plate.agents.items()}
    return [name for name, one in declared.items() if one is not None and one.reads_detection]


EXISTENCE_CHECKS: tuple[Check, ...] = (
    existence_has_detections,
    marginal_association_has_mixtures,
    lost_by_existence_has_existence,
)
