"""The first screen: every command in a group, with one line and one example."""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from typing import Any

GROUPS: Mapping[str, tuple[str, ...]] = {
    "see it work": ("demo", "doctor", "list", "completion"),
    "track": ("run", "batch", "resume", "verify"),
    "label a video": ("annotate",),
    "look at a run": ("report", "log", "diagnose", "smooth", "export"),
    "measure": ("score", "compare", "what-if"),
    "write a graph": ("init", "validate", "graph", "simulate", "schema"),
    "fit to your videos": ("fit", "learn-shape", "learn-stereo"),
    "detect; calibrate cameras": ("detect", "calibrate"),
}
"""Title -> its commands."""

EXAMPLES: Mapping[str, str] = {
    "demo": "demo crowd",
    "doctor": "doctor",
    "list": "list",
    "completion": "completion bash",
    "run": "run general --source video.mp4 --init 57,21,31,45 --out runs/mine",
    "batch": "batch general --source '*.mp4' --init-from '{name}.txt' --out runs/all",
    "annotate": "annotate video.mp4 --out labels/mine --open",
    "resume": "resume runs/mine",
    "verify": "verify runs/mine",
    "report": "report runs/mine --open",
    "log": "log runs/mine --why 120",
    "smooth": "smooth runs/mine --out runs/mine_smoothed",
    "diagnose": "diagnose runs/mine",
    "export": "export runs/mine --format coco --out tracks.json",
    "score": "score runs/mine --truth groundtruth.txt",
    "compare": "compare runs/a runs/b --html differences.html",
    "what-if": "what-if runs/mine --set target.belief.particles.size=1000",
    "init": "init mine.yaml",
    "validate": "validate mine.yaml",
    "graph": "graph general --formula",
    "simulate": "simulate general --source video.mp4 --init 57,21,31,45 --png prior.png",
    "schema": "schema > graph.schema.json",
    "fit": "fit general --source a.mp4 --truth a.txt --out mine.yaml",
    "learn-shape": "learn-shape person.npz --source a.mp4 --truth a.txt",
    "learn-stereo": "learn-stereo --source left --right right --calibration pair.yaml --truth a.txt",
    "detect": "detect motion --source video.mp4 --out detections.txt",
    "calibrate": "calibrate left right --board 9x6 --square 0.025 --out pair.yaml",
}
"""Command -> one that does something useful, without the program's name."""


def describe_commands(commands: argparse._SubParsersAction[Any]) -> str:
    """The groups, each command with its line and its example."""
    lines = {choice.dest: choice.help or "" for choice in commands._choices_actions}
    width = max(map(len, lines))
    shown: list[str] = []
    for title, names in GROUPS.items():
        shown += [f"{title}:"]
        for name in names:
            shown += [
                f"  {name:{width}}  {lines[name]}",
                f"  {'':{width}}  $ bayesnet-track {EXAMPLES[name]}",
            ]
    return "\n".join(shown)


def add_examples(commands: argparse._SubParsersAction[Any]) -> None:
    """Let the help of every command end with its example."""
    for name, parser in commands.choices.items():
        example = f"example:\n  bayesnet-track {EXAMPLES[name]}"
        parser.epilog = f"{parser.epilog}\n\n{example}" if parser.epilog else example
        parser.formatter_class = argparse.RawDescriptionHelpFormatter
