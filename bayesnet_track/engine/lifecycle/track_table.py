"""The live targets of a frame while births and deaths change them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from bayesnet_track.adapt.lifecycle import TrackHistory
from bayesnet_track.engine.state import TargetState, apply_decisions
from bayesnet_track.journal.events.event import Event
from bayesnet_track.journal.metrics import FrameMetrics
from bayesnet_track.journal.net.net import Decision, Net

Floats = NDArray[np.float64]


@dataclass(eq=False)
class TrackTable:
    """The targets while one frame changes them.

    Attributes:
        net: the live nets.
        targets: live target -> its state.
        metrics: one entry per target that was live in this frame, the new ones included.
        history: what is remembered.
        events: decisions and other events, in order.
    """

    net: Net
    targets: dict[str, TargetState]
    metrics: list[FrameMetrics]
    history: TrackHistory
    events: list[Event] = field(default_factory=list)

    def decide(self, *decisions: Decision) -> None:
        """Write decisions down and carry them out."""
        self.net = apply_decisions(self.net, decisions)
        self.events += decisions

    def of_plate(self, plate: str) -> list[str]:
        """Its live targets, in the order of their births."""
        return [target for target in self.targets if self.net.targets[target].template == plate]

    def held(self, plate: str) -> list[str]:
        """Its live targets that are not lost."""
        return [target for target in self.of_plate(plate) if self.net.targets[target].status != "lost"]

    def boxes(self, targets: Sequence[str]) -> Floats:
        """(K, 4) estimates of this frame."""
        at = {line.target: line.centre_box for line in self.metrics}
        return np.array([at[target] for target in targets], dtype=np.float64).reshape(-1, 4)
