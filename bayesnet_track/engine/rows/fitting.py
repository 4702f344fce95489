"""Which plates, and which targets of them, can be advanced as rows of a table; all others go one by one.

A plate fits whose targets have a Gaussian belief, a linear motion and one agent that is switched on, which
measures by the target's own detection; agents that are off may know its looks. A target fits as long as
nothing but its status was decided about it.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from bayesnet_track.belief.contract import BOX_FIELDS
from bayesnet_track.belief.gaussian.belief import GaussianFilter, GaussianPosterior, require_linear
from bayesnet_track.belief.motion.further_axes import BoxVelocityMotion
from bayesnet_track.belief.motion.models import KinematicMotion
from bayesnet_track.engine.compiled import CompiledPlate, Engine
from bayesnet_track.engine.lifecycle.unconfirmed import CrowdRule
from bayesnet_track.engine.scoring.score import ScoreState
from bayesnet_track.engine.state import TargetState
from bayesnet_track.graph.spec import InferenceNode, Lost
from bayesnet_track.inference.compile import Plan, compile_plan
from bayesnet_track.inference.measure import is_flat
from bayesnet_track.journal.target_net import TargetNet
from bayesnet_track.numerics.gaussian import chi_square_quantile
from bayesnet_track.observation.cue import OBSERVED, OWN_DETECTION, AssociationRule

LinearMotion = KinematicMotion | BoxVelocityMotion


@dataclass(frozen=True, eq=False)
class RowRule:
    """The rule that the rows of a plate have in common.

    Attributes:
        compiled: the plate.
        agent: its only agent that is switched on.
        others: its other agents.
        motion: how all of them move.
        association: which detection is whose, and how far off detections are.
        floor: of the agent's likelihood, the temperature taken in.
        temperature: the agent's.
        lost: when a target counts as lost.
        belief: how beliefs are updated.
        farthest: largest squared distance from the prediction of a detection that is used.
        counts: (4,) the fields of UD.
        plan: the compiled net with the agent.
        crowd: how targets exist and share detections; None where each is assigned one.
    """

    compiled: CompiledPlate
    agent: str
    others: tuple[str, ...]
    motion: LinearMotion
    association: AssociationRule
    floor: float
    temperature: float
    lost: Lost
    belief: GaussianFilter
    farthest: float
    counts: NDArray[np.bool_]
    plan: Plan
    crowd: CrowdRule | None = None

    @property
    def plate(self) -> str:
        """The plate's name."""
        return self.compiled.plate.name

    @property
    def root(self) -> str:
        """Its root node."""
        return self.compiled.plate.root

    @property
    def active(self) -> frozenset[str]:
        """The agents of a row that work: all."""
        return self.plan.active

    @property
    def shares_detections(self) -> bool:
        """True where several targets may use one detection, by probability."""
        return self.crowd is not None and self.crowd.is_marginal


def row_rule(engine: Engine, plate: str) -> RowRule | None:
    """The rule of the rows of a plate; None where its targets have to go one by one."""
    return None if engine.joins else _rule_of(engine.plates[plate])


@lru_cache(maxsize=64)
def _rule_of(compiled: CompiledPlate) -> RowRule | None:
    plate, motion = compiled.plate, compiled.motion
    if len(compiled.association_rules) != 1 or plate.factors or not is_flat(plate):
        return None
    agent, association = next(iter(compiled.association_rules.items()))
    idle = tuple(name for name in plate.agents if name != agent)
    is_usual = plate.agent(agent).active and not any(plate.agent(name).active for name in idle)
    if not is_usual or compiled.elsewhere:
        return None
    node, root = compiled.plate.agent(agent), compiled.plate.inference(compiled.plate.root)
    lost = compiled.plate.lost
    if lost.existence_rule is not None and lost.uncertain_below is not None:
        return None
    if association.floor is None:
        return None
    if not (_root_fits(root) and compiled.guard is None and compiled.moving is None):
        return None
    if not (
        isinstance(compiled.belief, GaussianFilter)
        and isinstance(motion, LinearMotion)
        and _is_linear(motion)
    ):
        return None
    return RowRule(
        compiled,
        agent,
        idle,
        motion,
        association,
        float(association.floor or 0.0) ** (1.0 / node.temperature),
        node.temperature,
        lost,
        compiled.belief,
        chi_square_quantile(compiled.belief.settings.gate, 4)
        if compiled.belief.settings.gate < 1.0
        else np.inf,
        np.array([name in root.ud_fields for name in BOX_FIELDS]),
        compile_plan(compiled.plate, [agent], compiled.cues),
        CrowdRule.of(compiled),
    )


def _root_fits(root: InferenceNode) -> bool:
    estimate = "map" if root.estimate is None else root.estimate.kind
    options = (root.adapt, root.score, root.localization_error, root.distractors)
    is_product = root.fuse is None or root.fuse.kind == "product"
    return estimate in ("map", "mean") and is_product and all(option is None for option in options)


def _is_linear(motion: LinearMotion) -> bool:
    try:
        require_linear(motion)
    except ValueError:
        return False
    return True


def net_fits(rule: RowRule, net: TargetNet) -> bool:
    """True where nothing but its status was decided about a live net."""
    return (
        net.active == rule.active
        and net.status != "uncertain"
        and not (net.quarantined or net.by_hand or net.faults or net.shed or net.sampled or net.rest_count)
        and net.most_particles is None
    )


def state_fits(rule: RowRule, state: TargetState, time: float) -> bool:
    """True where a state of that time is what a row holds."""
    return (
        state.time == time
        and isinstance(state.belief, GaussianPosterior)
        and state.plan.active == rule.active
        and state.motion_context is None
        and not (state.watched.slow or state.watched.parted or state.watched.frames)
        and state.scored == ScoreState()
        and state.references.keys() - {rule.agent} == {*rule.others}
        and state.references.get(rule.agent, {}).keys() <= {OWN_DETECTION, OBSERVED}
    )
