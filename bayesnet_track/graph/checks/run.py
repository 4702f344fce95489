"""Checks of a whole graph: named passes, each of which reports all its errors."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from itertools import islice
from pathlib import Path as FilePath
from typing import Any

from pydantic import ValidationError

from bayesnet_track.graph.checked import Calibration, CheckedGraph, CheckedTarget
from bayesnet_track.graph.checks.adapt import ADAPT_CHECKS, SCORE_CHECKS
from bayesnet_track.graph.checks.beliefs import (
    NOISE_CHECKS,
    PLACE_CHECKS,
    START_CHECKS,
    gaussian_settings_have_effect,
    grid_holds_the_motion,
    grid_resets_at_one_level,
    kalman_moves_linearly,
    sizes_in_order,
)
from bayesnet_track.graph.checks.cameras import (
    CAMERA_CHECKS,
    CAMERA_GRAPH_CHECKS,
    calibrations_of,
    cameras_can_be_read,
    in_units_of_the_state,
    read_lasting,
    read_views,
)
from bayesnet_track.graph.checks.cues import (
    CATEGORY_CHECKS,
    CUE_CHECKS,
    categories_have_evidence,
    cue_parameters,
    evidence_counts_once,
)
from bayesnet_track.graph.checks.factors import (
    CONSTANT_CHECKS,
    FACTOR_CHECKS,
    GIVEN_CHECKS,
    MEASURE_CHECKS,
    masks_of,
    read_factors,
    read_givens,
    read_measures,
)
from bayesnet_track.graph.checks.latent import TREE_CHECKS
from bayesnet_track.graph.checks.lifecycle import EXISTENCE_CHECKS, JOIN_CHECKS, LIFE_CHECKS
from bayesnet_track.graph.checks.modes import MODE_CHECKS
from bayesnet_track.graph.checks.motion import (
    FORMULA_CHECKS,
    FORMULA_JOIN_CHECKS,
    MOTION_CHECKS,
    gaussians_are_looked_for,
)
from bayesnet_track.graph.checks.plates import Check, Plate
from bayesnet_track.graph.checks.queries import INPUT_CHECKS, QUERY_CHECKS, with_polygons
from bayesnet_track.graph.checks.sensors import SENSOR_CHECKS, read_inverses
from bayesnet_track.graph.checks.several_cameras import per_camera
from bayesnet_track.graph.settings.net import AGENT_RULES
from bayesnet_track.graph.spec import Given, GraphSpec, Level, Lost, Noise
from bayesnet_track.graph.text.document import MAX_BYTES
from bayesnet_track.graph.text.explain import explain_errors
from bayesnet_track.graph.text.messages import MAX_MESSAGES, GraphError, GraphMessage, Positions
from bayesnet_track.graph.text.write import write_graph
from bayesnet_track.observation.cue import ENTRY_POINT_GROUP, CueDeclaration, installed_cues
from bayesnet_track.observation.cue_files import GivenCue, own_cues
from bayesnet_track.observation.image_files import Mask
from bayesnet_track.observation.plugins import given


def noise_is_there(plate: Plate) -> Iterator[GraphMessage]:
    """A random walk has noise, and so has a latent state around its parent's."""
    remedy = "an sd above 0, such as {sd_px: {x: 20, y: 20}}"
    for name, node in plate.inference.items():
        if (
            node.motion is not None
            and node.motion.random_walk is not None
            and _is_still(node.motion.random_walk)
        ):
            fault = "random_walk without noise: no hypothesis would ever move"
            yield plate.message(name, fault, remedy, key=("motion", "random_walk"))
        if node.fuse is not None and node.fuse.latent is not None and _is_still(node.fuse.latent.given):
            is_part = node.fuse.latent.given.is_part
            reason = (
                "the part would have no state of its own"
                if is_part
                else "the latent state would equal its parent's"
            )
            fault = f"given without noise: {reason}"
            yield plate.message(name, fault, remedy, key=("fuse", "latent", "given"))


def _is_still(noise: Noise) -> bool:
    parts: tuple[Any, ...] = (noise.sd_px, noise.sd_box, noise.sd_log)
    by_expressions = isinstance(noise, Given) and bool(noise.written)
    return not by_expressions and not any(
        getattr(part, field) > 0 for part in parts for field in type(part).model_fields
    )


def weights_name_the_children(plate: Plate) -> Iterator[GraphMessage]:
    """The weights of a pool name exactly the node's children."""
    for name, node in plate.inference.items():
        weights = node.fuse.pool if node.fuse is not None else None
        if weights is None or isinstance(weights, str):
            continue
        children = plate.children[name]
        for weighted in weights:
            if weighted not in children:
                fault = f"a weight for {weighted!r}, which is no child of this node"
                key = ("fuse", "pool", weighted)
                yield plate.message(name, fault, children, key=key, word=weighted, on_key=True)
        without = [child for child in children if child not in weights]
        if without:
            fault = f"no weight for {', '.join(without[:12])}"
            yield plate.message(name, fault, "a weight for every child, or equal", key=("fuse", "pool"))


def correlations_belong_to_learned_pools(plate: Plate) -> Iterator[GraphMessage]:
    """A correlation is of the children of a learned pool, which are two at least."""
    for name, node in plate.inference.items():
        is_learned = node.fuse is not None and node.fuse.pool == "learned"
        if node.correlation is not None and not is_learned:
            fault = "key 'correlation' at a node whose pool is not learned"
            yield plate.message(name, fault, "fuse: {pool: learned}", key=("correlation",), on_key=True)
        children = [child for child in plate.children[name] if child not in plate.factors]
        if is_learned and len(children) < 2:
            fault = (
                f"pool is learned, and {children[0]!r} is the only child" if children else "pool has no child"
            )
            yield plate.message(name, fault, "two children or more, or no fuse", key=("fuse", "pool"))


def thresholds_in_order(plate: Plate) -> Iterator[GraphMessage]:
    """`deactivate.below` is below `activate.above`, and `learn.below` below `lost.above`, in equal units."""
    for name, node in plate.inference.items():
        adapt = node.adapt
        activation = None if adapt is None or adapt.activate is None else adapt.activate.above
        deactivation = None if adapt is None or adapt.deactivate is None else adapt.deactivate.below
        if activation is not None and deactivation is not None:
            key = ("adapt", "deactivate", "below")
            yield from _crossing(plate, name, key, deactivation, activation, "adapt.activate.above")
        if node.learn is not None and node.parent is None:
            lost = node.lost or Lost()
            if lost.score_below is not None:
                continue
            text = "lost.above" if node.lost is not None else "lost.above by default"
            yield from _crossing(plate, name, ("learn", "below"), node.learn.below, lost.above, text)


def _crossing(
    plate: Plate, name: str, key: tuple[str, ...], low: Level, high: Level, high_name: str
) -> Iterator[GraphMessage]:
    if low.kind == high.kind and low.settings >= high.settings:
        unit = low.kind
        fault = (
            f"{'.'.join(key)} is {low.settings:.6g} {unit}, not below {high_name}, {high.settings:.6g} {unit}"
        )
        yield plate.message(name, fault, f"below {high.settings:.6g}", key=(*key, unit))


def someone_is_active(plate: Plate) -> Iterator[GraphMessage]:
    """At least one agent is switched on at the start."""
    if plate.agents and not any(agent.active for agent in plate.agents.values()):
        first = next(iter(plate.agents))
        fault = "no agent is switched on at the start"
        yield plate.message(first, fault, "active: true for at least one agent", key=("active",))


def rules_can_fire(plate: Plate) -> Iterator[GraphMessage]:
    """Every rule governs agents that it could switch."""
    for name, node in plate.inference.items():
        adapt = node.adapt
        if adapt is None:
            continue
        agents, count = plate.governed(name), len(plate.left_to(name))
        if not agents and adapt.agents is not None:
            continue  # its names are wrong, as another check says
        if not agents:
            fault = "adapt governs no agent: every agent below has rules of its own nearer by"
            yield plate.message(name, fault, key=("adapt",), on_key=True)
        elif adapt.on_call is not None:
            continue
        elif adapt.activate is None and adapt.deactivate is None:
            rules = ["activate", "deactivate", "on_call"]
            yield plate.message(name, "adapt without a rule", rules, key=("adapt",))
        elif adapt.keep > count:
            fault = f"keep is {adapt.keep}, and {count} agents are governed here"
            yield plate.message(name, fault, f"at most {count}", key=("adapt", "keep"))
        elif adapt.deactivate is not None and adapt.keep == count:
            fault = f"deactivate can never fire: keep is {adapt.keep} of {count} agents"
            remedy = "more agents, a smaller keep, or no such rule"
            yield plate.message(name, fault, remedy, key=("adapt", "deactivate"), on_key=True)
        elif adapt.deactivate is None and not any(plate.agents[agent].adapts for agent in agents):
            fault = "activate can never fire: every agent here is on, and nothing switches one off"
            rules_of_agents = ", ".join(f"{'an' if key[0] in 'aeiou' else 'a'} {key}" for key in AGENT_RULES)
            remedy = f"a deactivate rule, {rules_of_agents}, active: false, or no such rule"
            yield plate.message(name, fault, remedy, key=("adapt", "activate"), on_key=True)


def learning_has_a_rule(plate: Plate) -> Iterator[GraphMessage]:
    """An agent's learning rate needs the root's learning rule."""
    learns = any(plate.inference[root].learn is not None for root in plate.roots)
    for name, agent in plate.agents.items():
        if agent.learn_rate_max is not None and not learns:
            fault = "learn_rate_max has no effect: the root has no 'learn'"
            yield plate.message(name, fault, "learn at the root", key=("learn_rate_max",), on_key=True)


VALUE_CHECKS: tuple[Check, ...] = (
    noise_is_there,
    weights_name_the_children,
    correlations_belong_to_learned_pools,
    thresholds_in_order,
    *ADAPT_CHECKS,
    *SCORE_CHECKS,
    someone_is_active,
    learning_has_a_rule,
    sizes_in_order,
    kalman_moves_linearly,
    gaussian_settings_have_effect,
    grid_holds_the_motion,
    grid_resets_at_one_level,
    *MOTION_CHECKS,
    *FORMULA_CHECKS,
    *MODE_CHECKS,
    *CATEGORY_CHECKS,
    *START_CHECKS,
    *PLACE_CHECKS,
    *CAMERA_CHECKS,
)
"""These need no sound tree."""

RULE_CHECKS: tuple[Check, ...] = (rules_can_fire,)
"""These need a sound tree."""


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
    *NOISE_CHECKS,
    *SENSOR_CHECKS,
)


def check(
    spec: GraphSpec,
    positions: Positions | None = None,
    cues: Cues | None = None,
    masks: Mapping[str, Mask] | None = None,
    calibrations: Mapping[str, Calibration] | None = None,
) -> CheckedGraph:
    """The graph with its trees resolved and its cues' parameters typed.

    `positions` says where its parts stand (from `read_graph`); `cues` are the installed ones unless given,
    `masks` images that are known already, by their paths as written, and so `calibrations`.

    Raises:
        GraphError: every failure of every check in every target.
        CueError: one of `cues` cannot be used.
    """
    positions = Positions() if positions is None else positions
    named = cues_named(spec)
    passed_cues = {**given(ENTRY_POINT_GROUP), **mapped_cues(cues)}
    available = passed_cues if isinstance(cues, Mapping) else {**installed_cues(named), **passed_cues}
    folder = FilePath(positions.file).parent
    images, read = masks_of(spec, folder, masks), calibrations_of(spec, folder, calibrations)
    cameras = {name: read[source.key] for name, source in spec.cameras.items()}
    context = (positions, available, spec.constants, images, tuple(spec.inputs), cameras, spec.cameras)
    resolved = {name: per_camera(target, [*cameras]) for name, target in spec.targets.items()}
    plates = [Plate(name, in_units_of_the_state(target), *context) for name, target in resolved.items()]
    errors = [message for plate in plates for message in _violations(plate)]
    errors += cameras_can_be_read(spec, positions, read)
    of_graphs = (*CONSTANT_CHECKS, *CAMERA_GRAPH_CHECKS, *JOIN_CHECKS, *FORMULA_JOIN_CHECKS)
    for find in (*of_graphs, *QUERY_CHECKS, *INPUT_CHECKS, categories_have_evidence):
        errors += islice(find(spec, positions), MAX_MESSAGES + 1)
    spec, of_polygons = with_polygons(spec, folder, positions)
    errors += of_polygons
    text = write_graph(spec)
    if len(text.encode()) > MAX_BYTES:
        errors.append(
            positions.message((), f"more than {MAX_BYTES} bytes when written as YAML", "smaller graphs")
        )
    if errors:
        raise GraphError([*dict.fromkeys(errors)])  # a node of several cameras says the same for each
    used_cues = {name: passed_cues[name] for name in sorted(named) if name in passed_cues}
    used_masks = {name: mask for name, mask in images.items() if isinstance(mask, Mask)}
    files = {name: calibration for name, calibration in read.items() if isinstance(calibration, Calibration)}
    return CheckedGraph(
        spec, {plate.name: _resolve(plate) for plate in plates}, text, used_cues, used_masks, files
    )


def check_graph(
    graph: GraphSpec | Mapping[str, Any],
    cues: Cues | None = None,
    masks: Mapping[str, Mask] | None = None,
    calibrations: Mapping[str, Calibration] | None = None,
) -> CheckedGraph:
    """`check` for a graph written in Python, as a specification or as plain data with the words of YAML.

    Messages name the path of keys, for want of a line.

    Raises:
        GraphError: everything that is wrong with its form; else every failure of every check.
    """
    positions = Positions()
    if not isinstance(graph, GraphSpec):
        try:
            graph = GraphSpec.model_validate(graph)
        except ValidationError as error:
            raise GraphError(explain_errors(error, GraphSpec, graph, positions)) from None
    return check(graph, positions, cues, masks, calibrations)


def mapped_cues(cues: Cues | None) -> Mapping[str, CueDeclaration]:
    """Cues of one's own by name; raises CueError."""
    return cues if isinstance(cues, Mapping) else own_cues(cues or ())


def cues_named(spec: GraphSpec) -> frozenset[str]:
    """The cues of all agents and verifiers of a graph."""
    return frozenset(choice.cue for target in spec.targets.values() for _, _, choice in target.cue_choices())


def _violations(plate: Plate) -> list[GraphMessage]:
    tree = _failures(plate, TREE_CHECKS)
    values = _failures(plate, (*CUE_CHECKS, *LIFE_CHECKS, *VALUE_CHECKS))
    return tree + values if tree else values + _failures(plate, CHECKS_OF_A_SOUND_TREE)


def _failures(plate: Plate, checks: Iterable[Check]) -> list[GraphMessage]:
    """Messages of these checks; of each no more than a reader is shown."""
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
        inverses=read_inverses(plate),
        views=read_views(plate),
        lasting=read_lasting(plate),
    )
