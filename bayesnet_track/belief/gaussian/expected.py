"""Targets in modes as they are expected in a frame, which detections are weighed by."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from bayesnet_track.belief.contract import MotionModel, Posterior
from bayesnet_track.belief.gaussian.belief import GaussianPosterior
from bayesnet_track.belief.gaussian.modal import ModalFilter, ModalPosterior, mixture_moments, modal_in
from bayesnet_track.belief.particles.particle_set import ParticleSet
from bayesnet_track.graph import spec
from bayesnet_track.numerics.arrays import Floats, Ints
from bayesnet_track.numerics.gaussian import symmetric
from bayesnet_track.observation.cue import AssociationRule


@dataclass(frozen=True, eq=False)
class ExpectedInModes:
    """A target in modes as it is expected in a frame: what may be detected of it.

    Attributes:
        shares: (V,) probabilities of the modes in which it can be seen, given that it can.
        means: (V, D) in each.
        covariances: (V, D, D).
        visible: probability that it can be seen.
        values: of each constant, (V,) the number of its value in each of these modes.
    """

    shares: Floats
    means: Floats
    covariances: Floats
    visible: float
    values: Mapping[str, Ints] = field(default_factory=dict)

    def log_gains(self, rule: AssociationRule, labels: Sequence[str]) -> Floats:
        """(V, N) log of how much likelier labels are a target's in each mode than nobody's; 0 without."""
        if rule.label is None:
            return np.zeros((len(self.shares), 1))
        return rule.label.log_gains(labels)[:, self.values[rule.label.category]].T

    def log_gain(self, rule: AssociationRule, labels: Sequence[str]) -> Floats:
        """(N,) the same in all modes together, whatever the place."""
        with np.errstate(divide="ignore"):
            log = np.log(self.shares)[:, None] + self.log_gains(rule, labels)
        return np.asarray(np.logaddexp.reduce(log, axis=0))

    @property
    def moments(self) -> tuple[Floats, Floats]:
        """Mean and covariance of the target where it can be seen."""
        return mixture_moments(self.means, self.covariances, self.shares)


def expect(posterior: Posterior, motion: MotionModel, dt: float, settings: spec.Gaussian) -> ExpectedInModes:
    """A target `dt` frame intervals after the `posterior`, Gaussian or particles, moved by `motion`.

    Particles of each mode are taken by their moments.
    """
    modes = modal_in(motion).modes
    filtered = ModalFilter(settings, modes)
    predicted = filtered.predict(_in_gaussians(posterior, len(modes)), motion, dt, np.random.default_rng(0))
    visible_modes = np.flatnonzero(~np.array(modes.hidden))
    shares = predicted.mode_probabilities[visible_modes]
    visible = float(shares.sum())
    if visible <= 0.0:
        shares, visible = np.ones(len(visible_modes)), 0.0
    parts = [predicted.parts[mode] for mode in visible_modes]
    means, covariances = (
        np.array([part.mean for part in parts]),
        np.array([part.covariance for part in parts]),
    )
    values = {name: numbers[visible_modes] for name, numbers in modes.index.items()}
    return ExpectedInModes(shares / shares.sum(), means, covariances, min(visible, 1.0), values)


def _in_gaussians(posterior: Posterior, size: int) -> ModalPosterior:
    """A belief in modes as a Gaussian for each; of a mode without particles that of all of them."""
    if isinstance(posterior, ModalPosterior):
        return posterior
    assert isinstance(posterior, ParticleSet)
    states, weights = posterior.states, posterior.weights.weights
    modes, points = states[:, -1].astype(np.intp), states[:, :-1]
    shares = np.bincount(modes, weights, minlength=size)
    parts = []
    for mode in range(size):
        mode_weights = weights * (modes == mode) if shares[mode] > 0.0 else weights
        mode_weights = mode_weights / mode_weights.sum()
        mean = mode_weights @ points
        deviations = points - mean
        covariance = symmetric((deviations * mode_weights[:, None]).T @ deviations)
        parts.append(GaussianPosterior(mean, covariance, posterior.fields[:-1], len(states)))
    return ModalPosterior(tuple(parts), np.asarray(shares / shares.sum()))
