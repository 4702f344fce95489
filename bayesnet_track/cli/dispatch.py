"""A parsed command line carried out: what is said before it, and errors as exit codes."""

from __future__ import annotations

import argparse
from collections.abc import Callable

from bayesnet_track.cli.arguments import (
    BAD_GRAPH,
    BAD_OUTPUT,
    BAD_SOURCE,
    USAGE,
    UsageError,
    complain,
    words,
)
from bayesnet_track.cli.parser import COMMANDS as DECLARED
from bayesnet_track.graph.text.messages import GraphError
from bayesnet_track.numerics.compile_watch import WATCH

COMPILING = "compiling kernels that no earlier command has needed: seconds, up to a minute"
TRACKING = ("demo", "run", "resume", "batch", "what-if")
LOOKS_BACK = ("log", "score", "report", "compare", "diagnose", "export")
SILENT = ("quiet", "log_json", "json")
"""Options with which nothing is said of it: somebody reads by program, or does not want to know."""

COMMANDS = {name: action for name, (_, action) in DECLARED.items() if action is not None}
"""Command -> what it does."""


def call(options: argparse.Namespace) -> int:
    """Carry out a parsed command line; the exit code.

    Expected errors become one clear message; any other is an error in the program and passes through.
    """
    try:
        _allow(options)
        _say_what_is_missing(options)
        with WATCH.notifying(notice_compiling(options)):
            return COMMANDS[options.command](options)
    except GraphError as error:
        from bayesnet_track.graph.text.explain import describe_error

        complain(describe_error(error))
        return BAD_GRAPH
    except (OSError, ValueError) as error:
        code = _code_of(error, options.command)
        if code is None:
            raise
        complain(f"bayesnet-track {options.command}: {words(error)}")
        return code


def notice_compiling(options: argparse.Namespace) -> Callable[[], None]:
    """Says once that kernels are compiled, where that is wanted: else the first run seems to hang."""
    waiting = [] if any(getattr(options, name, False) for name in SILENT) else [COMPILING]

    def notify() -> None:
        if waiting:
            complain(waiting.pop())

    return notify


def _say_what_is_missing(options: argparse.Namespace) -> None:
    """At the start of a run, on a system that is not tested."""
    from bayesnet_track.runtime import system

    if options.command in TRACKING and not options.quiet and not getattr(options, "log_json", False):
        missing = system.describe_missing()
        if missing:
            complain(missing)


def _allow(options: argparse.Namespace) -> None:
    """Let the plug-ins of other packages that the user names be loaded, and load cue files."""
    files = getattr(options, "cue_file", ())
    if files:
        from bayesnet_track.observation.cue_files import use_cue_file

        for file in files:
            use_cue_file(file)
    names = [name for given in getattr(options, "allow_plugins", ()) for name in given]
    if not names:
        return
    from bayesnet_track.observation import cue, detector, plugins

    known = {**plugins.others(cue.ENTRY_POINT_GROUP), **plugins.others(detector.ENTRY_POINT_GROUP)}
    for name in names:
        if name not in known:
            there = ", ".join(sorted(known)) or "none is installed"
            raise UsageError(f"--allow-plugins {name}: no other package has it; there are: {there}")
    plugins.allow(names)


def _code_of(error: Exception, command: str) -> int | None:
    from bayesnet_track.journal.codec import JournalError
    from bayesnet_track.journal.writer import OutputError
    from bayesnet_track.observation.cue import CueError
    from bayesnet_track.runtime.checkpoints.checkpoint import CheckpointError
    from bayesnet_track.runtime.checkpoints.recipe import RecipeError
    from bayesnet_track.runtime.checkpoints.resume import ResumeError
    from bayesnet_track.runtime.recording.beliefs import UnkeptBeliefError
    from bayesnet_track.runtime.recording.manifest import ManifestError
    from bayesnet_track.runtime.recording.rundir import RunDirectoryError
    from bayesnet_track.sources.paths import SourceError
    from bayesnet_track.vision.calibration import CalibrationError

    if isinstance(error, UsageError | CueError | UnkeptBeliefError):
        return USAGE
    unreadable = RecipeError | CheckpointError | ResumeError | ManifestError
    if isinstance(error, SourceError | JournalError | CalibrationError | unreadable):
        return BAD_SOURCE
    if isinstance(error, RunDirectoryError):
        return BAD_SOURCE if command in LOOKS_BACK else BAD_OUTPUT
    return BAD_OUTPUT if isinstance(error, OutputError) else None
