"""What is said when a run has ended: how it went, as text or JSON, and which command is useful next."""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import TYPE_CHECKING

from bayesnet_track.cli.commands.answer import complain, say

if TYPE_CHECKING:
    from bayesnet_track.runtime.results import Summary

SHOWN_NOTICES = 5

ENDINGS = {
    "source_truncated": "the source is truncated",
    "source_damaged": "the source is damaged",
    "frame_size_changed": "stopped where the frames change size",
    "interrupted": "interrupted",
}


def say_end(options: argparse.Namespace, out: Path, summary: Summary) -> None:
    """Warnings, failures, then how the run went: a sentence, with --json an object, with --quiet nothing.

    Of `what-if` the object is the comparison.
    """
    from bayesnet_track.journal.text.explain import explain

    for notice in summary.notices[:SHOWN_NOTICES]:
        complain(explain(notice))
    if len(summary.notices) > SHOWN_NOTICES:
        complain(
            f"... and {len(summary.notices) - SHOWN_NOTICES} more; `bayesnet-track log {out}` lists them all"
        )
    for failure in list(summary.failures.values())[:SHOWN_NOTICES]:
        complain(explain(failure))
    if getattr(options, "json", False):
        if options.command in ("run", "resume"):
            say(json.dumps(as_object(out, summary)))
    elif not options.quiet:
        say(f"{out}: {as_sentence(summary)}")


def as_object(out: Path, summary: Summary) -> dict[str, object]:
    """What --json prints of a run."""
    return {
        "run": str(out),
        "frames": summary.frames,
        "seconds": round(summary.seconds, 3),
        "frames_per_second": round(summary.frames_per_second, 1),
        "reconfigurations": summary.reconfigurations,
        "lost_frames": summary.lost_frames,
        "complete": summary.complete,
        "reason": summary.reason,
    }


def as_sentence(summary: Summary) -> str:
    """`12 frames in 2.0 s (30 frames per second after the first), 1 reconfiguration`, and what went wrong."""
    times = []
    if summary.frames_per_second:
        times.append(f"{summary.frames_per_second:.0f} frames per second after the first")
    if summary.compiling_s >= 0.05:
        times.append(f"{summary.compiling_s:.1f} s of compiling")
    parts = [f"{_count(summary.frames, 'frame')} in {summary.seconds:.1f} s"]
    if times:
        parts[0] += f" ({', '.join(times)})"
    parts.append(_count(summary.reconfigurations, "reconfiguration"))
    if summary.lost_frames:
        lost = f"lost in {_count(summary.lost_frames, 'frame')}"
        several = f"a target {lost} (at most {summary.most_targets} targets at a time)"
        parts.append(lost if summary.most_targets < 2 else several)
    if not summary.complete:
        parts.append(ENDINGS[summary.reason])
    return ", ".join(parts)


def say_next(options: argparse.Namespace, out: Path, summary: Summary) -> None:
    """The command that is useful next: nothing where a program reads."""
    if options.quiet or options.log_json or getattr(options, "json", False) or not summary.frames:
        return
    if summary.reason == "interrupted":
        again = f"`bayesnet-track resume {out}` goes on from here; "
        can_resume = (out / "checkpoint").exists()
        shows = f"`bayesnet-track report {out} --open` shows what there is"
        complain(f"next: {again if can_resume else ''}{shows}")
    else:
        shows = f"`bayesnet-track report {out} --open` shows the run in a browser"
        then = f"`bayesnet-track log {out}` prints its decisions"
        if summary.lost_frames:
            then = f"`bayesnet-track diagnose {out}` names a key to try where it is lost"
        complain(f"next: {shows}; {then}")


def _count(number: int, noun: str) -> str:
    return f"{number} {noun}{'' if number == 1 else 's'}"
