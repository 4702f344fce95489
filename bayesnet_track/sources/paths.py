"""Names of sources: addresses as they may be shown, the files they stand for, and errors."""

from __future__ import annotations

import difflib
import glob
import re
from pathlib import Path

HIDDEN = "***"

_ADDRESS_SCHEME = re.compile(r"[A-Za-z][A-Za-z0-9+.\-]*://")
_ADDRESS = re.compile(rf"{_ADDRESS_SCHEME.pattern}[^\s'\"<>]+")
_HOST_AND_PORT = re.compile(r"(\[[^\]]*\]|[^:\[\]]*)(:\d+)?")
_SECRET = re.compile(
    r"([?&;][^=&;#\s]*(?:pass|pwd|token|secret|key|auth|sig|cred|login|user|usr|session)[^=&;#\s]*=)[^&;#\s]*",
    re.IGNORECASE,
)


def hide_secrets(text: str) -> str:
    """A text with user, password and tokens of every address in it replaced by three stars.

    >>> hide_secrets("no route to rtsp://admin:secret@10.0.0.7:554/live")
    'no route to rtsp://***@10.0.0.7:554/live'
    """
    return _ADDRESS.sub(lambda match: shown_address(match.group()), text) if "://" in text else text


def shown_address(text: str) -> str:
    """The same for a text that is one address, whatever its password holds; a path stays as it is.

    >>> shown_address("rtsp://admin:let me/in@now@10.0.0.7:554/live")
    'rtsp://***@10.0.0.7:554/live'
    >>> shown_address("http://cam/video.cgi?user=me&pwd=x&fps=5")
    'http://cam/video.cgi?user=***&pwd=***&fps=5'
    >>> shown_address("http://cam:8080/two@2x.mp4")
    'http://cam:8080/two@2x.mp4'
    """
    scheme = _ADDRESS_SCHEME.match(text)
    if scheme is None:
        return text
    remainder = text[scheme.end() :]
    authority = re.split(r"[/?#]", remainder, maxsplit=1)[0]
    # What is no host with a port begins with a user, whose password may hold the letters that end it.
    if _HOST_AND_PORT.fullmatch(authority) is None or "@" in authority:
        remainder = f"{HIDDEN}@{remainder[remainder.rfind('@') + 1 :]}" if "@" in remainder else HIDDEN
    return scheme.group() + _SECRET.sub(rf"\1{HIDDEN}", remainder)


class SourceError(ValueError):
    """A source that cannot be opened or read at all.

    Attributes:
        given: the source as given, but for passwords.
        found: what was found there.
        allowed: what would be accepted.
        mend: what to do.
    """

    def __init__(self, source: str, fault: str, remedy: str, mend: str) -> None:
        self.given, self.found, self.allowed, self.mend = shown_address(source), fault, remedy, mend
        super().__init__(f"source {self.given!r}: {fault}; allowed: {remedy}; {mend}")


_DIGITS = re.compile(r"(\d+)")


def natural_key(path: Path) -> tuple[tuple[tuple[int, str], ...], str]:
    """Sort key that takes runs of digits as numbers."""
    parts = _DIGITS.split(str(path))
    return tuple((int(part), "") if n % 2 else (-1, part) for n, part in enumerate(parts)), str(path)


def is_broken_link(path: Path) -> bool:
    """True for a link to what is not there."""
    return path.is_symlink() and not path.exists()


JUNK_FOLDERS = frozenset({"__MACOSX", "@eaDir", "#recycle", "$RECYCLE.BIN"})
"""What archivers, network drives and bins put beside the files of a user, with names of images in it."""


def is_junk(path: Path) -> bool:
    """True for what systems put beside the files of a user: names with a dot, and all in `JUNK_FOLDERS`.

    >>> [is_junk(Path(name)) for name in ("a/._1.png", "a/__MACOSX/1.png", ".hidden/1.png", "a/1.png")]
    [True, True, False, False]
    """
    return path.name.startswith(".") or not JUNK_FOLDERS.isdisjoint(path.parts)


def _keeps_number(path: Path) -> bool:
    """True for a file, or a broken link, which has a place among the frames; not for a pipe: it may hang."""
    return not is_junk(path) and (path.is_file() or is_broken_link(path))


def images_in(folder: Path) -> list[Path]:
    """The images directly in a folder, in no order; junk is none of them. Raises OSError."""
    return [
        path for path in folder.iterdir() if path.suffix.lower() in IMAGE_SUFFIXES and _keeps_number(path)
    ]


DEPTH_SUFFIXES = (".png", ".tif", ".tiff", ".npy")


def depth_files(text: str) -> list[Path]:
    """The depth files of a folder or glob, in natural order; raises SourceError when there is none."""
    folder = Path(text)
    try:
        names = folder.iterdir() if folder.is_dir() else (Path(name) for name in glob.glob(text))  # noqa: PTH207
        files = sorted(
            (p for p in names if p.suffix.lower() in DEPTH_SUFFIXES and _keeps_number(p)), key=natural_key
        )
    except OSError as error:
        raise SourceError(text, f"{error.strerror}", "a folder or glob of depth files", "check it") from error
    if not files:
        raise SourceError(
            text,
            "no depth file there",
            f"a folder or glob of {' '.join(DEPTH_SUFFIXES)}",
            "give the folder that holds them",
        )
    return files


KINDS = "a video file, a folder of images, a glob of images, a camera index such as 0, an http or rtsp URL"


IMAGE_SUFFIXES = frozenset(
    {".jpg", ".jpeg", ".png", ".bmp", ".tif", ".tiff", ".webp", ".pgm", ".ppm", ".pbm", ".pnm", ".jp2"}
)


OTHER_IMAGES = frozenset(
    {
        ".heic",
        ".heif",
        ".avif",
        ".jxl",
        ".exr",
        ".gif",
        ".apng",
        ".fits",
        ".dng",
        ".cr2",
        ".cr3",
        ".nef",
        ".arw",
    }
)


VIDEO_SUFFIXES = frozenset(
    {".mp4", ".m4v", ".mov", ".3gp", ".3g2", ".mj2", ".mkv", ".webm", ".avi", ".ts", ".mts", ".m2ts"}
    | {".mpg", ".mpeg", ".h264", ".264", ".h265", ".265", ".hevc", ".ivf", ".obu", ".ogg", ".ogv", ".flv"}
    | {".asf", ".wmv", ".mjpg", ".mjpeg", ".gif", ".apng", ".nut", ".dv", ".mxf", ".y4m", ".wtv", ".rm"}
)


"""What the neighbours of a missing source are known by; a source that is there may have any name."""


SEQUENCE_FOLDERS = ("img", "img1")


_SCHEME = re.compile(r"^([A-Za-z][A-Za-z0-9+.\-]+)(?::|,,)")


def is_file(text: str) -> bool:
    """True for what names files: no camera and no URL."""
    return not (text.isascii() and text.isdigit()) and _SCHEME.match(text) is None


def files_of(text: str) -> list[Path]:
    """The files that a path or a glob names, images in the order of the frames; raises SourceError."""
    path = Path(text)
    if path.is_dir():
        return sorted(_in_folder(text, path), key=natural_key)
    if path.is_file():
        return [path]
    if glob.has_magic(text):
        return sorted(_matching(text), key=natural_key)
    raise SourceError(text, "no such file or folder", KINDS, _nearest(path))


def image_names(text: str, frames: int) -> tuple[str, ...]:
    """Names of the image files of a source, one for each frame; none where frames are no such files."""
    try:
        files = files_of(text) if is_file(text) else []
    except SourceError:
        files = []
    names = tuple(file.name for file in files)
    are_images = all(file.suffix.lower() in IMAGE_SUFFIXES for file in files)
    return names if are_images and len(set(names)) == frames == len(names) else ()


def _matching(text: str) -> list[Path]:
    matches = [Path(name) for name in glob.glob(text, recursive=True)]  # noqa: PTH207 (keeps absolute patterns)
    images = [name for name in matches if name.suffix.lower() in IMAGE_SUFFIXES and _keeps_number(name)]
    if images:
        return images
    raise SourceError(
        text,
        f"the pattern matches {len(matches)} files, none of them an image",
        f"images ({' '.join(sorted(IMAGE_SUFFIXES))})",
        "quote the pattern so that the shell leaves it alone, and check it",
    )


def _in_folder(text: str, folder: Path) -> list[Path]:
    for place in (folder, *(folder / name for name in SEQUENCE_FOLDERS)):
        if place.is_dir():
            images = images_in(place)
            if images:
                return images
    raise SourceError(
        text,
        f"the folder holds no image ({sum(1 for _ in folder.iterdir())} entries)",
        f"images ({' '.join(sorted(IMAGE_SUFFIXES))}) in it or in {' or '.join(SEQUENCE_FOLDERS)} below it",
        "give the folder that holds the images",
    )


def _nearest(path: Path) -> str:
    parent = path.parent
    if not parent.is_dir():
        return f"the folder {str(parent)!r} does not exist either"
    try:
        names = sorted(entry.name for entry in parent.iterdir())
        similar = difflib.get_close_matches(path.name, names, n=20, cutoff=0.5)
        suggestion = next((name for name in similar if _could_be_read(parent / name)), None)
    except OSError:
        return "check the name"
    return "check the name" if suggestion is None else f"did you mean {str(parent / suggestion)!r}?"


def _could_be_read(path: Path) -> bool:
    """True for videos, images and folders of images, by their names."""
    if is_junk(path):
        return False
    if not path.is_dir():
        return path.suffix.lower() in VIDEO_SUFFIXES | IMAGE_SUFFIXES
    try:
        return bool(_in_folder(str(path), path))
    except SourceError:
        return False
