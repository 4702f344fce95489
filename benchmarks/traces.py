"""Runs that keep everything: the belief of every frame with its weights, not only what a journal holds."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from measuring import Image
from numpy.typing import NDArray
from peers import MeanShift

from bayesnet_track.engine.starts import Start, start_targets
from bayesnet_track.engine.step import Engine, Outcome, make_engine, step
from bayesnet_track.graph.spec import GraphSpec
from bayesnet_track.graph.text.load import load_graph
from bayesnet_track.journal.metrics import FrameMetrics
from bayesnet_track.journal.net.net import Decision
from bayesnet_track.numerics.boxes import centre_from_corner
from bayesnet_track.numerics.resampling import resample
from bayesnet_track.observation.planes import Frame
from bayesnet_track.sources.scenes import Scene

Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Moment:
    """One target in one frame.

    Attributes:
        image: the picture, BGR.
        metrics: what was measured.
        states: (N, D) hypotheses.
        weights: (N,) their weights.
    """

    image: Image
    metrics: FrameMetrics
    states: Floats
    weights: Floats

    @property
    def box(self) -> Floats:
        """The estimate, a centre box."""
        return np.array(self.metrics.centre_box)

    def drawn(self, count: int) -> Floats:
        """(count, 4) boxes drawn from the posterior, so that they carry no weights."""
        chosen = resample("systematic", self.weights, count, np.random.default_rng(0))
        return self.states[chosen, :4]


@dataclass(frozen=True, eq=False)
class Trace:
    """A whole run.

    Attributes:
        moments: target id -> frame by frame.
        decisions: all of them, in order.
        engine: what ran.
        last: its last outcome.
    """

    moments: dict[str, list[Moment]]
    decisions: list[Decision]
    engine: Engine
    last: Outcome

    @property
    def first(self) -> list[Moment]:
        """Those of the first target."""
        return self.moments["1"]

    def ud(self, target: str = "1") -> Floats:
        """(n,) UD of each frame, px^2."""
        return np.array([moment.metrics.ud_px2 for moment in self.moments[target]])

    def active(self, target: str = "1") -> list[tuple[str, ...]]:
        """Active agents of each frame."""
        return [moment.metrics.active for moment in self.moments[target]]


def trace(
    graph: GraphSpec | str,
    scene: Scene,
    seed: int,
    starts: Sequence[Start] = (),
    frames: int | None = None,
) -> Trace:
    """Track in a scene from its true first box, or from `starts`, keeping all beliefs."""
    checked = load_graph(graph)
    engine = make_engine(checked, seed)
    starts = starts or [Start(scene.start_box)]
    moments: dict[str, list[Moment]] = {str(number): [] for number in range(1, len(starts) + 1)}
    decisions: list[Decision] = []
    outcome: Outcome | None = None
    for index in range(frames or len(scene.frames)):
        depth = None if scene.stereo is None else scene.stereo.eye(index)
        frame = Frame(index, float(index), scene.frames[index], depth=depth)
        if outcome is None:
            outcome = start_targets(checked, engine, frame, starts)
        else:
            outcome = step(engine, outcome.state, frame)
        decisions += [event for event in outcome.events if isinstance(event, Decision)]
        for metrics in outcome.metrics:
            belief = outcome.state.targets[metrics.target].belief
            moments[metrics.target].append(
                Moment(frame.image, metrics, belief.states, belief.weights.weights)
            )
    assert outcome is not None
    return Trace(moments, decisions, engine, outcome)


def mean_shift(scene: Scene) -> Floats:
    """(n, 4) centre boxes of OpenCV's mean shift on the scene."""
    tracker = MeanShift()
    tracker.init(scene.frames[0], scene.start_box)
    boxes = [tracker.update(image)[1] for image in list(scene.frames)[1:]]
    return np.array([centre_from_corner(box) for box in (scene.start_box, *boxes)])
