"""Checks of joins: kinds that there are, one join for a pair of kinds, beliefs that can be joined."""

from __future__ import annotations

from collections.abc import Callable, Iterator

from bayesnet_track.graph.checks.modes import modes_are_not_joined
from bayesnet_track.graph.settings.joins import join_of
from bayesnet_track.graph.spec import GraphSpec, InferenceNode
from bayesnet_track.graph.text.messages import GraphMessage, Positions

GraphCheck = Callable[[GraphSpec, Positions], Iterator[GraphMessage]]
"""One pass over a whole graph: yields every violation."""


def joins_name_kinds(spec: GraphSpec, at: Positions) -> Iterator[GraphMessage]:
    """Every kind in a join's `between` is a kind of target of the graph."""
    for number, join in enumerate(spec.joins):
        for place, kind in enumerate(join.between or ()):
            if kind not in spec.targets:
                path = ("joins", number, "between", place)
                yield at.message(path, f"no kind of target {kind!r}", list(spec.targets), word=kind)


def one_join_for_a_pair(spec: GraphSpec, at: Positions) -> Iterator[GraphMessage]:
    """No pair of kinds has two joins: pixels would be accounted for twice."""
    kinds = list(spec.targets)
    for number in range(1, len(spec.joins)):
        for first in kinds:
            for second in kinds[kinds.index(first) :]:
                earlier = join_of(spec.joins[:number], first, second)
                if earlier is not None and spec.joins[number].holds_between(first, second):
                    found = f"a second join between {first} and {second}"
                    yield at.message(("joins", number), found, f"one, as in entry {earlier + 1}")


def an_attachment_has_two_kinds(spec: GraphSpec, at: Positions) -> Iterator[GraphMessage]:
    """An attachment names who carries, then what is carried: two different kinds."""
    for number, join in enumerate(spec.joins):
        if join.attachment is not None and len(set(join.between or ())) != 2:
            path = ("joins", number, "attachment")
            found = "attachment without a carrier's and a carried kind"
            yield at.message(path, found, "between: [carrier, carried]", on_key=True)


def joined_beliefs_are_particles(spec: GraphSpec, at: Positions) -> Iterator[GraphMessage]:
    """Targets that are joined hold their beliefs by particles: a joint belief reweights hypotheses."""
    for number, join in enumerate(spec.joins):
        for kind in join.between or tuple(spec.targets):
            target = spec.targets.get(kind)
            for name, node in () if target is None else target.nodes.items():
                if not isinstance(node, InferenceNode) or node.parent is not None or node.belief is None:
                    continue
                if node.belief.particles is None:
                    found = f"a join of {kind}, whose node {name} holds a {node.belief.kind} belief"
                    yield at.message(("joins", number), found, "kinds whose root has belief: particles")


JOIN_CHECKS: tuple[GraphCheck, ...] = (
    joins_name_kinds,
    one_join_for_a_pair,
    an_attachment_has_two_kinds,
    joined_beliefs_are_particles,
    modes_are_not_joined,
)
