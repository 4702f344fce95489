"""Context of a frame: external inputs, what all its stages share, and planes for many targets."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache, partial

import numpy as np

from bayesnet_track.belief.contract import MotionModel, Stream
from bayesnet_track.belief.motion.borders import Confined, confined
from bayesnet_track.engine.compiled import CompiledPlate, Engine
from bayesnet_track.inference.asking import Availability, Fault, TargetAvailability, score
from bayesnet_track.inference.compile import Plan
from bayesnet_track.journal.events.event import Input
from bayesnet_track.journal.events.faults import AgentMissed
from bayesnet_track.journal.events.load import InputRefused, LateFrame, Released, SpareTime, Toggled
from bayesnet_track.journal.net import Net
from bayesnet_track.numerics.arrays import Floats, Ints
from bayesnet_track.numerics.streams import moment_of
from bayesnet_track.observation.cue import FAULTS, Hypotheses, Reference
from bayesnet_track.observation.planes import MANY, Frame, Plane, PlaneCache, Planes, Region

ByHand = Toggled | Released


@dataclass(frozen=True, eq=False)
class ExternalInputs:
    """The inputs of one frame.

    Attributes:
        inputs: all but missing agents, in order, with this frame's index.
        availability: agents that give no answer.
        by_hand: target -> what a person switched.
        refused: what a person asked for that cannot be done.
        timing: what was late, or early.
    """

    inputs: tuple[Input, ...]
    availability: Availability
    by_hand: Mapping[str, tuple[ByHand, ...]]
    refused: tuple[InputRefused, ...]
    timing: tuple[LateFrame | SpareTime, ...]

    @property
    def to_repeat(self) -> tuple[Input, ...]:
        """Inputs that repeat the frame when given again; complete when the frame is done."""
        return (*self.inputs, *self.availability.events)


def route_inputs(engine: Engine, net: Net, frame: int, submitted: Iterable[Input]) -> ExternalInputs:
    """The inputs that are given with `frame`, by whom they concern in the net that it begins with."""
    inputs = tuple(replace(entry, frame=frame) for entry in submitted)
    if not inputs:
        return ExternalInputs((), Availability(frame), {}, (), ())
    by_hand: dict[str, tuple[ByHand, ...]] = {}
    refused: list[InputRefused] = []
    for entry in inputs:
        if not isinstance(entry, ByHand):
            continue
        reason = _impossible(engine, net, entry)
        if reason:
            refused.append(InputRefused(frame, entry.target, entry.node, reason))
        else:
            by_hand[entry.target] = (*by_hand.get(entry.target, ()), entry)
    return ExternalInputs(
        tuple(entry for entry in inputs if not isinstance(entry, AgentMissed)),
        Availability.of(frame, (entry for entry in inputs if isinstance(entry, AgentMissed))),
        by_hand,
        tuple(refused),
        tuple(entry for entry in inputs if isinstance(entry, LateFrame | SpareTime)),
    )


def _impossible(engine: Engine, net: Net, request: ByHand) -> str:
    """The reason why it cannot be done; empty when it can."""
    if request.target not in net.targets:
        return f"there is no target {request.target}"
    live = net.targets[request.target]
    if request.node not in engine.plates[live.template].plate.agents:
        return f"{live.template} has no agent {request.node}"
    if isinstance(request, Toggled) and request.on and request.node in live.quarantined:
        end = live.faults[request.node].until
        return f"{request.node} failed and is out {'for good' if end is None else f'until frame {end}'}"
    return ""


@dataclass(frozen=True, eq=False)
class FrameContext:
    """All that is shared within one frame. What lasts longer is in `engine` or in a state.

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
        cameras: camera -> how far its detections are from where targets were expected, put here.
    """

    engine: Engine
    net: Net
    cache: PlaneCache
    births: Mapping[str, str] = field(default_factory=dict)
    availability: Availability = field(default_factory=Availability)
    by_hand: Mapping[str, tuple[ByHand, ...]] = field(default_factory=dict)
    faults: dict[tuple[str, str], dict[str, str]] = field(default_factory=dict)
    seconds: dict[str, float] = field(default_factory=dict)
    cameras: dict[str, dict[str, float]] = field(default_factory=dict)

    @property
    def frame(self) -> Frame:
        """The frame."""
        return self.cache.frames.current

    @property
    def inputs(self) -> Mapping[str, float]:
        """Values of the names in expressions that are the same for all targets in the frame."""
        return self.cache.frames.names

    def confined(self, motion: MotionModel) -> Confined:
        """The motion on the image of the frame, with its inputs where they matter."""
        return confined(motion, self.frame.width, self.frame.height, self.inputs)

    def plate_of(self, target: str) -> CompiledPlate:
        """The compiled plate of the target."""
        return self.engine.plates[self.net.targets[target].template]

    def stream(self, target: str, node: str) -> Stream:
        """The random streams of a target's node in this frame, by purpose."""
        return self.stream_of(self.births[target], node)

    def stream_of(self, birth: str, node: str) -> Stream:
        """The same of what is born so, live or not."""
        return partial(self.engine.streams.of, birth, node, self.moment)

    @property
    def moment(self) -> int:
        """The key of the frame's draws."""
        return moment_of(self.frame.time)

    def births_of(self, targets: Iterable[str]) -> list[str]:
        """The keys of the draws of targets."""
        return [self.births[target] for target in targets]

    def availability_of(self, target: str, during: str) -> TargetAvailability:
        """The target's agents that give no answer when asked for one thing."""
        return self.availability.of_target(target, during)

    def note_fault(self, target: str, during: str, agent: str, fault: Fault) -> None:
        """An agent of a group had no answer for one of its targets."""
        if isinstance(fault, str):
            self.faults.setdefault((target, during), {})[agent] = fault
        else:
            self.availability.note(target, agent, during, fault.reason)

    def charge(self, part: str, start: float) -> float:
        """Add the seconds since `start` to a part's; the moment."""
        moment = self.engine.clock()
        self.seconds[part] = self.seconds.get(part, 0.0) + moment - start
        return moment


def planes_of_each(
    work: FrameContext,
    needs: Iterable[Plane],
    boxes: Floats,
    starts: Ints,
    grow: float = 0.0,
    share: bool = False,
) -> list[Planes]:
    """For each target planes that hold its boxes, each grown by `grow` of its size per side.

    Those of target t are `starts[t]` to `starts[t + 1] - 1` of the boxes (N, 4), one at least.

    With `share`, the same of the whole frame for all where their crops would take as long: planes do not
    depend on where they are cut.
    """
    from bayesnet_track.numerics.kernels.box_kernels import crops_of_each

    start, frame = work.engine.clock(), work.frame
    corners = crops_of_each(boxes, starts, grow, frame.width, frame.height)
    regions, needs = [Region(*corner) for corner in corners.tolist()], tuple(needs)
    image, is_shared = Region(0, 0, frame.width, frame.height), share and len(regions) > 1
    if is_shared and (len(regions) > MANY or 2 * sum(region.area for region in regions) > image.area):
        crops = [work.cache.planes(needs, image)] * len(regions)
    else:
        crops = [work.cache.planes(needs, region) for region in regions]
    work.charge("planes", start)
    return crops


def ask_together(
    work: FrameContext,
    group: tuple[CompiledPlate, Plan, Mapping[str, Sequence[Reference]]],
    hypotheses: Hypotheses,
    starts: Ints,
) -> tuple[dict[str, Floats], dict[int, dict[str, Fault]]]:
    """Agent -> (N,) its log-likelihoods; target t -> agent -> its fault, where one fails.

    Those of target t of the group are `starts[t]` to `starts[t + 1] - 1` of the hypotheses. A group is a
    plate, the plan whose agents are asked, and what each of them remembers of each target.
    """
    compiled, plan, references_by_agent = group
    messages: dict[str, Floats] = {}
    failed: dict[int, dict[str, Fault]] = {}
    for observation in plan.observations:
        cue, references = compiled.cues[observation.agent], references_by_agent[observation.agent]
        share = hasattr(cue, "log_likelihood_of_each")
        try:
            planes = planes_of_each(work, cue.needs, hypotheses.boxes, starts, share=share)
        except FAULTS:  # of planes: whose is found out where each target is asked by itself
            return {**messages, observation.agent: np.zeros(len(hypotheses))}, {
                t: {} for t in range(len(references))
            }
        start = work.engine.clock()
        values, faults = score(cue, planes, hypotheses, starts, references)
        work.charge(observation.agent, start)
        messages[observation.agent] = (
            values if observation.temperature == 1.0 else values / observation.temperature
        )
        for t, fault in faults.items():
            failed.setdefault(t, {})[observation.agent] = fault
    return messages, failed


def inside_frame(box: Floats, frame: Frame) -> Floats:
    """The box with its centre on the image, so that tracks and references stay meaningful."""
    x, y, w, h = box.tolist()  # plain numbers: a tenth of the time of arrays
    width, height = float(frame.width), float(frame.height)
    x, y = min(max(x, 0.0), width - 1.0), min(max(y, 0.0), height - 1.0)
    return np.array([x, y, min(max(w, 1.0), 2.0 * width), min(max(h, 1.0), 2.0 * height)])


def inside_frame_all(boxes: Floats, frame: Frame) -> Floats:
    """(T, 4) the same of several boxes."""
    return np.asarray(np.minimum(np.maximum(boxes, _SMALLEST), _largest(frame.width, frame.height)))


_SMALLEST = np.array([0.0, 0.0, 1.0, 1.0])


@lru_cache(maxsize=64)
def _largest(width: int, height: int) -> Floats:
    return np.array([width - 1.0, height - 1.0, 2.0 * width, 2.0 * height])
