"""The journal's events besides decisions. The docstrings here are the documentation of the file format.

A line of ``journal.jsonl`` is ``{"event": <snake_case class name>, <field>: <value>, ...}``, keys in the
order of the class. Decisions (`bayesnet_track.journal.net.net`) are written in the same way.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

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
from bayesnet_track.journal.events.rival_events import RivalSeen
from bayesnet_track.journal.net.net import Decision

JOURNAL_VERSION = 1


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
class FramesMissing:
    """The source jumps in time: frames are missing before `frame`; the belief is predicted over the gap.

    Attributes:
        frame: first frame after the gap.
        missing: how many nominal frame intervals are missing.
    """

    frame: int
    missing: float


@dataclass(frozen=True)
class FrameSizeChanged:
    """The pictures change size or channels at this frame.

    Attributes:
        frame: the frame.
        width: new columns.
        height: new rows.
        action: stop, or rescale to the first frame's size.
    """

    frame: int
    width: int
    height: int
    action: str


@dataclass(frozen=True)
class SourceDamaged:
    """The source is damaged at or before this frame.

    Attributes:
        frame: next frame to be read.
        reason: what the decoder said.
    """

    frame: int
    reason: str


@dataclass(frozen=True)
class FramesDropped:
    """Pictures of a live source were dropped, since something newer was there when the tracker was ready.

    Attributes:
        frame: next frame to be read.
        dropped: how many since the last line like this.
    """

    frame: int
    dropped: int


@dataclass(frozen=True)
class SourceStalled:
    """A live source gave no picture for a while; it is connected to anew.

    Attributes:
        frame: next frame to be read.
        seconds: wall-clock seconds since the last picture.
        reason: what was wrong.
        attempt: how often that was tried since the last picture, this time included.
    """

    frame: int
    seconds: float
    reason: str
    attempt: int


@dataclass(frozen=True)
class DegenerateBelief:
    """No hypothesis had a positive, finite weight; the prior was kept as the belief.

    Attributes:
        frame: the frame.
        target: target id.
        reason: the weights' fault.
    """

    frame: int
    target: str
    reason: str


@dataclass(frozen=True)
class BeliefReset:
    """A grid's evidence was not feasible under its prediction: gamma fell below a level.

    Attributes:
        frame: the frame.
        target: target id.
        gamma: mean likelihood under the prediction, divided by its mean over the region.
        below: level of gamma below which it happens.
        region: belief (the bounding box of the prediction) or image.
        region_px2: area of the region, px^2.
        action: reset (the belief starts again from the likelihood over the region) or ignore (the prediction
            stays).
    """

    frame: int
    target: str
    gamma: float
    below: float
    region: str
    region_px2: float
    action: str


@dataclass(frozen=True)
class ParticlesResized:
    """The number of hypotheses of an adaptive size is now a quarter above or below the one last written.

    Attributes:
        frame: the frame.
        target: target id.
        particles: the number of this frame.
        before: the number that was last written, or the one at the start.
        method: kld, kld_revised, kld_revised_simplified, asymptotic_normal or likelihood_sum.
        need: the number that the method asked for, before rounding and bounds.
        limit: what kept the number away from the need: max, min, or ess (too few effective hypotheses to
            save any); empty when nothing did. With `early`, max may hold one half of the hypotheses only.
        early: true when this frame's own evidence asked for more than the last frame's: more were drawn in
            the same frame.
        field: the field that asked for the most; empty for likelihood_sum.
        ess: effective hypotheses of the sample that asked.
        bins: occupied bins of the field, where the method counts them.
        bin_px: width of a bin.
        worth: hypotheses that are worth one drawn from the posterior; absent for likelihood_sum.
        sd_px: sd of the field in the posterior, for asymptotic_normal.
        setting: the setting that the number depends on: error, error_px, error_sd or threshold.
        level: its value.
        turning: its value at which the number would not have been written; null when no value is one.
    """

    frame: int
    target: str
    particles: int
    before: int
    method: str
    need: float
    limit: str
    early: bool
    field: str
    ess: float
    bins: int | None
    bin_px: float | None
    worth: float | None
    sd_px: float | None
    setting: str
    level: float
    turning: float | None


@dataclass(frozen=True)
class MeasurementGated:
    """A Gaussian belief did not use what an agent measured: it lies too far from the prediction.

    Attributes:
        frame: the frame.
        target: target id.
        node: the agent that measured, or the latent node that summed up its agents.
        d2: squared Mahalanobis distance of the measurement from the prediction.
        limit: largest that is used: the chi-square quantile of `gate`.
        gate: share of right measurements that the gate lets pass.
        degrees: number of fields measured, the degrees of freedom of chi-square.
        turning: gate from which on it would have been used; 1 when only no gate would.
        used: measurements of the same frame that were used; with 0 and no other evidence the belief is
            only predicted.
    """

    frame: int
    target: str
    node: str
    d2: float
    limit: float
    gate: float
    degrees: int
    turning: float
    used: int


@dataclass(frozen=True)
class SecondPass:
    """A frame surprised the belief: further hypotheses were drawn where the first ones found the target.

    Attributes:
        frame: the frame.
        target: target id.
        method: adaptive or west.
        kl: KL(posterior || prior) of the first pass, nats; the larger one of its two halves.
        above_kl: level above which a second pass is paid for.
        first: hypotheses of the first pass.
        particles: hypotheses drawn in addition.
        ess_first: effective hypotheses of the first pass.
        ess: effective hypotheses with the second pass.
    """

    frame: int
    target: str
    method: str
    kl: float
    above_kl: float
    first: int
    particles: int
    ess_first: float
    ess: float


@dataclass(frozen=True)
class ReferenceGuarded:
    """An agent's reference and its slow one parted, or agree again: learning stopped, or goes on.

    Attributes:
        frame: the frame.
        target: target id.
        node: the agent.
        parted: true when they parted in this frame, false when they agree again.
        own: log-likelihood of the estimate by the agent's own reference, nats.
        slow: the same by its slow reference.
        apart_nats: difference from which on they have parted.
        pull: share of the slow reference that is mixed into the agent's own per frame while they are parted.
        frames: for how many learning frames they were parted; 0 when they part.
    """

    frame: int
    target: str
    node: str
    parted: bool
    own: float
    slow: float
    apart_nats: float
    pull: float
    frames: int


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
    | RivalSeen
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
        sd: posterior sd of x, y, w, h in px, that of x and y with the graph's slack.
        ud_px2: uncertainty deviation at the root.
        ud_nodes: inference node -> its UD in px^2.
        quiet_px2: measured quiet level of UD at the root, or None.
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
        region50: bounds of the central 50 % of the centre, with the graph's slack: x_low, x_high, y_low,
            y_high in px.
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
