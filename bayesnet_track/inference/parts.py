"""Parts of a target: their place in their parent's box, their beliefs after a step, and their measures.

A part's state c is a box of its own, drawn around the mean A h of its parent's box h (`part_matrix`). Its
belief is the marginal of the net's joint posterior: with root h, the states c_1 .. c_k on the way down to the
part, and agents e that are all independent given the states,

    p(c_k | e) = integral of p(h | e) prod_j p(c_j | c_j-1) L_j(c_j) / m_j(c_j-1)  dh dc_1 .. dc_k-1,

where c_0 = h, L_j is the product of the messages of node j's children, and m_j(c_j-1) the integral of
p(c_j | c_j-1) L_j(c_j) over c_j, the message that j sends. Draws are index-aligned, c_j^i from
p(c_j | c_j-1^i), so that hypothesis i has the weight w_i prod_j L_j(c_j^i) / m_j(c_j-1^i), where w_i is the
root's posterior weight. A part with a motion of its own is no draw but in the root's states: it deviates from
its place by what their further fields hold, p(c_t | h_t, h_t-1, c_t-1), and its belief is that of the states.
A node held by one draw per hypothesis sends L_j(c_j^i) itself: every quotient is 1
there, and a part's draws have the root's posterior weights as they are; its own evidence is in them already.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from bayesnet_track.belief.contract import Evidence
from bayesnet_track.graph.checked import CheckedTarget
from bayesnet_track.graph.spec import Given
from bayesnet_track.inference.compile import Fusion, Plan
from bayesnet_track.inference.factors import draw_given
from bayesnet_track.numerics.arrays import Floats
from bayesnet_track.numerics.log_weights import DegenerateWeights, LogWeights
from bayesnet_track.observation.cue import Hypotheses


def part_matrix(given: Given) -> Floats | None:
    """(4, 4) A with A h the mean of a part's centre box given its parent's h; None when it is no part.

    >>> part_matrix(Given(offset_box={"y": -0.5}, size_box={"w": 0.5})) @ [10.0, 20.0, 4.0, 8.0]
    array([10., 16.,  2.,  8.])
    """
    if not given.is_part:
        return None
    offset, size = given.offset_box, given.size_box
    matrix = np.eye(4)
    if offset is not None:
        matrix[0, 2], matrix[1, 3] = offset.x, offset.y
    if size is not None:
        matrix[2, 2], matrix[3, 3] = size.w, size.h
    return matrix


def part_boxes(given: Given, parents: Floats) -> Floats:
    """(N, 4) mean boxes of a part in its parent's boxes (N, 4), sizes at least 1 px.

    What is no part has the parent's boxes themselves.
    """
    matrix = part_matrix(given)
    if matrix is None:
        return parents
    boxes = parents @ matrix.T
    np.maximum(boxes[:, 2:], 1.0, out=boxes[:, 2:])
    return boxes


def nominal_boxes(target: CheckedTarget, box: Floats, fields: Mapping[str, float]) -> dict[str, Floats]:
    """Part -> its mean box (4,) for a target in the centre box (4,), with further `fields` of its state."""
    boxes_of: dict[str | None, Floats] = {None: box}
    parts: dict[str, Floats] = {}
    columns = {name: np.array([value]) for name, value in fields.items()}
    for name in target.order:
        if name not in target.children:
            continue
        boxes_of[name] = boxes_of[target.parent[name]]
        place = _part_of(target, name)
        if place is not None:
            parents, written = Hypotheses(boxes_of[name][None], columns), target.givens.get(name)
            boxes = (
                part_boxes(place, parents.boxes) if written is None else draw_given(written, parents, None)
            )
            parts[name] = boxes_of[name] = boxes[0]
    return parts


def _part_of(target: CheckedTarget, name: str) -> Given | None:
    """The place of a part in its parent's box; None of a node that is no part."""
    fuse = target.inference(name).fuse if name in target.children else None
    place = None if fuse is None or fuse.latent is None else fuse.latent.given
    return place if place is not None and place.is_part else None


def part_of_agents(target: CheckedTarget) -> dict[str, str]:
    """Agent -> the nearest part above it; agents that look at the whole target are left out."""
    nearest: dict[str | None, str | None] = {None: None}
    for name in target.order:
        nearest[name] = nearest[target.parent[name]] if _part_of(target, name) is None else name
    return {agent: part for agent in target.agents if (part := nearest[agent]) is not None}


@dataclass(frozen=True, eq=False)
class PartBelief:
    """Belief about a part.

    Attributes:
        boxes: (N, 4) its draws, centre boxes, index-aligned with the root's hypotheses.
        weights: their posterior weights, given everything that the net saw.
    """

    boxes: Floats
    weights: LogWeights

    @property
    def mean(self) -> Floats:
        """(4,) the part's estimate: the mean of its belief."""
        return np.asarray(self.weights.weights @ self.boxes)

    @property
    def sd(self) -> Floats:
        """(4,) sds of its belief, px."""
        return np.sqrt(self.weights.weights @ (self.boxes - self.mean) ** 2)

    def uncertainty(self, columns: Sequence[int]) -> float:
        """UD over columns of the box, about the estimate."""
        return float(np.sum(self.sd[list(columns)] ** 2))


def part_beliefs(plan: Plan, evidence: Evidence, posterior: LogWeights) -> dict[str, PartBelief]:
    """Part -> its belief, for the root's `posterior` weights (N,) of the hypotheses that `evidence` is about.

    Where no draw of a part is left a weight, its draws have the root's.
    """
    fusions = {fusion.node: fusion for fusion in plan.fusions}
    log_ratios: dict[str, Floats | float] = {}
    beliefs: dict[str, PartBelief] = {}
    for step in plan.draws:
        inherited = 0.0 if step.node == plan.root else log_ratios.get(step.given_from, 0.0)
        log_ratios[step.node] = inherited + _quotient(plan, fusions.get(step.node), evidence)
        if step.given.is_part:
            beliefs[step.node] = PartBelief(
                evidence.latent[step.node].boxes, _weigh(posterior, log_ratios[step.node])
            )
    return beliefs


def _quotient(plan: Plan, fusion: Fusion | None, evidence: Evidence) -> Floats | float:
    """(N,) log L(c_i) / m(h_i) of a latent node; 0 where they are the same, or it has heard nothing."""
    if fusion is None or fusion.own == "one":
        return 0.0
    messages: Mapping[str, Floats] = evidence.messages
    sent = evidence.log_likelihood if fusion.node == plan.root else messages.get(fusion.node)
    if sent is None:
        return 0.0
    received = sum((messages[child] for child in fusion.children if child in messages), np.zeros(len(sent)))
    received += sum(evidence.factors.get(factor, 0.0) for factor in fusion.factors)
    # A hypothesis whose message is nothing has no weight, whatever its draw.
    return np.where(sent > -np.inf, received - np.where(sent > -np.inf, sent, 0.0), -np.inf)


def _weigh(posterior: LogWeights, log_ratios: Floats | float) -> LogWeights:
    if isinstance(log_ratios, float):
        return posterior
    try:
        return posterior.times(log_ratios)[0]
    except DegenerateWeights:
        return posterior
