"""What is remembered of targets that come and go, and when a lost one ends."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from bayesnet_track.adapt.candidates import Candidate
from bayesnet_track.adapt.existence import Population
from bayesnet_track.graph.settings.lifecycle import Death
from bayesnet_track.journal.net.target_net import Fault
from bayesnet_track.numerics.arrays import Floats
from bayesnet_track.observation.cue import Reference
from bayesnet_track.observation.detector import DetectorState


@dataclass(frozen=True, eq=False)
class AppearanceMemory:
    """A target as it is remembered, lost or dead.

    Attributes:
        target: target id.
        template: name of its plate.
        mean: (D,) mean state when it was last well seen.
        covariance: (D, D) of its belief then.
        time: that time, frame intervals.
        references: agent -> what it remembers.
        birth: what its draws were keyed by.
    """

    target: str
    template: str
    mean: Floats
    covariance: Floats
    time: float
    references: Mapping[str, Reference]
    birth: str


@dataclass(frozen=True, eq=False)
class TrackRecord:
    """What is counted of a live target.

    Attributes:
        since: frame in which its net was born.
        mean: (D,) mean state when it was last well seen.
        covariance: (D, D) of its belief then.
        time: that time, frame intervals.
        lost_frames: consecutive frames in which it is lost.
        unseen_frames: consecutive frames without a detection of its own.
    """

    since: int
    mean: Floats
    covariance: Floats
    time: float
    lost_frames: int = 0
    unseen_frames: int = 0


@dataclass(frozen=True, eq=False)
class TrackHistory:
    """What the engine remembers of births and deaths between frames.

    Attributes:
        detectors: detector -> its state.
        failed: detector -> its last failure.
        candidates: plate -> what was detected and is no target yet.
        records: live target -> what is counted of it.
        dead: targets whose nets ended and that can return, in the order of their deaths.
        overlaps: (younger, older) target -> overlaps of their beliefs in the last consecutive frames.
        refused: plate -> births refused so far.
        cut: detector -> frames in which it found more than `max_count`.
        last_id: largest number that was given to a target.
        births: live target -> what its draws are keyed by (`numerics.streams.birth_key`).
        populations: plate with `existence` -> what its detections have told about all of them.
    """

    detectors: Mapping[str, DetectorState] = field(default_factory=dict)
    failed: Mapping[str, Fault] = field(default_factory=dict)
    candidates: Mapping[str, tuple[Candidate, ...]] = field(default_factory=dict)
    records: Mapping[str, TrackRecord] = field(default_factory=dict)
    dead: tuple[AppearanceMemory, ...] = ()
    overlaps: Mapping[tuple[str, str], tuple[float, ...]] = field(default_factory=dict)
    refused: Mapping[str, int] = field(default_factory=dict)
    cut: Mapping[str, int] = field(default_factory=dict)
    last_id: int = 0
    births: Mapping[str, str] = field(default_factory=dict)
    populations: Mapping[str, Population] = field(default_factory=dict)


def find_end_cause(record: TrackRecord, rule: Death) -> tuple[str, int, int] | None:
    """Why a net ends: (lost or unseen, for how many frames, the rule's number); None when it lives on."""
    if record.lost_frames >= rule.lost_frames:
        return "lost", record.lost_frames, rule.lost_frames
    if rule.unseen_frames is not None and record.unseen_frames >= rule.unseen_frames:
        return "unseen", record.unseen_frames, rule.unseen_frames
    return None
