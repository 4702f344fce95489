"""Data of calibration: a graph run over a video with ground truth."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from bayesnet_track.engine.filtering import filter_target
from bayesnet_track.engine.frame_context import FrameContext
from bayesnet_track.engine.scoring.score import marginal_points
from bayesnet_track.engine.starts import Start, check_started, check_starts, start_targets
from bayesnet_track.engine.step import Engine, State, make_engine, step
from bayesnet_track.graph.checked import CheckedGraph
from bayesnet_track.graph.checks.run import check_graph
from bayesnet_track.graph.text.write import as_plain
from bayesnet_track.journal.metrics import FrameMetrics
from bayesnet_track.numerics.arrays import Floats
from bayesnet_track.numerics.boxes import centre_from_corner, overlap
from bayesnet_track.observation.planes import Frame, FramePair, PlaneCache

TEMPERATURES = np.geomspace(0.25, 16.0, 25)
"""Factors by which an agent's temperature is changed."""

TEMPERATURE_SLACK = 0.05
"""Sd, in box sides, of the true centre about the hypothesis that is right, where temperatures are judged."""

ELSEWHERE = 1e-3
"""Density of the true centre, per box side squared, that is granted whatever an agent says."""


@dataclass(frozen=True, eq=False)
class CalibrationData:
    """One run over one video: the frames after the first in which there is a target.

    Attributes:
        video: its name.
        iou: (n,) overlap of estimate and truth; 0 where the truth has no box, since the target is away.
        features: name -> (n,) filtered features of the score, and the `most` that it may be.
        ud_box: (n,) UD at the root as a share of the estimate's area.
        offsets: (n, 32, 2) true centre less quantiles of the belief's (`marginal_points`), in sqrt(w h) of
            the estimate; NaN where the truth has no box.
        scores: (n,) the graph's own scores.
        status: status of each frame.
        surprise: agent -> (25,) mean over the frames on target of -log of the density that the agent, at each
            of `TEMPERATURES` times its own temperature, gives to the true centre; empty unless asked for.
        most: (n,) what the score can be at most, whatever its coefficients; None for 1.
        cost_ms: declared cost of the agents that looked, milliseconds, mean over frames.
        all_scores: (m,) the graph's own scores of every frame after the first; 0 when there was no target
            any more.
        all_iou: (m,) overlap in the same frames.
    """

    video: str
    iou: Floats
    features: Mapping[str, Floats]
    ud_box: Floats
    offsets: Floats
    scores: Floats
    status: tuple[str, ...]
    surprise: Mapping[str, Floats] = field(default_factory=dict)
    most: Floats | None = None
    cost_ms: float = 0.0
    all_scores: Floats = field(default_factory=lambda: np.empty(0))
    all_iou: Floats = field(default_factory=lambda: np.empty(0))

    @property
    def frames(self) -> int:
        """Number of frames."""
        return len(self.iou)

    @property
    def seen(self) -> NDArray[np.bool_]:
        """(n,) whether the truth has a box."""
        return np.isfinite(self.offsets[:, 0, 0])


def by_video(data: Iterable[CalibrationData]) -> Mapping[str, list[CalibrationData]]:
    """Video -> its runs."""
    videos: dict[str, list[CalibrationData]] = {}
    for datum in data:
        videos.setdefault(datum.video, []).append(datum)
    return videos


def with_features(graph: CheckedGraph) -> CheckedGraph:
    """The graph, with a score where it has none, so that its frames have features."""
    written = as_plain(graph.spec)
    for name, plate in graph.targets.items():
        root = written["targets"][name]["nodes"][plate.root]
        root.setdefault("score", {"logistic": {"bias": 0}})
    return check_graph(written)


def calibration_data(
    graph: CheckedGraph,
    video: str,
    frames: Iterable[Frame],
    truth: Floats,
    seed: int = 0,
    temperatures: bool = False,
) -> CalibrationData:
    """Track through `frames` from the first of (n, 4) true corner boxes; needs a graph `with_features`.

    Raises:
        ValueError: the truth has fewer boxes than there are frames, none in the first, or none later.
    """
    engine = make_engine(graph, seed)
    state: State | None = None
    lines: list[FrameMetrics] = []
    overlaps, offsets, curves = [], [], _Curves()
    points: list[tuple[float, float]] = []
    for frame in frames:
        number = frame.index
        if number >= len(truth):
            raise ValueError(f"{video}: the truth has {len(truth)} boxes, and the video has more frames")
        if state is None:
            if not np.isfinite(truth[number]).all():
                raise ValueError(f"{video}: the truth has no box in the first frame")
            x, y, w, h = (float(v) for v in truth[number])
            starts = [Start((x, y, w, h))]
            check_starts(graph, starts, frame.width, frame.height)
            begun = start_targets(graph, engine, frame, starts)
            check_started(graph, begun)
            state = begun.state
            continue
        previous, state = state, (outcome := step(engine, state, frame)).state
        line = next((line for line in outcome.metrics if line.target == "1"), None)
        points.append((0.0 if line is None else line.score, 0.0))
        if line is None or "1" not in state.targets:
            continue
        true = centre_from_corner(truth[number])
        is_there = bool(np.isfinite(true).all())
        side = float(np.sqrt(line.centre_box[2] * line.centre_box[3]))
        iou = float(overlap(np.array(line.centre_box)[None], true[None])[0]) if is_there else 0.0
        points[-1] = (line.score, iou)
        lines.append(line)
        overlaps.append(iou)
        deviations = true[:2] - marginal_points(state.targets["1"].belief).T
        offsets.append(deviations / side if is_there else np.full_like(deviations, np.nan))
        if temperatures and iou > 0.5:
            curves.add(engine, previous, frame, true, side)
    if not any(np.isfinite(offset).all() for offset in offsets):
        raise ValueError(f"{video}: no frame after the first has a true box")
    centre_boxes = np.array([line.centre_box for line in lines])
    costs = next(iter(engine.plates.values())).costs_ms
    return CalibrationData(
        video,
        np.array(overlaps),
        {name: np.array([line.features[name] for line in lines]) for name in lines[0].features},
        np.array([line.ud_px2 for line in lines]) / (centre_boxes[:, 2] * centre_boxes[:, 3]),
        np.array(offsets),
        np.array([line.score for line in lines]),
        tuple(line.status for line in lines),
        curves.means(),
        np.array([line.features["most"] for line in lines]),
        float(np.mean([sum(costs[agent] for agent in line.active) for line in lines])),
        np.array([score for score, _ in points]),
        np.array([pair for _, pair in points]),
    )


class _Curves:
    """Sums, over frames, of what each agent at each temperature says of the true centre."""

    def __init__(self) -> None:
        self.sums: dict[str, Floats] = {}
        self.counts: dict[str, int] = {}

    def add(self, engine: Engine, state: State, frame: Frame, true: Floats, side: float) -> None:
        """One frame more, weighed once again."""
        cache = PlaneCache(FramePair(frame, state.previous))
        work = FrameContext(engine, state.net, cache, state.history.births)
        filtered = filter_target(work, "1", state.targets["1"])
        evidence, prior = filtered.step.evidence, filtered.step.prior.log
        deviations = (filtered.step.support.boxes[:, :2] - true[:2]) / (TEMPERATURE_SLACK * side)
        kernel = np.exp(-0.5 * (deviations**2).sum(axis=1)) / (2.0 * np.pi * TEMPERATURE_SLACK**2)
        for observation in state.targets["1"].plan.observations:
            agent = observation.agent
            if agent not in evidence.messages or evidence.measured.get(agent, evidence) is None:
                continue
            log = prior + evidence.messages[agent] / TEMPERATURES[:, None]
            weights = np.exp(log - log.max(axis=1, keepdims=True))
            density = (weights @ kernel) / weights.sum(axis=1)
            self.sums[agent] = self.sums.get(agent, np.zeros(len(TEMPERATURES))) - np.log(density + ELSEWHERE)
            self.counts[agent] = self.counts.get(agent, 0) + 1

    def means(self) -> dict[str, Floats]:
        """Agent -> mean surprise."""
        return {agent: total / self.counts[agent] for agent, total in self.sums.items()}
