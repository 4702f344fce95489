"""The backend for Label Studio: with its packages if they are installed, else with two stand-ins."""

import sys
from importlib.util import find_spec
from types import ModuleType, SimpleNamespace

import cv2
import numpy as np
import pytest

from bayesnet_track.graph.text.load import load_graph
from bayesnet_track.runtime.annotation import label_studio_backend
from bayesnet_track.runtime.annotation.asking import Asking
from bayesnet_track.runtime.annotation.formats.document import MismatchError
from bayesnet_track.runtime.annotation.label_studio_backend import Predictor, create_app
from bayesnet_track.sources.entrances.notices import InputNotice
from bayesnet_track.sources.scenes import make_scene

FRAMES = 8
SCENE = make_scene("two_squares", seed=0)
HEIGHT, WIDTH = SCENE.frames[0].shape[:2]
CONFIG = """<View>
  <Video name="video" value="$video"/>
  <VideoRectangle name="box" toName="video"/>
  <Labels name="labels" toName="video"><Label value="square"/></Labels>
</View>"""


@pytest.fixture(scope="module")
def video(tmp_path_factory):
    folder = tmp_path_factory.mktemp("video")
    for index in range(FRAMES):
        cv2.imwrite(str(folder / f"{index:03}.png"), SCENE.frames[index])
    return str(folder)


@pytest.fixture
def predictor():
    made = Predictor(load_graph("gray_square"), Asking(0.01, 3))
    yield made
    made.close()


def key_frame(frame, box, enabled=True):
    """A box of the video as Label Studio has it: frames from 1, sides in percent."""
    x, y, w, h = (float(100 * value / side) for value, side in zip(box, (WIDTH, HEIGHT) * 2, strict=True))
    shape = {"x": x, "y": y, "width": w, "height": h}
    return {"frame": frame + 1, "enabled": enabled, "rotation": 0, "time": 0.04 * frame, **shape}


def region(*sequence, frames=FRAMES, name="abc"):
    value = {"framesCount": frames, "duration": 0.04 * frames, "sequence": [*sequence], "labels": ["square"]}
    return {
        "id": name,
        "type": "videorectangle",
        "from_name": "box",
        "to_name": "video",
        "origin": "manual",
        "value": value,
    }


def boxes_of(found):
    sides = np.array([WIDTH, HEIGHT, WIDTH, HEIGHT]) / 100
    return {
        one["frame"] - 1: np.array([one["x"], one["y"], one["width"], one["height"]]) * sides
        for one in found["value"]["sequence"]
    }


def test_a_box_is_tracked_to_the_end_of_the_video(predictor, video):
    prediction = predictor.predict(video, "1", [region(key_frame(0, SCENE.truth[0]))])
    (found,) = prediction["result"]
    boxes = boxes_of(found)
    assert sorted(boxes) == list(range(FRAMES)) and 0 < prediction["score"] <= 1
    for frame, box in boxes.items():
        assert np.abs(box - SCENE.truth[frame]).max() < 15
    assert (found["id"], found["from_name"], found["value"]["labels"]) == ("abc", "box", ["square"])
    assert [one["enabled"] for one in found["value"]["sequence"]] == [True] * (FRAMES - 1) + [False]


def test_a_region_ends_where_it_is_unsure_and_the_next_box_goes_on(video):
    unsure = Predictor(load_graph("gray_square"), Asking(1.1, 2))
    (found,) = unsure.predict(video, "1", [region(key_frame(0, SCENE.truth[0]))])["result"]
    assert [one["frame"] for one in found["value"]["sequence"]] == [1]
    assert not found["value"]["sequence"][0]["enabled"]
    # What it ended itself is not taken for "gone" when a box is added.
    again = region(*found["value"]["sequence"], key_frame(4, SCENE.truth[4]))
    (found,) = unsure.predict(video, "1", [again])["result"]
    assert sorted(boxes_of(found)) == [0, 1, 2, 3, 4]
    unsure.close()


def test_what_was_predicted_is_tracked_anew_and_what_was_changed_is_kept(predictor, video):
    (first,) = predictor.predict(video, "1", [region(key_frame(0, SCENE.truth[0]))])["result"]
    sequence = [*first["value"]["sequence"]]
    moved = SCENE.truth[3] + np.array([6.0, 0, 0, 0])
    sequence[3] = key_frame(3, moved)
    (second,) = predictor.predict(video, "1", [region(*sequence)])["result"]
    boxes = boxes_of(second)
    np.testing.assert_allclose(boxes[3], moved, atol=1e-3)
    assert sorted(boxes) == list(range(FRAMES))
    assert not np.allclose(boxes[2], boxes_of(first)[2])  # now also tracked backward from the changed box
    (same,) = predictor.predict(video, "1", [region(*second["value"]["sequence"])])["result"]
    for frame, box in boxes_of(same).items():
        np.testing.assert_allclose(box, boxes[frame], atol=1e-3)


def test_a_key_frame_that_somebody_disabled_ends_the_region(predictor, video):
    (found,) = predictor.predict(video, "1", [region(key_frame(0, SCENE.truth[0], enabled=False))])["result"]
    assert sorted(boxes_of(found)) == [0]


@pytest.mark.parametrize(
    ("drawn", "said"),
    [
        (region(key_frame(0, (1, 1, 9, 9)), frames=24), "framesCount: 24 frames; the video has 8"),
        (region(key_frame(20, (1, 1, 9, 9))), "the video has frames 0 to 7"),
        (region(key_frame(0, (900, 1, 9, 9))), "1 of 1 box is outside of the frame of 320x240 px"),
    ],
)
def test_a_region_that_does_not_fit_the_video_is_refused(predictor, video, drawn, said):
    with pytest.raises(MismatchError, match=said):
        predictor.predict(video, "1", [drawn])


class Base:
    """The base class of label-studio-ml, as far as it is used."""

    def __init__(self, label_config=None, **kwargs):
        self.label_config = label_config

    def get_local_path(self, url, project_dir=None):
        return url


@pytest.fixture
def ask(monkeypatch):
    """Ask the application: with Flask's own client, or what it would be given."""
    if find_spec("label_studio_ml") is not None:
        # There is no server that a video could be fetched from.
        base = "label_studio_ml.model.LabelStudioMLBase.get_local_path"
        monkeypatch.setattr(base, Base.get_local_path)
        client = create_app("gray_square", threshold=0.01).test_client()
        assert client.post("/setup", json={"project": "1", "schema": CONFIG}).status_code == 200

        def post(task, context):
            data = {"tasks": [task], "project": "1", "label_config": CONFIG, "params": {"context": context}}
            answer = client.post("/predict", json=data)
            if answer.status_code != 200:
                raise MismatchError(answer.get_data(as_text=True))
            return answer.get_json()["results"]

        return post
    model, api = ModuleType("label_studio_ml.model"), ModuleType("label_studio_ml.api")
    model.LabelStudioMLBase = Base
    api.init_app = lambda model_class: SimpleNamespace(model=model_class(label_config=CONFIG))
    for name, module in (("model", model), ("api", api)):
        monkeypatch.setitem(sys.modules, f"label_studio_ml.{name}", module)
    monkeypatch.setitem(sys.modules, "label_studio_ml", ModuleType("label_studio_ml"))
    app = create_app("gray_square", threshold=0.01)
    return lambda task, context: app.model.predict([task], context=context)


def test_the_application_answers_with_predictions_of_label_studio(ask, video):
    task = {"id": 7, "data": {"video": video}}
    drawn = region(key_frame(0, SCENE.truth[0]))
    (prediction,) = ask(task, {"result": [drawn]})
    assert len(prediction["result"][0]["value"]["sequence"]) == FRAMES
    assert prediction["model_version"].startswith("bayesnet-track ")
    if find_spec("label_studio_sdk") is not None:
        from label_studio_sdk.label_interface import LabelInterface
        from label_studio_sdk.label_interface.objects import PredictionValue

        assert LabelInterface(CONFIG).validate_prediction(prediction, return_errors=True) == []
        PredictionValue.model_validate(prediction)
    assert ask(task, None) == [] and ask(task, {"result": []}) == []
    with pytest.raises(MismatchError, match="no 'video' in its data, which has film"):
        ask({"id": 7, "data": {"film": video}}, {"result": [drawn]})


def test_the_video_stays_decoded_until_another_is_asked_for(predictor, video, monkeypatch):
    opened = []
    real = label_studio_backend.open_source
    monkeypatch.setattr(label_studio_backend, "open_source", lambda path: opened.append(path) or real(path))
    for _ in range(2):
        predictor.predict(video, "1", [region(key_frame(0, SCENE.truth[0]))])
    assert opened == [video]


def test_a_region_that_cannot_be_tracked_stays_as_drawn_and_the_others_are_tracked(predictor, video):
    bad = region(key_frame(0, (20, 20, 0.5, 30)), name="bad")
    with pytest.warns(InputNotice, match=r"region bad: it stays as drawn: start box .* at least 1 px"):
        first, second = predictor.predict(
            video, "1", [bad, region(key_frame(0, SCENE.truth[0]), name="good")]
        )["result"]
    assert first == bad
    assert len(second["value"]["sequence"]) == FRAMES
