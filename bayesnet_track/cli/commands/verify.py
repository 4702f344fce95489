"""The command `verify`: whether the files of a run are what it wrote."""

from __future__ import annotations

import argparse
import json
from typing import TYPE_CHECKING, Any

from bayesnet_track.cli.commands.answer import BAD_SOURCE, INCOMPLETE, OK, say

if TYPE_CHECKING:
    from bayesnet_track.runtime.recording.verify import Verified

SAID = {
    "missing": "missing",
    "truncated": "truncated since it was written",
    "changed": "changed since it was written",
    "extra": "not of this run",
}
WITHOUT = {
    "unfinished": "unfinished: it has no manifest to compare with; `bayesnet-track resume {run}` finishes it",
    "running": "a process is writing it now; verify it when it has ended",
}


def verify(options: argparse.Namespace) -> int:
    """Compare a run with its manifest."""
    from bayesnet_track.runtime.recording.verify import verify

    found = verify(options.run)
    if options.json:
        held = {"run": options.run, "status": found.status, "result": found.result, "outputs": found.outputs}
        say(json.dumps(held, indent=1))
    else:
        _report(options.run, found)
    return {"verified": OK, "changed": BAD_SOURCE}.get(found.status, INCOMPLETE)


def _report(run: str, found: Verified) -> None:
    if found.status in WITHOUT:
        say(f"{run}: {WITHOUT[found.status].format(run=run)}")
        return
    wrong = {name: finding for name, finding in found.outputs.items() if finding != "ok"}
    for name, finding in wrong.items():
        say(f"{run}/{name}: {SAID[finding]}")
    if wrong:
        say(f"{run}: changed: {len(wrong)} of {len(found.outputs)} files are not as the run left them")
    else:
        say(f"{run}: verified: {len(found.outputs)} files, result {found.result}")


def add_verify(commands: argparse._SubParsersAction[Any]) -> None:
    """Add the command."""
    verify = commands.add_parser(
        "verify",
        help="check that the files of a finished run are unchanged",
        description="Compare every file of a run with the size and SHA-256 in its manifest.json. Exit code 0:"
        " all are unchanged; 4: a file was changed, truncated, removed or added, or this is no "
        "run; 5: the run is unfinished (`resume` finishes it) or still being written.",
    )
    verify.add_argument("run", metavar="RUN", help="run directory")
    verify.add_argument("--json", action="store_true", help="print what was found as JSON")
