"""Detection networks: layouts, geometry and files that are wrong."""

from __future__ import annotations

import numpy as np
import pytest

from bayesnet_track.observation.detector import DetectorError
from bayesnet_track.observation.planes import Frame, FramePair
from bayesnet_track.vision.detectors.onnx import LAYOUTS, LayoutError, Onnx, OnnxParameters

INPUT = {"input_width": 32, "input_height": 32}


def one_bright(height, width, rows, columns):
    image = np.zeros((height, width, 3), np.uint8)
    image[rows, columns] = 255
    return FramePair(Frame(0, 0.0, image), None)


@pytest.mark.parametrize(
    ("kind", "parameters", "label"),
    [
        ({}, {"layout": "rows"}, ""),
        ({}, {"layout": "rows", "classes": ["lamp"]}, "lamp"),
        ({"after": (0.25,)}, {"layout": "yolo", "classes": ["lamp", "other"]}, "lamp"),
        ({"after": (0.25,), "turned": True}, {"layout": "yolo"}, "0"),
        ({"after": (0.3, 0.9)}, {"layout": "yolo_objectness", "classes": ["a", "b"]}, "b"),
        ({"after": "ssd"}, {"layout": "ssd", "classes": ["none", "lamp"]}, "lamp"),
        ({"after": "end_to_end"}, {"layout": "yolo_end_to_end", "classes": ["none", "lamp"]}, "lamp"),
        ({"after": (0.25,), "second": (1, 1, 4, 4)}, {"layout": "yolo"}, "0"),
        ({"units": 1 / 32}, {"layout": "rows", "units": "share"}, ""),
    ],
)
def test_every_layout_gives_the_bright_cell(bench, network, kind, parameters, label):
    detector = bench.made("onnx", model=network(**kind), **INPUT, **parameters)
    found, state = detector.detect(one_bright(32, 32, slice(8, 16), slice(16, 24)), detector.start())
    assert state == {} and found.labels == (label,)
    assert found.boxes[0] == pytest.approx([19.5, 11.5, 8.0, 8.0], abs=1e-4)  # columns 16 to 23, rows 8 to 15
    assert found.scores[0] == pytest.approx(0.9 if label == "b" else 1.0, abs=1e-3)


def test_yolox_gives_boxes_in_cells_of_three_grids():
    rows = np.zeros((16 + 4 + 1, 7))  # 32 x 32 px: 4 x 4 cells of 8 px, 2 x 2 of 16, one of 32
    rows[6] = [0.5, 0.25, 0.0, np.log(2), 0.8, 0.1, 0.5]  # column 2 and row 1 of the first grid
    rows[17] = [0.0, 1.0, np.log(0.5), 0.0, 1.0, 0.9, 0.0]  # column 1 and row 0 of the second
    settings = OnnxParameters(model="x.onnx", layout="yolox", **INPUT, min_score=0.3)
    detector = Onnx(settings, lambda blob: [rows[None]])
    found, _ = detector.detect(one_bright(32, 32, slice(0), slice(0)), {})
    assert found.boxes == pytest.approx(np.array([[15.5, 15.5, 8, 16], [19.5, 9.5, 8, 16]]))
    assert found.labels == ("0", "1") and found.scores == pytest.approx([0.9, 0.4])
    with pytest.raises(DetectorError, match="gives 20 rows; the layout wants 21, one for each cell"):
        Onnx(settings, lambda blob: [rows[None, :20]]).check()


def test_boxes_are_brought_back_to_the_frame(bench, network):
    wide = one_bright(48, 96, slice(0, 24), slice(24, 48))  # a rim of 8 above and below, 3 px for one
    detector = bench.made("onnx", model=network(), **INPUT, min_score=0.6)
    assert detector.detect(wide, {})[0].boxes[0] == pytest.approx([35.5, 11.5, 24.0, 24.0], abs=1e-4)
    stretched = bench.made("onnx", model=network(), **INPUT, fit="stretch", min_score=0.6)
    found, _ = stretched.detect(wide, {})
    assert sorted(found.boxes[:, 1].round(2)) == [5.5, 17.5] and (found.boxes[:, 0] == 35.5).all()
    assert found.boxes[:, 2:] == pytest.approx(np.array([[24.0, 12.0]] * 2), abs=1e-4)


def test_labels_can_be_chosen(bench, network):
    parameters = {"model": network(after=(0.25,)), "layout": "yolo", "classes": ["lamp", "other"], **INPUT}
    pair = one_bright(32, 32, slice(8, 16), slice(16, 24))
    assert len(bench.made("onnx", **parameters, keep=["lamp"]).detect(pair, {})[0]) == 1
    assert len(bench.made("onnx", **parameters, keep=["other"]).detect(pair, {})[0]) == 0
    assert len(bench.made("onnx", **parameters, keep=["0"]).detect(pair, {})[0]) == 1


YOLO = {"layout": "yolo"}


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"keep": ["person"]}, "`keep` has 'person'; names of classes: none: give `classes`, or numbers; "),
        ({"keep": ["2"]}, "numbers 0 to 1"),
        ({"classes": ["a", "b"], "keep": ["c"]}, "`keep` has 'c'; names of classes: a, b; numbers 0 to 1"),
        ({"classes": ["a"]}, "gives scores for 2 classes, and `classes` names 1; a network for segmentation"),
        ({"layout": "rows", "keep": ["x"]}, "names of classes: none: give `classes`, or numbers"),
    ],
)
def test_classes_that_the_network_does_not_have_are_refused(bench, network, change, said):
    kind = {} if change.get("layout") == "rows" else {"after": (0.25,)}
    with pytest.raises(DetectorError) as error:
        bench.made("onnx", model=network(**kind), **{**YOLO, **INPUT, **change})
    assert said in str(error.value)


def test_of_several_outputs_only_one_may_be_of_the_layout(bench, network):
    with pytest.raises(DetectorError, match="outputs of 1 x 16 x 5, 1 x 4 x 4; 0 of them fit layout ssd"):
        bench.made("onnx", model=network(second=(1, 4, 4)), **{**INPUT, "layout": "ssd"})
    with pytest.raises(DetectorError, match="2 of them fit layout rows, one is needed"):
        bench.made(
            "onnx", model=network(size=40, second=(1, 5, 5)), layout="rows", input_width=40, input_height=40
        )


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"model": "not_there.onnx"}, "not_there.onnx: no such model file"),
        ({"layout": "ssd"}, "gives an output of 1 x 16 x 5; the layout wants rows of image, class, score"),
        ({"layout": "yolo_objectness"}, "gives an output of 1 x 16 x 5; the layout wants"),
        ({"input_width": 48}, "does not run on a 3-channel input of 48x32 px"),
    ],
)
def test_a_model_that_is_missing_or_of_another_shape_is_refused_before_the_first_frame(
    bench, network, change, said
):
    with pytest.raises(DetectorError) as error:
        bench.made("onnx", **{"model": network(), **INPUT, **change})
    assert said in str(error.value)


@pytest.mark.parametrize("content", [b"", b"no model", None])
def test_a_file_that_is_no_model_is_refused(bench, network, tmp_path, content):
    path = tmp_path / "wrong.onnx"
    whole = open(network(), "rb").read()  # noqa: SIM115, PTH123
    path.write_bytes(whole[: len(whole) // 2] if content is None else content)
    with pytest.raises(DetectorError, match=r"wrong\.onnx: "):
        bench.made("onnx", model=str(path), **INPUT)


@pytest.mark.parametrize("layout", sorted(LAYOUTS))
def test_layouts_refuse_what_they_cannot_be(layout):
    for shape in [(), (3,), (2, 4, 9), (2, 2), (16, 3)]:
        with pytest.raises(LayoutError):
            LAYOUTS[layout](np.zeros(shape))
