"""A Siamese network: two tiny halves written here, the crops they see, and files that do not fit."""

from __future__ import annotations

import os
import sys
import tracemalloc
from pathlib import Path

import cv2
import numpy as np
import pytest

from bayesnet_track import Tracker
from bayesnet_track.cli import doctor
from bayesnet_track.graph.text.messages import GraphError
from bayesnet_track.observation.cue import installed_cues
from bayesnet_track.vision.kernels.correlation_kernels import choose, explained
from bayesnet_track.vision.model_files import NANOTRACK, VARIABLE, find_model
from bayesnet_track.vision.siamese_crops import (
    Crop,
    Memory,
    crops_for,
    plain_correlator,
    search_crop,
    template_crop,
    wide_crop,
)
from bayesnet_track.vision.siamese_networks import (
    RUNTIMES,
    SEARCH,
    STRIDE,
    TEMPLATE,
    Networks,
    Response,
    SiameseError,
    load_networks,
)


def varint(value):
    low, rest = value & 127, value >> 7
    return bytes([low | (128 if rest else 0)]) + (varint(rest) if rest else b"")


def whole(field, value):
    return varint(field << 3) + varint(value)


def part(field, data):
    data = data if isinstance(data, bytes) else data.encode()
    return varint(field << 3 | 2) + varint(len(data)) + data


def tensor(name, values):
    sides = b"".join(whole(1, side) for side in values.shape)
    return part(5, sides + whole(2, 1) + part(8, name) + part(9, values.astype(np.float32).tobytes()))


def shape(name, sides):
    held = np.array(sides, np.int64).tobytes()
    return part(5, whole(1, len(sides)) + whole(2, 7) + part(8, name) + part(9, held))


def node(kind, inputs, output, **ints):
    names = b"".join(part(1, name) for name in inputs) + part(2, output) + part(4, kind)
    lists = (
        part(5, part(1, name) + b"".join(whole(8, v) for v in values) + whole(20, 7))
        for name, values in ints.items()
    )
    return part(1, names + b"".join(lists))


def value(field, name, shape):
    sides = b"".join(part(1, whole(1, side)) for side in shape)
    return part(field, part(1, name) + part(2, part(1, whole(1, 1) + part(2, sides))))


def model(nodes, tensors, values):
    graph = b"".join(nodes) + part(2, "g") + b"".join(tensors) + b"".join(values)
    return whole(1, 8) + part(7, graph) + part(8, part(1, "") + whole(2, 13))


def backbone():
    """How bright each cell of 16 x 16 px is, 0..1."""
    conv = node("Conv", ["x", "w"], "y", kernel_shape=[STRIDE] * 2, strides=[STRIDE] * 2, pads=[8, 8, 7, 7])
    weights = tensor("w", np.full((1, 3, STRIDE, STRIDE), 1 / (3 * 255 * STRIDE**2)))
    values = [value(11, "x", (1, 3, SEARCH, SEARCH)), value(12, "y", (1, 1, 16, 16))]
    return model([conv], [weights], values)


def head(half=TEMPLATE / 4, shapes=1):
    """Bright cells are the target, as far as the template is bright; its sides are `half` px from each.

    The shape of what is alike is held as a constant, as in the files of NanoTrack, `shapes` times.
    """
    nodes = [
        node("GlobalAveragePool", ["input1"], "usual"),
        node("Mul", ["input2", "usual"], "product"),
        *(
            node("Reshape", ["product", f"shape{k}"], "alike" if k == 0 else f"unused{k}")
            for k in range(shapes)
        ),
        node("Conv", ["alike", "w", "b"], "output1", kernel_shape=[1, 1]),
        node("Conv", ["input2", "none", "half"], "output2", kernel_shape=[1, 1]),
    ]
    tensors = [
        tensor("w", np.array([0.0, 80.0]).reshape(2, 1, 1, 1)),
        tensor("b", np.array([0.0, -10.0])),
        tensor("none", np.zeros((4, 1, 1, 1))),
        tensor("half", np.full(4, half)),
        *(shape(f"shape{k}", (1, -1, 16, 16)) for k in range(shapes)),
    ]
    values = [
        value(11, "input1", (1, 1, 8, 8)),
        value(11, "input2", (1, 1, 16, 16)),
        value(12, "output1", (1, 2, 16, 16)),
        value(12, "output2", (1, 4, 16, 16)),
    ]
    return model(nodes, tensors, values)


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    folder = tmp_path_factory.mktemp("halves")
    for name, content in (("backbone", backbone()), ("head", head())):
        (folder / f"{name}.onnx").write_bytes(content)
    return {name: str(folder / f"{name}.onnx") for name in ("backbone", "head")}


def bright(x, y):
    image = np.zeros((240, 320, 3), np.uint8)
    image[y - 20 : y + 20, x - 20 : x + 20] = 255
    return image


def test_the_proposals_of_two_files_are_where_the_target_is_now(files):
    memory = Memory(load_networks(**files))
    template = template_crop(np.array([159.5, 119.5, 40.0, 40.0])).cut(bright(160, 120))
    size = np.array([40.0, 40.0])
    boxes, logs = memory.proposals(bright(184, 112), search_crop(170.0, 120.0, size), template, size)
    sure = boxes[logs > np.log(0.5)]
    assert 9 <= len(sure) <= 25  # cells are 10 px apart, the target is 40 px wide
    assert np.abs(sure[:, :2].mean(axis=0) - [183.5, 111.5]).max() <= 5.0
    np.testing.assert_allclose(sure[:, 2:], 40.0, rtol=0.03)
    assert (np.diff(logs) <= 0).all()


def test_onnx_runtime_says_the_same(files):
    pytest.importorskip("onnxruntime")
    here, there = (load_networks(**files, sides=(159, 255), runtime=name) for name in RUNTIMES)
    rng = np.random.default_rng(3)
    template = rng.integers(0, 256, (TEMPLATE, TEMPLATE, 3), np.uint8)
    features = here.describe(template)
    np.testing.assert_allclose(there.describe(template), features, atol=1e-6)
    for side in (159, 255):
        crop = rng.integers(0, 256, (side, side, 3), np.uint8)
        one, other = (network.compare(features, crop, np.ones(2)) for network in (here, there))
        np.testing.assert_allclose(other.probabilities, one.probabilities, atol=1e-4)
        np.testing.assert_allclose(other.sides, one.sides, rtol=1e-5)


def test_without_onnx_runtime_it_is_said_what_to_install(files, monkeypatch):
    monkeypatch.setitem(sys.modules, "onnxruntime", None)
    with pytest.raises(SiameseError, match=r"ONNX Runtime is not installed: python -m pip install .*onnx"):
        load_networks(**files, runtime="onnxruntime")


@pytest.mark.parametrize("side", [159, 191, 255])
def test_a_smaller_crop_shows_the_middle_of_the_usual_one(files, side):
    """Cell for cell: the map of a head with a constant shape is cut, not squeezed."""
    networks = load_networks(**files, sides=(side,))
    image = np.random.default_rng(5).integers(0, 256, (SEARCH, SEARCH, 3), np.uint8)
    template = networks.describe(np.full((TEMPLATE, TEMPLATE, 3), 200, np.uint8))
    first, cells = (SEARCH - side) // 2, (side + 1) // STRIDE
    usual = networks.compare(template, image, np.ones(2)).probabilities
    found = networks.compare(template, image[first : first + side, first : first + side], np.ones(2))
    away = 8 - cells // 2
    assert found.probabilities.shape == (cells, cells) and found.sides.shape == (4, cells, cells)
    inner = found.probabilities[1:, 1:]  # the first cells reach beyond the crop
    np.testing.assert_allclose(inner, usual[away + 1 : away + cells, away + 1 : away + cells], atol=1e-5)


def test_a_head_whose_shape_cannot_be_told_takes_no_smaller_crop(tmp_path, files):
    odd = {**files, "head": written(tmp_path, head(shapes=2))}
    load_networks(**odd)
    with pytest.raises(SiameseError, match="search crops of 255 px only, not of 159"):
        load_networks(**odd, sides=(159,))


@pytest.mark.parametrize(("contrast", "is_seen"), [(0, False), (4, False), (40, True)])
def test_a_flat_crop_shows_nothing_whatever_the_network_says(contrast, is_seen):
    sure = Response(np.ones((16, 16), np.float32), np.full((4, 16, 16), 20, np.float32), STRIDE)
    stand_in = plain_correlator()
    memory = Memory(Networks(stand_in.describe, lambda template, crop, size: sure))
    image = np.zeros((240, 320, 3), np.uint8)
    image[110:130, 150:170] = contrast
    size = np.array([40.0, 40.0])
    template = template_crop(np.array([159.5, 119.5, 40.0, 40.0])).cut(bright(160, 120))
    boxes, logs = memory.proposals(image, search_crop(160.0, 120.0, size), template, size)
    assert (len(boxes) > 0) == (len(logs) > 0) == is_seen


def test_the_network_runs_once_for_the_same_question():
    runs, stand_in = [], plain_correlator()
    memory = Memory(Networks(stand_in.describe, lambda *given: runs.append(1) or stand_in.compare(*given)))
    image, size = bright(160, 120), np.array([40.0, 40.0])
    crop, template = search_crop(160.0, 120.0, size), np.full((TEMPLATE, TEMPLATE, 3), 9, np.uint8)
    for _ in range(3):
        memory.proposals(image, crop, template.copy(), size)
    assert len(runs) == 1
    memory.proposals(image, crop, template + 1, size)
    memory.proposals(bright(100, 100), crop, template, size)
    assert len(runs) == 3


@pytest.mark.parametrize("size", [(40.0, 40.0), (13.0, 37.0), (101.5, 20.25)])
def test_the_middle_cell_of_a_search_crop_is_its_place(size):
    """And its box, whose sides are as far as the target's in the template, has the target's size."""
    size = np.array(size)
    crop, shown = search_crop(150.3, 99.8, size), template_crop(np.array([150.3, 99.8, *size]))
    sides = np.zeros((4, 16, 16), np.float32)
    sides[:] = np.tile(size / 2 * TEMPLATE / shown.side, 2)[:, None, None]
    found = crop.boxes(Response(np.ones((16, 16), np.float32), sides, STRIDE)).reshape(16, 16, 4)[8, 8]
    assert np.abs(found[:2] - [150.3, 99.8]).max() <= 0.5 + 1e-9  # whole pixels are cut out
    np.testing.assert_allclose(found[2:], size, rtol=0.03)


def test_a_wide_crop_shows_what_is_beyond_the_usual_one_at_its_size():
    """The network is told how large the target is in it, and its boxes are in the frame."""
    pattern = np.repeat(np.repeat(np.random.default_rng(3).integers(0, 256, (5, 5, 3)), 8, 0), 8, 1)
    image, size = np.full((240, 320, 3), 90, np.uint8), np.array([40.0, 40.0])
    image[90:130, 210:250] = pattern
    there = np.array([229.5, 109.5, 40.0, 40.0])
    template, memory = template_crop(there).cut(image), Memory(plain_correlator())
    x, y = there[:2] - [90.0, 0.0]
    boxes, logs = memory.proposals(image, wide_crop(x, y, size), template, size)
    assert logs[0] > np.log(0.7)
    np.testing.assert_allclose(boxes[0], there, atol=3.0)
    usual, _ = memory.proposals(image, search_crop(x, y, size), template, size)
    assert not len(usual) or np.abs(usual[0] - there).max() > 20.0


def test_beyond_the_frame_a_crop_has_its_mean_colour():
    image = np.full((20, 30, 3), (10, 20, 30), np.uint8)
    for crop in (Crop(-5, -5, 40, 16), Crop(100, 100, 8, 16), Crop(2, 2, 8, 16)):
        assert crop.cut(image).shape == (16, 16, 3)
        assert (crop.cut(image) == (10, 20, 30)).all()


def padded(crop, image):
    """The whole square, with the mean colour beyond the image, and then reduced."""
    square = np.full((crop.side, crop.side, 3), np.rint(image.mean(axis=(0, 1))), np.uint8)
    x0, y0 = max(crop.left, 0), max(crop.top, 0)
    part = image[y0 : crop.top + crop.side, x0 : crop.left + crop.side]
    square[y0 - crop.top :, x0 - crop.left :][: part.shape[0], : part.shape[1]] = part
    return cv2.resize(square, (crop.shown, crop.shown), interpolation=cv2.INTER_LINEAR)


@pytest.mark.parametrize(
    ("crop", "most"),
    [
        (Crop(-30, 20, 64, 32), 0),
        (Crop(-3, -8, 61, 32), 0),
        (Crop(100, 60, 128, 32), 4),
        (Crop(-40, -5, 65, 32), 4),
        (Crop(-300, -411, 999, 32), 4),
    ],
)
def test_a_crop_beyond_the_frame_is_the_whole_square_reduced(crop, most):
    """To the byte up to twice the shown side, else nearly: OpenCV 4 samples at multiples of 1/32 px."""
    rough = np.random.default_rng(5).integers(0, 256, (5, 8, 3), np.uint8)
    image = cv2.resize(rough, (160, 100), interpolation=cv2.INTER_CUBIC)
    apart = np.abs(crop.cut(image).astype(int) - padded(crop, image))
    assert apart.max() <= most


def test_a_crop_of_a_large_target_takes_no_more_memory_than_the_image():
    image = np.full((540, 960, 3), 90, np.uint8)
    crop = wide_crop(480.0, 270.0, np.array([900.0, 900.0]))
    crop.cut(image)
    tracemalloc.start()
    try:
        crop.cut(image)
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert crop.side > 5000 and peak < image.nbytes


def test_crops_cover_the_boxes_or_the_most_that_are_allowed():
    rng = np.random.default_rng(2)
    boxes = np.column_stack([rng.normal(100, 40, (200, 2)), np.full((200, 2), 20.0)])
    asked, place, size = np.ones(200, bool), np.array([100.0, 100.0]), np.array([20.0, 20.0])
    every = list(crops_for(boxes, asked, place, size, 64))
    assert sorted(np.concatenate([which for _, which in every])) == list(range(200))
    few = list(crops_for(boxes, asked, place, size, 3))
    read = np.concatenate([which for _, which in few])
    assert len(few) == 3 and len(set(read)) == len(read) > 0.3 * 200
    assert list(crops_for(boxes, ~asked, place, size, 3)) == []


def test_a_hypothesis_is_as_likely_as_the_proposal_that_explains_it_best():
    proposals = np.array([[10.0, 10.0, 20.0, 10.0], [50.0, 10.0, 20.0, 10.0]])
    boxes = np.array(
        [[10.0, 10.0, 20.0, 10.0], [52.0, 10.0, 20.0, 10.0], [10.0, 10.0, 20.0 * np.e**0.1, 10.0]]
    )
    found = explained(boxes, proposals, np.array([0.0, -1.0]), 0.1, 0.1)
    np.testing.assert_allclose(found, [0.0, -1.5, -0.5])
    assert explained(boxes, proposals[:0], np.zeros(0), 0.1, 0.1).max() == -np.inf


@pytest.mark.parametrize("window", [0.0, 0.1, 0.455])
def test_the_proposal_that_is_chosen_is_that_of_the_formula(window):
    rng, expected, reach, penalty = np.random.default_rng(4), np.array([60.0, 40.0, 30.0, 20.0]), 45.0, 0.055

    def context(w, h):
        return np.sqrt((w + 0.5 * (w + h)) * (h + 0.5 * (w + h)))

    for _ in range(50):
        boxes = expected + rng.normal(0, [25, 25, 5, 3], (100, 4))
        boxes[:, 2:] = np.maximum(boxes[:, 2:], 1.0)
        logs = -np.sort(rng.exponential(1.0, 100))
        away = np.minimum(np.abs(boxes[:, :2] - expected[:2]) / reach, 1.0)
        near = (0.5 + 0.5 * np.cos(np.pi * away)).prod(axis=1)
        s = context(boxes[:, 2], boxes[:, 3]) / context(*expected[2:])
        r = boxes[:, 2] / boxes[:, 3] / (expected[2] / expected[3])
        worth = np.exp(logs) * np.exp(-penalty * (np.maximum(s, 1 / s) * np.maximum(r, 1 / r) - 1))
        best = int(np.argmax((1 - window) * worth + window * near))
        chosen, own = choose(boxes, logs, expected, window, reach, penalty)
        assert chosen == best
        assert np.isclose(own, worth[best], rtol=1e-12)


WRONG = {
    "missing": "head: .*none.onnx: no such model file",
    "one alone": "backbone: no path",
    "no model": "head: .*x.onnx: OpenCV cannot read it as an ONNX model",
    "truncated": "backbone: .*x.onnx: ",
    "interchanged": "are backbone and head interchanged",
    "not finite": "head: .*x.onnx: its outputs are not finite",
}


def spoiled(case, folder, files):
    return {
        "missing": lambda: {**files, "head": str(folder / "none.onnx")},
        "one alone": lambda: {**files, "backbone": ""},
        "no model": lambda: {**files, "head": written(folder, b"no network")},
        "truncated": lambda: {**files, "backbone": written(folder, backbone()[:-300])},
        "interchanged": lambda: {"backbone": files["head"], "head": files["backbone"]},
        "not finite": lambda: {**files, "head": written(folder, head(np.nan))},
    }[case]()


def written(folder, content):
    (folder / "x.onnx").write_bytes(content)
    return str(folder / "x.onnx")


@pytest.mark.parametrize("case", sorted(WRONG))
def test_files_that_do_not_fit_are_named(tmp_path, files, case):
    with pytest.raises(SiameseError, match=WRONG[case]):
        load_networks(**spoiled(case, tmp_path, files))


@pytest.mark.parametrize("case", sorted(WRONG))
def test_files_that_do_not_fit_are_named_by_onnx_runtime(tmp_path, files, case):
    pytest.importorskip("onnxruntime")
    with pytest.raises(SiameseError, match=WRONG[case].replace("OpenCV", "ONNX Runtime")):
        load_networks(**spoiled(case, tmp_path, files), runtime="onnxruntime")


@pytest.fixture
def halves(tmp_path, monkeypatch):
    """Two tiny halves in `models` of the folder where the program is started."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv(VARIABLE, raising=False)
    (tmp_path / "models").mkdir()
    for name, content in zip(NANOTRACK, (backbone(), head()), strict=True):
        (tmp_path / "models" / name).write_bytes(content)
    return tmp_path / "models"


def start_deep() -> Tracker:
    tracker = Tracker("deep", seed=0)
    tracker.init(bright(160, 120), (140, 100, 40, 40))
    return tracker


def test_deep_starts_with_the_files_in_models_and_says_which_they_are(halves):
    assert start_deep().update(bright(160, 120))[0]
    declaration = installed_cues()["siamese_box"]
    parameters = declaration.parameters(without_files="refuse")
    assert declaration.files(parameters) == tuple(str(Path("models") / name) for name in NANOTRACK)
    assert declaration.files(declaration.parameters()) == ()  # plain pixels stay plain pixels


def test_deep_refuses_to_start_with_one_of_the_two_only(halves):
    (halves / NANOTRACK[1]).unlink()
    with pytest.raises(
        SiameseError, match=rf"put {NANOTRACK[0]} and {NANOTRACK[1]} into the folder `models`"
    ):
        start_deep()


def test_a_damaged_file_in_models_is_named(halves):
    (halves / NANOTRACK[0]).write_bytes(b"no network")
    with pytest.raises(GraphError, match=rf"deep.yaml:\d+:\d+: network: backbone: models.{NANOTRACK[0]}: "):
        start_deep()


def test_the_variable_lists_folders_and_the_first_that_has_the_file_counts(halves, tmp_path, monkeypatch):
    other = tmp_path / "other"
    other.mkdir()
    (other / NANOTRACK[0]).write_bytes(b"")
    monkeypatch.setenv(VARIABLE, os.pathsep.join(["", str(tmp_path / "none"), str(other), str(halves)]))
    assert find_model(NANOTRACK[0]) == str(other / NANOTRACK[0])
    assert find_model(NANOTRACK[1]) == str(halves / NANOTRACK[1])
    monkeypatch.setenv(VARIABLE, str(other))  # the folder `models` is not looked in then
    assert find_model(NANOTRACK[1]) == NANOTRACK[1]


def test_a_file_that_the_graph_names_comes_first(halves, tmp_path):
    (tmp_path / NANOTRACK[0]).write_bytes(b"")
    assert find_model(NANOTRACK[0]) == NANOTRACK[0]
    missing = str(tmp_path / "none" / NANOTRACK[1])
    assert find_model(missing) == missing  # an absolute path is that file or none


def test_every_cue_that_takes_a_network_looks_there(halves):
    cues = installed_cues()
    assert cues["embedding"].parameters(model=NANOTRACK[0]).model == str(Path("models") / NANOTRACK[0])
    named = cues["opencv_tracker"].parameters(tracker="Vit", models={"net": NANOTRACK[1]})
    assert named.models == {"net": str(Path("models") / NANOTRACK[1])}


@pytest.mark.slow
def test_doctor_says_what_is_there_and_what_is_missing(halves):
    (found,) = doctor.check_models()
    assert found.level == "ok" and found.text == f"{halves}: {', '.join(sorted(NANOTRACK))}"
    (halves / NANOTRACK[1]).unlink()
    missing, found = doctor.check_models()
    assert (missing.level, found.level) == ("note", "ok")
    assert f"deep finds no {NANOTRACK[1]} in {halves}" in missing.text and VARIABLE in missing.cure
