"""The way back: events in any real sequence, and when the box and the status `tracking` are back after them.

    python benchmarks/way_back.py DATA_FOLDER --why WORDS [--graphs general,FILE] [--seeds 1] [--first-seed 0]
        [--strata "chosen on,untuned"] [--kinds black,leaves,patch,cut,jerk] [--passes FILE] [--write FOLDER]

Each event begins `BEFORE` frames into the sequence, and `AFTER` frames follow it:

- black: ten black frames.
- leaves: the view pans until the target is outside, rests, and pans back; what comes in is another scene.
- patch: a patch of another colour slides over the target, stays, and slides off.
- cut: frames of another sequence, then the sequence goes on where it was.
- jerk: from one frame to the next the view is displaced by two and a half box sides, and stays so.

The box is *back* in the first of three frames in a row with an IoU above 0.5 after the event. Printed of each
kind and stratum: in how many videos the target was held before, in how many of these its box is back, in how
many `tracking` is said within 10 frames of that, and the shares of `tracking` at IoU 0 and of hidden
frames. With `--passes` results are kept by commit, graph, kind, sequence and seed, and what is there is not
run again. With `--write` the videos are written as sequences (NAME_KIND/img/*.png, groundtruth.txt). A call
adds a line to the file of looks.
"""

from __future__ import annotations

import argparse
import json
import random
import subprocess
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from event_videos import EventVideo, cover_target, write_video
from events import run_graph
from measuring import Image, on_one_thread, table
from real_video import LOOKS, digest, note, read_graph
from sequences import STRATA, Sequence, find_sequences

BEFORE = 40
"""Frames in which nothing happens, the first included."""
AFTER = 45
"""Frames after the event."""
BLACK = 10
"""Black frames."""
PAN = 8
"""Frames in which the view pans."""
AWAY = 25
"""Frames without the target: outside, or of another sequence."""
HIDDEN = 20
"""Frames in which the patch covers the target."""
SLIDE = 5
"""Frames in which the patch comes or goes."""
JERK_BOX = 2.5
"""Displacement of a jerk, roots of the box's area."""
WITHIN = 10
"""Frames after the box is back within which `tracking` should be said."""
IN_A_ROW = 3
"""Frames in a row with an IoU above one half that count as back."""


def darken(own: Sequence, other: Sequence, coin: random.Random) -> EventVideo | None:
    """Black frames."""
    del other, coin
    images, truth, hidden = _start(own, BLACK)
    for index in range(BEFORE, BEFORE + BLACK):
        images[index], hidden[index] = np.zeros_like(images[index]), True
    return _video(own, images, truth, hidden)


def leave(own: Sequence, other: Sequence, coin: random.Random) -> EventVideo | None:
    """The view pans away from the target over another scene, and back."""
    images, truth, hidden = _start(own, 2 * PAN + AWAY)
    height, width = images[0].shape[:2]
    scene, event = _image_like(other, images[0]), slice(BEFORE, BEFORE + 2 * PAN + AWAY)
    axis = coin.choice((0, 1))
    size = (width, height)[axis]
    ends = truth[event, axis] + truth[event, 2 + axis]
    needed = (-float(np.nanmax(ends)) - 1.0, size - float(np.nanmin(truth[event, axis])) + 1.0)
    whole = min(needed, key=abs)  # the shorter way out
    pan = np.linspace(0.0, 1.0, PAN + 1)[1:]
    for index, share in enumerate([*pan, *[1.0] * AWAY, *(1.0 - pan)], start=BEFORE):
        shift = round(whole * float(share))
        images[index] = _displaced(images[index], scene, *((shift, 0) if axis == 0 else (0, shift)))
        truth[index, axis] += shift
        hidden[index] = truth[index, axis] + truth[index, 2 + axis] <= 0 or truth[index, axis] >= size
    return _video(own, images, truth, hidden)


def patch(own: Sequence, other: Sequence, coin: random.Random) -> EventVideo | None:
    """A patch slides over the target, and off it."""
    del other
    images, truth, hidden = _start(own, 2 * SLIDE + HIDDEN)
    inside = np.linspace(1.3, 0.0, SLIDE + 1)[1:]
    offsets = [*inside, *[0.0] * HIDDEN, *-inside[:-1][::-1], -1.3]
    for index in cover_target(images, truth, BEFORE, offsets, coin):
        hidden[index] = True
    return _video(own, images, truth, hidden)


def cut(own: Sequence, other: Sequence, coin: random.Random) -> EventVideo | None:
    """Frames of another sequence in between."""
    images, truth, _ = _start(own, 0)
    first = coin.randrange(max(len(other.files) - AWAY, 1))
    frames = [_like(cv2.imread(str(file)), images[0]) for file in other.files[first : first + AWAY]]
    away = np.full((len(frames), 4), np.nan)
    hidden = np.zeros(len(images) + len(frames), np.bool_)
    hidden[BEFORE : BEFORE + len(frames)] = True
    truth = np.concatenate([truth[:BEFORE], away, truth[BEFORE:]])
    return _video(own, [*images[:BEFORE], *frames, *images[BEFORE:]], truth, hidden)


def jerk(own: Sequence, other: Sequence, coin: random.Random) -> EventVideo | None:
    """The view is displaced at once; None where no direction keeps the target inside."""
    images, truth, hidden = _start(own, 0)
    x, y, w, h = truth[BEFORE]
    height, width = images[0].shape[:2]
    able = []
    for angle in np.linspace(0.0, 2.0 * np.pi, 16, endpoint=False):
        dx, dy = (round(float(JERK_BOX * np.sqrt(w * h) * part)) for part in (np.cos(angle), np.sin(angle)))
        if 0 <= x + dx <= width - w and 0 <= y + dy <= height - h:
            able.append((dx, dy))
    if not able:
        return None
    (dx, dy), scene = coin.choice(able), _image_like(other, images[0])
    for index in range(BEFORE, len(images)):
        images[index] = _displaced(images[index], scene, dx, dy)
    truth[BEFORE:, :2] += (dx, dy)
    return _video(own, images, truth, hidden)


KINDS: dict[str, Callable[[Sequence, Sequence, random.Random], EventVideo | None]] = {
    "black": darken,
    "leaves": leave,
    "patch": patch,
    "cut": cut,
    "jerk": jerk,
}
LASTS = {"black": BLACK, "leaves": 2 * PAN + AWAY, "patch": 2 * SLIDE + HIDDEN, "cut": AWAY, "jerk": 0}


def make_video(kind: str, own: Sequence, other: Sequence) -> EventVideo | None:
    """The video of one kind, always the same; None where the sequence is too short or has no room for it."""
    used = BEFORE + (0 if kind in ("cut", "jerk") else LASTS[kind])
    if len(own.files) < used + AFTER or not np.isfinite(own.truth[: used + AFTER]).all():
        return None
    return KINDS[kind](own, other, random.Random(f"{kind} {own.name}"))


def _start(own: Sequence, event: int) -> tuple[list[Image], Any, Any]:
    count = BEFORE + event + AFTER
    images = [image for image, _ in zip(own.images(), range(count), strict=False)]
    return images, own.truth[: len(images)].copy(), np.zeros(len(images), np.bool_)


def _video(own: Sequence, images: list[Image], truth: Any, hidden: Any) -> EventVideo:
    return EventVideo(own.name, images, truth, hidden, np.full(truth.shape, np.nan))


def _like(image: Any, wanted: Image) -> Image:
    """An image with the size of another."""
    size = (wanted.shape[1], wanted.shape[0])
    return np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), np.uint8)


def _image_like(sequence: Sequence, wanted: Image) -> Image:
    return _like(cv2.imread(str(sequence.files[0])), wanted)


def _displaced(image: Image, scene: Image, dx: int, dy: int) -> Image:
    """The image displaced by whole pixels over another scene."""
    made, (height, width) = scene.copy(), image.shape[:2]
    if abs(dx) < width and abs(dy) < height:
        part = image[max(-dy, 0) : height - max(dy, 0), max(-dx, 0) : width - max(dx, 0)]
        top, left = max(dy, 0), max(dx, 0)
        made[top : top + part.shape[0], left : left + part.shape[1]] = part
    return made


# ------------------------------------------------------------------------------------ results


def judge(row: dict[str, Any]) -> dict[str, Any]:
    """Whether it was held before, when the box was back and `tracking` said, and what was called wrongly."""
    iou, status = np.array(row["iou"]), np.array(row["status"])
    hidden = np.array(row["hidden"])
    good, said = iou > 0.5, status == "tracking"
    first = BEFORE - 1  # rows begin with the second frame
    after = first + LASTS[row["kind"]]
    held = int((good & said)[first - 5 : first].sum()) >= IN_A_ROW
    runs = [k for k in range(after, len(iou) - IN_A_ROW + 1) if good[k : k + IN_A_ROW].all()]
    back = runs[0] if runs else None
    told = None if back is None else next((k for k in range(back, len(iou)) if said[k]), None)
    return {
        "held": held,
        "back": None if back is None else back - after,
        "said": None if back is None or told is None else told - back,
        "open": back is not None and back + WITHIN < len(iou),  # there are frames enough to tell
        "wrong": int((said & (iou == 0))[first:].sum()),
        "hidden": int((said & hidden).sum()),
        "frames": len(iou) - first,
        "of_hidden": int(hidden.sum()),
        "iou": float(iou[after:].mean()),
        "doubt": float((~said)[after:][good[after:]].mean()) if good[after:].any() else 0.0,
    }


def summarize(rows: list[dict[str, Any]]) -> Iterator[list[str]]:
    """A row per tracker, stratum and kind."""
    for name in dict.fromkeys(row["graph"] for row in rows):
        for stratum in dict.fromkeys(row["stratum"] for row in rows):
            for kind in (*KINDS, "all"):
                of = (r for r in rows if r["graph"] == name and r["stratum"] == stratum)
                own = [judge(row) for row in of if kind in ("all", row["kind"])]
                held = [one for one in own if one["held"]]
                back = [one for one in held if one["open"]]
                told = [one for one in back if one["said"] is not None and one["said"] <= WITHIN]
                if held:
                    hidden, of_hidden = (sum(one[key] for one in own) for key in ("hidden", "of_hidden"))
                    yield [
                        name,
                        stratum,
                        kind,
                        f"{len(held)} of {len(own)}",
                        f"{len(back)}",
                        f"{len(told)} ({len(told) / max(len(back), 1):.2f})",
                        f"{np.mean([one['iou'] for one in held]):.2f}",
                        f"{np.mean([one['doubt'] for one in held]):.2f}",
                        f"{sum(one['wrong'] for one in own) / sum(one['frames'] for one in own):.4f}",
                        f"{hidden / max(of_hidden, 1):.3f}",
                    ]


HEAD = [
    "graph",
    "stratum",
    "event",
    "held before",
    "box back",
    "tracking within 10",
    "IoU after",
    "doubt while good",
]
HEAD += ["tracking at IoU 0", "hidden called tracking"]


def commit() -> str:
    """The commit whose code runs, with a plus where files differ from it."""
    call = ["git", "describe", "--always", "--dirty=+"]
    return subprocess.run(call, capture_output=True, text=True, check=False).stdout.strip()


def main() -> None:
    """Run what is missing, and print the table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("data", type=Path)
    parser.add_argument("--graphs", default="general", help="names or files, with commas")
    parser.add_argument("--why", required=True, help="what the look is for; goes into the record")
    parser.add_argument("--strata", default="chosen on,untuned")
    parser.add_argument("--kinds", default=",".join(KINDS))
    parser.add_argument("--seeds", type=int, default=1)
    parser.add_argument("--first-seed", type=int, default=0)
    parser.add_argument("--looks", type=Path, default=LOOKS)
    parser.add_argument("--code", help="what results are kept by (default: the commit)")
    parser.add_argument(
        "--passes", type=Path, metavar="FILE", help="keep results, and use those that are there"
    )
    parser.add_argument("--write", type=Path, metavar="FOLDER", help="write the videos, and run nothing")
    options = parser.parse_args()
    on_one_thread()
    specs, code = [read_graph(name) for name in options.graphs.split(",")], options.code or commit()
    seeds = range(options.first_seed, options.first_seed + options.seeds)
    shown = ", ".join(f"{name} {digest(spec)}" for name, spec in specs)
    if not options.write:
        what = {
            "half": options.strata,
            "graphs": shown,
            "seeds": str(seeds),
            "frames": f"way back: {options.kinds}",
        }
        note(options.looks, **what, why=options.why)
    known: dict[tuple[Any, ...], dict[str, Any]] = {}
    if options.passes and options.passes.exists():
        for line in options.passes.read_text(encoding="utf-8").splitlines():
            row = json.loads(line)
            known[tuple(row[key] for key in KEYS)] = row
    rows = []
    for stratum in options.strata.split(","):
        sequences = find_sequences(options.data, list(STRATA[stratum]), BEFORE + 2 * PAN + AWAY + AFTER)
        for place, own in enumerate(sequences):
            other = sequences[(place + 1) % len(sequences)]
            for kind in options.kinds.split(","):
                keys = [(code, digest(s), kind, own.name, seed) for _, s in specs for seed in seeds]
                video = None if all(key in known for key in keys) else make_video(kind, own, other)
                if video is not None and options.write:
                    write_video(video, options.write / f"{own.name}_{kind}")
                    continue
                for name, spec in specs:
                    for seed in seeds:
                        key = (code, digest(spec), kind, own.name, seed)
                        if key not in known and video is not None:
                            run = run_graph(spec, video, seed)
                            known[key] = {
                                **dict(zip(KEYS, key, strict=True)),
                                "iou": np.round(np.nan_to_num(run.iou), 3).tolist(),
                                "status": list(run.status),
                                "score": np.round(run.score, 4).tolist(),
                                "hidden": video.hidden[1:].tolist(),
                            }
                            if options.passes:
                                with options.passes.open("a", encoding="utf-8") as lines:
                                    lines.write(json.dumps(known[key]) + "\n")
                        if key in known:
                            rows.append({**known[key], "graph": name, "stratum": stratum})
    print(table(HEAD, list(summarize(rows))))


KEYS = ("code", "digest", "kind", "sequence", "seed")


if __name__ == "__main__":
    main()
