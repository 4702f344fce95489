"""The journal's events besides decisions. The docstrings here are the documentation of the file format.

A line of ``journal.jsonl`` is ``{"event": <snake_case class name>, <field>: <value>, ...}``, keys in the
order of the class. Decisions (`bayesnet_track.journal.net.net`) are written in the same way.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from bayesnet_track.journal.events.belief_events import (
    BeliefReset,
    DegenerateBelief,
    MeasurementGated,
    ParticlesResized,
    ReferenceGuarded,
    SecondPass,
)
from bayesnet_track.journal.events.distractor_events import DistractorSeen
from bayesnet_track.journal.events.inputs import AgentMissed, InputRefused
from bayesnet_track.journal.events.join_events import (
    AttachmentChanged,
    JoinMetrics,
    OcclusionChanged,
    RingChanged,
)
from bayesnet_track.journal.events.jump_events import Reappeared
from bayesnet_track.journal.events.life_events import BirthsRefused, CandidateConfirmed, DetectorFailed
from bayesnet_track.journal.events.machine_events import MachineChanged
from bayesnet_track.journal.events.part_metrics import PartMetrics
from bayesnet_track.journal.events.source_events import (
    FramesDropped,
    FrameSizeChanged,
    FramesMissing,
    SourceDamaged,
    SourceStalled,
)
from bayesnet_track.journal.net.net import Decision

JOURNAL_VERSION = 2


@dataclass(frozen=True)
class RunStarted:
    """First line of every journal.

    Attributes:
        journal: version of the file format.
        graph: the graph's name.
        graph_sha256: hash of the graph's canonical text, which stands in graph.yaml.
        seed: seed of all random streams.
        source: the source as given.
        width: columns of the first frame.
        height: rows of the first frame.
        has_color: False for a gray source.
        declared_frames: number of frames that the source declares, or None.
        frame_interval_s: nominal seconds between frames (1 time unit).
        costs_ms: declared cost of each cue, which rules weigh with.
        versions: of Python and of the libraries that touch numbers.
        inputs: files from outside besides the source (of detections), each with its SHA-256; left out when
            there are none.
    """

    journal: int
    graph: str
    graph_sha256: str
    seed: int
    source: str
    width: int
    height: int
    has_color: bool
    declared_frames: int | None
    frame_interval_s: float
    costs_ms: Mapping[str, float] = field(default_factory=dict)
    versions: Mapping[str, str] = field(default_factory=dict)
    inputs: Mapping[str, str] = field(default_factory=dict, metadata={"left_out_when_empty": True})


@dataclass(frozen=True)
class RunEnded:
    """Last line of a journal that was closed in order.

    Attributes:
        frames: frames read.
        declared_frames: what the source declared, or None.
        complete: False when the source ended early, was damaged, or the run was stopped.
        reason: end_of_source, source_truncated, source_damaged, frame_size_changed, interrupted, error.
    """

    frames: int
    declared_frames: int | None
    complete: bool
    reason: str


Event = (
    RunStarted
    | FramesMissing
    | FrameSizeChanged
    | SourceDamaged
    | MachineChanged
    | FramesDropped
    | SourceStalled
    | DegenerateBelief
    | MeasurementGated
    | BeliefReset
    | ParticlesResized
    | SecondPass
    | Reappeared
    | ReferenceGuarded
    | DistractorSeen
    | CandidateConfirmed
    | BirthsRefused
    | DetectorFailed
    | AgentMissed
    | InputRefused
    | OcclusionChanged
    | AttachmentChanged
    | RingChanged
    | RunEnded
    | Decision
)


@dataclass(frozen=True)
class FrameMetrics:
    """One line of ``frames.jsonl``: what was measured for one target in one frame.

    Attributes:
        frame: frame index.
        time_s: frame time in seconds; NaN of a `Tracker`, whose frames come without a clock.
        target: target id.
        box: estimate, centre box x, y, w, h in px.
        map: maximum a posteriori box.
        sd: posterior sd of x, y, w, h in px, that of x and y with the graph's localization_error.
        ud_px2: uncertainty deviation at the root.
        ud_nodes: inference node -> its UD in px^2.
        quiet_px2: measured baseline of UD at the root, or None.
        status: tracking, uncertain or lost.
        score: probability of being on target, an overlap (IoU) above 0.5, where the graph has coefficients
            for it; else an uncalibrated index in 0..1 from UD and evidence; high is sure.
        log_evidence: log normalising constant of the frame.
        surprise: KL(posterior || prior) over the hypotheses, nats: how far the frame moved the belief.
        ess: effective sample size of the hypotheses' posterior weights.
        particles: number of hypotheses at which the evidence was taken.
        active: agents that gave evidence in this frame.
        kl: active agent -> KL(belief || agent), nats.
        contribution: active agent -> KL(belief || belief without it), nats.
        agent_ud_px2: active agent -> UD about its own maximum-likelihood hypothesis.
        strength: node -> KL(prior times message || prior), nats: how much its message says.
        learn_rate: learning rate applied this frame (0 when UD is above the level).
        region50: bounds of the central 50 % of the centre, with the graph's localization_error: x_low,
            x_high, y_low, y_high in px.
        region90: the same of the central 90 %.
        cloud: hypotheses drawn from the posterior, whole px, centre boxes.
        silent: those of the active agents that measure and did not see the target.
        features: what a calibrated score was computed from; not written where it is an index.
        parts: node that is a part of the target -> its own estimate; not written where there are none.
        angle: rotation in the picture since the first frame, degrees, clockwise; not written while it is 0,
            as it is without `sd_angle_deg`.
        join: what the joint belief says of it; not written for a target that is not joined.
    """

    frame: int
    time_s: float
    target: str
    box: tuple[float, ...]
    map: tuple[float, ...]
    sd: tuple[float, ...]
    ud_px2: float
    ud_nodes: Mapping[str, float]
    quiet_px2: float | None
    status: str
    score: float
    log_evidence: float
    surprise: float
    ess: float
    particles: int
    active: tuple[str, ...]
    kl: Mapping[str, float]
    contribution: Mapping[str, float]
    agent_ud_px2: Mapping[str, float]
    strength: Mapping[str, float]
    learn_rate: float
    region50: tuple[float, ...]
    region90: tuple[float, ...]
    cloud: tuple[tuple[int, ...], ...]
    silent: tuple[str, ...] = ()
    features: Mapping[str, float] = field(default_factory=dict, metadata={"left_out_when_empty": True})
    parts: Mapping[str, PartMetrics] = field(default_factory=dict, metadata={"left_out_when_empty": True})
    angle: float = field(default=0.0, metadata={"left_out_when_empty": True})
    join: JoinMetrics | None = field(default=None, metadata={"left_out_when_empty": True})
