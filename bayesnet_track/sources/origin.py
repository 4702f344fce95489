"""Origin of frames: enough to open a source again, and to see that it still holds the same frames."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from errno import EINVAL
from pathlib import Path
from stat import S_ISREG
from typing import Literal

from bayesnet_track.sources.paths import (
    depth_files,
    files_of,
    hide_secrets,
    is_broken_link,
    is_file,
    shown_address,
)

Stamp = tuple[int, int, int]
"""Inode, size in bytes, and time of the last change of the contents in ns."""


def stamps(paths: Iterable[Path]) -> dict[Path, Stamp]:
    """Of each file that is there.

    >>> stamps([Path("nowhere.csv")])
    {}
    """
    stamp_of = {}
    for path in paths:
        with suppress(OSError):
            status = path.stat()
            stamp_of[path] = (status.st_ino, status.st_size, status.st_mtime_ns)
    return stamp_of


def changed_since(stamps_before: Mapping[Path, Stamp]) -> list[Path]:
    """The files that are others now; one that was removed was read, or its reader says what is missing."""
    current = stamps(stamps_before)
    return [path for path, stamp in stamps_before.items() if current.get(path, stamp) != stamp]


Kind = Literal["plain", "right", "side_by_side", "depth", "scene", "several", "own"]

SAMPLES, SAMPLE_BYTES = 16, 1 << 16
ENDS_BYTES = 1 << 20
"""Of a file longer than all of these together, only they are read."""


@dataclass(frozen=True)
class Fingerprint:
    """Content of a part of a source.

    Attributes:
        files: how many files.
        size: their bytes.
        sha256: of one file its size and samples of its bytes (all of a small one); of several their names and
            sizes, and the samples of the first, the middle and the last one.
    """

    files: int
    size: int
    sha256: str

    def __str__(self) -> str:
        return f"{self.files} file{'' if self.files == 1 else 's'}, {self.size} bytes, {self.sha256[:12]}"


@dataclass(frozen=True)
class Origin:
    """Arguments with which a source was opened; addresses are without their passwords.

    Attributes:
        kind: which of the ways: one eye, two (a source for the right one, or both in a picture), an eye with
            another sensor's depth, a built-in scene, sources of several cameras, or a source object of
            one's own.
        text: the source as given; of a scene its name.
        description: the source in the words of the journal.
        start: first frame, or None.
        end: frame to stop before, or None.
        on_resize: what a change of size does.
        allow_network: whether it might be a URL.
        right: source of the right eye.
        depth: folder or glob of depth files.
        calibration: the pair's file.
        seed: of a scene.
        stride: every how many-th frame is read.
        value_range: the values that become black and white; None for all that their type holds.
        size: width and height of frames without images, where nothing beside their detections says it.
        lazy: whether frames are decoded when somebody asks for their images.
        cameras: of several cameras, name -> how its source was opened.
        absolute: a path as given -> the same from the root.
        fingerprint: source, right, depth, calibration -> what it held.
    """

    kind: Kind
    text: str
    description: str
    start: int | None = None
    end: int | None = None
    on_resize: Literal["stop", "rescale"] = "stop"
    allow_network: bool = False
    right: str | None = None
    depth: str | None = None
    calibration: str | None = None
    seed: int = 0
    stride: int = 1
    value_range: tuple[float, float] | None = None
    size: tuple[int, int] | None = None
    lazy: bool = False
    cameras: Mapping[str, Origin] = field(default_factory=dict)
    absolute: Mapping[str, str] = field(default_factory=dict)
    fingerprint: Mapping[str, Fingerprint] = field(default_factory=dict)

    def __post_init__(self) -> None:
        # Nothing on the network is opened again: what is kept of its address is for people.
        for name, redact in (
            ("text", shown_address),
            ("description", hide_secrets),
            ("right", shown_address),
        ):
            if (value := getattr(self, name)) is not None:
                object.__setattr__(self, name, redact(value))

    @property
    def only_once(self) -> str | None:
        """Reason that the same frames cannot be read again; None where they can."""

        if self.kind == "own":
            return f"its frames came from an object ({self.description}) that cannot be made again"
        if self.cameras:
            reasons = (origin.only_once for origin in self.cameras.values())
            return next(filter(None, reasons), None)
        for text in (self.text, self.right):
            if self.kind == "scene" or text is None or is_file(text):
                continue
            kind_of_source = "camera" if text.isdigit() else "network source"
            return f"its frames came from a {kind_of_source} ({text}), which has others by now"
        return None

    def marked(self) -> Origin:
        """With absolute paths and fingerprints of the files as they are now.

        Raises:
            OSError: a file cannot be read.
            SourceError: there is no source any more.
        """

        if self.cameras:
            cameras = {camera: origin.marked() for camera, origin in self.cameras.items()}
            marks = {
                f"{part} of {camera}": mark
                for camera, origin in cameras.items()
                for part, mark in origin.fingerprint.items()
            }
            return replace(self, cameras=cameras, fingerprint=marks)
        texts = [text for text in self.parts().values() if is_file(text)]
        absolute = {text: str(Path(text).absolute()) for text in texts}
        return replace(self, absolute=absolute, fingerprint=self._fingerprints(absolute))

    def changes(self) -> tuple[str, ...]:
        """Differences from when the source was opened, in words: "source: 1 file, ... now 1 file, ...".

        Raises:
            OSError: a file cannot be read.
            SourceError: there is no source any more.
        """
        if self.cameras:
            return tuple(
                f"{camera}: {change}"
                for camera, origin in self.cameras.items()
                for change in origin.changes()
            )
        fingerprints = self._fingerprints(self.places())
        return tuple(
            f"{part}: {self.fingerprint[part]}, now {current}"
            for part, current in fingerprints.items()
            if part in self.fingerprint and current != self.fingerprint[part]
        )

    def parts(self) -> dict[str, str]:
        """Part (source, right, depth, calibration) -> its path as given; empty for scenes and the like."""
        if self.kind in ("scene", "several", "own"):
            return {}
        texts = {"source": self.text, "right": self.right, "depth": self.depth}
        texts["calibration"] = self.calibration
        return {part: text for part, text in texts.items() if text is not None}

    def places(self) -> dict[str, str]:
        """Each path as given -> where it is now: as it was, or as given where that is gone."""
        from glob import has_magic

        places = {}
        for text in self.parts().values():
            recorded = self.absolute.get(text, text)
            places[text] = recorded if has_magic(text) or os.path.exists(recorded) else text  # noqa: PTH110
        return places

    def files(self) -> list[Path]:
        """Every file that it is read from, as given."""
        parts = {part: text for part, text in self.parts().items() if is_file(text)}
        return [path for part, text in parts.items() for path in _files(part, text)]

    def _fingerprints(self, places: Mapping[str, str]) -> dict[str, Fingerprint]:
        parts = {part: text for part, text in self.parts().items() if is_file(text)}
        return {part: fingerprint_files(_files(part, places[text])) for part, text in parts.items()}


def _files(part: str, text: str) -> Sequence[Path]:
    if part == "calibration":
        return [Path(text)]
    return depth_files(text) if part == "depth" else files_of(text)


def fingerprint_files(files: Sequence[Path]) -> Fingerprint:
    """Content of the files, told from their names, sizes and samples of their bytes.

    Raises:
        OSError: one cannot be read.
    """
    sizes = [_size(path) for path in files]
    digest = hashlib.sha256()
    if len(files) > 1:
        for path, size in zip(files, sizes, strict=True):
            digest.update(f"{path.name}\0{size}\n".encode("utf-8", "surrogateescape"))
    for index in sorted({0, len(files) // 2, len(files) - 1}) if files else ():
        digest.update(f"{sizes[index]}\n".encode())
        for sample in _samples(files[index], sizes[index]):
            digest.update(sample)
    return Fingerprint(len(files), sum(sizes), digest.hexdigest())


def _size(path: Path) -> int:
    """Of a plain file: a device or a pipe might never end. A broken link among the frames holds nothing."""
    if is_broken_link(path):
        return 0
    status = path.stat()
    if not S_ISREG(status.st_mode):
        raise OSError(EINVAL, "not a plain file", str(path))
    return status.st_size


def _samples(path: Path, size: int) -> Iterable[bytes]:
    if is_broken_link(path):
        return
    with path.open("rb") as file:
        if size <= 2 * ENDS_BYTES + SAMPLES * SAMPLE_BYTES:
            yield file.read()
            return
        yield file.read(ENDS_BYTES)
        for number in range(SAMPLES):
            file.seek(size * (number + 1) // (SAMPLES + 1))
            yield file.read(SAMPLE_BYTES)
        file.seek(size - ENDS_BYTES)
        yield file.read(ENDS_BYTES)
