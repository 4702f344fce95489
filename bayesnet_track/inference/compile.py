"""Compile a checked net with its active agents into a plan: ordered steps and planes, also in words.

A pure function, called again at every reconfiguration.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Container, Iterable, Mapping
from dataclasses import dataclass, field, fields, is_dataclass, replace

from bayesnet_track.graph.checked import CheckedTarget, Conditional, Factor, MeasuredAs
from bayesnet_track.graph.checks.latent import Form, form_of, is_latent
from bayesnet_track.graph.expressions.parse import term_text
from bayesnet_track.graph.settings.net import pool_exponents
from bayesnet_track.graph.spec import AgentNode, Fuse, Given
from bayesnet_track.inference.factors import Weigh
from bayesnet_track.inference.views import View, views_below
from bayesnet_track.numerics.arrays import Floats
from bayesnet_track.observation.cue import AnyCue, AssociatingCue, AssociationRule, MeasuringCue, rule_of
from bayesnet_track.observation.planes import Plane

HELD: Mapping[Form, str] = {
    "one": "",
    "kernel": " by kernel",
    "gaussian": " as a Gaussian",
    "grid": " on a grid",
}


@dataclass(frozen=True)
class Draw:
    """Prior down: a latent node draws its own hypotheses around those of `given_from`, or in them.

    `written` is the distribution where expressions say it.
    With `moves` it has a motion of its own: the root's states hold by how much it deviates from there.
    """

    node: str
    given_from: str
    given: Given
    written: Conditional | None = None
    moves: bool = False


@dataclass(frozen=True)
class Observe:
    """An agent scores the hypotheses of the node `at` (the root or the nearest latent node above it).

    With `measures` it says where the target is instead, by quantities that `functions` have of a state. Its
    log-likelihood is divided by `temperature`. It looks at the image of `camera`, where there are several. Of
    one that is given detections, `rule` says which are the target's.
    """

    agent: str
    at: str
    measures: bool = False
    temperature: float = 1.0
    functions: MeasuredAs | None = None
    camera: str = ""
    rule: AssociationRule | None = field(default=None, compare=False)

    @property
    def errors(self) -> Callable[[Floats], Floats] | None:
        """Variances of detections of expected boxes (T, 4), by the rule; None of other agents."""
        rule = self.rule
        return None if rule is None else lambda boxes: rule.variances(boxes) * self.temperature


@dataclass(frozen=True)
class Fusion:
    """Likelihoods up: an inference node fuses its children's messages into its own.

    Attributes:
        node: the inference node.
        kind: product, pool or latent.
        children: children with a message in this plan.
        shares: weights of the children as given; only their ratios count, and only for a pool.
        given: p(own state | parent's state) of a latent node, or None.
        factors: factors of the node with a message in this plan; each counts once, in a pool too.
        written: p(own state | parent's state) where expressions say it.
        own: how a latent node's own state is held: one draw per hypothesis, draws joined by the
            row-normalised kernel, a Gaussian, or cells of a grid.
        correlation: of the children's errors, in a learned pool; None in others.
    """

    node: str
    kind: str
    children: tuple[str, ...]
    shares: tuple[float, ...]
    given: Given | None = None
    own: Form = "one"
    factors: tuple[str, ...] = ()
    correlation: float | None = None
    written: Conditional | None = None

    def weights(self, present: Container[str]) -> dict[str, float]:
        """Child in `present` -> exponent of its likelihood: for a pool `pool_exponents`, and 1 otherwise.

        Those of factors are 1.
        """
        shares = {c: share for c, share in zip(self.children, self.shares, strict=True) if c in present}
        weights = pool_exponents(shares, self.correlation) if self.kind == "pool" else shares
        for factor in self.factors:
            if factor in present:
                weights[factor] = 1.0
        return weights


@dataclass(frozen=True, eq=False)
class Plan:
    """Steps for one target in one frame.

    Attributes:
        target: name of the plate.
        root: its root node.
        active: agents that observe.
        draws: prior down, parents first; parts are drawn with no agent below them, too.
        observations: one per active agent, in file order.
        factors: one per factor, in file order.
        fusions: likelihoods up, children first; the root's is last. Empty when no agent is active and there
            are no factors.
        planes: planes that the active agents read, inputs first.
        idle_planes: inactive agent -> the planes that a due reference update reads, on the estimate's crop.
        views: prior down, before the draws: the root's hypotheses as cameras see them.
    """

    target: str
    root: str
    active: frozenset[str]
    draws: tuple[Draw, ...]
    observations: tuple[Observe, ...]
    factors: tuple[Weigh, ...]
    fusions: tuple[Fusion, ...]
    planes: tuple[Plane, ...]
    idle_planes: Mapping[str, tuple[Plane, ...]]
    views: tuple[View, ...] = ()

    def view(self, node: str) -> View | None:
        """A view by its name; None of another node."""
        return next((view for view in self.views if view.node == node), None)

    def in_image(self) -> Plan:
        """The plan of hypotheses that are boxes in the image of the only view, if there is one."""
        return replace(self, root=self.views[0].node, views=()) if self.views else self

    def _repr_html_(self) -> str:
        """For notebooks: what is done in which order, as a table."""
        from bayesnet_track.view.notebook import table

        planes = ", ".join(map(plane_words, self.planes)) or "none"
        views = [("prior down", step.node, f"projected from {step.given_from}") for step in self.views]
        draws = [
            ("prior down", draw.node, f"{'carried in' if draw.moves else 'drawn from'} {draw.given_from}")
            for draw in self.draws
        ]
        observed = [
            (
                "observe",
                step.agent,
                f"{'measures' if step.measures else 'scores the hypotheses of'} {step.at}"
                + (f", temperature {step.temperature:g}" if step.temperature != 1.0 else ""),
            )
            for step in self.observations
        ]
        joined = [
            ("likelihoods up", step.node, f"{step.kind} of {', '.join(step.children)}")
            for step in self.fusions
        ]
        idle = [("off", agent, "") for agent in self.idle_planes]
        factors = [("weigh", step.factor, f"{term_text(step.term)} at {step.at}") for step in self.factors]
        rows = [("planes", self.target, planes), *views, *draws, *observed, *factors, *joined, *idle]
        return table(rows, ("step", "node", "what"))


def compile_plan(target: CheckedTarget, active: Iterable[str], cues: Mapping[str, AnyCue]) -> Plan:
    """The plan of `target` with the agents `active`; `cues` maps every agent to its implementation."""
    working = frozenset(active)
    messengers = _messengers(target, working)
    inference = [name for name in target.order if name in target.children and name in messengers]
    watching = [name for name in target.agents if name in working]
    measuring = frozenset(name for name in target.agents if isinstance(cues[name], MeasuringCue))
    rules = {
        name: rule_of(cues[name]) if isinstance(cues[name], AssociatingCue) else None for name in watching
    }
    return Plan(
        target=target.name,
        root=target.root,
        active=working,
        draws=tuple(_draw(target, name) for name in _list_drawn(target, messengers)),
        observations=tuple(
            Observe(
                name,
                _hypotheses_of(target, target.parent[name]),
                name in measuring,
                target.agent(name).temperature,
                target.measures.get(name),
                target.camera_of(name) if rule is None else "",
                rule,
            )
            for name, rule in rules.items()
        ),
        factors=tuple(_weigh(target, name, factor) for name, factor in target.factors.items()),
        fusions=tuple(_fuse(target, name, messengers, measuring) for name in reversed(inference)),
        planes=_with_inputs(plane for name in watching for plane in cues[name].needs),
        idle_planes={name: _with_inputs(cues[name].needs) for name in target.agents if name not in working},
        views=views_below(target),
    )


def _messengers(target: CheckedTarget, active: frozenset[str]) -> frozenset[str]:
    """Nodes that send a message: active agents, factors, and inference nodes above one."""
    messengers = set(active | target.factors.keys())
    weighed = {factor.parent for factor in target.factors.values()}
    for name in reversed(target.order):
        if name in weighed or any(child in messengers for child in target.children.get(name, ())):
            messengers.add(name)
    return frozenset(messengers)


def _list_drawn(target: CheckedTarget, messengers: frozenset[str]) -> list[str]:
    """The latent nodes that send a message or are parts, and the latent ones above a part; parents first."""
    nodes: set[str] = set()
    for name in (name for name in reversed(target.order) if name in target.children):
        fuse = target.inference(name).fuse
        is_part = fuse is not None and fuse.latent is not None and fuse.latent.given.is_part
        if name in messengers or is_part or any(child in nodes for child in target.children[name]):
            nodes.add(name)
    return [name for name in target.order if name in nodes and is_latent(target, name)]


def _hypotheses_of(target: CheckedTarget, node: str | None) -> str:
    """The root, or the nearest latent node or view at or above `node`: whose hypotheses are seen there."""
    while node is not None and node != target.root and not has_hypotheses(target, node):
        node = target.parent[node]
    return node or target.root


def has_hypotheses(target: CheckedTarget, node: str) -> bool:
    """True of a latent node and of a view."""
    return node in target.views or is_latent(target, node)


def _draw(target: CheckedTarget, node: str) -> Draw:
    fuse = target.inference(node).fuse
    assert fuse is not None and fuse.latent is not None
    parent = target.parent[node]
    given_from = target.root if parent is None else _hypotheses_of(target, parent)
    return Draw(node, given_from, fuse.latent.given, target.givens.get(node), _moves(target, node))


def _moves(target: CheckedTarget, node: str) -> bool:
    return node != target.root and target.inference(node).motion is not None


def _weigh(target: CheckedTarget, name: str, factor: Factor) -> Weigh:
    node: str | None = factor.parent
    weighed = _hypotheses_of(target, node)
    parent = target.parent[weighed] if is_latent(target, weighed) else None
    is_prior = True
    while node is not None:
        fuse = target.inference(node).fuse
        is_prior = is_prior and (fuse is None or fuse.product is not None or node == factor.parent)
        is_prior = is_prior and not is_latent(target, node)
        node = target.parent[node]
    given_from = weighed if parent is None else _hypotheses_of(target, parent)
    root = target.inference(target.root)
    takes_linear = root.belief is not None and root.belief.gaussian is not None
    takes_linear = takes_linear and root.modes is None and root.category is None
    may_be_exact = takes_linear and factor.parent == target.root
    return Weigh(
        name, weighed, given_from, factor.term, factor.constants, is_prior, factor.mask, may_be_exact
    )


def _fuse(target: CheckedTarget, node: str, messengers: frozenset[str], measuring: Container[str]) -> Fusion:
    children = tuple(child for child in target.children[node] if child in messengers)
    fuse = target.inference(node).fuse or Fuse.model_validate("product")
    factors = tuple(name for name, factor in target.factors.items() if factor.parent == node)
    if fuse.kind == "pool":
        shares = tuple(fuse.shares(children).values())
        correlation = target.correlation(node)
        return Fusion(node, "pool", children, shares, factors=factors, correlation=correlation)
    shares = (1.0,) * len(children)
    if fuse.latent is None:
        return Fusion(node, fuse.kind, children, shares, factors=factors)
    conditional, form = fuse.latent.given, form_of(target, node, measuring)
    return Fusion(
        node, fuse.kind, children, shares, conditional, form, factors, written=target.givens.get(node)
    )


def _with_inputs(planes: Iterable[Plane]) -> tuple[Plane, ...]:
    """Every plane once, each after the planes that it is made from."""
    ordered: dict[Plane, None] = {}

    def visit(plane: Plane) -> None:
        for source in plane.inputs:
            visit(source)
        ordered.setdefault(plane)

    for plane in planes:
        visit(plane)
    return tuple(ordered)


def _describe_given(step: Draw) -> str:
    return f"a part of {step.given_from}" if step.given.is_part else step.given_from


def describe_plan(plan: Plan, agents: Mapping[str, AgentNode] | None = None) -> str:
    """The plan as text, one step a line."""
    lines = [f"target {plan.target}"]
    lines += [f"  plane    {plane_words(plane)}" for plane in plan.planes]
    lines += [f"  project  {view.node} from {view.given_from} by its camera" for view in plan.views]
    for draw in plan.draws:
        verb, centre = ("carry", "deviating from its place in") if draw.moves else ("draw ", "given")
        lines.append(f"  {verb}    {draw.node} {centre} {_describe_given(draw)}")
    for step in plan.observations:
        cue = "" if agents is None else f" ({agents[step.agent].agent.cue})"
        lines.append(f"  observe  {step.agent}{cue} at the hypotheses of {step.at}")
    lines += [f"  weigh    {step.factor} at {step.at}: {term_text(step.term)}" for step in plan.factors]
    for fusion in plan.fusions:
        terms = ", ".join(
            child if fusion.kind != "pool" or child in fusion.factors else f"{child}^{weight:.3g}"
            for child, weight in fusion.weights((*fusion.children, *fusion.factors)).items()
        )
        lines.append(f"  join     {fusion.node} = {fusion.kind}({terms}){HELD[fusion.own]}")
    for agent, planes in plan.idle_planes.items():
        names = ", ".join(map(plane_words, planes))
        lines.append(f"  idle     {agent}: {names} only for a due reference update, on the estimate's crop")
    return "\n".join(lines)


_CAPITAL = re.compile(r"(?<!^)(?=[A-Z])")
UNITS = {"px": " px", "px2": " px²", "m": " m", "deg": "°", "gray": " gray levels", "ms": " ms"}
"""Ends of a setting's name that say its unit, and how it is written behind the number."""


def plane_words(plane: object) -> str:
    """Name and settings of a plane, or its own words where it has any.

    >>> from bayesnet_track.vision.planes import Hue
    >>> plane_words(Hue(min_chroma=30, median_px=3))
    'hue (min chroma 30, median 3 px)'
    """
    if not is_dataclass(plane) or type(plane).__str__ is not object.__str__:
        return str(plane)
    name = _CAPITAL.sub(" ", type(plane).__name__).lower().removesuffix(" plane")
    settings = [
        _setting(setting.name, getattr(plane, setting.name)) for setting in fields(plane) if setting.repr
    ]
    words = ", ".join(setting for setting in settings if setting)
    return f"{name} ({words})" if words else name


def _setting(name: str, value: object) -> str:
    words = name.replace("_", " ")
    if isinstance(value, bool):
        return words if value else ""
    if is_dataclass(value):
        return plane_words(value)
    stem, _, unit = name.rpartition("_")
    if isinstance(value, int | float):
        return f"{stem.replace('_', ' ')} {value:g}{UNITS[unit]}" if unit in UNITS else f"{words} {value:g}"
    return f"{words} {value}"
