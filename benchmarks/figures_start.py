"""Draw the figures of the page "Where to start" that no other page has, on rendered scenes.

Run ``python benchmarks/figures_start.py``; pictures go to docs/figures. The page's other two figures are made
by `figures_cues.py` and `kalman_figures.py`.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace

import cv2
import numpy as np

from bayesnet_track import DetectionsTracker, Tracker, load_graph
from bayesnet_track.numerics.arrays import Image
from bayesnet_track.observation.detector import installed_detectors
from bayesnet_track.observation.planes import Frame, FramePair
from bayesnet_track.runtime.annotation.answers import Answer, by_target
from bayesnet_track.runtime.annotation.asking import annotate
from bayesnet_track.runtime.annotation.tracked import TrackerRuns
from bayesnet_track.sources.scenes import Scene, make_scene
from simulated.street import street

FIGURES = Path(__file__).parents[1] / "docs" / "figures"
COLORS = ((215, 120, 0), (0, 110, 230), (60, 160, 60), (170, 60, 150), (40, 40, 200))
DETECTED = (90, 90, 90)
HOWS = {"given": (20, 20, 20), "tracked": (110, 160, 40), "interpolated": (180, 60, 120)}
SURE = 0.8


@dataclass
class Pictures:
    """The frames of a scene, as `annotate` wants them."""

    scene: Scene
    last: int

    def __len__(self) -> int:
        return self.last + 1

    def image(self, frame: int) -> Image:
        """Rendered."""
        return self.scene.frames[frame]


def boxed(image: Image, box: tuple[float, ...], text: str, color: tuple[int, int, int]) -> Image:
    """A copy with a box and a line of text above it."""
    drawn = image.copy()
    x, y, w, h = (round(value) for value in box)
    cv2.rectangle(drawn, (x, y), (x + w, y + h), color, 2)
    (wide, tall), _ = cv2.getTextSize(text, cv2.FONT_HERSHEY_SIMPLEX, 0.45, 1)
    left, top = min(max(x - 1, 0), drawn.shape[1] - wide - 6), max(y - tall - 10, 0)
    cv2.rectangle(drawn, (left, top), (left + wide + 5, top + tall + 8), color, -1)
    white = (255, 255, 255)
    place = (left + 3, top + tall + 3)
    cv2.putText(drawn, text, place, cv2.FONT_HERSHEY_SIMPLEX, 0.45, white, 1, cv2.LINE_AA)
    return drawn


def save(name: str, views: list[Image]) -> None:
    """Views side by side."""
    rim = [cv2.copyMakeBorder(one, 0, 0, 0, 4, cv2.BORDER_CONSTANT, value=(255, 255, 255)) for one in views]
    cv2.imwrite(str(FIGURES / name), np.hstack(rim)[:, :-4], [cv2.IMWRITE_WEBP_QUALITY, 80])


def followed(name: str, scene: Scene, shown: tuple[int, ...]) -> None:
    """What `Tracker.plot` draws."""
    tracker = Tracker("general")
    tracker.init(scene.frames[0], scene.start_box)
    views = []
    for index in range(1, max(shown) + 1):
        tracker.update(scene.frames[index])
        if index in shown:
            views.append(np.asarray(tracker.plot(scene.frames[index]), dtype=np.uint8))
    save(name, views)


def numbered(shown: tuple[int, ...]) -> None:
    """Detections of `background`, and the targets that they became."""
    scene, declared = street(), installed_detectors()["background"]
    detector = declared.make(declared.parameters(min_area_px=200))
    state, views, before = detector.start(), [], None
    tracker = DetectionsTracker("kalman_detections", size=(scene.width, scene.height))
    for index in range(max(shown) + 1):
        frame = Frame(index, float(index), scene.frames[index])
        found, state = detector.detect(FramePair(frame, before), state)
        before, view = frame, scene.frames[index]
        half = found.boxes[:, 2:] / 2
        corners = np.concatenate([found.boxes[:, :2] - half, found.boxes[:, :2] + half], axis=1)
        made = tracker.update(SimpleNamespace(xyxy=corners, confidence=found.scores, tracker_id=None))
        for corner, target in zip(corners, made.tracker_id, strict=True):
            box = (*corner[:2], *(corner[2:] - corner[:2]))
            color = DETECTED if target < 0 else COLORS[int(target) % len(COLORS)]
            view = boxed(view, box, "detected" if target < 0 else f"person {target}", color)
        if index in shown:
            views.append(view)
    save("start_detections.webp", views)


def labelled(shown: tuple[int, ...]) -> None:
    """Boxes that two answers give, and where each comes from."""
    scene, last = make_scene("occluder", 0), max(shown)
    answers = [Answer("box", at, "1", tuple(float(v) for v in scene.truth[at])) for at in (0, last)]
    done = annotate(by_target(answers), TrackerRuns(load_graph("general"), Pictures(scene, last)), last + 1)
    views = []
    for index in shown:
        mark = done.marks["1"][index]
        text = mark.how if mark.how == "given" else f"{mark.how} {mark.probability:.2f}"
        color = HOWS[mark.how] if mark.probability >= SURE else (0, 140, 230)
        if mark.box is not None:
            views.append(boxed(scene.frames[index], mark.box, text, color))
    save("start_labels.webp", views)


def main() -> None:
    """Draw all of them."""
    cv2.setNumThreads(1)
    followed("start_video.webp", make_scene("occluder", 0), (10, 25, 40, 58))
    followed("start_opencv.webp", make_scene("two_squares", 0), (5, 25, 45))
    numbered((30, 60, 90))
    labelled((0, 10, 30, 59))


if __name__ == "__main__":
    main()
