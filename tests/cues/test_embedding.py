"""The embedding: a tiny network written here, its crops and shared crops, and models that do not fit."""

import numpy as np
import pytest

from bayesnet_track.cues.embedding import EmbeddingError, representatives
from bayesnet_track.observation.cue import installed_cues

INPUT = {"input_width": 8, "input_height": 8}


def varint(value):
    found = bytearray()
    while value > 127:
        found.append(value & 127 | 128)
        value >>= 7
    return bytes([*found, value])


def whole(field, value):
    return varint(field << 3) + varint(value)


def part(field, data):
    data = data if isinstance(data, bytes) else data.encode()
    return varint(field << 3 | 2) + varint(len(data)) + data


def value(field, name, shape):
    sides = b"".join(part(1, whole(1, side)) for side in shape)
    return part(field, part(1, name) + part(2, part(1, whole(1, 1) + part(2, sides))))


def ints(name, values):
    return part(5, part(1, name) + b"".join(whole(8, v) for v in values) + whole(20, 7))


def quarters(weight):
    """A network of one convolution: the mean of each channel in each quarter of 8 x 8 px, 12 numbers."""
    weights = np.zeros((3, 3, 4, 4), np.float32)
    weights[np.arange(3), np.arange(3)] = weight
    sides = b"".join(whole(1, side) for side in weights.shape)
    tensor = part(5, sides + whole(2, 1) + part(8, "weights") + part(9, weights.tobytes()))
    shape = part(5, whole(1, 2) + whole(2, 7) + part(8, "shape") + part(9, np.array([1, 12]).tobytes()))
    names = part(1, "x") + part(1, "weights") + part(2, "quarters") + part(4, "Conv")
    conv = part(1, names + ints("kernel_shape", [4, 4]) + ints("strides", [4, 4]))
    flat = part(1, part(1, "quarters") + part(1, "shape") + part(2, "y") + part(4, "Reshape"))
    graph = (
        conv + flat + part(2, "g") + tensor + shape + value(11, "x", (1, 3, 8, 8)) + value(12, "y", (1, 12))
    )
    return whole(1, 8) + part(7, graph) + part(8, part(1, "") + whole(2, 13))


@pytest.fixture
def model(tmp_path):
    path = tmp_path / "quarters.onnx"
    path.write_bytes(quarters(1 / 16))
    return str(path)


def test_the_vector_is_the_networks(ask, scene, model):
    """A target of 8 x 8 px is its own crop: quarters of red, green, blue over 255, less the mean."""
    asked = ask("embedding", model=model, mean=(10.0, 20.0, 30.0), **INPUT)
    image = np.random.default_rng(0).integers(0, 256, (scene.height, scene.width, 3)).astype(np.uint8)
    box = np.array([63.5, 43.5, 8.0, 8.0])
    crop = image[40:48, 60:68, ::-1].astype(float) - [10.0, 20.0, 30.0]
    quarters = crop.reshape(2, 4, 2, 4, 3).mean(axis=(1, 3)).transpose(2, 0, 1) / 255.0
    vector = asked.learn(scene.pair_of(image, image), box)["vector"]
    np.testing.assert_allclose(vector, quarters.ravel(), atol=1e-6)


def test_it_finds_the_target_by_the_network(ask, scene, model):
    asked = ask("embedding", model=model, **INPUT)
    reference = asked.learn(scene.pair(), scene.box())
    boxes = scene.around(scene.start + [16, -8], reach=40)
    values = asked.score(scene.pair((32, -16)), boxes, reference)
    peak = boxes[values >= values.max() - 1e-12, :2].mean(axis=0)
    # The crops are a tenth of a side apart.
    assert (np.abs(peak - scene.start - [32, -16]) <= 0.15 * scene.size).all()
    assert values.max() > np.log(0.5)
    assert np.median(values) < values.max() - 2.0


@pytest.mark.parametrize("most", [1, 7, 60])
def test_no_more_crops_than_asked_for(ask, scene, model, most):
    asked = ask("embedding", model=model, max_crops=most, **INPUT)
    reference, pair = asked.learn(scene.pair(), scene.box()), scene.pair()
    seen = []
    embed = asked.cue.embed
    object.__setattr__(asked.cue, "embed", lambda crops: seen.append(len(crops)) or embed(crops))
    asked.score(pair, scene.around(scene.start), reference)
    assert 0 < sum(seen) <= most
    assert (
        sum(seen) >= most / 3
    )  # and not far fewer: the lattice grows by a quarter, 1.6 times fewer in two sides


def test_a_representative_is_near_and_independent_of_company():
    """Half a step at most in place and in the logs of the sides, of its own sides."""
    rng = np.random.default_rng(3)
    size, step = np.array([40.0, 30.0]), 0.1
    boxes = np.column_stack([rng.uniform(0, 300, (200, 2)), size * np.exp(rng.normal(0, 0.3, (200, 2)))])
    found, which = representatives(boxes, size, step, 10**4)
    near = found[which]
    assert (np.abs(near[:, :2] - boxes[:, :2]) <= step / 2 * near[:, 2:] + 1e-9).all()
    assert (np.abs(np.log(near[:, 2:] / boxes[:, 2:])) <= step + 1e-9).all()
    few, of = representatives(boxes[:9], size, step, 10**4)
    np.testing.assert_array_equal(few[of], near[:9])
    coarse, group = representatives(boxes, size, step, 20)
    assert len(coarse) <= 20
    for k in range(len(coarse)):
        np.testing.assert_allclose(coarse[k], boxes[group == k].mean(axis=0))


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (None, "wrong.onnx: no such model file"),
        (b"no network", "wrong.onnx: OpenCV cannot read it as an ONNX model"),
        (quarters(np.nan), "wrong.onnx: no finite vector comes from an input of 8x8 px"),
    ],
)
def test_a_model_that_does_not_fit_is_named(ask, tmp_path, content, message):
    if content is not None:
        (tmp_path / "wrong.onnx").write_bytes(content)
    with pytest.raises(EmbeddingError, match=message):
        ask("embedding", model=str(tmp_path / "wrong.onnx"), **INPUT)


def test_validate_is_told_of_a_missing_file(model):
    declaration = installed_cues()["embedding"]
    assert "none.onnx: no such model file" in declaration.missing(declaration.parameters(model="none.onnx"))
    assert declaration.missing(declaration.parameters(model=model, **INPUT)) is None
    assert declaration.missing(declaration.parameters()) is None


def test_each_attempt_takes_from_boxes_that_are_off_and_ends(ask, scene):
    asked, pair = ask("embedding", floor=1e-6), scene.pair()
    reference, off = asked.learn(pair, scene.box()), (scene.box() + [12, 0, 0, 0])[None]
    values = [asked.score(pair, off, reference)[0]]
    for attempt in (1, 2, 3):
        reference = asked.cue.adapt(reference, attempt)
        values.append(asked.score(pair, off, reference)[0])
    assert np.all(np.diff(values) < 0)
    assert asked.cue.adapt(reference, 1) is None
