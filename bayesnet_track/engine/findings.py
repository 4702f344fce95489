"""What is found out of one target in the second half of its frame, step by step."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

from bayesnet_track.adapt.memory import RuleMemory
from bayesnet_track.adapt.rule_inputs import Measures, Situation
from bayesnet_track.belief.contract import Step
from bayesnet_track.belief.particles.particle_set import ParticleSet
from bayesnet_track.engine.scoring.score import Scored
from bayesnet_track.engine.state import TargetState
from bayesnet_track.inference.guard import Judged, Watched
from bayesnet_track.journal.events.event import Event
from bayesnet_track.journal.events.statuses import DistractorSeen
from bayesnet_track.journal.metrics import FrameMetrics
from bayesnet_track.journal.net.net import Decision
from bayesnet_track.journal.net.target_net import TargetNet
from bayesnet_track.numerics.arrays import Floats
from bayesnet_track.observation.cue import Measurement, Reference


@dataclass(frozen=True, eq=False)
class Measured:
    """What was measured.

    Attributes:
        state: (D,) the estimate.
        box: (4,) its centre box, inside the frame.
        net: the live net as a person switched it, without agents that failed or gave no answer.
        measures: UD, KL, contributions, ...
        scored: what the score remembers.
        score: probability of being on target; None where the graph does not say how it comes about.
        bound: the most that the score may be.
        distractor: what looks like the target beside it.
        notices: what guarantee and alarm give to write down.
    """

    state: Floats
    box: Floats
    net: TargetNet
    measures: Measures
    scored: Scored
    score: float | None = None
    bound: float = 1.0
    distractor: DistractorSeen | None = None
    notices: tuple[Event, ...] = ()

    @property
    def held(self) -> Floats | None:
        """(4,) the box, while it more probably holds the target than not."""
        is_held = self.net.status == "tracking" and (self.score is None or self.score >= 0.5)
        return self.box if is_held else None


@dataclass(frozen=True, eq=False)
class Decided:
    """What the rules make of it.

    Attributes:
        chosen: decisions, in order.
        memory: what they remember.
        quiet_px2: baseline of the root's UD; None while unknown.
        now: what they saw.
    """

    chosen: tuple[Decision, ...]
    memory: RuleMemory
    quiet_px2: float | None
    now: Situation


@dataclass(frozen=True, eq=False)
class Learnt:
    """What the agents learnt.

    Attributes:
        references: agent -> what it remembers.
        watched: the slow references that guard the others against drift.
        judged: what these say.
        decisions: those that stand, in order.
        angle: the estimate's rotation, degrees.
        rate: share of the largest learning rate.
    """

    references: Mapping[str, Reference]
    watched: Watched
    judged: Judged
    decisions: tuple[Decision, ...]
    angle: float
    rate: float = 0.0


@dataclass(frozen=True, eq=False)
class Heard:
    """What the agents said.

    Attributes:
        log_likelihoods: active agent -> (N,) its log-likelihood of each particle of the belief; none for
            other beliefs.
        measured: agent that found the target -> what it measured, in fields of the state.
    """

    log_likelihoods: Mapping[str, Floats] = field(default_factory=dict)
    measured: Mapping[str, Measurement] = field(default_factory=dict)


def heard(step: Step[Any], agents: frozenset[str]) -> Heard:
    """What the active `agents` said in a step, of the hypotheses that are still the belief's."""
    evidence = step.evidence
    is_aligned = isinstance(step.posterior, ParticleSet) and step.support is step.posterior
    messages = {name: evidence.messages[name] for name in evidence.messages if is_aligned and name in agents}
    measured = {
        name: one
        for name, one in evidence.gaussians.items()
        if name in agents and one.seen is None and not one.choices
    }
    return Heard(messages, measured)


@dataclass(frozen=True, eq=False)
class TargetResult:
    """What one frame gave for one target.

    Attributes:
        state: its state after the frame, still with the plan that the frame began with.
        box: (4,) its estimate, centre x, y, width and height.
        line: makes the line of what was measured.
        decisions: in order; they take effect on the next frame.
        events: what is written down besides.
        covariance: () -> (D, D) of its belief.
        heard: () -> what its agents said.
    """

    state: TargetState
    box: Floats
    line: Callable[[], FrameMetrics]
    decisions: tuple[Decision, ...]
    events: tuple[Event, ...]
    covariance: Callable[[], Floats]
    heard: Callable[[], Heard]
