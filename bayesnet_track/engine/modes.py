"""The modes of a target in one frame, and what is written down of them."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from bayesnet_track.belief.contract import Posterior
from bayesnet_track.belief.motion.modes import Modes, mode_probabilities
from bayesnet_track.journal.events.beliefs import ModeChanged
from bayesnet_track.journal.metrics import FrameMetrics
from bayesnet_track.journal.net.target_net import HiddenCause
from bayesnet_track.numerics.arrays import Floats

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
    def of(modes: Modes, before: Posterior, now: Posterior, dt: float) -> ModeState:
        """Those of two beliefs that are `dt` frame intervals apart."""
        first, last = (np.maximum(mode_probabilities(one, len(modes)), LEAST) for one in (before, now))
        return ModeState(modes, first, np.maximum(first @ modes.chain.over(dt), LEAST), last)

    def joined(self, now: Posterior) -> ModeState:
        """The same after a joint belief has weighed the hypotheses anew."""
        return replace(self, now=np.maximum(mode_probabilities(now, len(self.modes)), LEAST))

    @property
    def hidden(self) -> float | None:
        """Probability that the target cannot be seen; None where it always can."""
        return self.modes.probability_hidden(self.now) if self.modes.can_hide else None

    @property
    def hiding(self) -> HiddenCause | None:
        """That probability beside the one above which the target counts as lost."""
        hidden = self.hidden
        return None if hidden is None else HiddenCause(self.modes.lost_above, hidden)

    def named(self) -> dict[str, float]:
        """Mode -> its probability."""
        return self.modes.named(self.now)

    def change(self, frame: int, target: str) -> ModeChanged | None:
        """What is told where another mode is the most probable one now."""
        mode, before = int(np.argmax(self.now)), int(np.argmax(self.before))
        if mode == before:
            return None
        turning = float(np.log(self.predicted[before] / self.predicted[mode]))
        names = self.modes.names
        return ModeChanged(
            frame=frame,
            target=target,
            mode=names[mode],
            before=names[before],
            probability=float(self.now[mode]),
            predicted=float(self.predicted[mode]),
            nats=float(np.log(self.now[mode] / self.now[before])) + turning,
            turning=turning,
            hidden=self.hidden,
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
        modes=state.named(),
        modes_predicted=state.modes.named(state.predicted),
        hidden=hidden,
        score=score,
        status=status_by_modes(metrics.status, state.modes, state.now),
    )
