"""Python processes that this one starts: they import from where it imports, and end when it ends."""

from __future__ import annotations

import os
import signal
import sys
from contextlib import suppress

FLAGS = {"isolated": "-I", "ignore_environment": "-E", "no_user_site": "-s", "no_site": "-S"}
"""Of `sys.flags`, those that say where Python imports from -> as an option."""


def python(code: str, *arguments: str, descriptor: int = -1) -> list[str]:
    """The command that runs `code` in a process which imports from where this one does.

    Without it, Python looks in the working directory first: a file there that is named like a library would
    be run in its place. With `descriptor`, of a `tie`, the process ends when this one does.

    >>> command = python("import bayesnet_track", "argument")
    >>> command[0] == sys.executable, "-P" in command, command[-1]
    (True, True, 'argument')
    """
    options = [option for name, option in FLAGS.items() if getattr(sys.flags, name)]
    path = [folder for folder in sys.path if isinstance(folder, str)]
    lines = [f"import sys; sys.path[:] = {path!a}"]
    if descriptor >= 0:
        lines.append(f"from {__name__} import die_with; die_with({descriptor})")
    return [sys.executable, *options, "-P", "-c", "\n".join([*lines, code]), *arguments]


def tie() -> tuple[int, int]:
    """Two descriptors: a child that holds the first ends when the second is closed.

    So it is when this process ends, however it does. The first is to be closed here once the child has it. -1
    and -1 on Windows, where nothing of the kind is known.
    """
    return os.pipe() if os.name == "posix" else (-1, -1)


def cut(*descriptors: int) -> None:
    """Close what of a `tie` is held here."""
    for descriptor in descriptors:
        if descriptor >= 0:
            os.close(descriptor)


def die_with(descriptor: int) -> None:
    """End when the other end of `descriptor` closes, even amid a computation: the kernel sends a signal then.

    On Linux it is SIGKILL, which ends a process that is stopped, too. Who reads a channel notices its end;
    who computes for long, hangs or is stopped would not.
    """
    os.set_inheritable(descriptor, False)
    signal.signal(signal.SIGIO, signal.SIG_DFL)
    if not end_with(os.getpid(), descriptor):
        os._exit(1)


def end_with(process: int, descriptor: int) -> bool:
    """Let the kernel end a process that holds `descriptor`, too, when its other end closes; True if open.

    A process that was just forked may be stopped before it can ask for this itself.
    """
    import fcntl

    fcntl.fcntl(descriptor, fcntl.F_SETOWN, process)
    if hasattr(fcntl, "F_SETSIG"):
        with suppress(OSError):
            fcntl.fcntl(descriptor, fcntl.F_SETSIG, signal.SIGKILL)
    flags = fcntl.fcntl(descriptor, fcntl.F_GETFL)
    fcntl.fcntl(descriptor, fcntl.F_SETFL, flags | os.O_ASYNC | os.O_NONBLOCK)
    try:
        return os.read(descriptor, 1) != b""
    except BlockingIOError:
        return True
