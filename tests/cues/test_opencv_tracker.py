"""OpenCV's trackers as agents: frames in order, off and on, two targets, what is missing, what is stored."""

import io

import cv2
import numpy as np
import pytest

from bayesnet_track import GraphSpec, load_graph
from bayesnet_track.cli.main import main
from bayesnet_track.cues.opencv_tracker import missing_tracker, present_trackers
from bayesnet_track.engine.step import State, make_engine, start_target, step
from bayesnet_track.graph.text.messages import GraphError
from bayesnet_track.observation.cue import installed_cues
from bayesnet_track.observation.planes import Frame, FramePair

MOVE = np.array([3, 2])


def frame(scene, index, images={}):  # noqa: B006  one object per picture, as a run has it
    if index not in images:
        images[index] = Frame(index, float(index), scene.image(scene.start + MOVE * index))
    return FramePair(images[index], images.get(index - 1))


def around(scene, index, sd=2.0):
    boxes = np.tile(scene.box(MOVE * index), (50, 1))
    boxes[:, :2] += np.random.default_rng(index).normal(0, sd, (50, 2))
    return boxes


def run(asked, scene, frames, off=(), learn=True):
    """Places, frame by frame; the tracker is not asked in those that are `off`."""
    reference = asked.learn(frame(scene, 0), scene.box())
    places = {}
    for index in frames:
        if index not in off:
            places[index] = asked.measure(frame(scene, index), around(scene, index), reference)
        if learn:
            new = asked.learn(frame(scene, index), scene.box(MOVE * index))
            reference = asked.cue.blend(reference, new, 0.2)
    return places, reference


def test_it_follows_frame_by_frame_with_one_tracker(ask, scene):
    asked = ask("opencv_tracker")
    places, reference = run(asked, scene, range(1, 6))
    first = asked.learn(frame(scene, 0), scene.box())
    asked.measure(frame(scene, 1), around(scene, 1), first)
    assert reference.session._tracker is not None and first.session._tracker is not reference.session._tracker
    for index, found in places.items():
        assert found.fields == ("x", "y", "w", "h")
        assert np.abs(found.mean[:2] - scene.start - MOVE * index).max() < 5.0


def test_asked_twice_it_answers_the_same_and_moves_once(ask, scene):
    asked = ask("opencv_tracker")
    reference = asked.learn(frame(scene, 0), scene.box())
    one, two = (asked.measure(frame(scene, 1), around(scene, 1), reference) for _ in range(2))
    np.testing.assert_array_equal(one.mean, two.mean)
    once, _ = run(asked, scene, (1, 2))
    np.testing.assert_array_equal(
        asked.measure(frame(scene, 2), around(scene, 2), reference).mean[2:], once[2].mean[2:]
    )


def test_a_run_repeats_from_its_start(ask, scene):
    one, _ = run(ask("opencv_tracker"), scene, range(1, 5))
    two, _ = run(ask("opencv_tracker"), scene, range(1, 5))
    for index, found in one.items():
        np.testing.assert_array_equal(found.mean, two[index].mean)


@pytest.mark.parametrize("learn", [True, False])
def test_off_and_on_again_it_starts_from_the_last_estimate_learnt(ask, scene, learn):
    asked = ask("opencv_tracker")
    places, reference = run(asked, scene, range(1, 7), off=(3, 4), learn=learn)
    assert np.abs(places[5].mean[:2] - scene.start - MOVE * 5).max() < 5.0
    assert int(reference["index"]) == (6 if learn else 0)
    session = run(asked, scene, (1, 2, 3, 4), off=(3, 4))[1].session
    assert session.index == 4 and session._tracker is None  # made when it is asked


def test_where_it_leaves_the_estimate_it_starts_anew(ask, scene):
    asked = ask("opencv_tracker")
    reference = asked.learn(frame(scene, 0), scene.box())
    asked.measure(frame(scene, 1), around(scene, 1), reference)
    near = asked.learn(frame(scene, 1), scene.box(MOVE))
    far = asked.learn(frame(scene, 1), scene.box((60, 40)))
    assert asked.cue.blend(reference, near, 0.2).session is reference.session
    assert asked.cue.blend(reference, far, 0.2).session is far.session


def test_two_targets_have_a_tracker_each(ask, scene):
    asked = ask("opencv_tracker")
    one = asked.learn(frame(scene, 0), scene.box())
    other = asked.learn(frame(scene, 0), np.array([60.0, 60.0, 40.0, 40.0]))
    boxes = np.tile([60.0, 60.0, 40.0, 40.0], (20, 1))
    for index in (1, 2):
        here = asked.measure(frame(scene, index), around(scene, index), one)
        there = asked.measure(frame(scene, index), boxes, other)
    assert np.abs(here.mean[:2] - scene.start - 2 * MOVE).max() < 5.0
    assert np.abs(there.mean[:2] - 60.0).max() < 5.0


def test_what_can_be_stored_starts_it_again(ask, scene):
    asked = ask("opencv_tracker")
    reference = asked.learn(frame(scene, 2), scene.box(2 * MOVE))
    file = io.BytesIO()
    np.savez(file, **reference)
    file.seek(0)
    with np.load(file, allow_pickle=False) as stored:
        back = dict(stored)
    found = asked.measure(frame(scene, 3), around(scene, 3), back)
    np.testing.assert_array_equal(
        found.mean, asked.measure(frame(scene, 3), around(scene, 3), reference).mean
    )
    new = asked.learn(frame(scene, 3), scene.box(3 * MOVE))
    assert asked.cue.blend(back, new, 0.2).session is new.session


def test_it_looks_where_the_prediction_is(ask, scene):
    """A jump of 45 px is beyond MIL's own search; the view goes with the prediction."""
    asked = ask("opencv_tracker")
    jump = np.array([45, -30])
    reference = asked.learn(frame(scene, 0), scene.box())
    image = scene.image(scene.start + jump)
    boxes = np.tile(scene.box(jump), (20, 1))
    found = asked.measure(FramePair(Frame(1, 1.0, image), None), boxes, reference)
    assert np.abs(found.mean[:2] - scene.start - jump).max() < 5.0


def test_on_black_it_says_not_seen_and_comes_back(ask, scene):
    asked = ask("opencv_tracker")
    reference = asked.learn(frame(scene, 0), scene.box())
    black = Frame(1, 1.0, np.zeros_like(frame(scene, 0).current.image))
    assert asked.measure(FramePair(black, None), around(scene, 1), reference) is None
    assert (
        np.abs(
            asked.measure(frame(scene, 2), around(scene, 2), reference).mean[:2] - scene.start - 2 * MOVE
        ).max()
        < 8
    )


def graph(**parameters):
    return {
        "bayesnet": 1,
        "name": "baseline",
        "targets": {
            "it": {
                "nodes": {
                    "it": {
                        "belief": {"gaussian": {}},
                        "motion": {"random_walk": {"sd_px": {"x": 8, "y": 8}}},
                        "learn": {"below": {"ud_box": 0.9}},
                    },
                    "mil": {"parent": "it", "agent": {"opencv_tracker": parameters}},
                }
            }
        },
    }


def test_alone_in_a_net(scene):
    checked = load_graph(GraphSpec.model_validate(graph()))
    engine = make_engine(checked)
    state = start_target(engine, State(), frame(scene, 0).current, "1", "it", scene.box()).state
    for index in range(1, 6):
        outcome = step(engine, state, frame(scene, index).current)
        state = outcome.state
    assert np.abs(outcome.metrics[0].centre_box[:2] - scene.start - 5 * MOVE).max() < 5.0
    assert not [e for e in outcome.events if type(e).__name__ == "Quarantined"]


def test_a_tracker_that_is_not_there_is_an_error_with_those_that_are(monkeypatch, tmp_path):
    present = present_trackers()
    assert "MIL" in present
    monkeypatch.setattr("bayesnet_track.cues.opencv_tracker.present_trackers", lambda: ("MIL", "Vit"))
    with pytest.raises(GraphError) as error:
        load_graph(GraphSpec.model_validate(graph(tracker="CSRT")))
    for word in ("no tracker CSRT", "MIL, Vit", "opencv-contrib-python-headless"):
        assert word in str(error.value)
    declaration = installed_cues()["opencv_tracker"]
    with pytest.raises(ValueError, match="no tracker KCF"):
        declaration.make(declaration.parameters(tracker="KCF"))
    assert "takes the models net" in missing_tracker("Vit", {})
    assert "no such model file" in missing_tracker("Vit", {"net": str(tmp_path / "none.onnx")})
    (tmp_path / "some.onnx").write_bytes(b"")
    assert missing_tracker("Vit", {"net": str(tmp_path / "some.onnx")}) is None
    assert "takes the models (none)" in missing_tracker("MIL", {"net": "x"})
    odd = missing_tracker("Vit", {"net": str(tmp_path / "caf\udce9.onnx")})  # OpenCV would crash on it
    assert "not valid text" in odd and "rename" in odd


def test_validate_says_that_it_is_opaque(tmp_path, capsys):
    from bayesnet_track.graph.text.write import write_graph

    path = tmp_path / "baseline.yaml"
    path.write_text(write_graph(GraphSpec.model_validate(graph())), encoding="utf-8")
    assert main(["validate", str(path)]) == 0
    assert "opaque: mil (opencv_tracker) cannot be stored" in capsys.readouterr().out


def test_the_callers_random_numbers_of_opencv_do_not_matter(ask, scene):
    cv2.setRNGSeed(1)
    one, _ = run(ask("opencv_tracker"), scene, (1, 2))
    cv2.setRNGSeed(2)
    two, _ = run(ask("opencv_tracker"), scene, (1, 2))
    np.testing.assert_array_equal(one[2].mean, two[2].mean)
