"""What the tests of detectors share: running one over frames, scenes with truth, a tiny network."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from bayesnet_track.numerics.boxes import centre_from_corner, overlap
from bayesnet_track.observation.detector import installed_detectors
from bayesnet_track.observation.planes import Frame, FramePair
from bayesnet_track.sources.scenes import make_scene
from bayesnet_track.sources.scenes.library import SceneSource
from bayesnet_track.vision.planes import EdgePlane
from bayesnet_track.vision.shape import frame_example, learn_model, save_model
from tests.vision.detection_score import score_detections, total


def made(name, **parameters):
    declaration = installed_detectors()[name]
    return declaration.make(declaration.parameters(**parameters))


def frames_of(scene, end=None):
    return list(SceneSource(scene, "scene", end))


def pictures(images, has_color=True):
    return [Frame(k, float(k), np.asarray(image, np.uint8), has_color) for k, image in enumerate(images)]


def run(detector, frames, state=None):
    """Detections of each frame, and the last state."""
    state, previous, found = detector.start() if state is None else state, None, []
    for frame in frames:
        detections, state = detector.detect(FramePair(frame, previous), state)
        found.append(detections)
        previous = frame
    return found, state


def scored(found, scene, skip=0):
    """Recall and precision over the frames in which every object is whole and clear of the others."""
    paths = [centre_from_corner(path) for path in (scene.truth, *scene.others)]
    size, scores = np.array([scene.width, scene.height]), []
    for index, detections in enumerate(found):
        boxes = np.array([path[index] for path in paths])
        low, high = boxes[:, :2] - boxes[:, 2:] / 2, boxes[:, :2] + boxes[:, 2:] / 2
        seen = ((high > -0.5) & (low < size - 0.5)).all(axis=1)
        whole = ((low >= -1.0) & (high <= size)).all(axis=1)
        wide = boxes[seen] * [1.0, 1.0, 1.4, 1.4]
        apart = all(overlap(one, wide[:k]).max(initial=0.0) == 0 for k, one in enumerate(wide))
        if index >= skip and apart and (whole | ~seen).all():
            scores.append(score_detections(detections.boxes, boxes[seen]))
    return total(scores)


@pytest.fixture(scope="session")
def bench():
    """The builders of this file."""
    return SimpleNamespace(made=made, frames=frames_of, pictures=pictures, run=run, scored=scored)


@pytest.fixture(scope="session")
def person_model(tmp_path_factory):
    """A shape model of the scene's person, from ten frames of another seed."""
    scene, path = make_scene("person_and_board", 5), tmp_path_factory.mktemp("shape") / "person.npz"
    boxes = centre_from_corner(scene.truth)
    frames = [Frame(k, float(k), scene.frames[k]) for k in range(36, 56, 2)]
    vectors = [frame_example(frame, boxes[frame.index], EdgePlane(), 16)[0] for frame in frames]
    save_model(path, learn_model(np.array(vectors)))
    return str(path)


# ------------------------------------------------------------ a network as the bytes of its protobuf


def varint(number):
    low, rest = number & 127, number >> 7
    return bytes([low | (128 if rest else 0)]) + (varint(rest) if rest else b"")


def whole(field, number):
    return varint(field << 3) + varint(number)


def part(field, data):
    data = data if isinstance(data, bytes) else data.encode()
    return varint(field << 3 | 2) + varint(len(data)) + data


def tensor(name, values):
    kind = {"float32": 1, "int64": 7}[str(values.dtype)]
    sides = b"".join(whole(1, side) for side in values.shape)
    return part(5, sides + whole(2, kind) + part(8, name) + part(9, values.tobytes()))


def node(kind, inputs, output, *attributes):
    names = b"".join(part(1, name) for name in inputs) + part(2, output) + part(4, kind)
    return part(1, names + b"".join(part(5, one) for one in attributes))


def numbers(name, values):
    return part(1, name) + b"".join(whole(8, value) for value in values) + whole(20, 7)


def number(name, value):
    return part(1, name) + whole(3, value) + whole(20, 2)


def value(field, name, shape):
    sides = b"".join(part(1, whole(1, side)) for side in shape)
    return part(field, part(1, name) + part(2, part(1, whole(1, 1) + part(2, sides))))


def brightness_network(before=(), after=(), units=1.0, turned=False, size=32, stride=8, second=()):
    """A network that sees how bright each cell of 8x8 px of an input of `size` x `size` px is.

    It gives a row for each cell, one every `stride` px: columns `before`, x, y, w, h of the cell (in
    `units`), the brightness, columns `after`; an order of columns is how the layouts of detection networks
    differ. A `second` output has this shape.
    """
    side, per_row = 8, (size - 8) // stride + 1
    cells = per_row**2
    rows, columns = np.mgrid[:per_row, :per_row].reshape(2, -1) * stride
    box = np.stack([columns + 4.0, rows + 4.0, np.full(cells, 8.0), np.full(cells, 8.0)], axis=1) * units
    low, high = box[:, :2] - box[:, 2:] / 2, box[:, :2] + box[:, 2:] / 2
    table = [*(np.full(cells, v) for v in before), *box.T]
    if after == "end_to_end":
        left, right = np.column_stack([low, high]), np.full((cells, 1), 1.0)
    elif after == "ssd":
        left, right = np.column_stack([np.zeros(cells), np.ones(cells)]), np.column_stack([low, high])
    else:
        left, right = (
            np.column_stack(table),
            np.column_stack([np.full(cells, v) for v in after] or [[]] * cells),
        )
    weights = np.full((1, 3, side, side), 1 / (3 * side * side), np.float32)
    parts = [("left", left), ("right", right)]
    tensors = [tensor("weights", weights), tensor("shape", np.array([1, cells, 1], np.int64))]
    tensors += [tensor(name, v.astype(np.float32)[None]) for name, v in parts if v.size]
    order = ["left", "bright", *(["right"] if right.size else [])]
    wide = left.shape[1] + 1 + right.shape[1]
    nodes = [
        node(
            "Conv",
            ["x", "weights"],
            "seen",
            numbers("kernel_shape", [8, 8]),
            numbers("strides", [stride] * 2),
        ),
        node("Reshape", ["seen", "shape"], "bright"),
        node("Concat", order, "rows" if turned else "y", number("axis", 2)),
    ]
    if turned:
        nodes.append(node("Transpose", ["rows"], "y", numbers("perm", [0, 2, 1])))
    shape = (1, wide, cells) if turned else (1, cells, wide)
    outputs = value(12, "y", shape)
    if second:
        tensors.append(tensor("second_shape", np.array(second, np.int64)))
        nodes.append(node("Reshape", ["seen", "second_shape"], "z"))
        outputs += value(12, "z", second)
    graph = b"".join(nodes) + part(2, "g") + b"".join(tensors)
    graph += value(11, "x", (1, 3, size, size)) + outputs
    return whole(1, 8) + part(7, graph) + part(8, part(1, "") + whole(2, 13))


@pytest.fixture
def network(tmp_path):
    """Writes such a network; gives its path."""

    def write(**kind):
        path = tmp_path / "network.onnx"
        path.write_bytes(brightness_network(**kind))
        return str(path)

    return write
