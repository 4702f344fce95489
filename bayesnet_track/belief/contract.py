"""The contract between a belief and the engine, and the one state that stands for a belief.

A belief is stepped by ``step(prior, motion, evaluate, streams)``. It proposes hypotheses and asks `evaluate`
for their evidence, as often as it likes within a frame; it knows nothing of the net behind it.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Generic, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from bayesnet_track.belief.motion.noise import Transition
from bayesnet_track.graph import spec
from bayesnet_track.graph.expressions.distributions import LinearNormal
from bayesnet_track.journal.events.event import Event
from bayesnet_track.numerics.arrays import Floats, Ints
from bayesnet_track.numerics.distributions import nearest_probable
from bayesnet_track.numerics.log_weights import LogWeights
from bayesnet_track.observation.cue import Hypotheses, Measurement
from bayesnet_track.observation.protocols import Seen


@dataclass(frozen=True, eq=False)
class WeightedStates:
    """Hypotheses (N, D) with their posterior weights (`belief.contract.Support`)."""

    states: Floats
    weights: LogWeights

    @property
    def boxes(self) -> Floats:
        """(N, 4) centre boxes."""
        return self.states[:, :4]


def hypotheses_of(states: Floats, fields: tuple[str, ...]) -> Hypotheses:
    """Hypotheses that cues see of `states` (N, D): the boxes, and the further fields by name."""
    return Hypotheses(states[:, :4], {name: states[:, k] for k, name in enumerate(fields) if k >= 4})


Ancestors = NDArray[np.intp]

BOX_FIELDS = ("x", "y", "w", "h")

LEAST_SIDE_PX = 1.0
LEAST_SIDE_M = 0.01
"""Of targets on the ground, whose sides are in metres."""


@dataclass(frozen=True, eq=False)
class Evidence:
    """Evidence of the net about N hypotheses.

    Attributes:
        log_likelihood: (N,) of the whole net, finite or -inf; zeros when no agent is active.
        messages: node -> (N,) log-likelihood that it sent to its parent (agents and inference nodes).
        latent: latent node -> its own hypotheses, index-aligned with the root's.
        faults: agent that had a message in an earlier evaluation of the frame, and has none here -> why.
        gaussians: agent that measured, or latent node with a Gaussian belief -> its message as it reaches the
            root: its covariance divided by its weight in the pools on the way. Only where every node on the
            way multiplies messages.
        linear: factor of the root that is a product of normal densities of linear forms -> these. Only where
            the root's belief is a Gaussian without modes, which takes them exactly.
        sampled: (N,) the net's log-likelihood without `gaussians` and `linear`; None when there are none.
        measured: agent that measures -> what it measured; None when it saw nothing and is left out. Of
            agents whose detections are `Choices` of a group only those that saw nothing.
        factors: factor -> (N,) its log density at the node that it weighs.
        log_constants: agent that measured -> what the net's log-likelihood lacks, by it, to be the log
            density of what was measured. Agents that score, or that are given detections, have none.
    """

    log_likelihood: Floats
    messages: Mapping[str, Floats] = field(default_factory=dict)
    latent: Mapping[str, Hypotheses] = field(default_factory=dict)
    faults: Mapping[str, str] = field(default_factory=dict)
    gaussians: Mapping[str, Measurement] = field(default_factory=dict)
    sampled: Floats | None = None
    measured: Mapping[str, Measurement | None] = field(default_factory=dict)
    factors: Mapping[str, Floats] = field(default_factory=dict)
    log_constants: Mapping[str, float] = field(default_factory=dict)
    linear: Mapping[str, tuple[LinearNormal, ...]] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class Choices:
    """Detections that may be those of T targets, each a quantity z = h(x) + N(0, R) of K values.

    Attributes:
        fields: names of the values.
        starts: (T + 1,) where the detections of each target begin in the next three.
        values: (P, K) what was measured.
        covariances: (P, K, K) of the errors, beside those that `quantities` have of what is expected.
        weights: (P,) the probability that it is the target's.
        missed: (T,) that none is.
        quantities: h, where the values are no fields of the state.
    """

    fields: tuple[str, ...]
    starts: Ints
    values: Floats
    covariances: Floats
    weights: Floats
    missed: Floats
    quantities: Seen | None = None

    @property
    def counts(self) -> Ints:
        """(T,) number of detections of each target."""
        return self.starts[1:] - self.starts[:-1]


@dataclass(frozen=True, eq=False)
class GroupEvidence:
    """Evidence of the net about the hypotheses of each of T targets.

    Attributes:
        by_target: of one target after the other.
        choices: agent -> its detections, which are in no evidence of a target.
    """

    by_target: Sequence[Evidence]
    choices: Mapping[str, Choices] = field(default_factory=dict)


Evaluate = Callable[[Hypotheses, Floats], Evidence]
"""(hypotheses, (N,) normalised prior log-weights) -> evidence. May be called again in a frame."""

Stream = Callable[[str], np.random.Generator]
"""purpose -> generator, for one target and frame."""


class MotionModel(Protocol):
    """Motion of states. A state is a row of fields: x, y, w, h, then the fields that the model adds."""

    @property
    def fields(self) -> tuple[str, ...]:
        """Names of the columns of a state, BOX_FIELDS first."""

    def start(self, box: Floats, size: int, rng: np.random.Generator) -> Floats:
        """(size, D) states for a target first seen in the centre box (4,)."""

    def start_moments(self, box: Floats) -> tuple[Floats, Floats]:
        """(D,) mean and (D, D) covariance of what `start` draws."""

    def propagate(
        self, states: Floats, dt: float, rng: np.random.Generator, parents: Ancestors | None = None
    ) -> Floats:
        """(N, D) states after `dt` frame intervals; widths and heights stay at least 1 px.

        With `parents`, (N,) indices into `states`, those of `states[parents]`, which need not be copied then.
        """

    def drift(self, states: Floats, dt: float) -> Floats:
        """(N, D) states after `dt` frame intervals without noise."""

    def linearise(self, state: Floats, dt: float) -> tuple[Floats, Floats]:
        """F and Q, each (D, D), at a state (D,): the drift's Jacobian, and the covariance of the noise."""

    def log_density(self, states: Floats, previous: Floats, dt: float) -> Floats:
        """(M, N) log p(states_m | previous_n) over the fields that have noise."""

    def transition(self, previous: Floats, dt: float) -> Transition:
        """p(states | previous) in coordinates in which it is a mixture of diagonal Gaussians."""


class Posterior(Protocol):
    """Knowledge of a target after a frame, whatever represents it."""

    @property
    def fields(self) -> tuple[str, ...]:
        """Names of the D columns of a state, BOX_FIELDS first."""

    def __len__(self) -> int:
        """Number of hypotheses: particles, cells, or the samples it asks about."""

    @property
    def mean(self) -> Floats:
        """(D,) mean state."""

    @property
    def covariance(self) -> Floats:
        """(D, D) covariance of the state."""

    def uncertainty(self, reference: Floats, columns: Sequence[int]) -> float:
        """UD = E |s - about|^2 over the columns of the state, about a state (D,)."""

    def mass_within(self, centre: Floats, radius: float) -> tuple[float, float]:
        """Share of it whose centre (x, y) lies within `radius` px of `centre` (2,), and of how many draws.

        The second number is the effective number of draws that know the share; inf where it is exact.
        """

    def regions(self, shares: Sequence[float]) -> Floats:
        """(S, 4) x_low, x_high, y_low, y_high, px: the central share of the centre's weight on each axis."""

    def draw(self, size: int, rng: np.random.Generator) -> Floats:
        """(size, 4) centre boxes drawn from it."""


class Support(Protocol):
    """The weighted hypotheses at which a belief asked for evidence."""

    @property
    def states(self) -> Floats:
        """(N, D) states, the centre box first."""

    @property
    def boxes(self) -> Floats:
        """(N, 4) centre boxes."""

    @property
    def weights(self) -> LogWeights:
        """Their posterior weights."""


P = TypeVar("P", bound=Posterior)
P_co = TypeVar("P_co", bound=Posterior, covariant=True)

Report = Callable[[int, str], Event]
"""(frame, target) -> an event: what a belief did of its own accord, to be written down."""


@dataclass(frozen=True, eq=False)
class Predicted:
    """A Gaussian (D,), (D, D) that the belief before a frame's evidence consists of, and its weight."""

    weight: float
    mean: Floats
    covariance: Floats


@dataclass(frozen=True, eq=False)
class Step(Generic[P_co]):
    """One frame of a belief.

    Attributes:
        posterior: the belief after the frame.
        log_evidence: log of the frame's evidence, sum beta L for hypotheses of prior weights beta (unbiased
            in the natural scale); -inf when degenerate.
        support: the hypotheses at which the evidence was taken, with their posterior weights.
        prior: beta, the weights of the same hypotheses before the evidence.
        evidence: what the net said of them.
        find_map: () -> (D,) maximum a posteriori state, prior density included.
        degenerate: why the evidence could not be used (the posterior is the prior then), or None.
        reports: what the belief did of its own accord.
        predicted: the belief before the evidence where that is Gaussians, those of visible modes; empty where
            the support stands for it.
        ancestors: (N,) hypotheses of the belief before that those after it come from; None where unknown.
        log_gated: log of the floors of measurements that were gated out: the likelihood of outliers.
    """

    posterior: P_co
    log_evidence: float
    support: Support
    prior: LogWeights
    evidence: Evidence
    find_map: Callable[[], Floats]
    degenerate: str | None = None
    reports: tuple[Report, ...] = ()
    predicted: tuple[Predicted, ...] = ()
    ancestors: Ancestors | None = None
    log_gated: float = 0.0

    @property
    def log_density(self) -> float:
        """`log_evidence` with the constants of what was measured: comparable between models of one sensor."""
        return self.log_evidence + sum(self.evidence.log_constants.values()) + self.log_gated

    @cached_property
    def map_state(self) -> Floats:
        """(D,) maximum a posteriori state, found when first asked for."""
        return self.find_map()


class BeliefFilter(Protocol[P]):
    """Representation of a belief, and its step. Holds settings only; what it knows is the posterior."""

    def start(self, box: Floats, motion: MotionModel, stream: Stream) -> P:
        """The belief about a target first seen in the centre box (4,)."""

    def predict(self, prior: P, motion: MotionModel, dt: float, rng: np.random.Generator) -> P:
        """The belief after `dt` frame intervals without evidence."""

    def step(self, prior: P, motion: MotionModel, dt: float, evaluate: Evaluate, stream: Stream) -> Step[P]:
        """The belief after `dt` frame intervals and the evidence of a frame."""


def estimate(settings: spec.Estimate | None, step: Step[Posterior]) -> Floats:
    """(D,) the state that stands for the belief after a step; the MAP when nothing is chosen.

    - `map`: largest posterior density, prior density included.
    - `max_weight`: hypothesis of the largest weight.
    - `mean`: mean of the belief, which lies between the modes of a bimodal one.
    - `robust_mean`: weighted mean of the hypotheses whose centres lie within `box` sqrt(w h) of the best,
      in x and in y (tracking chapter, estimators).
    - `nearest`: of the hypotheses with at least `epsilon` of the largest weight, the one whose centre lies
      nearest to the mean prediction (General Distribution Filter 1.3, corrected). The weights of a grid are
      densities; those of particles that were drawn from the prediction are likelihoods.
    """
    kind = "map" if settings is None else settings.kind
    if kind == "map":
        return step.map_state
    if kind == "mean":
        return step.posterior.mean
    states, weights = step.support.states, step.support.weights.weights
    if settings is not None and settings.nearest is not None:
        predicted = step.prior.weights @ states[:, :2]
        return np.asarray(
            states[nearest_probable(states[:, :2], weights, predicted, settings.nearest.epsilon)]
        )
    peak = np.asarray(states[int(np.argmax(weights))])
    if kind == "max_weight" or settings is None or settings.robust_mean is None:
        return peak
    reach = settings.robust_mean.box * float(np.sqrt(peak[2] * peak[3]))
    x, y = (np.abs(states[:, axis] - peak[axis]) <= reach for axis in (0, 1))
    neighbours = np.flatnonzero(x & y)
    shares = weights[neighbours]
    return np.asarray(shares @ states[neighbours] / shares.sum())
