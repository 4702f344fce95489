"""How right the disparities are, and how well two real cameras are calibrated.

Rendered scenes, whose depth is known, need nothing. The real pairs are those of Debian's package
``opencv-doc``; without installing it::

    apt-get download opencv-doc && dpkg-deb -x opencv-doc_*.deb docs-of-opencv
    python benchmarks/stereo.py --data docs-of-opencv/usr/share/doc/opencv-doc/examples/data

A share "within 1 px" is of the pixels that have a disparity; "dense" is the share that has one.
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from bayesnet_track.cli.commands.calibrate import read_all
from bayesnet_track.numerics.boxes import centre_from_corner, overlap
from bayesnet_track.observation.planes import Region
from bayesnet_track.sources.scene_source import SceneSource
from bayesnet_track.sources.scenes import make_scene
from bayesnet_track.vision.planes.stereo_planes import Correlation, Matcher, Range, SemiGlobal
from bayesnet_track.vision.stereo.chessboard import calibrate
from bayesnet_track.vision.stereo.stereo_blobs import StereoBlobSettings, detect_stereo_blobs

Floats = NDArray[np.float64]

MATCHERS: dict[str, Matcher] = {
    "correlation": Correlation(),
    "  no filters": Correlation(min_texture_gray=0.0, min_correlation=0.0, min_difference=0.0),
    "  no third filter": Correlation(min_difference=0.0),
    "semi-global": SemiGlobal(),
}
HEAD = f"{'':20}{'dense':>8}{'within 1 px':>13}{'median error px':>17}{'ms':>8}"


def line(name: str, matcher: Matcher, left: object, right: object, low: int, high: int, true: Floats) -> str:
    """One row: found against true disparity (NaN where it is not known)."""
    region = Region(0, 0, true.shape[1], true.shape[0])
    matcher.disparity(left, right, low, high, region)  # type: ignore[arg-type]
    began = time.process_time()
    found = matcher.disparity(left, right, low, high, region)  # type: ignore[arg-type]
    spent = 1e3 * (time.process_time() - began)
    return row(name, found, true, np.isfinite(true)) + f"{spent:8.0f}"


def row(name: str, found: NDArray[np.float32], true: Floats, where: NDArray[np.bool_]) -> str:
    """Density and error of the pixels `where`."""
    known = np.isfinite(found) & where
    error = np.abs(found - true)[known]
    return f"{name:20}{known.sum() / where.sum():8.3f}{(error <= 1).mean():13.3f}{np.median(error):17.3f}"


def rendered() -> None:
    """Both matchers in both rooms: everywhere, and on the walking target."""
    for name, index in (("person_stereo", 80), ("glass_wall", 80)):
        scene = make_scene(name, 0)
        assert scene.stereo is not None
        view = scene.stereo
        true = view.geometry.focal_px * view.geometry.baseline_m / view.true_depth(index)
        eyes = scene.frames[index], view.right[index]
        x, y, w, h = (round(v) for v in scene.truth[index])
        person = np.zeros(true.shape, bool)
        person[y + 3 : y + h - 3, x + 3 : x + w - 3] = True
        print(f"\n{name}, frame {index}, 320x240, disparities 0 to 60, all of the picture\n{HEAD}")
        for what, matcher in MATCHERS.items():
            print(line(what, matcher, *eyes, 0, 60, true))
        print("on the target, 3 px inside its edges")
        for what, matcher in MATCHERS.items():
            found = matcher.disparity(*eyes, 0, 60, Region(0, 0, scene.width, scene.height))
            print(row(what, found, true, person))


def detected() -> None:
    """How well the detector's blobs agree with the target's box."""
    print("\ndetector: mean IoU of the best blob with the target's box, every tenth frame")
    reach = Range(1.0, 6.5, camera_height_m=1.2, min_pixels=400)
    for name in ("person_stereo", "glass_wall"):
        scene = make_scene(name, 0)
        for what in ("correlation", "semi-global"):
            best = []
            for frame in SceneSource(scene, name):
                if frame.index % 10 == 0:
                    found = detect_stereo_blobs(
                        frame, StereoBlobSettings(matcher=MATCHERS[what], range=reach)
                    )
                    match = overlap(found.boxes, centre_from_corner(scene.truth[frame.index]))
                    best.append(match.max(initial=0.0))
            share = np.mean(np.array(best) > 0.5)
            print(f"{name:16}{what:14}{np.mean(best):6.2f}, above 0.5 in {share:.0%} of the frames")


def aloe(data: Path) -> None:
    """The real pair with its measured disparity, whole and at half its size."""
    left, right = (cv2.imread(str(data / f"aloe{eye}.jpg")) for eye in "LR")
    measured = cv2.imread(str(data / "aloeGT.png"), cv2.IMREAD_GRAYSCALE)
    for scale in (1.0, 0.5):
        eyes = [cv2.resize(e, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA) for e in (left, right)]
        size = eyes[0].shape[1::-1]
        truth = cv2.resize(measured, size, interpolation=cv2.INTER_NEAREST).astype(float) * scale
        truth[truth == 0] = np.nan
        low, high = int(np.nanmin(truth)) - 2, int(np.nanmax(truth)) + 2
        print(f"\naloe, {size[0]}x{size[1]}, disparities {low} to {high}\n{HEAD}")
        for what, matcher in MATCHERS.items():
            print(line(what, matcher, *eyes, low, high, truth))


def chessboards(data: Path) -> None:
    """Two real cameras."""
    left, right = (read_all(str(data / f"{eye}[01]*.jpg")) for eye in ("left", "right"))
    fitted = calibrate(left, right, (9, 6), 0.025)
    print(f"\nchessboards, {len(fitted.used)} of {len(left)} pairs; reprojection rms [px]")
    print(f"left {fitted.left_rms_px:.3f}, right {fitted.right_rms_px:.3f}, both {fitted.pair_rms_px:.3f}")
    print(f"rows after rectification differ by {fitted.epipolar_px:.3f} px")


def main() -> None:
    """Print the figures."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--data", type=Path, help="folder with aloeL.jpg and left01.jpg")
    options = parser.parse_args()
    cv2.setNumThreads(1)
    rendered()
    detected()
    if options.data is not None:
        aloe(options.data)
        chessboards(options.data)


if __name__ == "__main__":
    main()
