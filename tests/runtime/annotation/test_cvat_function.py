"""The tracking function for CVAT: with its SDK if that is installed, else with stand-ins of two classes."""

import sys
from dataclasses import dataclass
from importlib.util import find_spec
from types import ModuleType

import numpy as np
import pytest

from bayesnet_track.runtime.annotation.cvat_function import create
from bayesnet_track.sources.entrances.notices import InputNotice
from bayesnet_track.sources.scenes import make_scene


@dataclass(frozen=True, kw_only=True)
class TrackableShape:
    type: str
    points: list


@dataclass(frozen=True, kw_only=True)
class TrackingFunctionSpec:
    supported_shape_types: list


class Picture:
    """A PIL image, as far as it is asked."""

    def __init__(self, bgr):
        self.rgb = bgr[:, :, ::-1]

    def convert(self, mode):
        assert mode == "RGB"
        return self.rgb


@pytest.fixture
def sdk(monkeypatch):
    if find_spec("cvat_sdk") is not None:
        import cvat_sdk.auto_annotation

        return cvat_sdk.auto_annotation
    made = ModuleType("cvat_sdk.auto_annotation")
    made.TrackableShape, made.TrackingFunctionSpec = TrackableShape, TrackingFunctionSpec
    monkeypatch.setitem(sys.modules, "cvat_sdk", ModuleType("cvat_sdk"))
    monkeypatch.setitem(sys.modules, "cvat_sdk.auto_annotation", made)
    return made


def test_it_tracks_a_rectangle_and_gives_up_where_it_is_unsure(sdk):
    scene = make_scene("two_squares", seed=0)
    x, y, w, h = map(float, scene.truth[0])
    function = create("gray_square", threshold=0.01)
    assert set(function.spec.supported_shape_types) == {"rectangle"}
    shape = sdk.TrackableShape(type="rectangle", points=[x, y, x + w, y + h])
    pictures = [function.preprocess_image(None, Picture(scene.frames[n])) for n in range(4)]
    assert np.array_equal(pictures[0], scene.frames[0])
    state = function.init_tracking_state(None, pictures[0], shape)
    for number in (1, 2, 3):
        found = function.track(None, pictures[number], state)
        assert found.type == "rectangle" and len(found.points) == 4
        tx, ty, tw, th = scene.truth[number]
        assert np.abs(np.array(found.points) - [tx, ty, tx + tw, ty + th]).max() < 15
    unsure = create("gray_square", threshold=1.1)
    state = unsure.init_tracking_state(None, pictures[0], shape)
    assert unsure.track(None, pictures[1], state) is None


def test_a_rectangle_without_a_width_is_left_to_the_person_and_stops_no_other(sdk):
    scene = make_scene("two_squares", seed=0)
    function = create("gray_square")
    flat = sdk.TrackableShape(type="rectangle", points=[10, 10, 10, 40])
    with pytest.warns(InputNotice, match=r"not tracked: start box 10,10,0,30: width and height"):
        state = function.init_tracking_state(None, scene.frames[0], flat)
    assert function.track(None, scene.frames[1], state) is None
