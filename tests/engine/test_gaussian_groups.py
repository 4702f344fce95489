"""Gaussian beliefs that agents of the image feed are stepped together, to the bytes of each alone."""

import numpy as np
import pytest

from bayesnet_track.engine.outcome import State
from bayesnet_track.engine.step import make_engine, start_target, step
from bayesnet_track.graph.checks.run import check
from bayesnet_track.graph.text.load import load_graph, read_graph
from bayesnet_track.journal.events.faults import MotionFlawed
from bayesnet_track.sources.scenes import make_scene
from bayesnet_track.sources.scenes.library import SceneSource

FRAMES = 8
SCENE = make_scene("flying_ball", 0)
VIDEO = list(SceneSource(SCENE, "flying_ball", FRAMES))
PLACES = {"1": 0.0, "2": 3.0, "3": -2.0, "4": 60.0}
"""Target -> how far from the ball it starts, px."""


def run(graph, targets):
    """Of each frame its events and, for each target, the bytes of its belief."""
    engine, state, plate = make_engine(graph, 0), State(), next(iter(graph.targets))
    for target in targets:
        box = np.array(SCENE.start_box, float) + [PLACES[target], 0, 0, 0]
        state = start_target(engine, state, VIDEO[0], target, plate, box).state
    beliefs, events = [], []
    for frame in VIDEO[1:]:
        outcome = step(engine, state, frame)
        state = outcome.state
        events += outcome.events
        own = {target: state.targets[target].belief for target in targets}
        beliefs.append({name: (one.mean.tobytes(), one.covariance.tobytes()) for name, one in own.items()})
    return beliefs, events


def expressed(drift):
    return check(
        *read_graph(
            f"""
bayesnet: 1
name: expressed
targets:
  ball:
    nodes:
      ball:
        belief: {{gaussian: {{filter: extended}}}}
        motion: {{expressions: {{drift: {{x: "{drift}"}}, sd: {{x: 2, y: 2}}}}}}
      place: {{parent: ball, agent: {{mean_shift: {{}}}}}}
"""
        )
    )


@pytest.mark.parametrize("name", ["kalman_ball", "falling_ball", "radar_ball"])
def test_a_belief_does_not_depend_on_who_else_is_in_the_group(name):
    graph = load_graph(name)
    together, _ = run(graph, PLACES)
    assert len({frame["1"] for frame in together}) == FRAMES - 1  # it moves
    for target in PLACES:
        alone, _ = run(graph, [target])
        assert alone == [{target: frame[target]} for frame in together]


def test_an_undefined_motion_is_reported_of_its_own_target_only():
    reach = SCENE.start_box[0] + 30
    graph = expressed(f"x + 0 * sqrt({reach} - x)")
    together, events = run(graph, PLACES)
    assert {event.target for event in events if isinstance(event, MotionFlawed)} == {"4"}
    alone, _ = run(graph, ["1"])
    assert alone == [{"1": frame["1"]} for frame in together]
