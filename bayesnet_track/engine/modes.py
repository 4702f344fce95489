"""The modes of a target in one frame, and what is written down of them."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from bayesnet_track.belief.contract import Posterior
from bayesnet_track.belief.gaussian.modal import ModalPosterior
from bayesnet_track.belief.motion.modes import FIELD, Modes, mode_probabilities
from bayesnet_track.belief.particles.particle_set import ParticleSet
from bayesnet_track.journal.events.beliefs import ModeChanged
from bayesnet_track.journal.metrics import FrameMetrics
from bayesnet_track.journal.target_net import HiddenCause
from bayesnet_track.numerics.arrays import Floats, Ints
from bayesnet_track.observation.cue import AssociationRule, LabelRule

LEAST = 1e-12
"""Probabilities of modes are at least this: of none is it certain that the target is not in it."""


@dataclass(frozen=True, eq=False)
class ModeState:
    """The modes of a target in one frame.

    Attributes:
        modes: what they are.
        before: (K,) their probabilities after the last frame.
        predicted: (K,) before the evidence of this one.
        now: (K,) after it.
    """

    modes: Modes
    before: Floats
    predicted: Floats
    now: Floats

    @staticmethod
    def of(modes: Modes, previous: Posterior, current: Posterior, dt: float) -> ModeState:
        """Modes of two beliefs that are `dt` frame intervals apart."""
        first, final = (
            np.maximum(mode_probabilities(belief, len(modes)), LEAST) for belief in (previous, current)
        )
        return ModeState(modes, first, np.maximum(first @ modes.chain.over(dt), LEAST), final)

    def joined(self, posterior: Posterior) -> ModeState:
        """The same after a joint belief has weighed the hypotheses anew."""
        return replace(self, now=np.maximum(mode_probabilities(posterior, len(self.modes)), LEAST))

    @property
    def hidden(self) -> float | None:
        """Probability that the target cannot be seen; None where it always can."""
        return self.modes.probability_hidden(self.now) if self.modes.can_hide else None

    @property
    def hiding(self) -> HiddenCause | None:
        """The probability of hiding beside the one above which the target counts as lost."""
        hidden = self.hidden
        return None if hidden is None else HiddenCause(self.modes.lost_above, hidden)

    def changes(self, frame: int, target: str) -> tuple[ModeChanged, ...]:
        """Events where another mode, or another value of a constant, is the most probable one now."""
        named = [("", self.modes.index[FIELD], self.modes.ways)]
        named += [
            (constant.name, self.modes.index[constant.name], constant.values)
            for constant in self.modes.constants
        ]
        changes = (self._change(frame, target, *choice) for choice in named if len(choice[2]) > 1)
        return tuple(change for change in changes if change is not None)

    def _change(
        self, frame: int, target: str, constant: str, index: Ints, names: tuple[str, ...]
    ) -> ModeChanged | None:
        first, predicted, final = (
            np.bincount(index, weights) for weights in (self.before, self.predicted, self.now)
        )
        mode, former = int(np.argmax(final)), int(np.argmax(first))
        # Where several are as probable as each other nothing has changed.
        if mode == former or final[mode] <= final[former] * (1.0 + 1e-9):
            return None
        turning = float(np.log(predicted[former] / predicted[mode]))
        return ModeChanged(
            frame=frame,
            target=target,
            mode=names[mode],
            before=names[former],
            probability=float(final[mode]),
            predicted=float(predicted[mode]),
            nats=float(np.log(final[mode] / final[former])) + turning,
            turning=turning,
            hidden=None if constant else self.hidden,
            of=constant,
        )


def status_by_modes(status: str, modes: Modes | None, probabilities: Floats) -> str:
    """The status that is reported: `hidden` of a target that is lost because it is probably hidden."""
    is_hidden = modes is not None and modes.probability_hidden(probabilities) > modes.lost_above
    return "hidden" if status == "lost" and is_hidden else status


def with_modes(metrics: FrameMetrics, state: ModeState | None, calibrated: bool = False) -> FrameMetrics:
    """The line with the target's modes; a score that is not `calibrated` falls with what is hidden.

    A target that is lost because it is probably hidden has the status `hidden`.
    """
    if state is None:
        return metrics
    hidden = state.hidden
    score = metrics.score if calibrated or hidden is None else metrics.score * (1.0 - hidden)
    return replace(
        metrics,
        modes=state.modes.named(state.now),
        modes_predicted=state.modes.named(state.predicted),
        category=state.modes.values(state.now),
        category_predicted=state.modes.values(state.predicted),
        hidden=hidden,
        score=score,
        status=status_by_modes(metrics.status, state.modes, state.now),
    )


def combination_probabilities(belief: Posterior, modes: Modes | None) -> Floats | None:
    """Probabilities of the combinations of what a target may be; None where it is nothing in particular."""
    if modes is None or not modes.constants:
        return None
    return np.asarray(np.bincount(modes.kinds, mode_probabilities(belief, len(modes))), dtype=np.float64)


def with_kinds(belief: Posterior, modes: Modes | None, kinds: Floats | None) -> Posterior:
    """A belief that starts again, about a target that is what it was with the probabilities `kinds`."""
    prior_kinds = combination_probabilities(belief, modes)
    if modes is None or prior_kinds is None or kinds is None:
        return belief
    with np.errstate(divide="ignore", invalid="ignore"):
        factors = np.where(prior_kinds > 0.0, kinds / prior_kinds, 0.0)
    return _reweighed(belief, factors[modes.kinds])


def with_label(belief: Posterior, modes: Modes | None, category: str, log: Floats | None) -> Posterior:
    """A belief that starts, after labels of log-likelihoods (V,) by the value of a category."""
    if modes is None or log is None:
        return belief
    return _reweighed(belief, np.exp(log - log.max())[modes.index[category]])


def _reweighed(belief: Posterior, factors: Floats) -> Posterior:
    """The belief with the weights of its modes times `factors` (K,)."""
    if isinstance(belief, ModalPosterior):
        shares = belief.mode_probabilities * factors
        return replace(belief, mode_probabilities=shares / shares.sum())
    if isinstance(belief, ParticleSet):
        with np.errstate(divide="ignore"):
            log = np.log(factors)[belief.states[:, -1].astype(np.intp)]
        return replace(belief, weights=belief.weights.times(log)[0])
    return belief


def with_labels(rule: AssociationRule, parameters: object, modes: Modes | None) -> AssociationRule:
    """The rule with how labels are evidence, by the `confusion` of an agent's parameters."""
    constants = {} if modes is None else {constant.name: constant for constant in modes.constants}
    for category, rows in getattr(parameters, "confusion", {}).items():
        if category in constants:
            labels = tuple(next(iter(rows.values())))
            of_values = (rows[value] for value in constants[category].values)
            table = tuple(tuple(row[label] for label in labels) for row in of_values)
            prior = constants[category].prior
            return replace(rule, label=LabelRule(category, labels, table, prior))
    return rule
