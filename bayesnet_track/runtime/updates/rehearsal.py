"""A made-up video of a second, tracked before the first frame of a tracker that is fed as frames come.

What a graph imports, and the kernels that it compiles or loads, are there then: no frame waits for them. A
process does it once for a graph and a kind of image. Nothing of it stays: engines are made for it alone.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from bayesnet_track.engine.outcome import State
from bayesnet_track.engine.starts import Start, start_targets
from bayesnet_track.engine.step import Engine, Outcome, make_engine, step
from bayesnet_track.graph.checked import CheckedGraph
from bayesnet_track.journal.events.event import Input
from bayesnet_track.journal.events.load import Released, Toggled
from bayesnet_track.journal.metrics import FrameMetrics
from bayesnet_track.numerics.arrays import Floats
from bayesnet_track.observation.detector import GIVEN, NOTHING, Detections, DetectorState, Scan
from bayesnet_track.observation.planes import Frame, FramePair

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

    now: Detections = field(default=NOTHING)
    scanned: Mapping[str, Scan] = field(default_factory=dict)

    def start(self) -> DetectorState:
        """It remembers nothing."""
        return {}

    def detect(self, frames: FramePair, state: DetectorState) -> tuple[Detections, DetectorState]:
        """What it was given for this frame."""
        return self.now, state

    def scans(self, frame: Frame) -> Mapping[str, Scan]:
        """What other sensors measured in this frame."""
        return self.scanned


def rehearse_detections(
    graph: CheckedGraph, seed: int, use: Callable[[Floats, Sequence[FrameMetrics]], object]
) -> None:
    """Track made-up detections: targets appear, meet, are missed, end and return.

    `use` is given the boxes of each frame and what was measured of the targets.
    """
    fed = Fed()

    def feed(frame: int) -> None:
        fed.now = _detections(frame, _labels(graph))

    engine = make_engine(graph, seed, detectors={GIVEN: fed})
    if _are_installed(engine):
        for outcome in _rehearse(graph, engine, (graph.text, GIVEN), [], feed, _Look(SIZE, True)):
            use(fed.now.boxes, outcome.metrics)


def rehearse_boxes(graph: CheckedGraph, engine: Engine, starts: Sequence[Start], first: Frame) -> None:
    """Track a made-up target for each of `starts`: it moves, is gone for a while, and returns.

    Frames have the colour of the `first` one; where masks lie over them, its size, too. Cues of the user's
    own are not asked about what is made up.
    """
    if _are_installed(engine):
        made_up = [Start(_corner(0, number), start.plate) for number, start in enumerate(starts)]
        look = _Look((first.width, first.height) if graph.masks else SIZE, first.has_color)
        key = graph.text, len(starts), look
        for outcome in _rehearse(graph, engine, key, made_up, lambda frame: None, look):
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


def _are_installed(engine: Engine) -> bool:
    """Whether all that is asked about pixels comes with the package."""
    asked = [cue for compiled in engine.plates.values() for cue in compiled.cues.values()]
    return all(type(one).__module__.partition(".")[0] == __package__.partition(".")[0] for one in asked)


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
