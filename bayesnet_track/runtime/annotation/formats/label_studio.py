"""Label Studio JSON: a task with a `videorectangle` region for each target, boxes in percent of the frame."""

from __future__ import annotations

import json
from collections.abc import Collection, Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

from bayesnet_track.runtime.annotation.answers import Answer
from bayesnet_track.runtime.annotation.formats.coco import read_json
from bayesnet_track.runtime.annotation.formats.document import (
    Document,
    MismatchError,
    check_frames,
    given_box,
    label_of,
    number_names,
    tidy,
)
from bayesnet_track.runtime.annotation.frame_store import Video
from bayesnet_track.runtime.annotation.fusing import Mark


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
            "meta": {"text": [target], "given": [f + 1 for f in sorted(own) if own[f].how == "given"]},
            "value": {
                "framesCount": video.frames,
                "duration": tidy(video.frames * video.frame_interval_s, 6),
                "sequence": [*key_frames(own, video)],
                "labels": [label_of(target)],
            },
        }
        for number, (target, own) in enumerate(document.marks.items(), 1)
    ]
    task = {"id": 1, "data": {"video": video.name}, "annotations": [{"id": 1, "result": results}]}
    return (json.dumps([task], allow_nan=False) + "\n").encode()


def key_frames(own: Mapping[int, Mark], video: Video) -> Iterator[dict[str, Any]]:
    """The marks of a target that have a box, as key frames; one that is not enabled ends the region."""
    for frame in sorted(own):
        box = own[frame].box
        if box is None:
            continue
        x, y, w, h = box
        after = own.get(frame + 1)
        yield {
            "frame": frame + 1,
            "time": tidy(frame * video.frame_interval_s, 6),
            # The region ends behind a key frame that is not enabled.
            "enabled": after is not None and after.box is not None,
            "rotation": 0,
            "x": tidy(100.0 * x / video.width, 6),
            "y": tidy(100.0 * y / video.height, 6),
            "width": tidy(100.0 * w / video.width, 6),
            "height": tidy(100.0 * h / video.height, 6),
        }


def read_label_studio(path: Path, video: Video) -> list[Answer]:
    """Key frames as given, or those of `meta.given`; behind one that is not enabled the target is gone.

    Raises:
        MismatchError: it does not fit the video, or is no video task of Label Studio.
        OSError: it cannot be read.
    """
    content = read_json(path)
    try:
        tasks = content if isinstance(content, list) else [content]
        if len(tasks) != 1:
            raise MismatchError(f"{path}: {len(tasks)} tasks; one of one video is needed")
        (task,) = tasks
        results = [
            one
            for annotation in task["annotations"][:1]
            for one in annotation["result"]
            if one["type"] == "videorectangle"
        ]
        labels = [str((one["value"].get("labels") or ["target"])[0]) for one in results]
        names = number_names((str(n), label) for n, label in enumerate(labels))
        answers = []
        for number, one in enumerate(results):
            place = f"{path}, result {one.get('id', number)}"
            if "framesCount" in one["value"]:
                check_frames(one["value"]["framesCount"], video, f"{place}, framesCount")
            meta = one.get("meta")
            given = meta.get("given") if isinstance(meta, dict) else None
            answers += [*read_key_frames(one["value"]["sequence"], names[str(number)], video, place, given)]
    except (KeyError, TypeError, AttributeError, IndexError) as error:
        raise MismatchError(
            f"{path}: no video task of Label Studio: annotations with results of type videorectangle are "
            f"needed; {error!s} is not as it should be"
        ) from error
    return answers


def read_key_frames(
    sequence: Iterable[Mapping[str, Any]],
    name: str,
    video: Video,
    place: str,
    given: Collection[int] | None = None,
) -> Iterator[Answer]:
    """Key frames as boxes of the target `name`, and where the target is gone.

    Boxes count only in the frames `given` (from 1), if there is such a list. Raises MismatchError.
    """
    for one in sorted(sequence, key=lambda one: int(one["frame"])):
        frame = int(one["frame"]) - 1
        box = (
            float(one["x"]) * video.width / 100.0,
            float(one["y"]) * video.height / 100.0,
            float(one["width"]) * video.width / 100.0,
            float(one["height"]) * video.height / 100.0,
        )
        answer = given_box(frame, name, box, video, f"{place}, frame {frame + 1} (counted from 1)")
        if given is None or frame + 1 in given:
            yield answer
        if not one.get("enabled", True) and frame + 1 < video.frames:
            yield Answer("gone", frame + 1, name)
