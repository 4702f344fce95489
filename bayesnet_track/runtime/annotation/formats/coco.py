"""COCO JSON with `track_id`: an image for each frame, an annotation for each box."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from bayesnet_track.runtime.annotation.answers import Answer
from bayesnet_track.runtime.annotation.formats.document import (
    Document,
    MismatchError,
    check_size,
    given_box,
    label_of,
    number_names,
    tidy,
)
from bayesnet_track.runtime.annotation.frame_store import Video


def as_coco(document: Document) -> bytes:
    """The text. Where a box comes from is in its `attributes`; frames without a target are in `tracks`."""
    video, labels = document.video, document.labels
    annotations = [
        {
            "id": row,
            "image_id": mark.frame + 1,
            "category_id": labels[label_of(target)],
            "track_id": number,
            "bbox": [tidy(value) for value in box],
            "area": tidy(box[2] * box[3]),
            "iscrowd": 0,
            "score": tidy(mark.probability, 6),
            "attributes": {"how": mark.how, "probability": tidy(mark.probability, 6)},
        }
        for row, (number, target, mark, box) in enumerate(document.boxes(), 1)
    ]
    content = {
        "info": {"description": f"annotations of {video.name}", "version": "1"},
        "licenses": [],
        "videos": [{"id": 1, "name": video.name, "width": video.width, "height": video.height}],
        "images": [
            {
                "id": frame + 1,
                "file_name": f"{frame:06d}.jpg",
                "width": video.width,
                "height": video.height,
                "video_id": 1,
                "frame_id": frame,
            }
            for frame in range(video.frames)
        ],
        "annotations": annotations,
        "categories": [{"id": n, "name": name, "supercategory": "target"} for name, n in labels.items()],
        "tracks": [
            {
                "id": number,
                "name": target,
                "category_id": labels[label_of(target)],
                "gone": [frame for frame in sorted(own) if own[frame].how == "gone"],
            }
            for number, (target, own) in enumerate(document.marks.items(), 1)
        ],
    }
    return (json.dumps(content, allow_nan=False) + "\n").encode()


def read_coco(path: Path, video: Video) -> list[Answer]:
    """Boxes as given: all of them, or those that say so where a file says where its boxes come from.

    Images are frames by their `frame_id`, else in the order of their file names.

    Raises:
        MismatchError: it does not fit the video, or is no COCO with `track_id`.
        OSError: it cannot be read.
    """
    content = read_json(path)
    try:
        frame_of = _frames(content["images"], video, path)
        labels = {one["id"]: str(one["name"]) for one in content.get("categories", ())}
        tracks = {one["id"]: one for one in content.get("tracks", ())}
        rows = list(enumerate(content["annotations"]))
        names = {str(number): str(one["name"]) for number, one in tracks.items()}
        keys = [(str(one["track_id"]), labels.get(one["category_id"], "target")) for _, one in rows]
        names = {**number_names(keys), **names}
        answers = []
        for number, one in rows:
            place = f"{path}, annotations[{number}]"
            if one["image_id"] not in frame_of:
                raise MismatchError(f"{place}: image_id {one['image_id']!r} is none of its images")
            if one.get("attributes", {}).get("how", "given") == "given":
                name = names[str(one["track_id"])]
                answers.append(given_box(frame_of[one["image_id"]], name, one["bbox"], video, place))
        for number, one in tracks.items():
            answers += gone_answers(names[str(number)], one.get("gone", ()), video)
    except (KeyError, TypeError, AttributeError) as error:
        raise MismatchError(
            f"{path}: no COCO of a video: images, annotations with image_id, track_id, category_id and bbox "
            f"are needed; {error!s} is not as it should be"
        ) from error
    return answers


def gone_answers(target: str, frames: Any, video: Video) -> list[Answer]:
    """An answer where each stretch of `frames` without the target begins."""
    gone = {int(frame) for frame in frames if 0 <= int(frame) < video.frames}
    return [Answer("gone", frame, target) for frame in sorted(gone) if frame - 1 not in gone]


def read_json(path: Path) -> Any:
    """The content of a JSON file; raises MismatchError where it is none."""
    try:
        return json.loads(path.read_text(encoding="utf-8-sig"))
    except (ValueError, RecursionError) as error:
        raise MismatchError(f"{path}: it is no JSON ({error})") from error


def _frames(images: Any, video: Video, path: Path) -> dict[Any, int]:
    for number, one in enumerate(images):
        check_size(one["width"], one["height"], video, f"{path}, images[{number}]")
    if all("frame_id" in one for one in images):
        return {one["id"]: int(one["frame_id"]) for one in images}
    if len(images) != video.frames:
        raise MismatchError(
            f"{path}: {len(images)} images without frame_id; the video has {video.frames} frames"
        )
    return {one["id"]: n for n, one in enumerate(sorted(images, key=lambda one: str(one["file_name"])))}
