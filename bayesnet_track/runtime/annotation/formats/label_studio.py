"""Label Studio JSON: a task with a `videorectangle` region for each target, boxes in percent of the frame."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Collection, Hashable, Iterator, Mapping
from operator import itemgetter
from pathlib import Path
from typing import Any

from bayesnet_track.runtime.annotation.answers import Answer
from bayesnet_track.runtime.annotation.formats.document import Document, MismatchError, label_of, tidy
from bayesnet_track.runtime.annotation.formats.rows import Row, answers_of
from bayesnet_track.runtime.annotation.formats.shapes import turned_box
from bayesnet_track.runtime.annotation.formats.texts import listed, needed, number, read_json, whole
from bayesnet_track.runtime.annotation.frame_store import Video
from bayesnet_track.runtime.annotation.fusing import Mark
from bayesnet_track.sources.entrances.notices import notice


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
                "sequence": [*_key_frames(own, video)],
                "labels": [label_of(target)],
            },
        }
        for number, (target, own) in enumerate(document.marks.items(), 1)
    ]
    task = {"id": 1, "data": {"video": video.name}, "annotations": [{"id": 1, "result": results}]}
    return (json.dumps([task], allow_nan=False) + "\n").encode()


def _key_frames(own: Mapping[int, Mark], video: Video) -> Iterator[dict[str, Any]]:
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
    results = _results(read_json(path), path)
    rows: list[Row] = []
    names: dict[Hashable, str] = {}
    for n, one in enumerate(results):
        place = f"result {one.get('id', n)}"
        value = needed(one["value"], ("sequence",), f"{path}, {place}, value")
        if "framesCount" in value:
            _check_frames(value["framesCount"], video, f"{path}, {place}, framesCount")
        meta = one.get("meta")
        given = meta.get("given") if isinstance(meta, Mapping) else None
        if given is not None and isinstance(meta, Mapping) and meta.get("text"):
            names[n] = str(listed(meta["text"], f"{path}, {place}, meta")[0])
        labels = value.get("labels") or value.get("rectanglelabels") or ["target"]
        label = str(listed(labels, f"{path}, {place}, labels")[0])
        rows += _read_key_frames(value["sequence"], (n, label), video, place, path, given)
    return answers_of(rows, video, path, names)


def _results(content: object, path: Path) -> list[Mapping[str, Any]]:
    """The regions of the task's annotation, of an export as JSON or as JSON_MIN."""
    tasks = content if isinstance(content, list) else [content]
    if len(tasks) != 1:
        raise MismatchError(f"{path}: {len(tasks)} tasks; one of one video is needed")
    task = needed(tasks[0], (), f"{path}, task")
    if "annotations" not in task:
        regions = [one for values in task.values() if isinstance(values, list) for one in values]
        values = [one for one in regions if isinstance(one, Mapping) and "sequence" in one]
        if not values:
            raise MismatchError(
                f"{path}: no video task of Label Studio: the key 'annotations' is missing, or the regions of "
                f"JSON_MIN; it has {', '.join(map(str, task)) or 'none'}"
            )
        return [{"value": value} for value in values]
    annotations = [
        needed(one, ("result",), f"{path}, annotations[{n}]")
        for n, one in enumerate(listed(task["annotations"], f"{path}, annotations"))
    ]
    done = [one for one in annotations if one.get("was_cancelled") is not True]
    if len(done) != 1:
        ids = ", ".join(str(one.get("id")) for one in done)
        raise MismatchError(
            f"{path}: the task has {len(done)} annotations"
            + (f" (id {ids}); leave the one that is meant" if done else "")
        )
    found = listed(done[0]["result"], f"{path}, result")
    results = [needed(one, ("type", "value"), f"{path}, result[{n}]") for n, one in enumerate(found)]
    others = Counter(str(one["type"]) for one in results if one["type"] != "videorectangle")
    for kind, count in others.items():
        notice(f"{path}: {count} results of type {kind} are no boxes of a video, and are not used")
    return [one for one in results if one["type"] == "videorectangle"]


def _read_key_frames(
    sequence: object,
    target: tuple[Hashable, str],
    video: Video,
    place: str,
    path: Path,
    given: Collection[int] | None = None,
) -> Iterator[Row]:
    """Key frames as boxes of the target, its identity and label, and where it is gone.

    Boxes count only in the frames `given` (from 1), if there is such a list. Raises MismatchError.
    """
    key, label = target
    here = f"{path}, {place}"
    frames = [needed(one, ("frame",), here) for one in listed(sequence, f"{here}, sequence")]
    numbered = sorted(((whole(one["frame"], "frame", here) - 1, one) for one in frames), key=itemgetter(0))
    for n, (frame, one) in enumerate(numbered):
        where = f"{place}, frame {frame + 1} (counted from 1)"
        needed(one, ("x", "y", "width", "height"), f"{path}, {where}")
        x, w = (number(one[side], side, f"{path}, {where}") * video.width / 100.0 for side in ("x", "width"))
        y, h = (
            number(one[side], side, f"{path}, {where}") * video.height / 100.0 for side in ("y", "height")
        )
        turn = number(one.get("rotation") or 0, "rotation", f"{path}, {where}")
        box = turned_box((x, y, w, h), turn, corner=True) if turn else (x, y, w, h)
        if given is None or frame + 1 in given:
            yield Row(where, frame, key, label, box, "rotated box" if turn else "")
        then = numbered[n + 1][0] if n + 1 < len(numbered) else None
        if one.get("enabled", True) is False and then != frame + 1:
            yield Row(where, frame + 1, key, label, None)


def _check_frames(frames: object, video: Video, place: str) -> None:
    """Refuse another number of frames; one more or less comes of rounding. Raises MismatchError."""
    found = whole(frames, "frames", place)
    if abs(found - video.frames) > 1:
        raise MismatchError(
            f"{place}: {found} frames; the video has {video.frames}: `frameRate` of <Video> in the labelling "
            "configuration has to be that of the video"
        )
    if found != video.frames:
        notice(f"{place}: {found} frames; the video has {video.frames}")
