"""The command `diagnose`: what stands out in a run, and a key and a value to try."""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any

from bayesnet_track.cli.commands.answer import OK, UsageError, complain, say

if TYPE_CHECKING:
    from bayesnet_track.cli.diagnose.findings import Finding
    from bayesnet_track.runtime.recording.run_reader import Run

ONE_BY_ONE = 3
"""Of more targets than this, findings that are alike are printed once."""
SHOWN_TARGETS = 8
UNTRIED = (
    "no value was tried here, and one that helps one video makes another worse: `what-if` tracks with it and "
    "compares. Compare a value with several seeds (run --seeds 5) before you keep it: one run may be chance"
)


def diagnose(options: argparse.Namespace) -> int:
    """Print what stands out, target by target."""
    import json

    from bayesnet_track.cli.diagnose.advice import advise, find_all
    from bayesnet_track.runtime.recording.run_reader import open_run

    run = open_run(options.run, complain)
    if options.target is not None and options.target not in run.targets:
        there = ", ".join(run.targets) or "none"
        raise UsageError(f"{options.run}: no target {options.target!r}; there are {there}")
    found = list(find_all(run, options.target))
    if options.json:
        say(json.dumps({"run": str(options.run), "findings": [advise(run, one) for one in found]}))
        return OK
    tried = False
    for alike in _grouped(run, found):
        advice = advise(run, alike[0])
        tried |= advice["try"] is not None
        say("\n".join(_lines(options.run, advice)))
        if len(alike) > 1:
            say("\n".join(_others(options.run, [one.target for one in alike[1:]])))
    if tried:
        say(UNTRIED)
    elif not found:
        say(
            "nothing stands out. That a run agrees with itself does not show that the boxes are right: "
            f"`bayesnet-track score {options.run} --truth FILE` does"
        )
    return OK


def _grouped(run: Run, found: Sequence[Finding]) -> Iterator[Sequence[Finding]]:
    """Findings that are alike: one by one for a few targets, together for many."""
    groups: dict[tuple[str, ...], list[Finding]] = {}
    several = len({one.target for one in found}) > ONE_BY_ONE
    for index, one in enumerate(found):
        alike = (
            (run.kinds[one.target], one.measure, str(one.remedy), str(one.agent))
            if several
            else (str(index),)
        )
        groups.setdefault(alike, []).append(one)
    yield from groups.values()


def _others(run: str, targets: Sequence[str]) -> Iterator[str]:
    from bayesnet_track.journal.text.wording import plural

    some = ", ".join(targets[:SHOWN_TARGETS]) + (", ..." if len(targets) > SHOWN_TARGETS else "")
    yield f"  also  {plural(len(targets), 'other target')}: {some}"
    yield f"        bayesnet-track diagnose {run} --target {targets[0]}"


def _lines(run: str, one: Mapping[str, Any]) -> Iterator[str]:
    yield f"{one['type']} {one['target']}: {one['found']}"
    if one["try"] is not None:
        yield f"  try   bayesnet-track what-if {run} --set '{one['try']}'"
    elif one["key"] is not None:
        yield f"  key   {one['key']}, but not in this graph: {one['refused']}"
    elif one["seed"]:
        yield f"  try   bayesnet-track what-if {run} --seed 1"
        yield "        if another seed holds the target, chance decided; if not, no agent sees it there"
    if one["why"] is not None:
        yield f"        {one['why']}"
    if one["frame"] is not None:
        yield f"  look  bayesnet-track log {run} --why {one['frame']}"


def add_diagnose(commands: argparse._SubParsersAction[Any]) -> None:
    """Add the command."""
    parser = commands.add_parser(
        "diagnose",
        help="find what went wrong in a run, and which key to turn",
        description="Read the files of a run, report what stands out, and name a key and a value to try. "
        "Nothing is tracked again.",
    )
    parser.add_argument("run", metavar="RUN", help="run directory")
    parser.add_argument("--target", metavar="ID", help="only this target")
    parser.add_argument("--json", action="store_true", help="print one JSON object")
