"""Checks of the life of targets: births, ends, existence, association, and joins of those that meet."""

from __future__ import annotations

from collections.abc import Callable, Iterator

from pydantic import ValidationError

from bayesnet_track.graph.checks.cues import plugin_parameters
from bayesnet_track.graph.checks.plates import Check, Plate, is_seen
from bayesnet_track.graph.expressions.distributions import linear_normals_of
from bayesnet_track.graph.expressions.parse import parse
from bayesnet_track.graph.expressions.terms import ExpressionError, names_in
from bayesnet_track.graph.settings.lifecycle import Confirm, join_of
from bayesnet_track.graph.spec import GraphSpec, InferenceNode
from bayesnet_track.graph.text.explain import explain_errors
from bayesnet_track.graph.text.messages import GraphMessage, KeyPath, Positions
from bayesnet_track.observation.detector import ENTRY_POINT_GROUP, detectors_of_graphs
from bayesnet_track.observation.plugins import why_absent


def modes_are_joined(spec: GraphSpec, positions: Positions) -> Iterator[GraphMessage]:
    """Targets with modes are in no attachments; those that a mode can hide are in no joins of pixels."""
    for number, join in enumerate(spec.joins):
        for kind in dict.fromkeys(join.between or spec.targets):
            target = spec.targets.get(kind)
            for name, node in () if target is None else target.nodes.items():
                if not isinstance(node, InferenceNode) or (node.modes is None and node.category is None):
                    continue
                hides = any(mode.hidden is not None for mode in (node.modes or {}).values())
                path: KeyPath = ("joins", number)
                if join.attachment is not None:
                    fault = f"attachment of {kind}, whose node {name} has modes: being carried is a mode, too"
                    remedy = "kinds without modes"
                    if node.modes is None:
                        fault = (
                            f"attachment of {kind}, whose node {name} has a category, as if it were a mode"
                        )
                        remedy = "kinds without category"
                    yield positions.message((*path, "attachment"), fault, remedy, on_key=True)
                elif hides and join.factor is None:
                    fault = f"a join of {kind}, which a mode can hide: a hidden target has no pixels to share"
                    yield positions.message(path, fault, "a join with factor; or modes without hidden")


DETECTOR = ("birth", "detector")


def detectors_are_installed(plate: Plate) -> Iterator[GraphMessage]:
    """Every `birth` names an installed detector, or `detections`; one of another package must be allowed."""
    birth = plate.spec.birth
    detectors = {} if birth is None else detectors_of_graphs([birth.detector.detector])
    if birth is not None and birth.detector.detector not in detectors:
        word = birth.detector.detector
        if (absent := why_absent(ENTRY_POINT_GROUP, word)) is not None:
            yield _message(plate, (*DETECTOR, word), f"detector {absent[0]}", absent[1], on_key=True)
            return
        yield _message(plate, (*DETECTOR, word), f"unknown detector {word!r}", list(detectors), word)


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
        yield from explain_errors(error, declaration.parameters, birth.detector.parameters, plate.at, path)


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
            fault = f"{node.agent.cue} without birth, whose detector would give it detections"
            yield plate.message(name, fault, "birth, too", key=("agent",))


def tracks_are_gaussian(plate: Plate) -> Iterator[GraphMessage]:
    """Tentative tracks are given detections; they, and those filtered anew over a gap, are Gaussian."""
    birth, root = plate.spec.birth, plate.inference.get(plate.roots[0]) if plate.roots else None
    reading = [
        name
        for name, node in plate.agents.items()
        if node.agent.cue in plate.cues and plate.cues[node.agent.cue].reads_detection
    ]
    is_gaussian = root is not None and root.belief is not None and root.belief.gaussian is not None
    remedy = "belief: {gaussian: {filter: kalman}}"
    if birth is not None and birth.tentative:
        key = ("birth", "tentative")
        if not reading:
            fault = "tentative without an agent that is given detections"
            yield _message(plate, key, fault, "an agent: detection, too, or no tentative", on_key=True)
        elif not is_gaussian:
            yield _message(plate, key, "tentative beside a belief that is not gaussian", remedy, on_key=True)
    for name in reading:
        if plate.agents[name].agent.parameters.get("re_update") and not is_gaussian:
            fault = "re_update beside a belief that is not gaussian"
            yield plate.message(name, fault, remedy, key=("agent",))


def _message(
    plate: Plate,
    key: KeyPath,
    fault: str,
    remedy: str | list[str],
    word: str = "",
    on_key: bool = False,
) -> GraphMessage:
    path = ("targets", plate.name, *key)
    return plate.at.message(path, fault, remedy, word=word, on_key=on_key or bool(word))


LIFE_CHECKS: tuple[Check, ...] = (
    detectors_are_installed,
    parameters_fit_the_detector,
    recall_has_a_detector,
    associating_agents_have_births,
    tracks_are_gaussian,
)


def existence_has_detections(plate: Plate) -> Iterator[GraphMessage]:
    """`existence` stands beside `birth`, without `confirm`, and an agent that measures by detections."""
    if plate.spec.existence is None:
        return
    path = ("targets", plate.name, "existence")
    birth = plate.spec.birth
    if birth is None:
        remedy = "birth, too, or no such key"
        yield plate.at.message(path, "existence without birth", remedy, on_key=True)
    if not agents_of_detections(plate):
        fault = "existence without an agent that measures by detections"
        yield plate.at.message(path, fault, "agent: detection in a node, or no such key", on_key=True)
    if birth is not None and birth.confirm != Confirm():
        key = ("targets", plate.name, "birth", "confirm")
        fault = "birth.confirm has no effect: existence.confirm says when a target is born"
        yield plate.at.message(key, fault, "one of existence, birth.confirm", on_key=True)


def marginal_association_has_mixtures(plate: Plate) -> Iterator[GraphMessage]:
    """`associate: marginal` needs `existence`, a Gaussian belief, and detections measured at its root."""
    if plate.spec.associate != "marginal":
        return
    path = ("targets", plate.name, "associate")
    if plate.spec.existence is None:
        remedy = "existence, too (existence: {}), or associate: assignment"
        yield plate.at.message(path, "associate: marginal without existence", remedy)
    for name, node in plate.inference.items():
        if node.parent is None and (node.belief is None or node.belief.kind != "gaussian"):
            fault = "associate: marginal with a belief that is not Gaussian"
            remedy = "belief: {gaussian: {filter: kalman}} at the root, or associate: assignment"
            yield plate.message(name, fault, remedy, key=("belief",) if node.belief else ())
    for name in agents_of_detections(plate):
        parent = plate.agents[name].parent
        if parent not in plate.roots and not is_seen(plate.spec, parent):
            fault = f"associate: marginal with an agent that measures by detections below {parent}"
            yield plate.message(name, fault, f"parent: {plate.roots[0]}", key=("parent",))


def identity_has_boxes(plate: Plate) -> Iterator[GraphMessage]:
    """`identity` needs detections that are boxes in the image, measured by an agent."""
    if plate.spec.identity is None:
        return
    path = ("targets", plate.name, "identity")
    if plate.spec.state != "box":
        fault = "identity of a state that has no box in the image"
        yield plate.at.message(path, fault, "state: box, or no such key", on_key=True)
    elif not agents_of_detections(plate) or plate.spec.birth is None:
        fault = "identity without an agent that measures by detections"
        remedy = "agent: detection in a node and birth: {detector: ...}, or no such key"
        yield plate.at.message(path, fault, remedy, on_key=True)


def lost_by_existence_has_existence(plate: Plate) -> Iterator[GraphMessage]:
    """`lost.existence_below` needs `existence`, lies above `existence.end`, and is the only rule."""
    rule = plate.spec.existence
    for name, node in plate.inference.items():
        limit = None if node.lost is None else node.lost.existence_rule
        if node.lost is None or limit is None:
            continue
        (measure, level), key = limit, ("lost", f"{limit[0]}_below")
        if rule is None:
            fault = f"lost.{measure}_below without existence"
            yield plate.message(name, fault, "existence for the target, or no such key", key=key, on_key=True)
        elif level <= rule.end:
            fault = f"lost.{measure}_below is {level:g}, not above existence.end, {rule.end:g}"
            yield plate.message(name, fault, f"above {rule.end:g}", key=key)
        if measure == "existence_in_box" and plate.spec.state != "box":
            fault = "lost.existence_in_box_below of a state that has no box in the image"
            yield plate.message(name, fault, "existence_below", key=key, on_key=True)
        rivals = {"above", "fit_below", "score_below", "existence_below"} & node.lost.model_fields_set
        rivals.discard(f"{measure}_below")
        for rival in sorted(rivals):
            fault = f"lost.{rival} has no effect: with {measure}_below existence alone says what is lost"
            remedy = f"one of {rival}, {measure}_below"
            yield plate.message(name, fault, remedy, key=("lost", rival), on_key=True)


def agents_of_detections(plate: Plate) -> list[str]:
    """The agents that measure by detections."""
    declared = {name: plate.cues.get(node.agent.cue) for name, node in plate.agents.items()}
    return [
        name
        for name, declaration in declared.items()
        if declaration is not None and declaration.reads_detection
    ]


EXISTENCE_CHECKS: tuple[Check, ...] = (
    existence_has_detections,
    marginal_association_has_mixtures,
    identity_has_boxes,
    lost_by_existence_has_existence,
)


GraphCheck = Callable[[GraphSpec, Positions], Iterator[GraphMessage]]
"""One pass over a whole graph: yields every violation."""


def joins_name_kinds(spec: GraphSpec, positions: Positions) -> Iterator[GraphMessage]:
    """Every kind in a join's `between` is a kind of target of the graph."""
    for number, join in enumerate(spec.joins):
        for place, kind in enumerate(join.between or ()):
            if kind not in spec.targets:
                path = ("joins", number, "between", place)
                yield positions.message(path, f"no kind of target {kind!r}", list(spec.targets), word=kind)


def one_join_for_a_pair(spec: GraphSpec, positions: Positions) -> Iterator[GraphMessage]:
    """No pair of kinds has two joins: pixels would be accounted for twice."""
    kinds = list(spec.targets)
    for number in range(1, len(spec.joins)):
        for first in kinds:
            for second in kinds[kinds.index(first) :]:
                earlier = join_of(spec.joins[:number], first, second)
                if earlier is not None and spec.joins[number].holds_between(first, second):
                    fault = f"a second join between {first} and {second}"
                    yield positions.message(("joins", number), fault, f"one, as in entry {earlier + 1}")


def an_attachment_has_two_kinds(spec: GraphSpec, positions: Positions) -> Iterator[GraphMessage]:
    """An attachment names who carries, then what is carried: two different kinds."""
    for number, join in enumerate(spec.joins):
        if join.attachment is not None and len(set(join.between or ())) != 2:
            path = ("joins", number, "attachment")
            fault = "attachment without a carrier's and a carried kind"
            yield positions.message(path, fault, "between: [carrier, carried]", on_key=True)


def joined_beliefs_are_of_a_kind(spec: GraphSpec, positions: Positions) -> Iterator[GraphMessage]:
    """Joined targets hold hypotheses that are weighed anew, or Gaussians that linear factors relate."""
    for number, join in enumerate(spec.joins):
        roots = {kind: node for kind in join.between or tuple(spec.targets) for node in _roots_of(spec, kind)}
        names = {kind: node[0] for kind, node in roots.items()}
        beliefs = {
            kind: "particles" if node.belief is None else node.belief.kind
            for kind, (_, node) in roots.items()
        }
        place: KeyPath = ("joins", number)
        for kind in (kind for kind, belief in beliefs.items() if belief != "particles"):
            who = f"{kind}, whose node {names[kind]}"
            if beliefs[kind] != "gaussian" or join.factor is None:
                fault = f"a join of {who} holds a {beliefs[kind]} belief"
                addition = "; or gaussian beliefs and a factor of linear forms" * (
                    beliefs[kind] == "gaussian"
                )
                yield positions.message(place, fault, f"kinds whose root has belief: particles{addition}")
            elif {*beliefs.values()} != {"gaussian"}:
                fault = f"a join of {who} holds a gaussian belief, with one that does not"
                yield positions.message(place, fault, "one kind of belief for both")
            elif roots[kind][1].modes is not None or roots[kind][1].category is not None:
                state = "a category" if roots[kind][1].modes is None else "modes"
                fault = f"a join of {who} has a gaussian belief and {state}"
                yield positions.message(place, fault, f"belief: particles, or no {state.removeprefix('a ')}")


def factors_of_gaussians_are_linear(spec: GraphSpec, positions: Positions) -> Iterator[GraphMessage]:
    """The factor of Gaussian beliefs is a product of normal densities of linear forms of both states."""
    for number, join in enumerate(spec.joins):
        kinds = join.between or ()
        nodes = [node for kind in kinds for _, node in _roots_of(spec, kind)]
        if join.factor is None or not any(node.belief and node.belief.gaussian for node in nodes):
            continue
        try:
            term = parse(join.factor)
        except ExpressionError:
            continue  # said by the check of expressions
        fixed = {name: 1.0 for name in names_in(term) if not name.startswith(("a.", "b."))}
        if linear_normals_of(term, fixed) is None:
            fault = "a factor of gaussian beliefs that is no product of normal densities of linear forms"
            remedy = "such as normal(a.x - b.x, 40, 5) * normal(a.y - b.y, 0, 5); or belief: particles"
            yield positions.message(("joins", number, "factor"), fault, remedy)


def _roots_of(spec: GraphSpec, kind: str) -> list[tuple[str, InferenceNode]]:
    target = spec.targets.get(kind)
    nodes = {} if target is None else target.nodes
    return [
        (name, node)
        for name, node in nodes.items()
        if isinstance(node, InferenceNode) and node.parent is None
    ]


JOIN_CHECKS: tuple[GraphCheck, ...] = (
    joins_name_kinds,
    one_join_for_a_pair,
    an_attachment_has_two_kinds,
    joined_beliefs_are_of_a_kind,
    factors_of_gaussians_are_linear,
    modes_are_joined,
)
