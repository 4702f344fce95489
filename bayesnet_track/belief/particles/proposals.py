"""Second passes: where they are drawn, and the weights that make a sample of the prior of both passes.

All densities are relative to the prior's, which cancels: a hypothesis that the first pass draws n times and
the second one m r times as densely as the prior has the weight 1 / (n + m r), r being the ratio of the second
proposal's density to the prior's.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bayesnet_track.belief.contract import Ancestors, MotionModel
from bayesnet_track.belief.motion.borders import Confined
from bayesnet_track.belief.motion.noise import Transition
from bayesnet_track.belief.particles.particle_set import Inputs
from bayesnet_track.belief.particles.sample_size import WeightedSample, prior_of
from bayesnet_track.graph.settings.beliefs import SecondPassProposal
from bayesnet_track.numerics.arrays import Floats
from bayesnet_track.numerics.density import mixture_log_density
from bayesnet_track.numerics.gaussian import weighted_moments
from bayesnet_track.numerics.log_weights import LogWeights
from bayesnet_track.numerics.resampling import systematic

EFFECTIVE = (40, 4)
"""Effective hypotheses that Gaussians are fitted to; sharper likelihoods are flattened until there are.

Many make a fit that is right for one mode. Few stay within the mode that the frame favours where the prior
has several: the flatter a likelihood, the more it is of all of them."""
STRETCH = 2.0
"""How far the fit to a flattened likelihood L^t is sharpened again, at most; the rest of 1 / t is caution."""


@dataclass(frozen=True, eq=False)
class Message:
    """A Gaussian likelihood exp(information' x - x' precision x / 2) of K coordinates.

    Attributes:
        precision: (K, K), positive semi-definite.
        information: (K,).
    """

    precision: Floats
    information: Floats


def fit_message(
    points: Floats, beta: LogWeights, log_likelihood: Floats, effective: float = EFFECTIVE[0]
) -> Message:
    """The Gaussian that turns the mean and covariance of a prior sample into those of its posterior.

    Directions in which the posterior is not narrower get no precision. In a surprise few hypotheses hold all
    weight, and their covariance says nothing: then L^t is fitted, t < 1 as large as leaves `effective`
    hypotheses (at most a quarter of all), and the Gaussian is raised to min(1 / t, STRETCH).

    Args:
        points: (N, K) coordinates of the sample.
        beta: their prior weights.
        log_likelihood: (N,) finite or -inf, not all -inf.
        effective: hypotheses that are to count.

    Raises:
        DegenerateWeights: no hypothesis has a positive, finite weight.
    """
    power, posterior = flatten_to_ess(beta, log_likelihood, min(effective, len(points) / 4))
    centre, spread = weighted_moments(points, beta.weights)
    mean, covariance = weighted_moments(points, posterior.weights)
    # In coordinates in which the prior has covariance 1.
    # Where all of it lies on the image's border a coordinate has no variance of its own.
    root = np.linalg.cholesky(spread + np.diag(1e-9 * np.diagonal(spread) + 1e-12))
    whiten = np.linalg.inv(root)
    variances, axes = np.linalg.eigh(whiten @ covariance @ whiten.T)
    precisions = 1.0 / np.maximum(variances, 1e-6)
    shift = axes.T @ (whiten @ (mean - centre))
    gained = np.maximum(precisions - 1.0, 0.0)
    gained_shift = np.where(gained > 0, precisions * shift, 0.0)
    stretch = min(1.0 / power, STRETCH)
    back = whiten.T @ axes
    precision = (back * (stretch * gained)) @ back.T
    return Message(precision, back @ (stretch * gained_shift) + precision @ centre)


@dataclass(frozen=True, eq=False)
class Fitted:
    """A proposal q(k, x) over pairs of a parent and a state: C components for each of K' parents.

    Attributes:
        transition: p(x | k).
        log_shares: (C, K') log-probability of a component and a parent.
        means: (C, K', K) of the coordinates.
        roots: (C, K', K, K) lower roots of their covariances.
    """

    transition: Transition
    log_shares: Floats
    means: Floats
    roots: Floats

    def draw(self, size: int, rng: np.random.Generator) -> tuple[Ancestors, Floats]:
        """(size,) parents and (size, K) coordinates."""
        flat = systematic(np.exp(self.log_shares).ravel(), size, rng)
        component, parent = np.unravel_index(flat, self.log_shares.shape)
        noise = rng.standard_normal((size, self.means.shape[2]))
        steps = np.einsum("nij,nj->ni", self.roots[component, parent], noise)
        return parent.astype(np.intp, copy=False), self.means[component, parent] + steps

    def log_density(self, points: Floats, parents: Ancestors) -> Floats:
        """(M,) log q(k_m, x_m) of coordinates (M, K) and their parents, per unit of the coordinates."""
        parts = []
        for shares, means, roots in zip(self.log_shares, self.means, self.roots, strict=True):
            root = roots[parents]
            whitened = np.linalg.solve(root, (points - means[parents])[:, :, None])[:, :, 0]
            log_det = np.log(np.diagonal(root, axis1=1, axis2=2)).sum(axis=1)
            parts.append(shares[parents] - 0.5 * np.sum(whitened**2 + np.log(2 * np.pi), axis=1) - log_det)
        return np.asarray(np.logaddexp.reduce(parts, axis=0))


def fit_proposal(transition: Transition, weights: LogWeights, message: Message) -> Fitted:
    """beta_k p(x | k) times a Gaussian likelihood, normalised: exact for what both Gaussians say.

    Args:
        transition: p(x | k) of all parents.
        weights: beta, theirs.
        message: the likelihood.
    """
    means, sds = transition.means, transition.sds
    motion_precision = sds**-2.0
    # (C, K', K, K): the precisions of motion and message add up.
    precision = motion_precision[..., None] * np.eye(means.shape[1]) + message.precision
    covariance = np.linalg.inv(precision)
    information = motion_precision * means + message.information
    centres = np.einsum("ckij,ckj->cki", covariance, information)
    # The integral of motion times message over x, without what is the same for all.
    overlap = 0.5 * (
        np.einsum("cki,cki->ck", information, centres)
        - np.sum(motion_precision * means**2, axis=2)
        + np.linalg.slogdet(covariance)[1]
        - 2.0 * np.log(sds).sum(axis=2)
    )
    log_shares = transition.log_shares[:, None] + weights.log + overlap
    shares = LogWeights.normalise(log_shares.ravel())[0].log.reshape(log_shares.shape)
    return Fitted(transition, shares, centres, np.linalg.cholesky(covariance))


def paired_log_density(transition: Transition, points: Floats, parents: Ancestors) -> Floats:
    """(M,) log p(x_m | k_m) of coordinates (M, K) and their parents, per unit of the coordinates."""
    means = transition.means[parents]
    parts = []
    for share, sds in zip(transition.log_shares, transition.sds, strict=True):
        deviations = (points - means) / sds[parents]
        parts.append(share - np.sum(0.5 * (deviations**2 + np.log(2 * np.pi)) + np.log(sds[parents]), axis=1))
    return np.asarray(np.logaddexp.reduce(parts, axis=0))


@dataclass(frozen=True, eq=False)
class Draws:
    """Hypotheses of a second pass before their evidence.

    Attributes:
        states: (M, D).
        ancestors: (M,) the parent that each moved from.
        log_ratio: (M,) log of the second proposal's density over the prior's, at these.
        log_ratio_first: (N,) the same at the hypotheses of the first pass.
    """

    states: Floats
    ancestors: Ancestors
    log_ratio: Floats
    log_ratio_first: Floats

    @property
    def log_alone(self) -> Floats:
        """(M,) log-weights that make them a sample of the prior by themselves."""
        return np.asarray(-np.log(len(self.states)) - self.log_ratio)


@dataclass(frozen=True, eq=False)
class CombinedSample:
    """Two passes as one.

    Attributes:
        whole: all hypotheses, weighted as a sample of the prior.
        log_second: log of the evidence by the second pass alone, whose natural scale is unbiased whatever the
            first one gave.
    """

    whole: WeightedSample
    log_second: float


def confine_to_image(motion: MotionModel, states: Floats) -> Floats:
    """`states` (N, D), changed in place to lie on the image where `motion` is confined to it."""
    return motion.confine(states) if isinstance(motion, Confined) else states


def reweight_sample(sample: WeightedSample, prior_log: Floats) -> WeightedSample:
    """The pass with other prior log-weights (N,)."""
    return WeightedSample(sample.states, prior_log, sample.ancestors, sample.evidence)


def log_sum(log: Floats) -> float:
    """log sum exp of (N,), -inf when all are."""
    return float(np.logaddexp.reduce(log))


# ------------------------------------------------------------------------------------ by a fitted Gaussian


def draw_fitted(inputs: Inputs, first: WeightedSample, settings: SecondPassProposal) -> Draws | None:
    """Parents and states by the motion times a Gaussian likelihood that the first pass is fitted with.

    Pairs (parent, state) are drawn from beta_k p(x | k) G(x), normalised in closed form, over all hypotheses
    of the last frame: O(N). For a linear-Gaussian motion and a Gaussian likelihood it tends to the proposal
    of least variance, p(x | k, y) with parents by p(y | k). Half of the draws are by a fit to many
    hypotheses, half by one to few (`EFFECTIVE`). None for a motion that cannot be drawn from in this way: one
    without noise, or whose coordinates have no known way back.

    Raises:
        DegenerateWeights: no hypothesis of the first pass has a positive, finite likelihood.
    """
    motion, beta = inputs.motion, inputs.prior.weights
    transition = motion.transition(inputs.prior.states, inputs.dt)
    if transition.states is None or transition.means.shape[1] == 0:
        return None
    points = transition.coordinates(first.states)[0]
    likelihood = first.evidence.log_likelihood
    proposals = [
        fit_proposal(transition, beta, fit_message(points, prior_of(first), likelihood, effective))
        for effective in EFFECTIVE
    ]

    m = len(first)
    as_first = round(settings.defensive * m)
    counts = [m - as_first - (m - as_first) // 2, (m - as_first) // 2]
    rng = inputs.stream("second pass")
    pairs = [proposal.draw(count, rng) for proposal, count in zip(proposals, counts, strict=True)]
    parents, draws = (np.concatenate(parts) for parts in zip(*pairs, strict=True))
    still = motion.drift(inputs.prior.states[parents], inputs.dt)
    ancestors = systematic(beta.weights, as_first, rng).astype(np.intp, copy=False)
    propagated = motion.propagate(inputs.prior.states[ancestors], inputs.dt, rng)
    states = np.concatenate([transition.states(draws, still), propagated])
    ancestors = np.concatenate([parents, ancestors])

    def log_ratio(points: Floats, parents: Ancestors) -> Floats:
        prior = beta.log[parents] + paired_log_density(transition, points, parents)
        log_ratios = [proposal.log_density(points, parents) - prior for proposal in proposals]
        with np.errstate(divide="ignore"):
            shares = np.log(np.array([*counts, as_first]) / m)[:, None]
        return np.asarray(np.logaddexp.reduce(shares + np.array([*log_ratios, np.zeros(len(points))])))

    # Densities are those of the model without borders, so they are taken before states are confined.
    of_second = log_ratio(transition.coordinates(states)[0], ancestors)
    return Draws(
        confine_to_image(motion, states),
        ancestors,
        of_second,
        log_ratio(points, first.ancestors),
    )


def mix_defensive(log_ratio: Floats, defensive: float) -> Floats:
    """The ratio to the prior when a share of the draws is from the prior itself."""
    if defensive == 0:
        return log_ratio
    return np.asarray(np.logaddexp(np.log1p(-defensive) + log_ratio, np.log(defensive)))


# ------------------------------------------------------------------------------------ by the parents


def draw_by_parents(inputs: Inputs, first: WeightedSample, settings: SecondPassProposal) -> Draws:
    """Importance resampling: parents of hypotheses that did well, moved again (eqs. 5.23-5.26, corrected).

    j is drawn by v' among the parents of the first pass, each as often as it was drawn there, and weighted by
    (1/N) / v'_j, not by the inverse likelihood alone. v'_j is the mean likelihood of j and its neighbours,
    those whose drift is nearest in sds of the noise, mixed with the defensive share of 1/N. Where a
    hypothesis of the first pass is weighted by v', its own likelihood is left out, or it would pay for having
    done well.

    Raises:
        DegenerateWeights: no hypothesis of the first pass has a positive, finite likelihood.
    """
    parents = inputs.prior.states[first.ancestors]
    likelihood = np.exp(first.evidence.log_likelihood - top(first.evidence.log_likelihood))
    if settings.neighbours == 1:
        mean = others_mean = likelihood
    else:
        transition = inputs.motion.transition(parents, inputs.dt)
        group = neighbourhoods(transition.means / transition.sds[0], settings.neighbours)
        total, count = np.bincount(group, likelihood)[group], np.bincount(group)[group]
        mean, others_mean = total / count, np.maximum(total - likelihood, 0.0) / np.maximum(count - 1, 1)
    beta = prior_of(first).weights
    scale = float(beta @ mean)
    with np.errstate(divide="ignore"):
        ratio, ratio_first = (
            mix_defensive(np.log(v / scale), settings.defensive) for v in (mean, others_mean)
        )
    indices = systematic(beta * np.exp(ratio), len(first), inputs.stream("second pass"))
    states = inputs.motion.propagate(parents[indices], inputs.dt, inputs.stream("second propagate"))
    return Draws(states, first.ancestors[indices], ratio[indices], ratio_first)


def neighbourhoods(points: Floats, size: int) -> NDArray[np.intp]:
    """(N,) labels of groups of near points (N, K), of `size` to 2 size - 1 each (all N when they are fewer).

    Cut at the median of the widest coordinate until no group can be cut.
    """
    labels = np.zeros(len(points), dtype=np.intp)
    waiting, label = [np.arange(len(points))], 0
    while waiting:
        group = waiting.pop()
        if len(group) < 2 * size or points.shape[1] == 0:
            labels[group], label = label, label + 1
            continue
        group_points = points[group]
        order = np.argsort(group_points[:, int(np.argmax(np.ptp(group_points, axis=0)))], kind="stable")
        half = len(group) // 2
        waiting += [group[order[:half]], group[order[half:]]]
    return labels


def top(log_likelihood: Floats) -> float:
    """The largest log-likelihood.

    Raises:
        DegenerateWeights: it is not finite.
    """
    LogWeights.normalise(log_likelihood)
    return float(np.max(log_likelihood))


_BLOCK = 2**20
"""Pairs of a point and a component summed in one go: bounds the memory."""


@dataclass(frozen=True, eq=False)
class Kernels:
    """A mixture of Gaussians of one covariance.

    Attributes:
        weights: of the M components.
        centres: (M, K).
        root: (K, K) lower root of the covariance.
    """

    weights: LogWeights
    centres: Floats
    root: Floats

    def draw(self, size: int, rng: np.random.Generator) -> tuple[Ancestors, Floats]:
        """(size,) components and (size, K) points."""
        components = systematic(self.weights.weights, size, rng).astype(np.intp, copy=False)
        steps = rng.standard_normal((size, len(self.root))) @ self.root.T
        return components, self.centres[components] + steps

    def log_density(self, points: Floats, without_own: int = 0) -> Floats:
        """(N,) log-density of points (N, K); the first `without_own` leave out the component of their index.

        A point that helped to place the kernels would otherwise pay for its own kernel.
        """
        back = np.linalg.inv(self.root).T
        whitened, centres = points @ back, self.centres @ back
        log_peak = -np.log(np.diagonal(self.root)).sum() - 0.5 * points.shape[1] * np.log(2 * np.pi)
        log_densities = log_mixture(whitened, self.weights.log, centres)
        with_own, count = log_densities[:without_own], without_own
        at_own = self.weights.log[:count] - 0.5 * np.sum((whitened[:count] - centres[:count]) ** 2, axis=1)
        with np.errstate(divide="ignore", invalid="ignore"):
            log_others = np.log(-np.expm1(np.minimum(at_own - with_own, 0.0)))
            log_densities[:count] = np.where(np.isfinite(with_own), with_own + log_others, with_own)
        return np.asarray(log_densities + log_peak)


def log_mixture(points: Floats, log_weights: Floats, centres: Floats) -> Floats:
    """(N,) log sum_m w_m exp(-|point_n - centre_m|^2 / 2); O(N M)."""
    middle = centres.mean(axis=0)  # squares are expanded: subtract first what would cancel
    points, centres = points - middle, centres - middle
    fixed = log_weights - 0.5 * np.sum(centres**2, axis=1)
    result = np.empty(len(points))
    rows = max(1, _BLOCK // len(centres))
    for start in range(0, len(points), rows):
        some = points[start : start + rows]
        terms = some @ centres.T + fixed
        peaks = terms.max(axis=1)
        terms -= peaks[:, None]
        np.exp(terms, out=terms)
        result[start : start + rows] = peaks + np.log(terms.sum(axis=1)) - 0.5 * np.sum(some**2, axis=1)
    return result


def log_prior(transition: Transition, weights: LogWeights, points: Floats) -> Floats:
    """(N,) log sum_k beta_k p(x_n | k) of coordinates (N, K), per unit of the coordinates; O(N K')."""
    parts = []
    for share, sds in zip(transition.log_shares, transition.sds, strict=True):
        if (sds == sds[0]).all():
            sd = sds[0]
            peak = share - np.log(sd).sum() - 0.5 * len(sd) * np.log(2 * np.pi)
            parts.append(peak + log_mixture(points / sd, weights.log, transition.means / sd))
        else:
            rows = max(1, _BLOCK // len(sds))
            starts = range(0, len(points), rows)
            blocks = [
                mixture_log_density(points[start : start + rows], weights.log, transition.means, sds)
                for start in starts
            ]
            parts.append(share + np.concatenate(blocks))
    return np.asarray(np.logaddexp.reduce(parts, axis=0))


def flatten_to_ess(beta: LogWeights, log_likelihood: Floats, least_ess: float) -> tuple[float, LogWeights]:
    """t in (0, 1] and beta L^t, normalised, with an effective size from `least_ess` on where it can be had.

    Raises:
        DegenerateWeights: no hypothesis has a positive, finite weight.
    """
    power, weights = 1.0, beta.times(log_likelihood)[0]
    while weights.ess < least_ess and power > 1e-6:
        power *= 0.8
        weights = beta.times(power * log_likelihood)[0]
    return power, weights
