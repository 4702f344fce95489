"""Weigh hypotheses by the graph's factors: expressions of their states instead of what agents see."""

from __future__ import annotations

from collections.abc import Mapping, MutableMapping
from dataclasses import dataclass, field

import numpy as np

from bayesnet_track.belief.contract import BOX_FIELDS, Evidence
from bayesnet_track.belief.motion.formulas import Undefined
from bayesnet_track.graph.expressions.evaluate import log_values
from bayesnet_track.graph.expressions.terms import MASK, PARENT, Term
from bayesnet_track.numerics.arrays import Floats
from bayesnet_track.observation.cue import Hypotheses
from bayesnet_track.observation.image_files import Mask
from bayesnet_track.observation.planes import FramePair

Value = Floats | float

ZERO_BELOW = -1e100
"""A log density below this is a density of zero, so that sums of them stay finite."""


@dataclass(frozen=True)
class Weigh:
    """A factor weighs the hypotheses of the node `at` (the root or the nearest latent node above it).

    Attributes:
        factor: the factor node.
        at: the node.
        given_from: whose hypotheses those of a latent node are drawn around; the node itself for the root.
        term: the expression, a density up to a constant.
        constants: the numbers that it uses by name.
        is_prior: it multiplies the root's prior: all nodes from it up to the root are products.
        mask: the image that the expression asks, or None.
    """

    factor: str
    at: str
    given_from: str
    term: Term
    constants: Mapping[str, float]
    is_prior: bool
    mask: Mask | None = None


@dataclass(frozen=True)
class Flaw:
    """What was wrong with a factor's values in one frame.

    Attributes:
        undefined: hypotheses of which it has no value; they count as impossible.
        hypotheses: how many there were.
        ignored: no hypothesis was possible, so it was left out of the frame.
    """

    undefined: int
    hypotheses: int
    ignored: bool


@dataclass(frozen=True, eq=False)
class Factors:
    """What was found of a target's factors in one frame.

    Attributes:
        flaws: factor -> what was wrong when it was first evaluated.
        used: factors that were evaluated and not left out.
        undefined: field of a latent node by expressions, ``given head.x`` -> at how many hypotheses its
            distribution has no value.
    """

    flaws: MutableMapping[str, Flaw] = field(default_factory=dict)
    used: set[str] = field(default_factory=set)
    undefined: MutableMapping[str, Undefined] = field(default_factory=dict)


def weigh(
    step: Weigh, own: Hypotheses, above: Hypotheses, frames: FramePair, found: Factors
) -> Floats | None:
    """(N,) log density of a factor, finite or -inf; None where it is left out of the frame.

    `own` are the hypotheses that it weighs, `above` those around which they were drawn.

    It is left out where it is zero for all hypotheses that the frame begins with. Of those that are drawn
    later all may be impossible, and then they have no weight.
    """
    flaw = found.flaws.get(step.factor)
    if flaw is not None and flaw.ignored:
        return None
    size = len(own)
    names = _names(step, own, above, frames)
    log = np.array(np.broadcast_to(log_values(step.term, names), (size,)), dtype=np.float64)
    undefined = np.isnan(log)
    log[undefined | ~(log >= ZERO_BELOW)] = -np.inf
    ignored = bool(size) and step.factor not in found.used and not np.isfinite(log).any()
    if undefined.any() or ignored:
        found.flaws.setdefault(step.factor, Flaw(int(undefined.sum()), size, ignored))
    if ignored:
        return None
    found.used.add(step.factor)
    return log


def log_prior_factor(steps: tuple[Weigh, ...], evidence: Evidence) -> Floats:
    """(N,) log of the factors that multiply the root's prior; zeros when there are none."""
    found = [evidence.factors[one.factor] for one in steps if one.is_prior and one.factor in evidence.factors]
    return np.sum(found, axis=0) if found else np.zeros(len(evidence.log_likelihood))


def log_seen(steps: tuple[Weigh, ...], evidence: Evidence) -> Floats:
    """(N,) log-likelihood of what was seen alone, without the factors that multiply the root's prior."""
    if not steps:
        return evidence.log_likelihood
    log = log_prior_factor(steps, evidence)
    return evidence.log_likelihood - np.where(np.isfinite(log), log, 0.0)


def _names(step: Weigh, own: Hypotheses, above: Hypotheses, frames: FramePair) -> dict[str, Value | Mask]:
    """What the names of an expression stand for."""
    return {
        **frames.names,
        **{name: own.boxes[:, k] for k, name in enumerate(BOX_FIELDS)},
        "mode": 0.0,  # where a place is asked about, and no hypothesis: the first mode
        **{PARENT + name: above.boxes[:, k] for k, name in enumerate(BOX_FIELDS)},
        **own.fields,
        **step.constants,
        **({} if step.mask is None else {MASK: step.mask}),
    }
