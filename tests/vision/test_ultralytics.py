"""Ultralytics itself: networks of its own model files, with random weights, give the same boxes here.

Skipped where it is not installed; `.ci/ultralytics` installs it and runs these.
"""

from __future__ import annotations

import numpy as np
import pytest

from bayesnet_track import DetectionsTracker
from bayesnet_track.observation.detector import detections_of
from bayesnet_track.observation.planes import Frame, FramePair
from bayesnet_track.vision.detectors.onnx import OnnxParameters, _make

ultralytics = pytest.importorskip("ultralytics")
torch = pytest.importorskip("torch")
pytestmark = pytest.mark.slow

WIDTH, HEIGHT, INPUT_HEIGHT = 320, 240, 256
SETTINGS = {"min_score": 0.5, "max_overlap": 0.6, "max_count": 300, "max_area_share": 1.0, "min_area_px": 1.0}


def picture(seed):
    """A smooth random picture, (INPUT_HEIGHT, WIDTH, 3) uint8."""
    import cv2

    noise = np.random.default_rng(seed).random((INPUT_HEIGHT, WIDTH, 3)) * 255
    return cv2.normalize(cv2.GaussianBlur(noise.astype(np.uint8), (0, 0), 6), None, 0, 255, cv2.NORM_MINMAX)


def network(name):
    """A network of ultralytics' own YAML whose random weights say something different of each place.

    Its normalisations take the moments of random pictures, and the last layer of each head of classes is
    scaled so that about one place in a hundred passes the threshold: untrained, all scores would be equal.
    """
    torch.manual_seed(0)
    model = ultralytics.YOLO(name, verbose=False)
    pictures = np.stack([picture(seed) for seed in range(100, 104)]).transpose(0, 3, 1, 2)
    batch = torch.from_numpy(np.ascontiguousarray(pictures)).float() / 255
    for module in model.model.modules():
        if isinstance(module, torch.nn.BatchNorm2d):
            module.momentum = 0.5
    head = model.model.model[-1]
    with torch.no_grad():
        model.model.train()
        for _ in range(4):
            model.model(batch)
        model.model.eval()
        for part in ("cv3", "one2one_cv3"):
            for block in getattr(head, part, None) or []:
                spread(block[-1], model.model, batch)
        for part in (
            "cv2",
            "one2one_cv2",
        ):  # edges within four cells of the centre: no box as large as the frame
            for block in getattr(head, part, None) or []:
                block[-1].bias.view(4, -1)[:, 4:] -= 6
    return model


def spread(layer, model, batch):
    """Scale and shift a layer so that one in 5,000 of its outputs over the pictures is above 0."""
    outputs = []
    hook = layer.register_forward_hook(lambda _module, _inputs, output: outputs.append(output))
    model(batch)
    hook.remove()
    if outputs:
        scale = 2 / outputs[0].std()
        least = outputs[0].flatten().sort().values[-outputs[0].numel() // 5000]
        layer.weight *= scale
        layer.bias.copy_((layer.bias - least) * scale)


def clipped(boxes):
    """Edges of (N, 4) boxes x, y, w, h inside the frame, as ultralytics gives them, (N, 4) px."""
    low = boxes[:, :2] + 0.5 - boxes[:, 2:] / 2
    edges = np.hstack([low, low + boxes[:, 2:]])
    return np.clip(edges, 0, [WIDTH, HEIGHT, WIDTH, HEIGHT])


@pytest.mark.parametrize("name", ["yolov8n.yaml", "yolo11n.yaml", "yolov5n.yaml"])
def test_an_export_gives_the_boxes_of_its_own_package(name, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)  # the export is written beside the process
    model, image = network(name), picture(1)[:HEIGHT]
    result = model.predict(
        image, conf=0.5, iou=0.6, agnostic_nms=True, imgsz=(INPUT_HEIGHT, WIDTH), device="cpu", verbose=False
    )[0]
    theirs = detections_of(result)
    path = model.export(format="onnx", imgsz=(INPUT_HEIGHT, WIDTH), simplify=False, verbose=False)
    parameters = OnnxParameters(
        model=str(path), input_width=WIDTH, input_height=INPUT_HEIGHT, layout="yolo", **SETTINGS
    )
    detector = _make(parameters)
    ours, _state = detector.detect(FramePair(Frame(0, 0.0, image), None), detector.start())
    assert 2 <= len(theirs) < 300
    names = [str(key) for label in theirs.labels for key, text in result.names.items() if text == label]
    np.testing.assert_allclose(np.sort(ours.scores), np.sort(theirs.scores), atol=1e-4)
    order, other = np.argsort(-ours.scores, kind="stable"), np.argsort(-theirs.scores, kind="stable")
    np.testing.assert_allclose(clipped(ours.boxes)[order], clipped(theirs.boxes)[other], atol=0.05)
    assert [ours.labels[k] for k in order] == [names[k] for k in other]


def test_results_are_tracked_as_they_are():
    model, tracker = network("yolov8n.yaml"), DetectionsTracker("kalman_detections", size=(WIDTH, HEIGHT))
    image = picture(1)[:HEIGHT]
    result = model.predict(
        image, conf=0.5, iou=0.1, agnostic_nms=True, imgsz=(INPUT_HEIGHT, WIDTH), device="cpu", verbose=False
    )[0]
    for _ in range(4):
        marked = tracker.update(result)
    numbers = marked.tracker_id.tolist()
    assert len(numbers) == len(result.boxes) > 1
    assert min(numbers) >= 0 and len(set(numbers)) == len(numbers) == len(tracker.targets)
