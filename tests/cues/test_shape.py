"""The shape cue: contours shared by cells, its score, learning, and models from files."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from bayesnet_track import floored, load_graph
from bayesnet_track.cues import shape
from bayesnet_track.cues.shape import CUE, MODES, ShapeCue
from bayesnet_track.graph.text.messages import GraphError
from bayesnet_track.observation.cue import Hypotheses
from bayesnet_track.observation.planes import Frame, FramePair, PlaneCache, Planes, Region
from bayesnet_track.vision.kernels.shape_kernels import shape_energy
from bayesnet_track.vision.shape import contours, learn_model, save_model, vectors

BOX = np.array([80.0, 60.0, 50.0, 60.0])
FORMS = ("ellipse", "rectangle", "triangle")


def drawn(form: str, box: np.ndarray = BOX, ink: int = 180, ground: int = 80) -> np.ndarray:
    """A form that fills the centre box, with a little noise."""
    image = np.full((140, 180), ground, np.uint8)
    (x, y, w, h), shift = box * 16, 4
    if form == "ellipse":
        axes = (round(w / 2), round(h / 2))
        cv2.ellipse(image, (round(x), round(y)), axes, 0, 0, 360, ink, -1, cv2.LINE_AA, shift)
    else:
        top = [(x, y - h / 2)] if form == "triangle" else [(x - w / 2, y - h / 2), (x + w / 2, y - h / 2)]
        corners = np.array([*top, (x + w / 2, y + h / 2), (x - w / 2, y + h / 2)])
        cv2.fillPoly(image, [np.rint(corners).astype(np.int32)], ink, cv2.LINE_AA, shift)
    noise = np.random.default_rng(7).integers(-3, 4, image.shape)
    return np.clip(image + noise, 0, 255).astype(np.uint8)


def planes_of(gray: np.ndarray, cue: ShapeCue) -> Planes:
    frame = Frame(0, 0.0, cv2.merge([gray] * 3))
    return PlaneCache(FramePair(frame, None)).planes(cue.needs, Region(0, 0, frame.width, frame.height))


def made(**parameters: object) -> ShapeCue:
    return CUE.make(CUE.parameters(**parameters))


def score(cue: ShapeCue, gray: np.ndarray, boxes: np.ndarray, reference: object) -> np.ndarray:
    return cue.log_likelihood(planes_of(gray, cue), Hypotheses(np.atleast_2d(boxes)), reference)


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("other", FORMS)
def test_forms_are_told_apart_whatever_their_place_size_and_brightness(form: str, other: str) -> None:
    cue = made()
    reference = cue.learn(planes_of(drawn(form), cue), BOX)
    moved = np.array([97.3, 66.4, 62.5, 75.0])  # 1.25 times the size
    value = score(cue, drawn(other, moved, ink=40, ground=150), moved, reference)[0]
    assert value > -0.5 if form == other else value < -1.0


def test_the_value_is_the_gaussian_of_the_chain() -> None:
    """Step by step for one box: contour, vector, energy with the residual, support, floor."""
    cue = made(sd_distance=0.2, sd_support=0.4, sharpness=0.7, floor=0.01)
    model = learn_model(np.random.default_rng(0).normal(size=(6, 256)) * 0.1)
    learnt = cue.learn(planes_of(drawn("ellipse"), cue), BOX)
    reference = {**learnt, "mean": learnt["mean"] + 0.02, "support": np.array([1.0])}
    reference["modes"] = np.concatenate([model.modes, np.zeros((MODES - len(model.modes), 256))])
    reference["variances"] = np.concatenate([model.variances, np.zeros(MODES - len(model.modes))])
    gray, planes = drawn("rectangle"), planes_of(drawn("rectangle"), cue)
    points = planes[cue.edges]
    cell = np.array([[250.0 / 3, 60.0, 50.0, 60.0]])  # the lattice's nearest: 10 steps of 25/3 and 6 of 10 px
    found = contours(points[points[:, 2] & 1 == 1, :2], cell, np.array([180, 140]))
    vector = vectors(found, BOX[None], 16)[0]
    energy = shape_energy(vector, reference["mean"], model.modes, model.variances, 256 * 0.2**2)
    missing = max(1.0 - found.support[0], 0.0) / 0.4
    expected = floored(np.array([-0.5 * 0.7 * (energy + missing**2)]), 0.01)
    assert score(cue, gray, BOX, reference) == pytest.approx(expected, abs=1e-12)


def test_a_shape_outside_the_modes_is_no_match() -> None:
    """A model whose modes know nothing of a triangle: its coordinates are small, its residual is not."""
    cue = made()
    sizes = [BOX * [1, 1, 1, scale] for scale in (0.9, 1.0, 1.1)]
    seen = [cue.learn(planes_of(drawn("ellipse", box), cue), box)["mean"] for box in sizes]
    model = learn_model(np.array(seen))
    reference = cue.learn(planes_of(drawn("ellipse"), cue), BOX)
    room = MODES - len(model.modes)
    reference = {
        **reference,
        "mean": model.mean,
        "modes": np.concatenate([model.modes, np.zeros((room, 256))]),
        "variances": np.concatenate([model.variances, np.zeros(room)]),
    }
    assert score(cue, drawn("ellipse"), BOX, reference)[0] > -0.3
    assert score(cue, drawn("triangle"), BOX, reference)[0] < -1.0


def test_without_edges_every_box_is_at_the_floor_and_learning_says_nothing() -> None:
    cue = made(floor=0.05)
    blank = np.full((140, 180), 120, np.uint8)
    boxes = BOX + np.array([[0.0, 0, 0, 0], [10, 5, 0, 0], [-20, 0, 9, 3]])
    reference = cue.learn(planes_of(drawn("ellipse"), cue), BOX)
    # missing 100 % of the support is 4 sd: exp(-8) above the floor at most
    assert score(cue, blank, boxes, reference) == pytest.approx(np.log(0.05), abs=np.exp(-8) / 0.05)
    assert (score(cue, drawn("ellipse"), boxes, cue.learn(planes_of(blank, cue), BOX)) == 0).all()


def test_size_itself_costs_nothing() -> None:
    cue = made()
    reference = cue.learn(planes_of(drawn("ellipse"), cue), BOX)
    for scale in (0.5, 1.6):
        box = np.array([90.0, 68.0, *(BOX[2:] * scale)])
        assert score(cue, drawn("ellipse", box), box, reference)[0] > -0.6


def test_faint_edges_are_found_after_local_action() -> None:
    cue = made()
    # a step of 16 gray levels under a Gaussian of 1 px has a slope of 16 / sqrt(2 pi) = 6.4: below 8, above 4
    faint = drawn("ellipse", ink=96)
    reference = cue.learn(planes_of(drawn("ellipse"), cue), BOX)
    tuned = cue.adapt(reference, 1)
    assert score(cue, faint, BOX, reference)[0] < -2.0
    assert score(cue, faint, BOX, tuned)[0] > -0.5
    assert cue.adapt(tuned, 2) is not None and cue.adapt(tuned, 3) is None


def test_the_model_moves_toward_what_is_seen() -> None:
    cue = made()
    ellipse, rectangle = (cue.learn(planes_of(drawn(form), cue), BOX) for form in ("ellipse", "rectangle"))
    reference = ellipse
    for _ in range(12):
        reference = cue.blend(reference, rectangle, 0.1)
    values = [score(cue, drawn(form), BOX, reference)[0] for form in ("rectangle", "triangle")]
    assert values[0] > score(cue, drawn("rectangle"), BOX, ellipse)[0] + 0.5
    assert values[1] < -1.0
    assert {name: a.shape for name, a in reference.items()} == {name: a.shape for name, a in ellipse.items()}
    assert np.count_nonzero(reference["variances"]) == 1  # both lie on one line


def test_a_silhouette_with_few_edges_teaches_nothing() -> None:
    cue = made()
    old = cue.learn(planes_of(drawn("ellipse"), cue), BOX)
    fade = np.clip((95 - np.arange(180)) / 50, 0, 1)  # 2 gray levels per pixel: no edge of its own
    half = (80 + (drawn("rectangle") - 80.0) * fade).round().astype(np.uint8)
    blended = cue.blend(old, cue.learn(planes_of(half, cue), BOX), 0.5)
    assert all(np.array_equal(blended[name], old[name]) for name in old)


def test_learning_at_ease_takes_local_action_back() -> None:
    cue = made()
    old = cue.learn(planes_of(drawn("ellipse"), cue), BOX)
    assert cue.blend(cue.adapt(old, 1), old, 0.1)["contrast"] == [0]


def test_boxes_of_one_cell_share_a_snake(monkeypatch: pytest.MonkeyPatch) -> None:
    cue, asked = made(), []
    reference = cue.learn(planes_of(drawn("ellipse"), cue), BOX)
    boxes = np.repeat(BOX[None], 1000, axis=0)
    boxes[:, :2] += np.random.default_rng(0).uniform(-20, 20, (1000, 2))

    def counting(points: np.ndarray, cells: np.ndarray, frame: np.ndarray) -> object:
        asked.append(len(cells))
        return contours(points, cells, frame)

    monkeypatch.setattr(shape, "contours", counting)
    score(cue, drawn("ellipse"), boxes, reference)
    # 60 to 100 touches 6 cells of 25/3 px across, 40 to 80 touches 5 of 10 px down
    assert asked == [30]


@pytest.fixture
def model_file(tmp_path: Path) -> Path:
    cue, seen = made(), []
    for scale in (0.95, 1.0, 1.05):
        box = BOX * [1, 1, scale, 1]
        seen.append(cue.learn(planes_of(drawn("ellipse", box), cue), box)["mean"])
    save_model(tmp_path / "ellipse.npz", learn_model(np.array(seen)))
    return tmp_path / "ellipse.npz"


def test_a_model_file_is_what_is_looked_for_and_stays(model_file: Path) -> None:
    cue = made(model=str(model_file))
    triangle = planes_of(drawn("triangle"), cue)
    reference = cue.learn(triangle, BOX)
    assert score(cue, drawn("ellipse"), BOX, reference)[0] > -0.3
    assert score(cue, drawn("triangle"), BOX, reference)[0] < -1.0
    blended = cue.blend(reference, cue.learn(triangle, BOX), 0.5)
    assert all(np.array_equal(blended[name], reference[name]) for name in ("mean", "modes", "variances"))


GRAPH = """\
bayesnet: 1
name: t
targets:
  t:
    nodes:
      t:
        motion: {random_walk: {sd_px: {x: 10, y: 10}}}
      outline: {parent: t, agent: {shape: {model: MODEL}}}
"""


def test_a_model_file_that_does_not_fit_is_an_error_of_the_graph(tmp_path: Path, model_file: Path) -> None:
    graph = tmp_path / "g.yaml"
    graph.write_text(GRAPH.replace("MODEL", str(model_file)))
    assert load_graph(graph).targets["t"].parameters["outline"].model == str(model_file)
    for name, said in (("none.npz", "is not there"), ("g.yaml", "is damaged, or no shape model")):
        graph.write_text(GRAPH.replace("MODEL", str(tmp_path / name)))
        with pytest.raises(GraphError) as error:
            load_graph(graph)
        (message,) = error.value.errors
        assert (message.line, message.column, message.node) == (8, 51, "outline")
        assert said in str(message)
