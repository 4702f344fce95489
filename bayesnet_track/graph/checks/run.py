"""Check a graph against every check of the language: named passes, each of which reports all its errors."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from itertools import islice
from pathlib import Path as FilePath
from typing import Any

from pydantic import ValidationError

from bayesnet_track.graph.checked import CheckedGraph, CheckedTarget
from bayesnet_track.graph.checks.cues import CUE_CHECKS, cue_parameters
from bayesnet_track.graph.checks.evidence import evidence_counts_once
from bayesnet_track.graph.checks.existence import EXISTENCE_CHECKS
from bayesnet_track.graph.checks.factors import CONSTANT_CHECKS, FACTOR_CHECKS, masks_of, read_factors
from bayesnet_track.graph.checks.formulas import FORMULA_JOIN_CHECKS
from bayesnet_track.graph.checks.givens import GIVEN_CHECKS, read_givens
from bayesnet_track.graph.checks.joins import JOIN_CHECKS
from bayesnet_track.graph.checks.lifecycle import LIFE_CHECKS
from bayesnet_track.graph.checks.measures import MEASURE_CHECKS, read_measures
from bayesnet_track.graph.checks.motion import gaussians_are_looked_for
from bayesnet_track.graph.checks.plates import Check, Plate
from bayesnet_track.graph.checks.trees import TREE_CHECKS
from bayesnet_track.graph.checks.values import RULE_CHECKS, VALUE_CHECKS
from bayesnet_track.graph.spec import GraphSpec
from bayesnet_track.graph.text.document import MAX_BYTES
from bayesnet_track.graph.text.explain import explain
from bayesnet_track.graph.text.messages import MAX_MESSAGES, GraphError, GraphMessage, Positions
from bayesnet_track.graph.text.write import write_graph
from bayesnet_track.observation.cue import ENTRY_POINT_GROUP, CueDeclaration, installed_cues
from bayesnet_track.observation.cue_files import GivenCue, own_cues
from bayesnet_track.observation.masks import Mask
from bayesnet_track.observation.plugins import given

Cues = Mapping[str, CueDeclaration] | Iterable[GivenCue]
"""All cues that there are, by name; or, beside the installed ones, declarations or files of one's own."""

CHECKS_OF_A_SOUND_TREE = (
    *RULE_CHECKS,
    *EXISTENCE_CHECKS,
    evidence_counts_once,
    gaussians_are_looked_for,
    *FACTOR_CHECKS,
    *GIVEN_CHECKS,
    *MEASURE_CHECKS,
)


def check(
    spec: GraphSpec,
    at: Positions | None = None,
    cues: Cues | None = None,
    masks: Mapping[str, Mask] | None = None,
) -> CheckedGraph:
    """The graph with its trees resolved and its cues' parameters typed.

    `at` says where its parts stand (from `read_graph`); `cues` are the installed ones unless given, `masks`
    images that are known already, by their paths as written.

    Raises:
        GraphError: every failure of every check in every target.
        CueError: one of `cues` cannot be used.
    """
    at = Positions() if at is None else at
    named = cues_named(spec)
    own = {**given(ENTRY_POINT_GROUP), **mapped_cues(cues)}
    known = own if isinstance(cues, Mapping) else {**installed_cues(named), **own}
    images = masks_of(spec, FilePath(at.file).parent, masks)
    plates = [Plate(name, target, at, known, spec.constants, images) for name, target in spec.targets.items()]
    errors = [message for plate in plates for message in _violations(plate)]
    for find in (*CONSTANT_CHECKS, *JOIN_CHECKS, *FORMULA_JOIN_CHECKS):
        errors += islice(find(spec, at), MAX_MESSAGES + 1)
    text = write_graph(spec)
    if len(text.encode()) > MAX_BYTES:
        errors.append(at.message((), f"more than {MAX_BYTES} bytes when written as YAML", "smaller graphs"))
    if errors:
        raise GraphError(errors)
    kept = {name: own[name] for name in sorted(named) if name in own}
    asked = {name: one for name, one in images.items() if isinstance(one, Mask)}
    return CheckedGraph(spec, {plate.name: _resolve(plate) for plate in plates}, text, kept, asked)


def check_graph(
    graph: GraphSpec | Mapping[str, Any],
    cues: Cues | None = None,
    masks: Mapping[str, Mask] | None = None,
) -> CheckedGraph:
    """`check` for a graph written in Python, as a specification or as plain data with the words of YAML.

    Messages name the path of keys, for want of a line.

    Raises:
        GraphError: everything that is wrong with its form; else every failure of every check.
    """
    at = Positions()
    if not isinstance(graph, GraphSpec):
        try:
            graph = GraphSpec.model_validate(graph)
        except ValidationError as error:
            raise GraphError(explain(error, GraphSpec, graph, at)) from None
    return check(graph, at, cues, masks)


def mapped_cues(cues: Cues | None) -> Mapping[str, CueDeclaration]:
    """Cues of one's own by name; raises CueError."""
    return cues if isinstance(cues, Mapping) else own_cues(cues or ())


def cues_named(spec: GraphSpec) -> frozenset[str]:
    """The cues of all agents and verifiers of a graph."""
    return frozenset(chosen.cue for target in spec.targets.values() for _, _, chosen in target.cue_choices())


def _violations(plate: Plate) -> list[GraphMessage]:
    tree = _failures(plate, TREE_CHECKS)
    values = _failures(plate, (*CUE_CHECKS, *LIFE_CHECKS, *VALUE_CHECKS))
    return tree + values if tree else values + _failures(plate, CHECKS_OF_A_SOUND_TREE)


def _failures(plate: Plate, checks: Iterable[Check]) -> list[GraphMessage]:
    """What fails these checks; of each no more than a reader is shown."""
    return [message for check in checks for message in islice(check(plate), MAX_MESSAGES + 1)]


def _resolve(plate: Plate) -> CheckedTarget:
    return CheckedTarget(
        name=plate.name,
        spec=plate.spec,
        root=plate.roots[0],
        order=tuple(plate.order),
        parent={name: plate.spec.nodes[name].parent for name in plate.order},
        children={name: tuple(plate.children[name]) for name in plate.inference},
        parameters={
            name: cue_parameters(node.agent, plate.cues[node.agent.cue])
            for name, node in plate.agents.items()
        },
        governor=plate.governor,
        factors=read_factors(plate),
        constants=plate.constants,
        givens=read_givens(plate),
        measures=read_measures(plate),
    )
