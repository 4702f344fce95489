"""CVAT for video 1.1: XML with a track for each target."""

from __future__ import annotations

import xml.etree.ElementTree as Tree
from collections.abc import Iterator, Mapping

from bayesnet_track.runtime.annotation.answers import Box
from bayesnet_track.runtime.annotation.formats.document import Document, label_of
from bayesnet_track.runtime.annotation.fusing import Mark

HOWS = ("given", "tracked", "interpolated")


def as_cvat(document: Document) -> bytes:
    """The text. Every box is a key frame, since CVAT draws straight lines between them.

    The label's attributes `how` and `probability` say where a box comes from, `name` which target it is.
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
            for name, value in {**shown, "name": target}.items():
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
        for called, kind, values in (
            ("how", "select", "\n".join(HOWS)),
            ("probability", "text", ""),
            ("name", "text", ""),
        ):
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
