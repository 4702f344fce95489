"""Whole nets in worker processes: the same to the last bit, whatever happens to the processes."""

from __future__ import annotations

import os
import signal

import pytest

from bayesnet_track.engine.starts import Start, has_births, start_targets
from bayesnet_track.engine.step import State, make_engine, step
from bayesnet_track.graph.spec import GraphSpec
from bayesnet_track.graph.text.load import load_graph
from bayesnet_track.journal.codec import to_json
from bayesnet_track.journal.events.by_hand import Toggled
from bayesnet_track.runtime.executors import make_executor
from bayesnet_track.runtime.executors.placing import PlacingError
from bayesnet_track.runtime.executors.target_executor import ProcessTargetExecutor
from bayesnet_track.sources.scene_source import SceneSource
from bayesnet_track.sources.scenes import make_scene

ALONE = {"joins": ()}
"""What makes the crowd's graph one of targets that do not depend on each other."""


def play(graph, scene_name, frames, places, before=lambda frame, executor: ()):
    """The lines of the journal and of the measurements; `before` gives what comes from outside."""
    scene, lines, state = make_scene(scene_name, seed=0), [], State()
    starts = [] if has_births(graph) else [Start(box, plate) for plate, box in scene.starts]
    with make_executor("serial", workers=2, places=places) as executor:
        engine = executor.engine(make_engine(graph), graph)
        for frame in SceneSource(scene, "scene", frames):
            external_inputs = before(frame.index, executor)
            if state.previous is None:
                outcome = start_targets(graph, engine, frame, starts)
            else:
                outcome = step(engine, state, frame, external_inputs)
            state = outcome.state
            lines += [to_json(one) for one in (*outcome.events, *outcome.metrics)]
    return lines


@pytest.fixture(scope="module")
def crowd():
    spec = load_graph("crowd").spec
    return load_graph(GraphSpec.model_validate({**spec.model_dump(), **ALONE}))


@pytest.mark.slow
def test_workers_are_killed_and_a_person_switches(crowd):
    killed = []

    def external_inputs(frame, executor):
        if frame in (3, 6) and executor.processes is not None:
            killed.extend(executor.processes.workers())
            for pid in executor.processes.workers():
                os.kill(pid, signal.SIGKILL)
        return [Toggled(frame, "2", "color", False)] if frame == 5 else []

    assert play(crowd, "crowd", 9, {"disc": "process"}, external_inputs) == play(
        crowd, "crowd", 9, {}, external_inputs
    )
    assert len(set(killed)) == 4


@pytest.mark.slow
def test_targets_that_are_born_and_die():
    graph = load_graph("orange_and_gray_detected")
    if graph.spec.joins:
        graph = load_graph(GraphSpec.model_validate({**graph.spec.model_dump(), **ALONE}))
    places = dict.fromkeys(graph.targets, "process")
    assert play(graph, "orange_and_gray", 60, places) == play(graph, "orange_and_gray", 60, {})


def test_nets_that_depend_on_each_other_stay_in_the_engine():
    graph = load_graph("crowd")
    with (
        make_executor("serial", places={"disc": "process"}) as executor,
        pytest.raises(PlacingError) as error,
    ):
        executor.engine(make_engine(graph), graph)
    assert str(error.value) == (
        "the nets of disc cannot be in processes: the graph has `joins`: "
        "what one net sees depends on the others"
    )


def test_a_name_that_is_no_agent_and_no_plate_is_refused(crowd):
    with (
        make_executor("serial", places={"disk": "process"}) as executor,
        pytest.raises(PlacingError) as error,
    ):
        executor.engine(make_engine(crowd), crowd)
    assert str(error.value) == "no agent 'disk'; the graph has color, and the plates disc"


def test_nothing_is_kept_of_targets_that_are_gone():
    executor = ProcessTargetExecutor(None, ("nets 1",), frozenset({"disc"}))
    executor._returned = {"1": object(), "2": object()}
    executor._share_out({"2": object()})
    assert set(executor._returned) == {"2"}
