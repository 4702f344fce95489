"""The evidence of hypotheses that cannot be seen: what agents say of them is of the background."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from bayesnet_track.belief.contract import Evaluate, Evidence
from bayesnet_track.belief.motion.modes import FIELD, Modes
from bayesnet_track.graph.settings.motion import Hidden
from bayesnet_track.inference.compile import Observe, Plan
from bayesnet_track.inference.gaussian_messages import measurement_message
from bayesnet_track.inference.messages import join_messages
from bayesnet_track.numerics.arrays import Floats
from bayesnet_track.observation.cue import Hypotheses, Measurement
from bayesnet_track.observation.protocols import BOX


@dataclass(frozen=True)
class Sight:
    """Visibility in each mode, in frames of one size.

    Attributes:
        modes: the modes.
        width: columns of the frame.
        height: rows.
        unasked: agents that measure by detections, in a frame in which nobody detected: they missed nothing.
    """

    modes: Modes
    width: int
    height: int
    unasked: frozenset[str] = frozenset()

    def background(
        self, unseen: Hidden, measured: Measurement | None, temperature: float, hypotheses: Hypotheses
    ) -> float:
        """Log-likelihood that an agent gives a hidden target, on the scale of its own messages.

        Of one that measured it is the density of a measurement anywhere in the frame, times sqrt|2 pi R|, as
        its message has a peak of 1.
        """
        if measured is None:
            return float(np.log(unseen.likelihood)) / temperature
        scale = 0.5 * float(np.linalg.slogdet(2.0 * np.pi * measured.covariance)[1])
        if measured.log_peak is not None:
            scale = -measured.log_peak
        if measured.label is not None:
            scale += measured.label.log_nobody
        return float(np.log(unseen.mistaken) + scale - np.log(self._extents(measured, hypotheses)).sum())

    def _extents(self, measured: Measurement, hypotheses: Hypotheses) -> Floats:
        """(K,) how far apart two measurements of a quantity may lie, in its unit.

        Of a field of the state the frame's width or height. Of an angle the circle; of other functions of the
        state what they span for the hypotheses, and for their mean in the frame's corners, centre and sides.
        """
        if measured.seen is None:
            return np.array(
                [self.height if name in ("y", "h") else self.width for name in measured.fields], float
            )
        states = {**dict(zip(BOX, hypotheses.boxes.T, strict=True)), **hypotheses.fields}
        columns, rows = np.meshgrid([0.0, self.width / 2, self.width], [0.0, self.height / 2, self.height])
        places = {name: np.full(columns.size, values.mean()) for name, values in states.items()}
        places |= {"x": columns.ravel(), "y": rows.ravel()}
        quantities = np.concatenate([measured.seen.function(fields) for fields in (states, places)])
        quantities = np.where(np.isfinite(quantities), quantities, measured.mean)
        spans = np.where(measured.seen.periods < np.inf, measured.seen.periods, np.ptp(quantities, axis=0))
        return np.asarray(np.maximum(spans, np.sqrt(2.0 * np.pi * np.diag(measured.covariance))))

    def message(
        self, evidence: Evidence, step: Observe, hypotheses: Hypotheses, modes: NDArray[np.intp]
    ) -> Floats:
        """(N,) what an agent says of hypotheses in these modes."""
        message, measured = evidence.messages[step.agent], evidence.measured.get(step.agent)
        if step.agent in evidence.measured and measured is None:
            return message
        if measured is not None and measured.choices:  # the association weighed them against none
            return np.where(np.array(self.modes.hidden)[modes], 0.0, message)
        unseen = self.modes.unseen
        levels = np.array(
            [
                0.0
                if background is None
                else self.background(background, measured, step.temperature, hypotheses)
                for background in unseen
            ]
        )
        if measured is not None:
            missed = self.modes.missed * np.exp(levels[list(self.modes.hidden)].max())
            floor = float(missed / (missed + 1.0 - self.modes.missed))
            message = measurement_message(replace(measured, floor=floor), hypotheses)
        return np.where(np.array(self.modes.hidden)[modes], levels[modes], message)

    def log_detected(self, evidence: Evidence) -> Floats:
        """(K,) log-probability that the agents that measure see something, or nothing, as they did."""
        measured = {
            agent: measurement
            for agent, measurement in evidence.measured.items()
            if agent not in self.unasked and not (measurement is not None and measurement.choices)
        }
        silent = sum(measurement is None for measurement in measured.values())
        sighted, missed = len(measured) - silent, self.modes.missed
        visible = silent * np.log(missed) + sighted * np.log1p(-missed)
        # What of a measurement is `mistaken` is in its background.
        unseen = [
            0.0 if background is None else silent * np.log1p(-background.mistaken)
            for background in self.modes.unseen
        ]
        return np.where(self.modes.hidden, unseen, visible)


def evaluate_modes(
    plan: Plan, sight: Sight, evaluate: Evaluate, hypotheses: Hypotheses, prior_log: Floats
) -> Evidence:
    """The evidence of the net for hypotheses of which each is in a mode.

    Of a hypothesis that is hidden every agent that gave evidence says what it says of the background.
    Products, pools and temperatures join that as they join what agents see. A measurement far from a visible
    hypothesis is of the background, too, the target missed: that stands in for the agent's own floor.
    """
    number = hypotheses.fields[FIELD].astype(np.intp)
    if sight.modes.constants:
        fields = {**hypotheses.fields, **sight.modes.fields(number)}
        hypotheses = Hypotheses(hypotheses.boxes, fields)
    evidence = evaluate(hypotheses, prior_log)
    if not sight.modes.can_hide:
        return evidence
    log_detected = sight.log_detected(evidence)[number]
    hidden = np.array(sight.modes.hidden)[number]
    logs = _logs(plan, sight, evidence, hypotheses, number)
    if all(fusion.own == "one" for fusion in plan.fusions):
        joined = join_messages(plan, logs, evidence.measured, evidence.latent, hypotheses, prior_log)
        messages = joined.messages
    else:
        # Integrals over a latent node's state are of draws of all hypotheses, as if each could be seen. That
        # of the background, a constant, is its value at the own draw.
        visible = np.full_like(number, sight.modes.hidden.index(False))
        anywhere = _logs(plan, sight, evidence, hypotheses, visible)
        joined = join_messages(plan, anywhere, evidence.measured, evidence.latent, hypotheses, prior_log)
        plain_plan = replace(plan, fusions=tuple(replace(fusion, own="one") for fusion in plan.fusions))
        silent = {agent: None for agent, measured in evidence.measured.items() if measured is None}
        unseen = join_messages(plain_plan, logs, silent, evidence.latent, hypotheses, prior_log).messages
        messages = {node: np.where(hidden, unseen[node], log) for node, log in joined.messages.items()}
    total = messages.pop(plan.root, np.zeros(len(hypotheses)))
    messages = {node: message for node, message in messages.items() if node not in evidence.factors}
    # What was measured is not of what is hidden: all that is said of it counts as sampled.
    sampled = None if joined.sampled is None else np.where(hidden, total, joined.sampled)
    return _replaced(replace(evidence, messages=messages), total, sampled, log_detected)


def _logs(
    plan: Plan, sight: Sight, evidence: Evidence, hypotheses: Hypotheses, modes: NDArray[np.intp]
) -> dict[str, Floats]:
    """Agent or factor -> (N,) what it says of hypotheses in these modes."""
    logs = dict(evidence.factors)
    for step in plan.observations:
        if step.agent in evidence.messages:
            # What a view measured is of the root's state already.
            states = (
                hypotheses if plan.view(step.at) is not None else evidence.latent.get(step.at, hypotheses)
            )
            logs[step.agent] = sight.message(evidence, step, states, modes)
    return logs


def _replaced(evidence: Evidence, total: Floats, sampled: Floats | None, extra: Floats) -> Evidence:
    return replace(
        evidence, log_likelihood=total + extra, sampled=None if sampled is None else sampled + extra
    )
