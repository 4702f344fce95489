"""Context of a frame: what all its stages share, made once per frame."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from functools import partial

from bayesnet_track.belief.contract import Stream
from bayesnet_track.engine.compiled import CompiledPlate, Engine
from bayesnet_track.engine.external_inputs import ByHand
from bayesnet_track.inference.asking import Availability, Fault, TargetAvailability
from bayesnet_track.journal.net import Net
from bayesnet_track.numerics.streams import moment_of
from bayesnet_track.observation.planes import Frame, PlaneCache


@dataclass(frozen=True, eq=False)
class FrameContext:
    """What is shared by all that is done in one frame. What lasts longer is in `engine` or in a state.

    Attributes:
        engine: the graph ready to run, made once for all frames.
        net: the live nets that the frame begins with.
        cache: the frame, the one before it, and their planes.
        births: target -> what its draws are keyed by (`numerics.streams.birth_key`).
        availability: agents that give no answer.
        by_hand: target -> what a person switched.
        faults: (target, what its agents were asked for in a group) -> agent -> what was wrong; a target that
            goes by itself then does not ask these agents again.
        seconds: agent (or planes, belief, measure, learn, life, joins) -> seconds, added up here.
    """

    engine: Engine
    net: Net
    cache: PlaneCache
    births: Mapping[str, str] = field(default_factory=dict)
    availability: Availability = field(default_factory=Availability)
    by_hand: Mapping[str, tuple[ByHand, ...]] = field(default_factory=dict)
    faults: dict[tuple[str, str], dict[str, str]] = field(default_factory=dict)
    seconds: dict[str, float] = field(default_factory=dict)

    @property
    def frame(self) -> Frame:
        """The frame."""
        return self.cache.frames.current

    @property
    def inputs(self) -> Mapping[str, float]:
        """What names of expressions stand for that are the same of all targets in the frame."""
        return self.cache.frames.names

    def plate_of(self, target: str) -> CompiledPlate:
        """What the target's plate needs to run."""
        return self.engine.plates[self.net.targets[target].template]

    def stream(self, target: str, node: str) -> Stream:
        """The random streams of a target's node in this frame, by purpose."""
        return self.stream_of(self.births[target], node)

    def stream_of(self, birth: str, node: str) -> Stream:
        """The same of what is born so, live or not."""
        return partial(self.engine.streams.of, birth, node, self.moment)

    @property
    def moment(self) -> int:
        """What the frame's draws are keyed by."""
        return moment_of(self.frame.time)

    def births_of(self, targets: Iterable[str]) -> list[str]:
        """What the draws of targets are keyed by."""
        return [self.births[target] for target in targets]

    def availability_of(self, target: str, during: str) -> TargetAvailability:
        """Which of the target's agents give no answer when asked for one thing."""
        return self.availability.of_target(target, during)

    def note_fault(self, target: str, during: str, agent: str, fault: Fault) -> None:
        """An agent of a group had no answer for one of its targets."""
        if isinstance(fault, str):
            self.faults.setdefault((target, during), {})[agent] = fault
        else:
            self.availability.note(target, agent, during, fault.reason)

    def charge(self, part: str, started: float) -> float:
        """Add the seconds since `started` to a part's; the moment."""
        now = self.engine.clock()
        self.seconds[part] = self.seconds.get(part, 0.0) + now - started
        return now
