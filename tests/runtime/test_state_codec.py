"""The engine's state as bytes: what goes on from them writes the same journal, for every graph there is."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import is_dataclass
from typing import Any, get_args, get_type_hints

import numpy as np
import pytest

from bayesnet_track import Start, load_graph
from bayesnet_track.engine.starts import has_births, start_targets
from bayesnet_track.engine.step import Engine, State, make_engine, step
from bayesnet_track.graph.checked import CheckedGraph
from bayesnet_track.graphs import graph_names
from bayesnet_track.inference.compile import Plan
from bayesnet_track.journal.codec import to_json
from bayesnet_track.numerics.log_weights import LogWeights
from bayesnet_track.observation.detector import GIVEN
from bayesnet_track.observation.planes import Frame
from bayesnet_track.runtime.checkpoints.state_codec import CLASSES, StateError, decode_state, encode_state
from bayesnet_track.sources.detection_files import FileDetector
from bayesnet_track.sources.scenes.library import SceneSource

SCENES = {
    "kalman_ball": "flying_ball",
    "hidden_ball": "flying_ball",
    "person_shape": "person_and_board",
    "person_same_clothes": "person_same_clothes",
    "kalman_detections": "crowd",
    "people_detections": "crowd",
    "orange_and_gray_detected": "orange_and_gray",
}
FAST = ("two_squares", "general", "kalman_ball", "hidden_ball", "street")
FRAMES = {"crowd": 75, "two_people_color_stereo_shape": 20}
"""Where others are needed than usual: the crowd's first join is in frame 72."""
FEW, MANY = 8, 40
"""Frames of fast and of slow tests."""
NOT_HERE = {"deep", "people", "radar_crowd"}  # these need files that are not shipped, or sensors
STARTABLE = tuple(sorted({*graph_names()} - NOT_HERE))


def scene_of(graph: str, frames: int) -> SceneSource:
    from bayesnet_track.sources.scenes import scene_names

    name = SCENES.get(graph, graph if graph in scene_names() else "two_squares")
    return SceneSource.named(name, 0, frames)


def detections_of(source: SceneSource) -> FileDetector:
    """Every target where it is, as a detector would say it."""
    from bayesnet_track.numerics.boxes import centre_from_corner
    from bayesnet_track.observation.detector import Detections

    truth = source.scene.truth
    return FileDetector(
        {
            frame: Detections(centre_from_corner(np.asarray(truth[frame])[None]), np.array([0.9]), ("",))
            for frame in range(len(truth))
        }
    )


def engine_of(graph: CheckedGraph, source: SceneSource) -> Engine:
    births = [plate.spec.birth for plate in graph.targets.values() if plate.spec.birth is not None]
    is_given = any(birth.detector.detector == GIVEN for birth in births)
    return make_engine(graph, 0, detectors={GIVEN: detections_of(source)} if is_given else None)


def journals(
    graph: CheckedGraph, source: SceneSource, between: Callable[[Engine, State, Frame], State]
) -> Iterator[str]:
    """The lines of a run whose state goes through `between` after each frame."""
    engine = engine_of(graph, source)
    starts = [Start(box, plate) for plate, box in source.scene.starts if plate in graph.targets]
    starts = [] if has_births(graph) else starts or [Start(source.scene.start_box)]
    state: State | None = None
    for frame in source:
        outcome = start_targets(graph, engine, frame, starts) if state is None else step(engine, state, frame)
        yield from (to_json(event) for event in outcome.events)
        yield from (to_json(metrics) for metrics in outcome.metrics)
        state = between(engine, outcome.state, frame)


def through_bytes(engine: Engine, state: State, frame: Frame) -> State:
    data = encode_state(state)
    again = decode_state(data, engine, frame)
    assert encode_state(again) == data
    return again


@pytest.mark.parametrize(
    "name",
    [name if name in FAST else pytest.param(name, marks=pytest.mark.slow) for name in STARTABLE],
)
def test_every_graph_goes_on_from_bytes_as_if_nothing_had_been(name: str) -> None:
    graph, source = load_graph(name), scene_of(name, FRAMES.get(name, FEW if name in FAST else MANY))
    expected = list(journals(graph, source, lambda engine, state, frame: state))
    assert list(journals(graph, source, through_bytes)) == expected


def parts(hint: Any) -> Iterator[Any]:
    """The classes that a type hint names."""
    yield from (part for inner in get_args(hint) for part in parts(inner))
    if is_dataclass(hint):
        yield hint


def test_every_class_that_a_stored_one_holds_is_stored() -> None:
    """A class that is added to the state and forgotten here would end checkpoints."""
    held = {part for kind in CLASSES for hint in get_type_hints(kind).values() for part in parts(hint)}
    assert held - {Plan, Frame} <= set(CLASSES)


@pytest.fixture(scope="module")
def reached() -> tuple[Engine, State, Frame]:
    # The box is carried from frame 22 on.
    graph, source = load_graph("carried_box"), scene_of("carried_box", 24)
    found: list[tuple[Engine, State, Frame]] = []
    list(journals(graph, source, lambda *now: found.append(now) or now[1]))
    assert found[-1][1].joins.carried
    return found[-1]


def test_what_was_one_object_is_one_object_again(reached: tuple[Engine, State, Frame]) -> None:
    engine, state, frame = reached
    again = decode_state(encode_state(state), engine, frame)
    assert again.previous is frame
    for target, carried in state.joins.carried.items():
        assert carried.belief is state.targets[target].belief
        assert again.joins.carried[target].belief is again.targets[target].belief


def test_plans_are_compiled_again(reached: tuple[Engine, State, Frame]) -> None:
    engine, state, frame = reached
    again = decode_state(encode_state(state), engine, frame)
    for target, one in state.targets.items():
        own, other = one.plan, again.targets[target].plan
        assert (own.active, own.draws, own.observations, own.fusions, own.planes) == (
            (other.active, other.draws, other.observations, other.fusions, other.planes)
        )


def with_reference(state: State, value: object) -> State:
    from dataclasses import replace

    (name, one), *_ = state.targets.items()
    agent = next(iter(one.references))
    changed = replace(one, references={**one.references, agent: {"value": value}})
    return replace(state, targets={name: changed})


@pytest.mark.parametrize(
    "array",
    [
        np.array([np.nan, np.inf, -np.inf, -0.0, 5e-324]),
        np.arange(12, dtype=np.int16).reshape(3, 4).T,
        np.arange(24.0)[::-2],
        np.zeros((0, 4)),
        np.array(True),
        np.broadcast_to(np.float32(3), (2, 3)),
    ],
)
def test_arrays_keep_bits_and_layout(reached: tuple[Engine, State, Frame], array: np.ndarray) -> None:
    engine, state, frame = reached
    again = decode_state(encode_state(with_reference(state, array)), engine, frame)
    found = next(iter(next(iter(again.targets.values())).references.values()))["value"]
    assert (found.dtype, found.shape, found.tobytes()) == (array.dtype, array.shape, array.tobytes())
    assert found.strides == array.strides or array.flags.c_contiguous
    assert found.flags.writeable == array.flags.writeable


@pytest.mark.parametrize("value", [object(), np.array([object()]), {1, 2}, b"bytes"])
def test_what_is_not_known_is_refused(reached: tuple[Engine, State, Frame], value: object) -> None:
    with pytest.raises(StateError, match="cannot be stored"):
        encode_state(with_reference(reached[1], value))


def test_damage_is_an_error_and_makes_nothing_else(reached: tuple[Engine, State, Frame]) -> None:
    engine, state, frame = reached
    data = encode_state(state)
    for bad in (b"", b"[]\n", data[:-1], data + b"\0", data.replace(b'"TargetState"', b'"os.system"  ')):
        with pytest.raises(StateError):
            decode_state(bad, engine, frame)


def test_weights_are_bit_exact(reached: tuple[Engine, State, Frame]) -> None:
    engine, state, frame = reached
    again = decode_state(encode_state(state), engine, frame)
    for target, one in state.targets.items():
        own, other = one.belief.weights, again.targets[target].belief.weights
        assert isinstance(other, LogWeights) and other.weights.tobytes() == own.weights.tobytes()
