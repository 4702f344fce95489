"""Which file of a folder or of a zip holds the annotations, as other tools lay them out."""

from __future__ import annotations

import tempfile
import zipfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from bayesnet_track.runtime.annotation.formats.document import MismatchError
from bayesnet_track.sources.entrances.notices import heard, notice
from bayesnet_track.sources.mot_lines import NotTextError, read_text
from bayesnet_track.sources.paths import is_junk, natural_key

TEXTS = frozenset({".xml", ".json", ".txt", ".names", ".data", ".yaml", ".yml", ".ini"})
OTHERS = frozenset({".gz", ".tgz", ".tar", ".bz2", ".xz", ".7z", ".rar", ".zst"})
MOST_BYTES = 1 << 30
LISTS = frozenset({"classes", "labels", "train", "val", "valid", "validation", "test", "trainval"})
"""Names of text files that list classes or images."""


@contextmanager
def unpacked(path: Path) -> Iterator[Path]:
    """The folder with the texts of a zip, which is gone afterwards; any other path as it is.

    Errors and notices name files below the zip.

    Raises:
        MismatchError: the zip is damaged, has a password or holds more than 1 GiB of text, or another archive
            is given.
    """
    if path.suffix.lower() in OTHERS and path.is_file():
        raise MismatchError(f"{path}: of archives only a zip is read; unpack it")
    if path.is_dir() or not zipfile.is_zipfile(path):
        yield path
        return
    with tempfile.TemporaryDirectory(prefix="bayesnet_track_zip_") as folder:
        root = Path(folder) / path.name
        root.mkdir()
        _unpack(path, root)
        said: list[str] = []
        try:
            with heard(said.append):
                yield root
        except MismatchError as error:
            raise MismatchError(str(error).replace(str(root), str(path))) from error
        for sentence in said:
            notice(sentence.replace(str(root), str(path)))


def _unpack(path: Path, root: Path) -> None:
    try:
        with zipfile.ZipFile(path) as archive:
            members = [one for one in archive.infolist() if _is_text(one.filename)]
            if sum(one.file_size for one in members) > MOST_BYTES:
                raise MismatchError(f"{path}: more than 1 GiB of text in it; unzip it")
            for member in members:
                archive.extract(member, root)
    except (zipfile.BadZipFile, RuntimeError, NotImplementedError, EOFError, ValueError) as error:
        if isinstance(error, MismatchError):
            raise
        raise MismatchError(f"{path}: the zip cannot be read ({error}); unzip it") from error


def _is_text(name: str) -> bool:
    inside = Path(name)
    return not name.endswith("/") and inside.suffix.lower() in TEXTS and not is_junk(inside)


def annotations_in(folder: Path) -> Path:
    """The annotations of a folder: its file in a known place, or itself where it is a folder of YOLO.

    CVAT writes `annotations.xml`, `annotations/instances_default.json` and `gt/gt.txt`, Roboflow
    `train/_annotations.coco.json`. Raises MismatchError where several would do.
    """
    known = [folder / "annotations.xml", folder / "gt" / "gt.txt"]
    known += sorted(folder.glob("annotations/instances_*.json"))
    found = [file for file in known if file.is_file()]
    if not found and not label_folders(folder):
        patterns = ("*.xml", "*.json", "annotations/*.json", "*/_annotations.coco.json")
        found = sorted(file for one in patterns for file in folder.glob(one) if not is_junk(file))
        found += label_files(folder)[:1] if found else []
    if len(found) > 1:
        names = ", ".join(str(file.relative_to(folder)) for file in found)
        raise MismatchError(f"{folder}: {names}: name the file that is meant, or leave the others out")
    return found[0] if found else folder


def label_folders(folder: Path) -> list[Path]:
    """Where YOLO's labels are below a folder, if they are not in itself."""
    found = [folder / "labels", *sorted(folder.glob("obj_*_data")), *sorted(folder.glob("*/labels"))]
    return [one for one in found if one.is_dir()]


def label_files(folder: Path) -> list[Path]:
    """The files of YOLO's labels below a folder, in natural order; lists of classes and images are none."""
    below = [file for one in label_folders(folder) for file in one.rglob("*.txt")]
    return sorted(
        (file for file in below or folder.glob("*.txt") if _has_labels(file, folder)), key=natural_key
    )


def _has_labels(file: Path, folder: Path) -> bool:
    stem = file.stem.lower()
    is_list = stem in LISTS or stem.startswith("readme")
    return not is_list and not is_junk(file.relative_to(folder)) and file.is_file()


def text_of(file: Path) -> str:
    """A whole file as text; raises MismatchError where it is none."""
    try:
        return read_text(file)
    except NotTextError as error:
        raise MismatchError(str(error)) from error
