"""A tracker between two calls: times of its frames, its state, its rehearsal before the first frame.

What a graph imports, and the kernels that it compiles or loads, are there then: no frame waits for them. A
process does it once for a graph and a kind of image. Nothing of it stays: engines are made for it alone.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache
from typing import Never, Self

import numpy as np
from numpy.typing import NDArray

from bayesnet_track.engine.compiled import CompiledPlate
from bayesnet_track.engine.outcome import State
from bayesnet_track.engine.starts import Start, start_targets
from bayesnet_track.engine.step import Engine, Outcome, make_engine, step
from bayesnet_track.graph.checked import CheckedGraph
from bayesnet_track.journal.events.event import Event, Input
from bayesnet_track.journal.events.load import Released, Toggled
from bayesnet_track.journal.metrics import Answers, FrameMetrics
from bayesnet_track.journal.target_net import TargetNet
from bayesnet_track.numerics.arrays import Floats
from bayesnet_track.observation.cue import Cue, Hypotheses, Reference
from bayesnet_track.observation.detector import GIVEN, NOTHING, Detections, DetectorState, Scan
from bayesnet_track.observation.planes import Frame, FramePair, Plane, Planes
from bayesnet_track.runtime.resizing import Resizing
from bayesnet_track.runtime.results import FrameKind
from bayesnet_track.sources.entrances.notices import notice

ASSUMED_FPS = 25.0
"""Nominal frames a second where nobody says: those of a folder of images."""

MOST_FPS = 1e6
MOST_S = 1e11
"""Beyond it are the milliseconds since 1970, not the seconds."""

MOST_INTERVALS = 1e10
"""From one frame to the next: a belief that has spread for longer has no number that is good for anything."""

LONG_GAP, LONG_GAP_S = 500.0, 5.0
"""Intervals and seconds: what milliseconds given as seconds exceed, and hardly anything that is tracked."""


@dataclass(frozen=True)
class FrameClock:
    """The time of the last frame, and what the time of the next one is found from.

    Attributes:
        fps: nominal frames a second, as given; None where nobody says.
        index: number of the last frame, from 0; -1 before the first.
        time: its time in nominal frame intervals after the first frame.
        time_s: its time in seconds, as given; NaN without a clock.
        first_s: that of the first frame where times are given, else None.
    """

    fps: float | None = None
    index: int = -1
    time: float = -1.0
    time_s: float = math.nan
    first_s: float | None = None

    @classmethod
    def of_rate(cls, fps: float | None) -> Self:
        """The clock before the first frame; raises ValueError for no number of frames a second."""
        if fps is None:
            return cls()
        number = _number(fps)
        if not 1.0 / MOST_FPS <= number <= MOST_FPS:
            raise ValueError(
                f"fps={fps!r}: nominal frames a second, a number from {1 / MOST_FPS:g} to {MOST_FPS:g}, are "
                f"needed; leave it out for {ASSUMED_FPS:g}"
            )
        return cls(number)

    @property
    def rate(self) -> float:
        """Nominal frames a second."""
        return ASSUMED_FPS if self.fps is None else self.fps

    def restarted(self) -> Self:
        """The clock before the first frame of another video."""
        return type(self)(self.fps)

    def tick(self, time_s: float | None, anew: str) -> Self:
        """The clock at the next frame, which comes at `time_s`, or one nominal interval later with None.

        Args:
            time_s: seconds, any origin from 0 on.
            anew: what to call where the camera, or its clock, began anew.

        Raises:
            ValueError: not a time, not later than the last one, or given with some frames only.
        """
        index = self.index + 1
        if index and (time_s is None) != (self.first_s is None):
            with_or_not = ("without", "with") if time_s is None else ("with", "without")
            raise ValueError(
                f"frame {index} comes {with_or_not[0]} time_s and the frames before it {with_or_not[1]}; "
                "allowed: time_s with every frame, the first one, too, or with none"
            )
        if time_s is None:
            seconds = math.nan if self.fps is None else index / self.fps
            return replace(self, index=index, time=float(index), time_s=seconds)
        seconds = checked_seconds(time_s)
        if self.first_s is None:
            return replace(self, index=0, time=0.0, time_s=seconds, first_s=seconds)
        time = self._intervals(seconds, self.first_s)
        if not (seconds > self.time_s and time > self.time):
            raise ValueError(
                f"frame {index} at time_s={seconds!r} is not later than the frame before it, at "
                f"{self.time_s!r}; leave out frames that come late or twice; where the camera or its clock "
                f"began anew, {anew}"
            )
        if time - self.time > MOST_INTERVALS:
            raise ValueError(
                f"frame {index} at time_s={seconds!r} is more than {MOST_INTERVALS:g} intervals of "
                f"{self.rate:g} frames a second after the frame before it, at {self.time_s!r}; for another "
                f"video {anew}"
            )
        if time - self.time >= LONG_GAP and seconds - self.time_s >= LONG_GAP_S:
            notice(
                f"frame {index} comes {seconds - self.time_s:.6g} s after the one before it, "
                f"{time - self.time:.6g} intervals of {self.rate:g} frames a second: time_s counts seconds; "
                f"for another video {anew}"
            )
        return replace(self, index=index, time=time, time_s=seconds)

    def _intervals(self, seconds: float, first_s: float) -> float:
        """Intervals after the first frame; what is whole up to the rounding of the seconds is whole."""
        time = (seconds - first_s) * self.rate
        rounded = float(round(time))
        slack = 1e-9 + 4.0 * math.ulp(max(seconds, first_s)) * self.rate
        return rounded if abs(time - rounded) <= slack and rounded > self.time else time


def refuse_unknown(call: str, unknown: dict[str, Never]) -> Never:
    """Refuse keywords that a call has not, with a word on the one for times; raises TypeError."""
    name = next(iter(unknown))
    raise TypeError(f"{call}() has no argument {name!r}; the time of a frame, in seconds, is time_s=")


def checked_seconds(time_s: float) -> float:
    """The time of a frame as a float, s; raises ValueError for what is none."""
    seconds = _number(time_s)
    if not 0.0 <= seconds <= MOST_S:
        raise ValueError(
            f"time_s={time_s!r}: the time of a frame in seconds, a number from 0 to {MOST_S:g}; where its "
            "clock counts milliseconds or nanoseconds, divide by 1e3 or 1e9"
        )
    return seconds


def _number(value: object) -> float:
    """The value as a float; NaN where it is none."""
    if isinstance(value, str | bytes | bool):
        return math.nan
    try:
        return float(value)  # type: ignore[arg-type]
    except (TypeError, ValueError, OverflowError):
        return math.nan


def image_users(engine: Engine) -> tuple[str, ...]:
    """Names of what needs the pixels of each frame; empty if given detections are all that is used."""
    return tuple(
        f"{name} of {plate}" if len(engine.plates) > 1 else name
        for plate, compiled in engine.plates.items()
        for name in _of_plate(compiled)
    )


def _of_plate(compiled: CompiledPlate) -> Iterator[str]:
    for agent, cue in compiled.cues.items():
        if cue.needs:
            yield f"agent {agent}"
    birth = compiled.plate.spec.birth
    if birth is not None and birth.detector.detector != GIVEN:
        yield f"births by {birth.detector.detector}"
    if compiled.finder is not None:
        yield "relocalize by a detector"
    if compiled.moving is not None and compiled.moving.camera is not None:
        yield "motion with camera"
    if compiled.verifiers:
        yield f"score with {', '.join(compiled.verifiers)}"
    lost = compiled.plate.inference(compiled.plate.root).lost
    if lost is not None and lost.scene_cut is not None:
        yield "lost with scene_cut"


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
        answers: answers to the queries of the graph.
    """

    state: State
    clock: FrameClock
    metrics: Sequence[FrameMetrics]
    events: tuple[Event, ...]
    kind: FrameKind
    resizing: Resizing
    nets_before: Mapping[str, TargetNet] = field(default_factory=dict)
    answers: tuple[Answers, ...] = ()


SIZE = (320, 240)
"""Width and height of the made-up frames, px: neither modules nor kernels depend on them."""
FRAMES, GONE = 24, (8, 18)
"""Frames of it, and those in which targets are gone."""
INTERVAL_S = 0.04
ALL_ON = (3, 6)
"""From when to when all agents are on."""
_done: set[tuple[object, ...]] = set()


@dataclass(frozen=True)
class _Look:
    """Width and height of made-up frames, px, and whether they have colour."""

    size: tuple[int, int]
    has_color: bool


@dataclass
class Fed:
    """A detector that finds what it is given."""

    now: Detections | None = field(default=NOTHING)
    scanned: Mapping[str, Scan] = field(default_factory=dict)

    def start(self) -> DetectorState:
        """It remembers nothing."""
        return {}

    def detect(self, frames: FramePair, state: DetectorState) -> tuple[Detections | None, DetectorState]:
        """Detections that it was given for this frame; None where nobody looked."""
        return self.now, state

    def scans(self, frame: Frame) -> Mapping[str, Scan]:
        """Scans of other sensors in this frame."""
        return self.scanned


def rehearse_detections(
    graph: CheckedGraph, seed: int, use: Callable[[Floats, Sequence[FrameMetrics]], object]
) -> None:
    """Track made-up detections: targets appear, meet, are missed, end and return.

    `use` is given the boxes of each frame and what was measured of the targets. Nothing is made up for
    several cameras, in which not all boxes stand in the same places.
    """
    if graph.several_cameras or (graph.text, GIVEN) in _done:
        return
    fed = Fed()

    def feed(frame: int) -> None:
        fed.now = _detections(frame, _labels(graph))

    engine = _without_own_cues(make_engine(graph, seed, detectors={GIVEN: fed}))
    if engine is not None:
        for outcome in _rehearse(graph, engine, (graph.text, GIVEN), [], feed, _Look(SIZE, True)):
            assert fed.now is not None
            use(fed.now.boxes, outcome.metrics)
            tuple(outcome.metrics)  # lines are made when they are asked for


def rehearse_boxes(graph: CheckedGraph, engine: Engine, starts: Sequence[Start], first: Frame) -> None:
    """Track a made-up target for each of `starts`: it moves, is gone for a while, and returns.

    Frames have the colour of the `first` one; where masks lie over them, its size, too. Cues of the user's
    own are not asked about what is made up. Nothing is made up on the ground, where not every box stands.
    """
    able = _without_own_cues(engine)
    if able is not None and not graph.calibrations:
        made_up = [Start(_corner(0, number), start.plate) for number, start in enumerate(starts)]
        look = _Look((first.width, first.height) if graph.masks else SIZE, first.has_color)
        key = graph.text, len(starts), look
        for outcome in _rehearse(graph, able, key, made_up, lambda frame: None, look):
            tuple(outcome.metrics)  # lines are made when they are asked for


def _rehearse(
    graph: CheckedGraph,
    engine: Engine,
    key: tuple[object, ...],
    starts: Sequence[Start],
    feed: Callable[[int], None],
    look: _Look,
) -> Iterator[Outcome]:
    if key in _done:
        return
    _done.add(key)
    feed(0)
    state = start_targets(graph, engine, _frame(0, look), starts).state
    for frame in range(1, FRAMES):
        feed(frame)
        outcome = step(engine, state, _frame(frame, look), _switches(frame, state, engine))
        state = outcome.state
        yield outcome
    # Imported here: a tracker is imported without Numba.
    from bayesnet_track.numerics.compiled import rehearse_rare_calls

    rehearse_rare_calls()


def _switches(frame: int, state: State, engine: Engine) -> list[Input]:
    """All agents on by hand for some frames: the rules may switch them on in any later one."""
    if frame not in ALL_ON:
        return []
    nodes = [
        (target, agent)
        for target, net in state.net.targets.items()
        for agent in engine.plates[net.template].plate.agents
    ]
    if frame == ALL_ON[0]:
        return [Toggled(frame, target, agent, True) for target, agent in nodes]
    return [Released(frame, target, agent) for target, agent in nodes]


class _Silent:
    """A cue that says nothing, in place of one of the user's own."""

    needs: tuple[Plane, ...] = ()

    def learn(self, planes: Planes, box: Floats) -> Reference:
        """An empty reference."""
        return {}

    def blend(self, reference: Reference, observed: Reference, rate: float) -> Reference:
        """The same as before."""
        return reference

    def log_likelihood(self, planes: Planes, hypotheses: Hypotheses, reference: Reference) -> Floats:
        """(N,) zeros: all are alike."""
        return np.zeros(len(hypotheses.boxes))


def _without_own_cues(engine: Engine) -> Engine | None:
    """The engine with a silent cue in place of each that does not come with the package.

    None where one of these cannot be replaced, since it does more than to score hypotheses.
    """
    plates = {}
    for name, plate in engine.plates.items():
        replaced = {agent for agent, cue in plate.cues.items() if not _is_installed(cue)}
        if any(not isinstance(plate.cues[agent], Cue) or agent in plate.adaptable for agent in replaced):
            return None
        silent = {agent: _Silent() for agent in replaced}
        plates[name] = replace(plate, cues={**plate.cues, **silent}) if replaced else plate
    return replace(engine, plates=plates)


def _is_installed(cue: object) -> bool:
    """True if a cue comes with the package."""
    return type(cue).__module__.partition(".")[0] == __package__.partition(".")[0]


def _labels(graph: CheckedGraph) -> tuple[str, ...]:
    births = [target.spec.birth for target in graph.targets.values()]
    return tuple(label for birth in births if birth is not None for label in birth.labels) or ("",)


def _frame(index: int, look: _Look) -> Frame:
    """A texture with a coloured box on it for each of two targets, but for some frames."""
    image = _texture(*look.size).copy()
    if not GONE[0] <= index < GONE[1]:
        for number, colour in enumerate(((20, 40, 220), (200, 160, 20))):
            x, y, w, h = (int(value) for value in _corner(index, number))
            image[y : y + h, x : x + w] = colour
    if not look.has_color:
        image[:] = image[:, :, :1]
    return Frame(index, float(index), image, look.has_color, index * INTERVAL_S)


@lru_cache(maxsize=2)
def _texture(width: int, height: int) -> NDArray[np.uint8]:
    coarse = np.random.default_rng(0).integers(40, 215, (-(-height // 8), -(-width // 8), 3), dtype=np.uint8)
    return np.repeat(np.repeat(coarse, 8, axis=0), 8, axis=1)[:height, :width]


def _corner(frame: int, number: int) -> tuple[float, float, float, float]:
    return (40.0 + 2 * frame, 40.0 + 90 * number, 40.0, 56.0)


def _detections(frame: int, labels: Sequence[str]) -> Detections:
    """Six boxes; two of them meet, one is missed for some frames, one ends, one comes late, one is weak."""
    speeds = np.array([4.0, -4.0, 3.0, 2.0, -3.0, 1.0])
    x = np.array([60.0, 150.0, 40.0, 220.0, 280.0, 120.0]) + speeds * frame
    y = np.array([60.0, 64.0, 150.0, 160.0, 70.0, 190.0]) + frame % 3
    boxes = np.stack([x, y, np.full(6, 20.0), np.full(6, 44.0)], axis=1)
    is_there = [True, True, not GONE[0] <= frame < GONE[1], frame < GONE[0], frame > 6, frame % 4 != 3]
    scores = np.array([0.95, 0.9, 0.85, 0.9, 0.8, 0.3 if frame % 3 else 0.7])
    rows = np.flatnonzero(is_there)
    rows = rows[np.argsort(-scores[rows], kind="stable")]
    return Detections(boxes[rows], scores[rows], tuple(labels[row % len(labels)] for row in rows.tolist()))
