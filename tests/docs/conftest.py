"""The folder in which the code of the pages runs."""

from __future__ import annotations

import shutil
from pathlib import Path
from types import SimpleNamespace

import cv2
import numpy as np
import pytest

from bayesnet_track.runtime.recording.videowriter import VideoWriter
from tests.engine.test_several_cameras import write_graph

ROOT = Path(__file__).parents[2]
FRAMES = 125
START = (57, 21, 31, 45)
"""Where the pages say that the target is in the first frame."""


def corner(index: int) -> tuple[int, int]:
    """Left and top of the target in a frame: across and back, once up and down."""
    return START[0] + round(80 * (1 - np.cos(index / 20))), START[1] + round(50 * (1 - np.cos(index / 25)))


def film() -> list[np.ndarray]:
    """An orange patterned box before a gray patterned ground, 320 x 240."""
    rng = np.random.default_rng(5)
    ground = cv2.resize(rng.integers(60, 160, (30, 40, 3), dtype=np.uint8), (320, 240))
    box = cv2.resize(rng.integers(0, 60, (6, 4, 3), dtype=np.uint8), START[2:]) + np.array(
        (20, 110, 190), np.uint8
    )
    images = []
    for index in range(FRAMES):
        x, y = corner(index)
        image = ground.copy()
        image[y : y + START[3], x : x + START[2]] = box
        images.append(image)
    return images


def write_video(path: Path, images: list[np.ndarray]) -> None:
    with VideoWriter(path, 320, 240, 0.04) as video:
        for image in images:
            video.write(image)


def write_truth(path: Path, count: int, elsewhere: int = 0) -> None:
    """Boxes of the target, and then wrong ones, so that `fit` sees what losing it looks like."""
    boxes = [f"{corner(n)[0]},{corner(n)[1]},{START[2]},{START[3]}" for n in range(count)]
    path.write_text("\n".join([*boxes, *["250,10,31,45"] * elsewhere]) + "\n")


def mot(count: int, identity: bool) -> str:
    """Lines of MOT: the target, and three boxes that stand still, so that targets 1 to 3 are born."""
    still = [(20, 150, 30, 60), (150, 160, 30, 60), (260, 150, 30, 60)]
    lines = []
    for n in range(count):
        for number, box in enumerate([(*corner(n), *START[2:]), *still], 1):
            lines.append(f"{n + 1},{number if identity else -1},{','.join(map(str, box))},1,-1,-1,-1")
    return "\n".join(lines) + "\n"


@pytest.fixture(scope="session")
def stocked(tmp_path_factory):
    """What the pages take for granted: videos, ground truth, detections, graphs."""
    folder, images = tmp_path_factory.mktemp("stock"), film()
    write_video(folder / "video.mp4", images)
    write_truth(folder / "groundtruth.txt", FRAMES)
    for name in ("a", "b", "street", "game"):
        write_video(folder / f"{name}.mp4", images[:30])
        write_truth(folder / f"{name}.txt", 20, elsewhere=10)
    for name in ("data/one", "data/two", "cars"):
        (folder / name / "img").mkdir(parents=True)
        write_truth(folder / name / "groundtruth.txt", 15, elsewhere=8)
        for n, image in enumerate(images[:23]):
            cv2.imwrite(str(folder / name / "img" / f"{n:03}.png"), image)
    shutil.copy(folder / "video.mp4", folder / "vtest.avi")
    shutil.copytree(folder / "data/one/img", folder / "img1")
    for n in (1, 2):
        shutil.copy(folder / "a.mp4", folder / "cars" / f"{n}.mp4")
        shutil.copy(folder / "a.txt", folder / "cars" / f"{n}.txt")
    for name in ("detections.txt", "found.txt", "det.txt"):
        (folder / name).write_text(mot(FRAMES, identity=False))
    for name in ("gt.txt", "tracks.txt"):
        (folder / name).write_text(mot(FRAMES, identity=True))
    for name in ("graph.yaml", "many.yaml"):
        shutil.copy(ROOT / "graphs" / "people_detections.yaml", folder / name)
    shutil.copy(ROOT / "graphs" / "kalman_ball.yaml", folder / "my_graph.yaml")
    write_graph(folder, ("north", "south"))
    return folder, images


@pytest.fixture
def workplace(stocked, tmp_path):
    """A copy of the stock for one page."""
    folder, images = stocked
    place = shutil.copytree(folder, tmp_path / "place", symlinks=True)
    return SimpleNamespace(folder=place, images=images)
