"""Fake cues, small graphs and tiny videos, shared by the tests of several rooms."""

from __future__ import annotations

import gc
import os
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from fractions import Fraction
from types import SimpleNamespace
from typing import Any

import av
import numpy as np
import pytest
from hypothesis import HealthCheck, settings

from bayesnet_track import CueDeclaration, CueParameters, GraphSpec
from bayesnet_track.belief.contract import BOX_FIELDS, Step
from bayesnet_track.belief.particles.belief import ParticleSet
from bayesnet_track.engine.lines import Lines
from bayesnet_track.engine.step import Engine, Outcome, State, make_engine, start_target, step
from bayesnet_track.graph.checked import CheckedGraph, CheckedTarget
from bayesnet_track.graph.checks.run import check_graph
from bayesnet_track.inference.compile import Plan, compile_plan
from bayesnet_track.inference.measure import measure
from bayesnet_track.inference.messages import Observer, evaluate
from bayesnet_track.numerics.log_weights import DegenerateWeights, LogWeights
from bayesnet_track.numerics.streams import Streams
from bayesnet_track.observation.cue import METHODS, Hypotheses, Measurement, Reference, blend_arrays
from bayesnet_track.observation.planes import Frame, FramePair, PlaneCache, Region

# Without bytecode on disk every worker and every process that a test starts compiles all that it imports.
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)

# No property depends on how fast the machine is. Those that say no number of examples take more of them with
# `pytest -m hypothesis --hypothesis-profile thorough`.
for _name, _examples in (("repeatable", 30), ("thorough", 100)):
    settings.register_profile(
        _name,
        max_examples=_examples,
        derandomize=True,
        deadline=None,
        suppress_health_check=[HealthCheck.too_slow],
    )
settings.load_profile("repeatable")

CLOCK_BOUND = {
    "tests/browser/test_run_page.py": {
        "test_a_long_run_opens_quickly": "opens within 4 s",
    },
    "tests/reliability/test_kill.py": {
        "test_no_more_than_two_seconds_of_work_are_repeated": "2 s of work at most",
    },
    "tests/runtime/executors/test_endings.py": {
        "test_a_run_whose_agents_hang_ends_as_soon": "ends within 2 s",
        "test_no_worker_outlives_a_run_that_is_ended": "gone within 2 s",
    },
    "tests/runtime/executors/test_faults.py": {
        "test_a_killed_worker_is_seen_within_50_ms_and_back_within_a_second": "medians of 50 ms and 1 s",
    },
    "tests/runtime/test_deadline.py": {
        "test_a_frame_comes_in_time_though_an_agent_is_ten_times_slower": "frames within 55 ms",
    },
    "tests/sources/test_http_live.py": {
        "test_a_slow_tracker_gets_the_newest_frame_and_the_rate_is_measured": "moments within 0.1 s",
    },
    "tests/sources/test_live.py": {
        "test_a_slow_tracker_gets_the_newest_picture_and_the_rest_is_counted": (
            "pictures at most two intervals old"
        ),
        "test_a_stall_is_told_and_the_source_connected_to_anew": "a stall is 0.08 s",
        "test_closing_ends_a_wait": "ends within 2 s",
        "test_no_connection_outlasts_a_reader_that_is_closed_in_another_thread": (
            "two connections within 0.15 s"
        ),
        "test_the_pauses_between_attempts_double": "three attempts within 0.5 s",
        "test_two_eyes_are_paired_by_what_is_newest": "a connection within 0.2 s",
    },
    "tests/sources/test_stream.py": {
        "test_a_stream_that_stalls_and_breaks_is_taken_up_again": "times of arrival within 0.6 s",
    },
    "tests/vision/test_apart.py": {
        "test_what_goes_on_for_ever_is_ended": "a process imports OpenCV within 2 s",
    },
    "tests/runtime/test_live_server.py": {
        "test_a_client_that_says_nothing_is_let_go_and_never_bars_the_others": "an answer within 0.3 s",
        "test_it_ends_quickly": "ends within 1 s",
    },
    "tests/runtime/test_thumbnails.py": {
        "test_an_encoder_that_hangs_holds_up_nobody": "10,000 calls within 1 s",
    },
    "tests/runtime/test_live_view.py": {
        "test_a_page_that_reads_nothing_does_not_slow_the_run": "1,000 lines within 1 s",
    },
}
"""Tests that a busy machine alone can fail, and the limit by the clock that each asserts.

No other test is run again: what should be equal to the byte, and what happens when a process dies or a signal
comes at any instant, must hold the first time.
"""


@pytest.hookimpl(wrapper=True)
def pytest_collection() -> Iterator[None]:
    """Collect without looking for garbage, of which there is none: what is collected stays to the end."""
    gc.disable()
    try:
        return (yield)
    finally:
        gc.collect()
        gc.freeze()
        gc.enable()


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Run the clock-bound ones again, twice at most."""
    for item in items:
        path, _, name = item.nodeid.partition("[")[0].partition("::")
        if name in CLOCK_BOUND.get(path, ()):
            item.add_marker(pytest.mark.flaky(reruns=2, reruns_delay=1))


@pytest.fixture(autouse=True, scope="session")
def _nothing_said_of_compiling() -> Iterator[None]:
    """What a command prints here is the same whether kernels come from the cache or not."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("bayesnet_track.cli.main.notice_compiling", lambda options: lambda: None)
        yield


class Everything(set[object]):
    """A set in which everything is."""

    def __contains__(self, item: object) -> bool:
        return True


@pytest.fixture(autouse=True, scope="session")
def _nothing_rehearsed() -> Iterator[None]:
    """Graphs are taken for rehearsed, and networks for tried in another process.

    Neither changes a result, and each takes as long as a test. `tests/runtime/test_rehearsal.py`,
    `tests/vision/test_apart.py` and `test_damaged_networks.py` have what they do.
    """
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("bayesnet_track.runtime.frame_clock._done", Everything())
        patch.setattr("bayesnet_track.vision.siamese_networks._tried", Everything())
        yield


@pytest.fixture(scope="session")
def clock_bound() -> Mapping[str, Mapping[str, str]]:
    """File -> test -> the limit by the clock for which it is run again."""
    return CLOCK_BOUND


START = (50.0, 40.0, 20.0, 20.0)


@dataclass(frozen=True)
class FakePlane:
    """A plane of zeros that counts where it was computed."""

    name: str
    inputs: tuple[FakePlane, ...] = ()
    margin: int | None = 0
    is_points: bool = False
    computed: list[Region] = field(default_factory=list, compare=False, hash=False)

    def __str__(self) -> str:
        return self.name

    def compute(self, frames: FramePair, inputs: tuple[Any, ...], region: Region) -> Any:
        assert len(inputs) == len(self.inputs)
        self.computed.append(region)
        return np.zeros((region.y1 - region.y0, region.x1 - region.x0))


class BrokenPlane(FakePlane):
    def compute(self, frames: FramePair, inputs: tuple[Any, ...], region: Region) -> Any:
        raise OSError("no such feature")


@dataclass(frozen=True)
class Oracle:
    """A cue whose log-likelihood is `see(planes, hypotheses, reference)`; it writes down what it learns."""

    see: Callable[..., Any]
    needs: tuple[FakePlane, ...] = ()
    learnt: list[tuple[int, Region, tuple[float, ...]]] = field(default_factory=list)
    blended: list[float] = field(default_factory=list)
    reference: Callable[[Any, Any], Reference] = lambda planes, box: {"box": box}

    def learn(self, planes: Any, box: Any) -> Reference:
        self.learnt.append((planes.frame.index, planes.region, tuple(box)))
        return self.reference(planes, box)

    def blend(self, old: Reference, new: Reference, rate: float) -> Reference:
        self.blended.append(rate)
        return blend_arrays(old, new, rate)

    def log_likelihood(self, planes: Any, hypotheses: Any, reference: Reference) -> Any:
        return self.see(planes, hypotheses, reference)


@dataclass(frozen=True)
class Measuring:
    """A cue that measures a place with a covariance, and writes down in which frames it is asked."""

    place: tuple[float, float]
    variance: float
    needs: tuple[FakePlane, ...] = ()
    asked: list[int] = field(default_factory=list)

    def learn(self, planes: Any, box: Any) -> Reference:
        return {"box": box}

    def blend(self, old: Reference, new: Reference, rate: float) -> Reference:
        return new

    def measure(self, planes: Any, hypotheses: Any, weights: Any, reference: Reference) -> Measurement:
        self.asked.append(planes.frame.index)
        return Measurement(("x", "y"), np.array(self.place), self.variance * np.eye(2))


@dataclass(frozen=True)
class AdaptableOracle(Oracle):
    tune: Callable[[Reference, int], Reference | None] = lambda reference, attempt: reference

    def adapt(self, reference: Reference, attempt: int) -> Reference | None:
        return self.tune(reference, attempt)


def gaussian(x: float, y: float, sd: float, floor: float = 0.0) -> Callable[..., Any]:
    """A likelihood whose centre lies at (x, y), 1 at its best."""

    def see(planes: Any, hypotheses: Any, reference: Any) -> Any:
        away = hypotheses.boxes[:, :2] - (x, y)
        log = -0.5 * np.sum(away**2, axis=1) / sd**2
        return log if floor == 0 else np.logaddexp(np.log(floor), np.log1p(-floor) + log)

    return see


def flat(value: float = 0.0) -> Callable[..., Any]:
    """A likelihood that says nothing."""
    return lambda planes, hypotheses, reference: np.full(len(hypotheses), value)


def declare(cue: Any, **settings: Any) -> CueDeclaration:
    flags = {flag: hasattr(cue, method) for flag, method in METHODS.items()}
    return CueDeclaration(
        **flags,
        **{"name": "oracle", "summary": "", "parameters": CueParameters, "make": lambda p: cue, **settings},
    )


def graph_of(nodes: Mapping[str, Any], cues: Mapping[str, CueDeclaration]) -> CheckedGraph:
    """A valid graph of the plate "plate"; a text for a node is the parent of an agent."""
    full = {
        name: {"parent": node, "agent": name} if isinstance(node, str) else dict(node)
        for name, node in nodes.items()
    }
    root = next(name for name, node in full.items() if "parent" not in node)
    full[root] = {"motion": {"random_walk": {"sd_px": {"x": 8.0, "y": 8.0}}}, **full[root]}
    spec = GraphSpec.model_validate({"name": "test", "targets": {"plate": {"nodes": full}}})
    return check_graph(spec, cues)


def plate_of(nodes: Mapping[str, Any]) -> tuple[CheckedTarget, dict[str, Oracle]]:
    """The checked plate and an oracle per agent that says nothing and needs a plane of its own name."""
    agents = [n for n, node in nodes.items() if isinstance(node, str) or "agent" in node]
    cues = {agent: Oracle(flat(), (FakePlane(agent),)) for agent in agents}
    return graph_of(nodes, {agent: declare(cues[agent]) for agent in agents}).targets["plate"], cues


def frame_at(index: int, time: float | None = None, value: int = 0) -> Frame:
    return Frame(index, float(index if time is None else time), np.full((100, 120, 3), value, np.uint8))


def observer_of(cues: Mapping[str, Any], seed: int = 0, node: str = "root", index: int = 1) -> Observer:
    streams = Streams(seed)
    return Observer(
        PlaneCache(FramePair(frame_at(index), None)),
        cues,
        {agent: {} for agent in cues},
        lambda purpose: streams.of("1", node, index, purpose),
    )


def engine_of(
    nodes: Mapping[str, Any], sees: Mapping[str, Any], seed: int = 0, **settings: Any
) -> tuple[Engine, dict[str, Any]]:
    """An engine of fake cues: `sees` maps an agent to its cue or to what it sees."""
    cues = {agent: see if isinstance(see, Oracle) else Oracle(see) for agent, see in sees.items()}
    declarations = {agent: declare(cue, **settings) for agent, cue in cues.items()}
    return make_engine(graph_of(nodes, declarations), seed, declarations), cues


def play(
    engine: Engine, frames: Iterable[Frame] | int, starts: Mapping[str, tuple[float, ...]] | None = None
) -> list[Outcome]:
    """Every frame's outcome, the start's first; an integer is that many frames after the first."""
    pictures = [frame_at(n) for n in range(frames + 1)] if isinstance(frames, int) else list(frames)
    state, outcomes = State(), []
    for target, box in ({"1": START} if starts is None else starts).items():
        outcomes.append(start_target(engine, state, pictures[0], target, "plate", np.array(box)))
        state = outcomes[-1].state
    if len(outcomes) > 1:
        events = tuple(event for outcome in outcomes for event in outcome.events)
        outcomes = [Outcome(state, Lines(born=[m for o in outcomes for m in o.metrics]), events)]
    for picture in pictures[1:]:
        outcomes.append(step(engine, outcomes[-1].state, picture))
    return outcomes


@pytest.fixture(scope="session")
def fakes() -> SimpleNamespace:
    """The builders of this file."""
    return SimpleNamespace(
        START=START,
        AdaptableOracle=AdaptableOracle,
        BrokenPlane=BrokenPlane,
        Measuring=Measuring,
        Oracle=Oracle,
        Plan=Plan,
        Plane=FakePlane,
        compile_plan=compile_plan,
        declare=declare,
        engine=engine_of,
        flat=flat,
        frame=frame_at,
        gaussian=gaussian,
        graph=graph_of,
        observer=observer_of,
        plate=plate_of,
        play=play,
    )


FRAGMENTED = {"movflags": "frag_keyframe+empty_moov+default_base_moof"}


def picture(number, size):
    """A gray ramp with a bright square that moves: columns 2 n .. 2 n + 9."""
    width, height = size
    image = np.repeat(np.linspace(0, 120, width).astype(np.uint8)[None, :, None], height, axis=0)
    image = np.repeat(image, 3, axis=2)
    image[5:15, 2 * number % width : 2 * number % width + 10] = (40, 120, 250)
    return image


def write_video(path, codec="mpeg4", frames=40, size=(64, 48), rate=25, pix="yuv420p", **more):
    """Write `frames` pictures; returns the path.

    `stamps` are the pictures' times in intervals (default 0, 1, 2, ...), `options` those of the container,
    `then` a second size that half of the pictures have, `gop` the distance of key frames.
    """
    stamps = more.get("stamps") or list(range(frames))
    interval = 1 / Fraction(rate)
    with av.open(str(path), "w", options=more.get("options", {})) as container:
        stream = container.add_stream(codec, rate=rate)
        stream.width, stream.height = size
        stream.pix_fmt = pix
        stream.codec_context.time_base = interval / more.get("fine", 1)
        stream.codec_context.gop_size = more.get("gop", 10)
        encoders = [(size, stream)]
        if "then" in more:
            second = av.CodecContext.create(codec, "w")
            second.width, second.height = more["then"]
            second.pix_fmt, second.framerate, second.time_base = pix, Fraction(rate), interval
            encoders.append((more["then"], second))
        done = 0
        for part, (part_size, encoder) in zip(np.array_split(stamps, len(encoders)), encoders, strict=True):
            for stamp in part:
                frame = av.VideoFrame.from_ndarray(picture(done, part_size), format="bgr24")
                frame.pts, frame.time_base = (
                    round(stamp * more.get("fine", 1)),
                    interval / more.get("fine", 1),
                )
                for packet in encoder.encode(frame):
                    packet.stream = stream
                    container.mux(packet)
                done += 1
            for packet in encoder.encode():
                packet.stream = stream
                container.mux(packet)
    return path


@pytest.fixture
def make_video(tmp_path):
    """Writes a video of this name into the test's folder; settings as in `write_video`."""

    def make(name, **settings):
        return write_video(tmp_path / name, **settings)

    return make


@pytest.fixture(scope="session")
def whole_videos(tmp_path_factory):
    """One whole video of 40 frames per container: name -> path."""
    folder = tmp_path_factory.mktemp("videos")
    start = {"movflags": "faststart"}
    return {
        "plain.mp4": write_video(folder / "plain.mp4", "libx264"),
        "start.mp4": write_video(folder / "start.mp4", "libx264", options=start),
        "xvid.avi": write_video(folder / "xvid.avi", "mpeg4"),
        "h264.mkv": write_video(folder / "h264.mkv", "libx264"),
    }


@pytest.fixture(scope="session")
def weigh(fakes):
    """(nodes, sees, boxes, prior log-weights, active) -> the step and its measures."""

    def run(nodes, sees, boxes, beta=None, active=None, area=400.0, best=None):
        plate, _ = fakes.plate(nodes)
        cues = {agent: fakes.Oracle(see) for agent, see in sees.items()}
        plan = compile_plan(plate, cues if active is None else active, cues)
        prior = LogWeights.uniform(len(boxes)) if beta is None else LogWeights.normalise(np.asarray(beta))[0]
        evidence = evaluate(plan, fakes.observer(cues), Hypotheses(boxes), prior.log)
        degenerate = None
        try:
            weights, log_evidence = prior.times(evidence.log_likelihood)
        except DegenerateWeights as fault:
            weights, log_evidence, degenerate = prior, -np.inf, str(fault)
        posterior = ParticleSet(boxes, BOX_FIELDS, weights)
        state = boxes[int(np.argmax(weights.log)) if best is None else best]
        step = Step(posterior, log_evidence, posterior, prior, evidence, lambda: state, degenerate)
        return step, measure(plate, plan, step, area)

    return run
