"""A crowd with known ground truth, as MOT files and as a video, from one seed.

    python benchmarks/simulate_crowd.py OUT [--seed 0] [--missed 0.1] [--clutter 5] [--merging front]

Writes OUT/gt.txt (the ground truth), OUT/det.txt (what a detector reports), OUT/crowd.json (all settings)
and, unless --no-video is given, OUT/video.mkv. The same arguments write the same bytes of the text files.
Track and score it with

    bayesnet-track run kalman_detections --source OUT/video.mkv --detections OUT/det.txt --out OUT/run
    bayesnet-track score OUT/run --truth OUT/gt.txt
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Sequence
from dataclasses import asdict, fields
from pathlib import Path
from typing import Any, get_args

from bayesnet_track.runtime.recording.videowriter import VideoWriter
from simulated.crowd_detector import (
    DetectorSettings,
    Merging,
    detect_crowd,
    detections_text,
)
from simulated.walkers import CrowdSettings, make_crowd

FRAME_S = 0.04


def main(arguments: Sequence[str] | None = None) -> None:
    """Write the files."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("out", type=Path, help="folder to write into")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--no-video", action="store_true", help="text files only")
    for settings in (CrowdSettings, DetectorSettings):
        for field in fields(settings):
            kind: dict[str, Any] = (
                {"choices": get_args(Merging)} if field.name == "merging" else {"type": type(field.default)}
            )
            name = "--" + field.name.replace("_", "-")
            parser.add_argument(name, default=field.default, help=f"default: {field.default}", **kind)
    options = parser.parse_args(arguments)
    given = vars(options)
    try:
        people, detector = (
            settings(**{field.name: given[field.name] for field in fields(settings)})
            for settings in (CrowdSettings, DetectorSettings)
        )
        crowd = make_crowd(people, options.seed)
    except ValueError as error:
        parser.error(str(error))
    reported = detect_crowd(crowd, detector, options.seed)
    options.out.mkdir(parents=True, exist_ok=True)
    record = {"seed": options.seed, "crowd": asdict(people), "detector": asdict(detector)}
    (options.out / "crowd.json").write_text(json.dumps(record, indent=1) + "\n")
    (options.out / "gt.txt").write_text(crowd.mot_text())
    (options.out / "det.txt").write_text(detections_text(reported))
    if not options.no_video:
        with VideoWriter(options.out / "video.mkv", people.width, people.height, FRAME_S) as video:
            for image in crowd.movie():
                video.write(image)
    boxes = sum(len(one.people) for one in reported)
    print(f"{options.out}: {crowd.boxes.shape[1]} people, {people.frames} frames, {boxes} detections")


if __name__ == "__main__":
    main()
