"""Page of a run: one HTML file that needs no network, with small pictures of its frames."""

from __future__ import annotations

import base64
import hashlib
from collections.abc import Iterable, Iterator, Mapping, Sequence, Set
from dataclasses import dataclass
from functools import cache
from html import escape
from importlib.resources import files
from itertools import chain, islice
from pathlib import Path
from typing import Any

import numpy as np

from bayesnet_track.numerics.arrays import Image
from bayesnet_track.view.page_data import Columns
from bayesnet_track.view.page_tables import pack

QUALITY = 50
"""JPEG: WebP as good would be a quarter smaller, and take 15 times as long."""
FULL_QUALITY = 85
SIZES = (
    (800, 1),
    (640, 1),
    (480, 1),
    (400, 1),
    (320, 1),
    (400, 2),
    (320, 2),
    (256, 2),
    (320, 3),
    (256, 3),
    (256, 4),
    (256, 6),
    (200, 8),
)
"""Width in px and step in frames, the best first; width is that of a square picture of the same area."""
SAMPLE = 6


@dataclass(frozen=True)
class Pictures:
    """Encoded pictures of some frames.

    Attributes:
        frames: index of each picture's frame, rising.
        data: one JPEG file per picture.
        step: about every how manyth frame has one.
        annotated: whether what is believed is drawn into them already.
    """

    frames: tuple[int, ...]
    data: tuple[bytes, ...]
    step: int = 1
    annotated: bool = False


Images = Iterable[tuple[int, Mapping[str, Image]]]
"""Frame, and camera -> (H, W, 3) uint8 BGR of those that have one; the only camera is called ""."""


def gather(
    images: Images,
    expected: int,
    event_frames: Set[int] = frozenset(),
    budget: int = 7_000_000,
    annotated: bool = False,
) -> dict[str, Pictures]:
    """Pictures of each camera of `images`, which take at most `budget` bytes together, in equal shares.

    Width and step are encodings by the first pictures and the `expected` number of frames, so that one pass
    over the source is enough. Where they turn out too large, every other picture goes, again and again;
    those of the frames `event_frames` go last.
    """
    source = _with_content(images)
    sample = list(islice(source, SAMPLE))
    cameras = dict.fromkeys(camera for _, views in sample for camera in views)
    share = budget // max(1, len(cameras))
    encodings = {}
    for camera in cameras:
        of_camera = [views[camera] for _, views in sample if camera in views]
        encodings[camera] = _choose(of_camera, expected, share)
    pictures: dict[str, dict[int, bytes]] = {camera: {} for camera in cameras}
    totals = dict.fromkeys(cameras, 0)
    for frame, views in chain(sample, source):
        for camera, image in views.items():
            width, step = encodings.setdefault(camera, SIZES[-1])
            encoded = pictures.setdefault(camera, {})
            if frame % step and frame not in event_frames:
                continue
            encoded[frame] = _encode(image, width)
            totals[camera] = totals.get(camera, 0) + len(encoded[frame])
            while totals[camera] > share and len(encoded) > 1:
                step *= 2
                encoded = _thin(encoded, step, event_frames)
                totals[camera] = sum(map(len, encoded.values()))
            encodings[camera], pictures[camera] = (width, step), encoded
    return {
        camera: Pictures(tuple(sorted(encoded)), tuple(encoded[k] for k in sorted(encoded)), step, annotated)
        for (camera, encoded), (_, step) in zip(pictures.items(), encodings.values(), strict=True)
    }


def full_pictures(images: Images) -> Iterator[tuple[int, str, bytes]]:
    """Every frame of each camera in its own size, as JPEG."""
    import cv2

    for frame, views in _with_content(images):
        for camera, image in views.items():
            is_encoded, data = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, FULL_QUALITY])
            if is_encoded:
                yield frame, camera, data.tobytes()


def _with_content(images: Images) -> Iterator[tuple[int, Mapping[str, Image]]]:
    """The images; of several cameras without those of files of detections, which are black."""
    for frame, views in images:
        yield frame, {camera: image for camera, image in views.items() if not camera or image.any()}


def _choose(sample: list[Image], expected: int, budget: int) -> tuple[int, int]:
    """The best width and step that are likely to fit, with a margin for harder pictures to come."""
    for width, step in SIZES:
        mean = sum(len(_encode(image, width)) for image in sample) / len(sample)
        if 1.15 * mean * expected / step <= budget:
            return width, step
    return SIZES[-1]


def _thin(pictures: dict[int, bytes], step: int, event_frames: Set[int]) -> dict[int, bytes]:
    thinned = {frame: data for frame, data in pictures.items() if frame % step == 0 or frame in event_frames}
    return thinned if len(thinned) < len(pictures) else dict(list(pictures.items())[::2])


def _encode(image: Image, width: int) -> bytes:
    """A JPEG file no larger than asked for, and no larger than the picture."""
    import cv2

    rows, columns = image.shape[:2]
    scale = min(1.0, width / float(np.sqrt(rows * columns)))
    if scale < 1.0:
        size = (max(1, round(columns * scale)), max(1, round(rows * scale)))
        image = np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), dtype=np.uint8)
    options = [cv2.IMWRITE_JPEG_QUALITY, QUALITY, cv2.IMWRITE_JPEG_OPTIMIZE, 1]
    is_encoded, data = cv2.imencode(".jpg", image, options)
    return data.tobytes() if is_encoded else b""


FRAMES_FOLDER = "frames"
GENERATOR = '<meta name="generator" content="bayesnet_track">'
LARGEST = 10_000_000
"""Bytes of a page, unless what was measured alone takes more."""
LEAST_ROOM = 500_000


def one_file(
    header: Mapping[str, Any], columns: Columns, pictures: Mapping[str, Pictures], without: str = ""
) -> Iterator[str]:
    """The HTML text, in pieces, with everything in it.

    Args:
        header: from `run_data`.
        columns: from `run_data`.
        pictures: camera -> those of some or all frames; the only camera is called "".
        without: why there are none, in words for the reader.
    """
    main = next(iter(pictures.values()), Pictures((), ()))
    meta: dict[str, Any] = {"where": "file", "step": main.step, "annotated": main.annotated}
    meta["without"] = without
    numbers, start = {}, 0
    for camera, of_camera in pictures.items():
        ends = start + np.cumsum([len(data) for data in of_camera.data], dtype=np.int64)
        numbers[_column("frame", camera)] = np.array(of_camera.frames, dtype=np.int32)
        numbers[_column("end", camera)] = ends.astype(np.int32)
        if camera:
            meta.setdefault("starts", {})[camera] = start
        start = int(ends[-1]) if len(ends) else start
    yield from _page({**header, "pictures": meta}, {**columns, **numbers}, "blob:")
    yield '<script type="text/plain" id="run-pictures">'
    data = [image for of_camera in pictures.values() for image in of_camera.data]
    yield base64.b64encode(b"".join(data)).decode()
    yield "</script>\n</body>\n</html>\n"


def with_folder(
    header: Mapping[str, Any], columns: Columns, frames: Mapping[str, Sequence[int]], annotated: bool = False
) -> Iterator[str]:
    """The HTML text of a page whose pictures, of `frames` of each camera, lie where `picture_name` says."""
    meta = {"where": "folder", "step": 1, "annotated": annotated, "without": ""}
    numbers = {
        _column("frame", name): np.array(of_camera, dtype=np.int32) for name, of_camera in frames.items()
    }
    yield from _page({**header, "pictures": meta}, {**columns, **numbers}, "'self' file: blob:")
    yield "</body>\n</html>\n"


def _column(name: str, camera: str) -> str:
    return f"pictures/{camera}/{name}" if camera else f"pictures/{name}"


def room_for_pictures(header: Mapping[str, Any], columns: Columns, largest: int = LARGEST) -> int:
    """Bytes that pictures may take so that the page of `one_file` stays below `largest`."""
    other_bytes = (
        len(pack(header, columns)) * 4 // 3 + len(_built("run_page.js")) + len(_built("run_page.css"))
    )
    return max((largest - other_bytes - 100_000) * 3 // 4, LEAST_ROOM)


def is_page(place: Path) -> bool:
    """True if a file is a page of a run."""
    with place.open("rb") as file:
        return GENERATOR.encode() in file.read(2048)


def picture_name(frame: int, camera: str = "") -> str:
    """Path of a frame's picture, from the page's folder; those of several cameras have folders."""
    return "/".join(part for part in (FRAMES_FOLDER, camera, f"{frame:06d}.jpg") if part)


def live_page() -> tuple[bytes, str]:
    """The page of a run in progress, which asks for its data where it comes from, and its security policy."""
    return _served_page(_LIVE_BODY, "blob: data:")


def annotate_page() -> tuple[bytes, str]:
    """The page on which a video is annotated, which asks for its data where it comes from, and its policy."""
    return _served_page(_ANNOTATE_BODY, "'self' data:")


def identities_page() -> tuple[bytes, str]:
    """The page on which identities of a run are asked about, likewise."""
    return _served_page(_IDENTITIES_BODY, "'self' data:")


def _served_page(body: str, images: str) -> tuple[bytes, str]:
    policy = f"{_policy(images)}; connect-src 'self'; frame-ancestors 'none'"
    # Browsers look for an icon; the empty one keeps them from asking outside of the page's own address.
    pieces = (
        *_head("bayesnet-track", policy, '<link rel="icon" href="data:,">\n'),
        body,
        f"<script>{_built('run_page.js')}</script>\n</body>\n</html>\n",
    )
    return "".join(pieces).encode(), policy


def _page(header: Mapping[str, Any], columns: Columns, images: str) -> Iterator[str]:
    run = header["run"]
    yield from _head(f"{run['graph']} on {run['source']}", _policy(images))
    yield _BODY
    yield '<script type="text/plain" id="run-data">'
    yield base64.b64encode(pack(header, columns)).decode()
    yield "</script>\n"
    # The pictures come behind the script, so that the page stands before they are read.
    yield f"<script>{_built('run_page.js')}</script>\n"


_BODY = '<div id="page"><noscript>This page needs JavaScript, which is switched off.</noscript></div>\n'
_LIVE_BODY = _BODY.replace("<div", "<div data-live=yes", 1)
_IDENTITIES_BODY = _BODY.replace("<div", "<div data-identities=yes", 1)
_ANNOTATE_BODY = _BODY.replace("<div", "<div data-annotate=yes", 1)


def _policy(images: str) -> str:
    """Nothing may be loaded or sent: no address is allowed, and script and style only as they were built."""
    return (
        f"default-src 'none'; script-src {_hash(_built('run_page.js'))}; "
        f"style-src {_hash(_built('run_page.css'))}; img-src {images}; base-uri 'none'; form-action 'none'"
    )


def _head(title: str, policy: str, extra: str = "") -> Iterator[str]:
    # In a page only a server can forbid frames around it.
    own_policy = policy.replace("; frame-ancestors 'none'", "")
    yield '<!doctype html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
    yield f'<meta http-equiv="Content-Security-Policy" content="{escape(own_policy, quote=True)}">\n'
    yield f'{GENERATOR}\n<meta name="viewport" content="width=device-width, initial-scale=1">\n'
    yield '<meta name="color-scheme" content="light dark">\n<meta name="referrer" content="no-referrer">\n'
    yield f"{extra}<title>{escape(title)}</title>\n"
    yield f"<style>{_built('run_page.css')}</style>\n</head>\n<body>\n"


@cache
def _built(name: str) -> str:
    return (files("bayesnet_track.view") / "page" / name).read_text(encoding="utf-8")


def _hash(text: str) -> str:
    return f"'sha256-{base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()}'"
