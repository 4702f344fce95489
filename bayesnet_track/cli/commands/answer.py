"""How a command answers: its exit code, what it says, and what it says when the user made a mistake."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path
from typing import TextIO

from bayesnet_track.sources.paths import hide_secrets

OK, FAILED, USAGE, BAD_GRAPH, BAD_SOURCE, INCOMPLETE, BAD_OUTPUT = range(7)


class UsageError(ValueError):
    """Arguments that make no sense, alone or together."""


@contextmanager
def users_mistake() -> Iterator[None]:
    """What fails inside does so because of an argument, or of a file that one names: `UsageError`."""
    from bayesnet_track.journal.codec import JournalError

    try:
        yield
    except JournalError:
        raise
    except (OSError, ValueError) as error:
        raise UsageError(words(error)) from error


@contextmanager
def users_file(option: str, expected: str) -> Iterator[None]:
    """`users_mistake` for the file of an option; one that cannot be read is said with what it should hold."""
    from bayesnet_track.sources.mot_lines import NotTextError

    with users_mistake():
        try:
            yield
        except (OSError, NotTextError) as error:
            raise UsageError(f"{option} {words(error)}; expected {expected}") from error


def writing(path: Path) -> AbstractContextManager[None]:
    """What the system refuses inside it is about an output: `OutputError`, which names it."""
    from bayesnet_track.journal import writer

    return writer.writing(path)


def check_free(path: Path, overwrite: bool) -> None:
    """Refuse to write over another file unless that is asked for; raises OutputError."""
    from bayesnet_track.journal.disk import is_there
    from bayesnet_track.journal.writer import OutputError

    with writing(path):
        if is_there(path) and not overwrite:
            raise OutputError(f"{path}: it is there already; --overwrite replaces it")


def words(error: Exception) -> str:
    """An error as a message; the system's own in the form "file: what is wrong"."""
    if isinstance(error, OSError) and error.filename is not None and error.strerror is not None:
        return f"{error.filename}: {error.strerror}"
    return str(error)


def say(text: str) -> None:
    """Print a result."""
    sys.stdout.write(text + "\n")


def complain(message: str) -> None:
    """Print what is wrong."""
    run_silently(lambda: sys.stderr.write(hide_secrets(message) + "\n"))


def run_silently(show: Callable[[], object]) -> None:
    """Write to stderr; that nobody reads it any more stops nothing."""
    try:
        show()
    except BrokenPipeError:
        mute(sys.stderr)


def mute(stream: TextIO) -> None:
    """Let what is written go nowhere: at its end the interpreter would complain of a reader that is gone."""
    nowhere = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, stream.fileno())
    os.close(nowhere)
