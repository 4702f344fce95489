"""CVAT for video 1.1: XML with a track for each target."""

from __future__ import annotations

import xml.etree.ElementTree as Tree
from collections.abc import Iterator, Mapping
from pathlib import Path

from bayesnet_track.runtime.annotation.answers import Answer, Box
from bayesnet_track.runtime.annotation.formats.document import (
    Document,
    MismatchError,
    check_frames,
    check_size,
    given_box,
    label_of,
    number_names,
)
from bayesnet_track.runtime.annotation.frame_store import Video
from bayesnet_track.runtime.annotation.fusing import Mark

HOWS = ("given", "tracked", "interpolated")


def as_cvat(document: Document) -> bytes:
    """The text. Every box is a key frame, since CVAT draws straight lines between them.

    The label's attributes `how` and `probability` say where a box comes from.
    """
    root = Tree.Element("annotations")
    Tree.SubElement(root, "version").text = "1.1"
    _add_meta(Tree.SubElement(root, "meta"), document)
    for number, (target, own) in enumerate(document.marks.items()):
        track = Tree.SubElement(
            root, "track", {"id": str(number), "label": label_of(target), "source": "semi-auto"}
        )
        for mark, box in _with_ends(own):
            x, y, w, h = box
            corners = {"xtl": x, "ytl": y, "xbr": x + w, "ybr": y + h}
            element = Tree.SubElement(
                track,
                "box",
                {
                    "frame": str(mark.frame),
                    "keyframe": "1",
                    "outside": "1" if mark.how == "gone" else "0",
                    "occluded": "0",
                    **{name: f"{value + 0.0:.3f}" for name, value in corners.items()},
                    "z_order": "0",
                },
            )
            shown = {"how": mark.how, "probability": f"{mark.probability:.3f}"} if mark.box else {}
            for name, value in shown.items():
                Tree.SubElement(element, "attribute", {"name": name}).text = value
    Tree.indent(root)
    data: bytes = Tree.tostring(root, encoding="utf-8", xml_declaration=True)
    return data + b"\n"


def _with_ends(own: Mapping[int, Mark]) -> Iterator[tuple[Mark, Box]]:
    """The boxes, and one that is outside where the target goes or nothing is known of the next frame."""
    last = None
    for frame in sorted(own):
        mark = own[frame]
        if last is not None and last[0].frame + 1 < frame:
            yield Mark(last[0].frame + 1, None, "gone"), last[1]
            last = None
        if mark.box is not None:
            last = mark, mark.box
            yield last
        elif last is not None:
            yield mark, last[1]
            last = None


def _add_meta(meta: Tree.Element, document: Document) -> None:
    video = document.video
    task = Tree.SubElement(meta, "task")
    for name, value in {"name": video.name, "size": video.frames, "mode": "interpolation"}.items():
        Tree.SubElement(task, name).text = str(value)
    size = Tree.SubElement(task, "original_size")
    Tree.SubElement(size, "width").text = str(video.width)
    Tree.SubElement(size, "height").text = str(video.height)
    labels = Tree.SubElement(task, "labels")
    for name in document.labels:
        label = Tree.SubElement(labels, "label")
        Tree.SubElement(label, "name").text = name
        attributes = Tree.SubElement(label, "attributes")
        for called, kind, values in (("how", "select", "\n".join(HOWS)), ("probability", "text", "")):
            attribute = Tree.SubElement(attributes, "attribute")
            about = {
                "name": called,
                "mutable": "True",
                "input_type": kind,
                "default_value": "",
                "values": values,
            }
            for key, value in about.items():
                Tree.SubElement(attribute, key).text = value


def read_cvat(path: Path, video: Video) -> list[Answer]:
    """Key frames as given, or those whose attribute `how` says so; `outside` is gone.

    Raises:
        MismatchError: it does not fit the video, or is no CVAT for video.
        OSError: it cannot be read.
    """
    data = path.read_bytes()
    if b"<!DOCTYPE" in data or b"<!ENTITY" in data:
        raise MismatchError(f"{path}: it declares entities, which CVAT does not write")
    try:
        root = Tree.fromstring(data)
    except Tree.ParseError as error:
        raise MismatchError(f"{path}: it is no XML ({error})") from error
    if root.tag != "annotations":
        raise MismatchError(f"{path}: <{root.tag}>; <annotations> of CVAT for video is needed")
    if root.find("image") is not None:
        raise MismatchError(f"{path}: CVAT for images; export it from CVAT as `CVAT for video 1.1`")
    _check_meta(root, video, path)
    tracks = root.findall("track")
    names = number_names((str(n), track.get("label", "target")) for n, track in enumerate(tracks))
    return [
        answer
        for number, track in enumerate(tracks)
        for answer in _answers(track, names[str(number)], video, f"{path}, track {track.get('id', number)}")
    ]


def _check_meta(root: Tree.Element, video: Video, path: Path) -> None:
    meta = root.find("meta")
    for job in [] if meta is None else [*meta.findall("task"), *meta.findall("job")]:
        frames = job.findtext("size")
        if frames is not None:
            check_frames(_whole(frames), video, f"{path}, meta, size")
        size = job.find("original_size")
        if size is not None:
            found = (_whole(size.findtext("width", "")), _whole(size.findtext("height", "")))
            check_size(*found, video, f"{path}, meta, original_size")


def _whole(text: str) -> int | str:
    return int(text) if text.strip().isdigit() else text


def _answers(track: Tree.Element, name: str, video: Video, place: str) -> Iterator[Answer]:
    is_gone = True
    for box in sorted(track.findall("box"), key=lambda one: _frame_of(one, place)):
        frame = _frame_of(box, place)
        here = f"{place}, frame {frame}"
        if box.get("outside") == "1":
            if not is_gone and 0 <= frame < video.frames:
                yield Answer("gone", frame, name)
            is_gone = True
            continue
        try:
            x, y, right, bottom = (float(box.get(key, "")) for key in ("xtl", "ytl", "xbr", "ybr"))
        except ValueError as error:
            raise MismatchError(f"{here}: xtl, ytl, xbr and ybr are needed") from error
        answer = given_box(frame, name, (x, y, right - x, bottom - y), video, here)
        how = next((a.text for a in box.findall("attribute") if a.get("name") == "how"), None)
        if how == "given" or (how not in HOWS and box.get("keyframe", "1") == "1"):
            yield answer
        is_gone = False


def _frame_of(box: Tree.Element, place: str) -> int:
    text = box.get("frame", "")
    if not text.isdigit() or len(text) > 9:
        raise MismatchError(f"{place}: frame {text!r}; a whole number is needed")
    return int(text)
