"""Each entrance is fed as much as fits, half and twice as much, and something else: never silence.

What fits is used without a word. Of the others all is used, or a notice or an error names the file.
"""

import json
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import pytest

from bayesnet_track.cli.main import main

FRAMES, WIDTH, HEIGHT = 24, 96, 72
SIDE = 20

READINGS = """\
bayesnet: 1
name: told
targets:
  thing:
    nodes:
      thing:
        belief: {particles: {size: 50}}
        motion: {random_walk: {sd_px: {x: 3, y: 3}}}
        fuse: product
      told:
        parent: thing
        agent: {readings: {file: "FILE", sd: {x: 2}}}
        measures: {x: x}
"""


def boxes(count, scale=1.0):
    """Corner boxes of the square that moves, one a frame."""
    return [(scale * (10 + 3 * n), scale * 20, scale * SIDE, scale * SIDE) for n in range(count)]


def write_images(folder, count=FRAMES, scale=1, dtype=np.uint8):
    rng = np.random.default_rng(0)
    back, square = rng.integers(40, 90, (HEIGHT, WIDTH, 3)), rng.integers(150, 255, (SIDE, SIDE, 3))
    folder.mkdir()
    for n in range(count):
        image = back.copy()
        left = min(10 + 3 * n, WIDTH - SIDE)
        image[20 : 20 + SIDE, left : left + SIDE] = square
        image = cv2.resize(image.astype(np.uint8), None, fx=scale, fy=scale)
        assert cv2.imwrite(str(folder / f"{n:03d}.png"), image.astype(dtype))
    return folder


def lines(path, rows):
    path.write_text("".join(",".join(f"{value:g}" for value in row) + "\n" for row in rows))
    return path


def mot(path, count=FRAMES, scale=1.0):
    return lines(path, [(n + 1, 1, *box, 1, -1, -1, -1) for n, box in enumerate(boxes(count, scale))])


def coco(path, count=FRAMES, scale=1):
    size = {"width": WIDTH * scale, "height": HEIGHT * scale}
    images = [{"id": n, "file_name": f"{n:03d}.png", **size} for n in range(count)]
    shown = [
        {"id": n, "image_id": n, "category_id": 1, "bbox": list(box), "attributes": {"track_id": 1}}
        for n, box in enumerate(boxes(count, scale))
    ]
    categories = [{"id": 1, "name": "thing"}]
    path.write_text(json.dumps({"images": images, "annotations": shown, "categories": categories}))
    return path


@dataclass
class Place:
    """A folder in which a test works, with the images of a source."""

    path: Path

    @property
    def source(self):
        folder = self.path / "source"
        return folder if folder.is_dir() else write_images(folder)

    def run(self, graph, *more, code=None):
        """A run over the source; `code` is asserted where it is given."""
        out = str(self.path / "run")
        found = main(["run", str(graph), "--source", str(self.source), "--out", out, "-q", *map(str, more)])
        assert code is None or found == code
        return found

    @property
    def tracked(self):
        """Frames and corner boxes of the tracks."""
        rows = np.loadtxt(self.path / "run" / "tracks.txt", delimiter=",", ndmin=2)
        return rows[:, 0].astype(int) - 1, rows[:, 2:6]


def detections(place, write):
    return place.run("kalman_detections", "--detections", write(place.path / "given.txt"))


def truth_of_one(place, write):
    place.run("two_squares", "--init", "10,20,20,20", code=0)
    return main(["score", str(place.path / "run"), "--truth", str(write(place.path / "given.txt"))])


def truth_of_many(place, write):
    mot(place.path / "all.txt")
    place.run("kalman_detections", "--detections", place.path / "all.txt", code=0)
    return main(["score", str(place.path / "run"), "--truth", str(write(place.path / "given.txt"))])


def readings(place, write):
    graph = place.path / "graph.yaml"
    graph.write_text(READINGS.replace("FILE", str(write(place.path / "given.txt"))))
    return place.run(graph, "--init", "10,20,20,20")


def depth(place, write):
    return place.run("two_squares", "--init", "10,20,20,20", "--depth", write(place.path / "given.txt"))


def imports(place, write):
    given = str(write(place.path / "given.json"))
    out = str(place.path / "labels")
    return main(["annotate", str(place.source), "--out", out, "--import", given, "--no-view"])


def start(place, write):
    return place.run("two_squares", f"--init={write(place.path)}")


def values(place, write):
    low, high = write(place.path)
    folder = place.path / "source"
    write_images(folder)
    for path in folder.iterdir():
        image = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE).astype(np.uint16) + 8000
        assert cv2.imwrite(str(path), image)
    return place.run("two_squares", "--init", "10,20,20,20", "--range", f"{low},{high}")


def rows_of_one(count, scale=1.0):
    return lambda path: lines(path, boxes(count, scale))


def rows_of_many(count, scale=1.0):
    return lambda path: mot(path, count, scale)


def rows_of_readings(count, header="frame,x"):
    def write(path):
        rows = [f"{n},{10 + 3 * n + SIDE / 2}" for n in range(count)]
        path.write_text("\n".join([header, *rows]) + "\n")
        return path

    return write


def points(count, scale=1):
    def write(path):
        folder = path.with_suffix("")
        folder.mkdir()
        for n in range(count):
            np.save(folder / f"{n:03d}.npy", np.ones((HEIGHT * scale, WIDTH * scale, 3), np.float32))
        return folder

    return write


def polygons(path):
    return lines(path, [(x, y, x + w, y, x + w, y + h, x, y + h) for x, y, w, h in boxes(FRAMES)])


def nothing(path):
    path.write_text("")
    return path


CASES = {
    detections: (
        rows_of_many(FRAMES),
        [rows_of_many(2 * FRAMES), rows_of_many(FRAMES // 2), rows_of_many(FRAMES, 4.0), polygons, nothing],
    ),
    truth_of_one: (
        rows_of_one(FRAMES),
        [rows_of_one(2 * FRAMES), rows_of_one(FRAMES // 2), rows_of_one(FRAMES, 8.0), nothing],
    ),
    truth_of_many: (
        rows_of_many(FRAMES),
        [rows_of_many(2 * FRAMES), rows_of_many(FRAMES // 2), rows_of_many(FRAMES, 8.0), nothing],
    ),
    readings: (
        rows_of_readings(FRAMES),
        [
            rows_of_readings(2 * FRAMES),
            rows_of_readings(FRAMES // 2),
            rows_of_readings(FRAMES, "frame,y"),
            polygons,
            nothing,
        ],
    ),
    depth: (
        points(FRAMES),
        [points(2 * FRAMES), points(FRAMES // 2), points(FRAMES, 2), polygons, nothing],
    ),
    imports: (
        coco,
        [
            lambda path: coco(path, 2 * FRAMES),
            lambda path: coco(path, FRAMES, 2),
            polygons,
            nothing,
        ],
    ),
    start: (
        lambda _: "10,20,20,20",
        [lambda _: "90,60,40,40", lambda _: "20,20,90,70", lambda _: "10,20,20", lambda _: "200,20,20,20"],
    ),
    values: (
        lambda _: (8000, 8255),
        [lambda _: (0, 65535), lambda _: (8200, 8255), lambda _: (0, 4000), lambda _: (8255, 8000)],
    ),
}
OTHERS = [(feed, n) for feed, (_, others) in CASES.items() for n in range(len(others))]


@pytest.mark.parametrize("feed", CASES, ids=lambda feed: feed.__name__)
def test_what_fits_is_used_without_a_word(tmp_path, capsys, feed):
    assert feed(Place(tmp_path), CASES[feed][0]) == 0
    said = [line for line in capsys.readouterr().err.splitlines() if "given" in line or "lie" in line]
    assert said == []


@pytest.mark.slow
@pytest.mark.parametrize(("feed", "n"), OTHERS, ids=[f"{feed.__name__}-{n}" for feed, n in OTHERS])
def test_of_more_less_or_something_else_nothing_is_left_out_in_silence(tmp_path, capsys, feed, n):
    try:
        code = feed(Place(tmp_path), CASES[feed][1][n])
    except SystemExit as left:
        code = left.code
    err = capsys.readouterr().err
    named = any(word in err for word in ("given", "start box", "--init", "values of the first frame"))
    assert named or (code != 0 and err), f"exit code {code}, and only this is said: {err!r}"
