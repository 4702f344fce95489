"""The option of the annotated video."""

from __future__ import annotations

import argparse

FORMATS = ("mkv", "mp4")


def add_video_option(parser: argparse.ArgumentParser) -> None:
    """`--video`, alone or with a format."""
    parser.add_argument(
        "--video",
        nargs="?",
        const="mkv",
        default=False,
        type=_format,
        metavar="FORMAT",
        help="also write the annotated video into the run: video.mkv, or video.mp4 with --video mp4",
    )


def _format(text: str) -> str:
    if text in FORMATS:
        return text
    suffix = text.rpartition(".")[2].lower()
    if suffix in FORMATS:
        raise argparse.ArgumentTypeError(
            f"{text!r}: the video is written into the run, as video.{suffix}: --video {suffix}"
        )
    raise argparse.ArgumentTypeError(f"{text!r}: mkv or mp4 is needed, or nothing: write --video last")
