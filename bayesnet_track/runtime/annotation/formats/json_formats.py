"""Formats in JSON: COCO with `track_id`, and Label Studio's video regions."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Collection, Hashable, Iterator, Mapping, Sequence
from operator import itemgetter
from pathlib import Path
from typing import Any

from bayesnet_track.runtime.annotation.answers import Answer, Box
from bayesnet_track.runtime.annotation.asking import BoxMark
from bayesnet_track.runtime.annotation.formats.reading import (
    Document,
    MismatchError,
    box_around,
    check_frame_size,
    corner_box,
    identity_text,
    label_of,
    list_at,
    mask_box,
    needed,
    number,
    pairs,
    read_json,
    rounded,
    turned_box,
    whole_value,
)
from bayesnet_track.runtime.annotation.formats.rows import Row, answers_of, first_of_numbers, frames_of_names
from bayesnet_track.runtime.annotation.frame_store import Video
from bayesnet_track.sources.entrances.notices import few, notice

IDENTITIES = (
    (None, "track_id"),
    ("attributes", "track_id"),
    (None, "instance_id"),
    ("attributes", "instance_id"),
    ("attributes", "id"),
)
"""Object in the annotation (None: itself) and key of the identity, as tools write it; the first is taken."""


def annotations_as_coco(document: Document) -> bytes:
    """The text. Where a box comes from is in its `attributes`; frames without a target are in `tracks`."""
    video, labels = document.video, document.labels
    annotations = [
        {
            "id": row,
            "image_id": mark.frame + 1,
            "category_id": labels[label_of(target)],
            "track_id": number,
            "bbox": [rounded(value) for value in box],
            "area": rounded(box[2] * box[3]),
            "iscrowd": 0,
            "score": rounded(mark.probability, 6),
            "attributes": {"how": mark.how, "probability": rounded(mark.probability, 6)},
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
                "file_name": document.image(frame),
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
                "gone": [frame for frame in sorted(boxes) if boxes[frame].how == "gone"],
            }
            for number, (target, boxes) in enumerate(document.marks.items(), 1)
        ],
    }
    return (json.dumps(content, allow_nan=False) + "\n").encode()


def read_coco(path: Path, video: Video, images: Sequence[str] = ()) -> list[Answer]:
    """Boxes as given: all of them, or those that say so where a file says where its boxes come from.

    Images are frames by their `frame_id`, else by their file names, of which `images` has those of the video.

    Raises:
        MismatchError: it does not fit the video, or is no COCO with identities.
        OSError: it cannot be read.
    """
    content = needed(read_json(path), ("images", "annotations"), str(path))
    frame_of = _frames(list_at(content["images"], f"{path}, images"), video, images, path)
    labels = {}
    for n, entry in enumerate(list_at(content.get("categories", []), f"{path}, categories")):
        place = f"{path}, categories[{n}]"
        category = needed(entry, ("id", "name"), place)
        labels[identity_text(category["id"], "id", place)] = str(category["name"])
    annotations = list_at(content["annotations"], f"{path}, annotations")
    rows = list(
        _rows(
            [needed(*_placed(path, n, entry)) for n, entry in enumerate(annotations)], frame_of, labels, path
        )
    )
    names: dict[Hashable, str] = {}
    for n, entry in enumerate(list_at(content.get("tracks", []), f"{path}, tracks")):
        place = f"{path}, tracks[{n}]"
        track = needed(entry, ("id",), place)
        key = identity_text(track["id"], "id", place)
        if "name" in track:
            names[key] = str(track["name"])
        frames = {
            whole_value(frame, "gone", place) for frame in list_at(track.get("gone", []), f"{place}, gone")
        }
        starts = sorted(frame for frame in frames if frame - 1 not in frames)
        rows += [Row(f"tracks[{n}]", frame, key, "", None) for frame in starts]
    return answers_of(rows, video, path, names)


def _placed(path: Path, n: int, entry: object) -> tuple[object, tuple[str, ...], str]:
    return entry, ("image_id",), f"{path}, annotations[{n}]"


def _frames(entries: list[Any], video: Video, images: Sequence[str], path: Path) -> dict[str, int]:
    """Image id -> frame."""
    records = [needed(entry, ("id",), f"{path}, images[{n}]") for n, entry in enumerate(entries)]
    for n, record in enumerate(records):
        if record.get("width") is not None and record.get("height") is not None:
            check_frame_size(record["width"], record["height"], video, f"{path}, images[{n}]")
    videos = {
        identity_text(record["video_id"], "video_id", str(path)) for record in records if "video_id" in record
    }
    if len(videos) > 1:
        raise MismatchError(f"{path}: images of {len(videos)} videos; those of one are needed")
    ids = [identity_text(record["id"], "id", f"{path}, images[{n}]") for n, record in enumerate(records)]
    if len(set(ids)) < len(ids):
        raise MismatchError(f"{path}: two images have the same id")
    if records and all("frame_id" in record for record in records):
        numbers = [
            whole_value(record["frame_id"], "frame_id", f"{path}, images[{n}]")
            for n, record in enumerate(records)
        ]
        first = first_of_numbers(numbers, video.frames)
        if first is None and all(key == str(value + 1) for key, value in zip(ids, numbers, strict=True)):
            first = 0  # ids of images count from 1
        if first is not None:
            if first == 1:
                notice(f"{path}: its frame_id count from 1")
            return {key: value - first for key, value in zip(ids, numbers, strict=True)}
    names = [
        str(needed(record, ("file_name",), f"{path}, images[{n}]")["file_name"])
        for n, record in enumerate(records)
    ]
    if len(set(names)) < len(names):
        raise MismatchError(f"{path}: two images have the same file_name")
    frames = frames_of_names(names, video, images, f"{path}, images") if names else {}
    return {key: frames[name] for key, name in zip(ids, names, strict=True)}


def _rows(
    annotations: Sequence[Mapping[str, Any]],
    frame_of: Mapping[str, int],
    labels: Mapping[str, str],
    path: Path,
) -> Iterator[Row]:
    keys = _identities(annotations, path)
    interpolated, with_box = 0, set[str]()
    box: Box | None
    for n, (annotation, key) in enumerate(zip(annotations, keys, strict=True)):
        place = f"{path}, annotations[{n}]"
        image = identity_text(annotation["image_id"], "image_id", place)
        if image not in frame_of:
            raise MismatchError(f"{place}: image_id {annotation['image_id']!r} is none of its images")
        attributes = _attributes(annotation)
        if attributes.get("how", "given") != "given":
            continue
        if attributes.get("keyframe", True) is False:
            interpolated += 1
            continue
        category = annotation.get("category_id")
        label = labels.get(str(category), "target" if category is None else f"class {category}")
        box, shape = (None, "") if attributes.get("outside") is True else _box(annotation, place)
        if box is not None:
            with_box.add(key)
        yield Row(f"annotations[{n}]", frame_of[image], key, label, box, shape)
    empty = [key for key in dict.fromkeys(keys) if key not in with_box]
    if empty:
        notice(
            f"{path}: {len(empty)} of {len(set(keys))} targets give no box (outside, or between key frames): "
            f"{few(empty)}"
        )
    if interpolated:
        notice(
            f"{path}: {interpolated} of {len(annotations)} boxes are interpolated ones (keyframe false), "
            "and are left to the tracker"
        )


def _attributes(annotation: Mapping[str, Any]) -> Mapping[str, Any]:
    attributes = annotation.get("attributes")
    return attributes if isinstance(attributes, Mapping) else {}


def _identities(annotations: Sequence[Mapping[str, Any]], path: Path) -> list[str]:
    """The identity of each annotation, all by the first key that any of them has."""
    places = {
        (holder, key): [
            (annotation if holder is None else _attributes(annotation)).get(key) for annotation in annotations
        ]
        for holder, key in IDENTITIES
    }
    columns = {
        source: values for source, values in places.items() if any(value is not None for value in values)
    }
    if not annotations:
        return []
    (holder, key), values = next(iter(columns.items()), ((None, "track_id"), [None] * len(annotations)))
    name = key if holder is None else f"{holder}.{key}"
    if None in values:
        n = values.index(None)
        searched = ", ".join(key if holder is None else f"{holder}.{key}" for holder, key in IDENTITIES)
        raise MismatchError(
            f"{path}, annotations[{n}] (id {annotations[n].get('id')!r}): the key {name!r} is missing, which "
            f"says which target it is; keys that are looked for: {searched}"
        )
    keys = [identity_text(value, name, f"{path}, annotations[{n}]") for n, value in enumerate(values)]
    for (second_holder, second_key), column in columns.items():
        if second_key != "id" and None not in column and _differ(keys, column):
            second_name = second_key if second_holder is None else f"{second_holder}.{second_key}"
            raise MismatchError(
                f"{path}: it fits two readings: identities by {name!r}, and by {second_name!r}, differ"
            )
    return keys


def _differ(keys: Sequence[str], values: Sequence[object]) -> bool:
    """True if two columns of identities part the annotations otherwise."""
    pairs_count = len({(key, str(value)) for key, value in zip(keys, values, strict=True)})
    return pairs_count != len(set(keys)) or pairs_count != len({str(value) for value in values})


def _box(annotation: Mapping[str, Any], place: str) -> tuple[Box, str]:
    """The box of an annotation, and what it was made of."""
    turn = number(_attributes(annotation).get("rotation") or 0, "rotation", place)
    segments = annotation.get("segmentation")
    if not annotation.get("bbox") or (turn and segments):
        if not segments:
            raise MismatchError(
                f"{place} (id {annotation.get('id')!r}): the key 'bbox' is missing, and 'segmentation'"
            )
        return _segmented(segments, place)
    box = corner_box(annotation["bbox"], "bbox", place)
    return (turned_box(box, turn), "rotated box") if turn else (box, "")


def _segmented(segmentation: Any, place: str) -> tuple[Box, str]:
    try:
        if isinstance(segmentation, Mapping):
            height = whole_value(list_at(segmentation.get("size"), f"{place}, size")[0], "size", place)
            counts = segmentation.get("counts")
            if not isinstance(counts, str | list):
                raise ValueError("counts are missing")
            return mask_box(counts, height), "mask"
        polygons = list_at(segmentation, f"{place}, segmentation")
        values = [
            pairs(number(value, "segmentation", place) for value in list_at(polygon, place))
            for polygon in polygons
        ]
        return box_around([point for polygon in values for point in polygon]), "polygon"
    except (ValueError, IndexError) as error:
        if isinstance(error, MismatchError):
            raise
        raise MismatchError(f"{place}: segmentation is neither polygons nor a mask ({error})") from error


def as_label_studio(document: Document) -> bytes:
    """The text. Every box is a key frame; `meta.given` lists the frames (from 1) that a person answered."""
    video = document.video
    results = [
        {
            "id": f"target{number}",
            "type": "videorectangle",
            "from_name": "box",
            "to_name": "video",
            "origin": "manual",
            "meta": {"text": [target], "given": [f + 1 for f in sorted(boxes) if boxes[f].how == "given"]},
            "value": {
                "framesCount": video.frames,
                "duration": rounded(video.frames * video.frame_interval_s, 6),
                "sequence": [*_key_frames(boxes, video)],
                "labels": [label_of(target)],
            },
        }
        for number, (target, boxes) in enumerate(document.marks.items(), 1)
    ]
    task = {"id": 1, "data": {"video": video.name}, "annotations": [{"id": 1, "result": results}]}
    return (json.dumps([task], allow_nan=False) + "\n").encode()


def _key_frames(boxes: Mapping[int, BoxMark], video: Video) -> Iterator[dict[str, Any]]:
    """The marks of a target that have a box, as key frames; one that is not enabled ends the region."""
    for frame in sorted(boxes):
        box = boxes[frame].box
        if box is None:
            continue
        x, y, w, h = box
        following = boxes.get(frame + 1)
        yield {
            "frame": frame + 1,
            "time": rounded(frame * video.frame_interval_s, 6),
            # The region ends behind a key frame that is not enabled.
            "enabled": following is not None and following.box is not None,
            "rotation": 0,
            "x": rounded(100.0 * x / video.width, 6),
            "y": rounded(100.0 * y / video.height, 6),
            "width": rounded(100.0 * w / video.width, 6),
            "height": rounded(100.0 * h / video.height, 6),
        }


def read_label_studio(path: Path, video: Video) -> list[Answer]:
    """Key frames as given, or those of `meta.given`; behind one that is not enabled the target is gone.

    Raises:
        MismatchError: it does not fit the video, or is no video task of Label Studio.
        OSError: it cannot be read.
    """
    results = _results(read_json(path), path)
    rows: list[Row] = []
    names: dict[Hashable, str] = {}
    for n, result in enumerate(results):
        place = f"result {result.get('id', n)}"
        value = needed(result["value"], ("sequence",), f"{path}, {place}, value")
        if "framesCount" in value:
            _check_frames(value["framesCount"], video, f"{path}, {place}, framesCount")
        meta = result.get("meta")
        given_frames = meta.get("given") if isinstance(meta, Mapping) else None
        if given_frames is not None and isinstance(meta, Mapping) and meta.get("text"):
            names[n] = str(list_at(meta["text"], f"{path}, {place}, meta")[0])
        labels = value.get("labels") or value.get("rectanglelabels") or ["target"]
        label = str(list_at(labels, f"{path}, {place}, labels")[0])
        rows += _read_key_frames(value["sequence"], (n, label), video, place, path, given_frames)
    return answers_of(rows, video, path, names)


def _results(content: object, path: Path) -> list[Mapping[str, Any]]:
    """The regions of the task's annotation, of an export as JSON or as JSON_MIN."""
    tasks = content if isinstance(content, list) else [content]
    if len(tasks) != 1:
        raise MismatchError(f"{path}: {len(tasks)} tasks; one of one video is needed")
    task = needed(tasks[0], (), f"{path}, task")
    if "annotations" not in task:
        regions = [entry for values in task.values() if isinstance(values, list) for entry in values]
        values = [entry for entry in regions if isinstance(entry, Mapping) and "sequence" in entry]
        if not values:
            raise MismatchError(
                f"{path}: no video task of Label Studio: the key 'annotations' is missing, or the regions of "
                f"JSON_MIN; it has {', '.join(map(str, task)) or 'none'}"
            )
        return [{"value": value} for value in values]
    annotations = [
        needed(entry, ("result",), f"{path}, annotations[{n}]")
        for n, entry in enumerate(list_at(task["annotations"], f"{path}, annotations"))
    ]
    finished = [entry for entry in annotations if entry.get("was_cancelled") is not True]
    if len(finished) != 1:
        ids = ", ".join(str(entry.get("id")) for entry in finished)
        raise MismatchError(
            f"{path}: the task has {len(finished)} annotations"
            + (f" (id {ids}); leave the one that is meant" if finished else "")
        )
    entries = list_at(finished[0]["result"], f"{path}, result")
    results = [needed(entry, ("type", "value"), f"{path}, result[{n}]") for n, entry in enumerate(entries)]
    other_kinds = Counter(str(entry["type"]) for entry in results if entry["type"] != "videorectangle")
    for kind, count in other_kinds.items():
        notice(f"{path}: {count} results of type {kind} are no boxes of a video, and are not used")
    return [entry for entry in results if entry["type"] == "videorectangle"]


def _read_key_frames(
    sequence: object,
    target: tuple[Hashable, str],
    video: Video,
    place: str,
    path: Path,
    chosen_frames: Collection[int] | None = None,
) -> Iterator[Row]:
    """Key frames as boxes of the target, its identity and label, and where it is gone.

    Boxes count only in the frames `given` (from 1), if there is such a list. Raises MismatchError.
    """
    key, label = target
    origin = f"{path}, {place}"
    frames = [needed(key_frame, ("frame",), origin) for key_frame in list_at(sequence, f"{origin}, sequence")]
    numbered = sorted(
        ((whole_value(key_frame["frame"], "frame", origin) - 1, key_frame) for key_frame in frames),
        key=itemgetter(0),
    )
    for n, (frame, key_frame) in enumerate(numbered):
        position = f"{place}, frame {frame + 1} (counted from 1)"
        needed(key_frame, ("x", "y", "width", "height"), f"{path}, {position}")
        x, w = (
            number(key_frame[side], side, f"{path}, {position}") * video.width / 100.0
            for side in ("x", "width")
        )
        y, h = (
            number(key_frame[side], side, f"{path}, {position}") * video.height / 100.0
            for side in ("y", "height")
        )
        turn = number(key_frame.get("rotation") or 0, "rotation", f"{path}, {position}")
        box = turned_box((x, y, w, h), turn, corner=True) if turn else (x, y, w, h)
        if chosen_frames is None or frame + 1 in chosen_frames:
            yield Row(position, frame, key, label, box, "rotated box" if turn else "")
        next_frame = numbered[n + 1][0] if n + 1 < len(numbered) else None
        if key_frame.get("enabled", True) is False and next_frame != frame + 1:
            yield Row(position, frame + 1, key, label, None)


def _check_frames(frames: object, video: Video, place: str) -> None:
    """Refuse another number of frames; one more or less comes of rounding. Raises MismatchError."""
    count = whole_value(frames, "frames", place)
    if abs(count - video.frames) > 1:
        raise MismatchError(
            f"{place}: {count} frames; the video has {video.frames}: `frameRate` of <Video> in the labelling "
            "configuration has to be that of the video"
        )
    if count != video.frames:
        notice(f"{place}: {count} frames; the video has {video.frames}")
