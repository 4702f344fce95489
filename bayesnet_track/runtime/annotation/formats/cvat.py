"""CVAT's XML 1.1: a track for each target of a video; images with shapes without identities."""

from __future__ import annotations

import xml.etree.ElementTree as Tree
from collections import Counter
from collections.abc import Callable, Hashable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from bayesnet_track.runtime.annotation.answers import Answer, Box
from bayesnet_track.runtime.annotation.asking import BoxMark
from bayesnet_track.runtime.annotation.formats.reading import (
    Document,
    MismatchError,
    box_around,
    check_frame_size,
    ellipse_box,
    label_of,
    number,
    pairs,
    read_xml,
    turned_box,
    whole_value,
)
from bayesnet_track.runtime.annotation.formats.rows import Row, answers_of, frames_of_names
from bayesnet_track.runtime.annotation.frame_store import Video
from bayesnet_track.sources.entrances.notices import few, notice

HOWS = ("given", "tracked", "interpolated")


def as_cvat(document: Document) -> bytes:
    """The text. Every box is a key frame, since CVAT draws straight lines between them.

    The label's attributes `how` and `probability` say where a box comes from, `name` which target it is.
    """
    root = Tree.Element("annotations")
    Tree.SubElement(root, "version").text = "1.1"
    _add_meta(Tree.SubElement(root, "meta"), document)
    for index, (target, boxes) in enumerate(document.marks.items()):
        track = Tree.SubElement(
            root, "track", {"id": str(index), "label": label_of(target), "source": "semi-auto"}
        )
        for mark, box in _with_ends(boxes):
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
            properties = {"how": mark.how, "probability": f"{mark.probability:.3f}"} if mark.box else {}
            for name, value in {**properties, "name": target}.items():
                Tree.SubElement(element, "attribute", {"name": name}).text = value
    Tree.indent(root)
    data: bytes = Tree.tostring(root, encoding="utf-8", xml_declaration=True)
    return data + b"\n"


def _with_ends(of_target: Mapping[int, BoxMark]) -> Iterator[tuple[BoxMark, Box]]:
    """The boxes, and one that is outside where the target goes or nothing is known of the next frame."""
    previous = None
    for frame in sorted(of_target):
        mark = of_target[frame]
        if previous is not None and previous[0].frame + 1 < frame:
            yield BoxMark(previous[0].frame + 1, None, "gone"), previous[1]
            previous = None
        if mark.box is not None:
            previous = mark, mark.box
            yield previous
        elif previous is not None:
            yield mark, previous[1]
            previous = None


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
        for called, kind, values in (
            ("how", "select", "\n".join(HOWS)),
            ("probability", "text", ""),
            ("name", "text", ""),
        ):
            attribute = Tree.SubElement(attributes, "attribute")
            properties = {
                "name": called,
                "mutable": "True",
                "input_type": kind,
                "default_value": "",
                "values": values,
            }
            for key, value in properties.items():
                Tree.SubElement(attribute, key).text = value


UNNAMED = "CVAT for images does not say which target it is: export it from CVAT as `CVAT for video 1.1`"
CUBOID = tuple(f"{side}{face}" for face in (1, 2) for side in ("tl", "bl", "tr", "br"))


@dataclass(frozen=True)
class Task:
    """Numbering of the frames of a file: frame n of the video is number `first + n * step`."""

    first: int = 0
    step: int = 1

    def frame(self, index: int, place: str) -> int:
        """The frame of the video; raises MismatchError where a number is between its steps."""
        frame, remainder = divmod(index - self.first, self.step)
        if remainder:
            raise MismatchError(
                f"{place}: frame {index} is none of {self.first}, {self.first + self.step}, ..."
            )
        return frame


def read_cvat(path: Path, video: Video, images: Sequence[str] = ()) -> list[Answer]:
    """Key frames as given, or those whose attribute `how` says so; `outside` is gone.

    Shapes other than boxes give their upright boxes. Frames are those of the video that the task was made of,
    or, if the video has only those of the task (`start_frame`, `frame_filter`), the task's.

    Raises:
        MismatchError: it does not fit the video, or is no CVAT XML.
        OSError: it cannot be read.
    """
    root = read_xml(path)
    if root.tag != "annotations":
        raise MismatchError(f"{path}: <{root.tag}>; <annotations> of CVAT for video is needed")
    tasks = {track.get("task_id") for track in (*root.findall("track"), *root.findall("image"))}
    if len(tasks) > 1:
        raise MismatchError(f"{path}: it holds {len(tasks)} tasks; export that of the video alone")
    task = _check_meta(root, next(iter(tasks), None), video, path)
    tracks = root.findall("track")
    if not tracks and root.find("image") is not None:
        return answers_of(_image_rows(root, video, images, path), video, path, unnamed=UNNAMED)
    if root.find("image") is not None:
        notice(f"{path}: {len(root.findall('image'))} <image> beside its tracks are not used")
    names: dict[Hashable, str] = {}
    for n, track in enumerate(tracks):
        named = {_attribute(shape, "name") for shape in track} - {None}
        hows = {_attribute(shape, "how") for shape in track}
        if len(named) == 1 and hows & {*HOWS}:
            names[n] = str(named.pop())
    return answers_of(_track_rows(tracks, task, video, path), video, path, names)


def _check_meta(root: Tree.Element, task_id: str | None, video: Video, path: Path) -> Task:
    """Read how the task, of a project the `task_id` one, numbers its frames; raises MismatchError."""
    of_project = root.findall("meta/project/tasks/task")
    jobs = [*root.findall("meta/task"), *root.findall("meta/job")]
    task = Task()
    for job in jobs + [
        candidate for candidate in of_project if task_id is not None and candidate.findtext("id") == task_id
    ]:
        size = job.find("original_size")
        if size is not None:
            w, h = (whole_value(size.findtext(side), side, f"{path}, meta") for side in ("width", "height"))
            check_frame_size(w, h, video, f"{path}, meta, original_size")
        if job.findtext("size") is not None:
            task = _numbered(job, video, f"{path}, meta")
    return task


def _numbered(job: Tree.Element, video: Video, place: str) -> Task:
    size = whole_value(job.findtext("size"), "size", place)
    first = whole_value(job.findtext("start_frame") or "0", "start_frame", place)
    frame_filter = "".join((job.findtext("frame_filter") or "").split())
    step = whole_value(frame_filter.removeprefix("step="), "frame_filter", place) if frame_filter else 1
    stop = whole_value(job.findtext("stop_frame") or str(first + (size - 1) * step), "stop_frame", place)
    if step < 1 or first < 0:
        raise MismatchError(f"{place}: frames from {first} in steps of {step}")
    if (first, step) == (0, 1) and size == video.frames:
        return Task()
    if (first, step) != (0, 1) and size == video.frames:
        notice(
            f"{place}: its frames {first} to {stop} in steps of {step} are taken as the {size} of the video"
        )
        return Task(first, step)
    if ((first, step) != (0, 1) or job.tag == "job") and stop < video.frames:
        return Task()
    raise MismatchError(f"{place}, size: {size} frames; the video has {video.frames}")


def _track_rows(tracks: Sequence[Tree.Element], task: Task, video: Video, path: Path) -> Iterator[Row]:
    left, unknown, empty = 0, Counter[str](), list[str]()
    for n, track in enumerate(tracks):
        place, label = f"track {track.get('id', n)}", track.get("label", "target")
        shapes = [element for element in track if element.tag in SHAPES]
        unknown.update(element.tag for element in track if element.tag not in SHAPES)
        is_gone, count = True, 0
        numbered = (
            (whole_value(element.get("frame"), "frame", f"{path}, {place}"), element) for element in shapes
        )
        for index, element in sorted(numbered, key=lambda pair: pair[0]):
            position = f"{place}, frame {index}"
            frame = task.frame(index, f"{path}, {place}")
            if element.get("outside") == "1":
                if not is_gone:
                    yield Row(position, frame, n, label, None)
                is_gone = True
                continue
            is_gone = False
            how = _attribute(element, "how")
            is_key = element.get("keyframe", "1") == "1"
            if how == "given" or (how not in HOWS and is_key):
                box, shape = _upright(element, f"{path}, {position}")
                yield Row(position, frame, n, label, box, shape)
                count += 1
            else:
                left += not is_key
        if not count:
            empty.append(f"{place} ({label}): {_explain_empty(shapes)}")
    if empty:
        notice(f"{path}: {len(empty)} of {len(tracks)} tracks give no box: {few(empty)}")
    _say(path, left, unknown)


def _explain_empty(shapes: Sequence[Tree.Element]) -> str:
    """The reason why no box of a track is given."""
    hidden = sum(shape.get("outside") == "1" for shape in shapes)
    between = sum(shape.get("keyframe", "1") != "1" for shape in shapes if shape.get("outside") != "1")
    reasons = [f"{hidden} outside"] * bool(hidden) + [f"{between} between key frames (keyframe 0)"] * bool(
        between
    )
    return f"of {len(shapes)} shapes {', '.join(reasons)}" if reasons else f"{len(shapes)} shapes, none given"


def _image_rows(root: Tree.Element, video: Video, images: Sequence[str], path: Path) -> Iterator[Row]:
    elements = root.findall("image")
    names = [element.get("name", "") for element in elements]
    if len(set(names)) < len(names):
        raise MismatchError(f"{path}: two images have the same name")
    frames = frames_of_names(names, video, images, f"{path}, images")
    unknown = Counter[str]()
    for image, name in zip(elements, names, strict=True):
        if image.get("width") is not None:
            w, h = (
                whole_value(image.get(side), side, f"{path}, image {name}") for side in ("width", "height")
            )
            check_frame_size(w, h, video, f"{path}, image {name}")
        for n, element in enumerate(image):
            if element.tag not in SHAPES:
                unknown[element.tag] += 1
                continue
            position, label = f"image {name}, <{element.tag}> {n}", element.get("label", "target")
            identity = next((v for v in (_attribute(element, key) for key in ("track_id", "id")) if v), None)
            box, shape = _upright(element, f"{path}, {position}")
            yield Row(
                position, frames[name], label if identity is None else (label, identity), label, box, shape
            )
    _say(path, 0, unknown)


def _say(path: Path, left: int, unknown: Counter[str]) -> None:
    if left:
        notice(f"{path}: {left} boxes between key frames are left to the tracker")
    for tag, count in unknown.items():
        notice(f"{path}: {count} <{tag}> are no boxes, and are not used")


def _attribute(shape: Tree.Element, name: str) -> str | None:
    return next(
        (attribute.text for attribute in shape.findall("attribute") if attribute.get("name") == name), None
    )


def _upright(shape: Tree.Element, place: str) -> tuple[Box, str]:
    """The upright box of a shape, and what it was made of; raises MismatchError."""
    return SHAPES[shape.tag](shape, place)


def _values(shape: Tree.Element, keys: Sequence[str], place: str) -> list[float]:
    missing = [key for key in keys if shape.get(key) is None]
    if missing:
        raise MismatchError(f"{place}: {', '.join(missing)} of <{shape.tag}> are missing")
    return [number(shape.get(key), key, place) for key in keys]


def _rotation(shape: Tree.Element, place: str) -> float:
    return number(shape.get("rotation", "0"), "rotation", place)


def _of_box(shape: Tree.Element, place: str) -> tuple[Box, str]:
    x, y, right, bottom = _values(shape, ("xtl", "ytl", "xbr", "ybr"), place)
    box, turn = (x, y, right - x, bottom - y), _rotation(shape, place)
    return (turned_box(box, turn), "rotated box") if turn else (box, "")


def _of_ellipse(shape: Tree.Element, place: str) -> tuple[Box, str]:
    cx, cy, rx, ry = _values(shape, ("cx", "cy", "rx", "ry"), place)
    return ellipse_box((cx, cy), (rx, ry), _rotation(shape, place)), "ellipse"


def _of_mask(shape: Tree.Element, place: str) -> tuple[Box, str]:
    left, top, w, h = _values(shape, ("left", "top", "width", "height"), place)
    return (left, top, w, h), "mask"


def _of_cuboid(shape: Tree.Element, place: str) -> tuple[Box, str]:
    values = _values(shape, [f"{axis}{corner}" for corner in CUBOID for axis in "xy"], place)
    return box_around(pairs(values)), "cuboid"


def _points(shape: Tree.Element, place: str) -> list[tuple[float, float]]:
    words = [word for word in shape.get("points", "").split(";") if word.strip()]
    points = [[number(value, "points", place) for value in word.split(",")] for word in words]
    if not points or any(len(point) != 2 for point in points):
        raise MismatchError(f"{place}: points of <{shape.tag}>: `x,y;x,y;...` is needed")
    return [(x, y) for x, y in points]


def _of_points(shape: Tree.Element, place: str) -> tuple[Box, str]:
    return box_around(_points(shape, place)), {"points": "set of points"}.get(shape.tag, shape.tag)


def _of_skeleton(shape: Tree.Element, place: str) -> tuple[Box, str]:
    visible = [point for point in shape.findall("points") if point.get("outside") != "1"]
    return box_around([point for shown_point in visible for point in _points(shown_point, place)]), "skeleton"


SHAPES: dict[str, Callable[[Tree.Element, str], tuple[Box, str]]] = {
    "box": _of_box,
    "ellipse": _of_ellipse,
    "mask": _of_mask,
    "cuboid": _of_cuboid,
    "polygon": _of_points,
    "polyline": _of_points,
    "points": _of_points,
    "skeleton": _of_skeleton,
}
