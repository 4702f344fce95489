"""Where a tracker stands between two calls."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from bayesnet_track.engine.step import State
from bayesnet_track.journal.events.event import Event
from bayesnet_track.journal.metrics import FrameMetrics
from bayesnet_track.journal.net.target_net import TargetNet
from bayesnet_track.runtime.frame_kind import FrameKind
from bayesnet_track.runtime.resizing import Resizing
from bayesnet_track.runtime.updates.frame_clock import FrameClock


@dataclass(frozen=True, eq=False)
class Standing:
    """All that a tracker knows after a frame: replaced as a whole, so that who reads it never sees half.

    Attributes:
        state: the engine's state.
        clock: at the last frame.
        metrics: what was measured in it, in the pixels of the frames that are given.
        events: what was decided in it.
        kind: of the frames.
        resizing: how these become those that the engine sees.
        nets_before: nets that were live before it.
    """

    state: State
    clock: FrameClock
    metrics: Sequence[FrameMetrics]
    events: tuple[Event, ...]
    kind: FrameKind
    resizing: Resizing
    nets_before: Mapping[str, TargetNet] = field(default_factory=dict)
