"""The main program of a worker process: answer questions about agents until the engine goes.

``python -m bayesnet_track.runtime.executors.worker CHANNEL LIFELINE FRAMES MEMORY_MB``, open files;
it is started by `workers.Worker` only.
"""

from __future__ import annotations

import fcntl
import os
import pickle
import signal
import sys
from multiprocessing.connection import Connection


def main(arguments: list[str]) -> None:
    """Serve until the channel closes."""
    channel, lifeline, frames, memory_mb = (int(argument) for argument in arguments)
    for descriptor in (channel, lifeline, frames):
        os.set_inheritable(descriptor, False)
    _die_with(lifeline)
    _load()
    _limit(memory_mb)
    _serve(Connection(channel), frames, memory_mb > 0)


def _die_with(lifeline: int) -> None:
    """End when the other end of `lifeline` closes, even amid a computation: the kernel sends a signal then.

    A worker that waits notices its closed channel; one that computes for long, or hangs, would not.
    """
    signal.signal(signal.SIGIO, signal.SIG_DFL)
    fcntl.fcntl(lifeline, fcntl.F_SETOWN, os.getpid())
    flags = fcntl.fcntl(lifeline, fcntl.F_GETFL)
    fcntl.fcntl(lifeline, fcntl.F_SETFL, flags | os.O_ASYNC | os.O_NONBLOCK)
    try:
        gone = os.read(lifeline, 1) == b""
    except BlockingIOError:
        gone = False
    if gone:  # before the signal was asked for
        os._exit(1)


def _load() -> None:
    """Import what cues need, so that a ready worker answers at once."""
    import cv2
    import numba  # noqa: F401

    import bayesnet_track.runtime.executors.host  # noqa: F401

    cv2.setNumThreads(1)


def _limit(memory_mb: int) -> None:
    """Let the process have `memory_mb` above what it has now; 0 does not limit it."""
    if memory_mb > 0:
        import resource

        from bayesnet_track.runtime.executors.memory import own_bytes

        limit = own_bytes() + (memory_mb << 20)
        resource.setrlimit(resource.RLIMIT_AS, (limit, limit))


def _serve(channel: Connection, frames: int, is_limited: bool) -> None:
    from bayesnet_track.runtime.executors.frames import FrameView
    from bayesnet_track.runtime.executors.host import AgentHost

    host = AgentHost(FrameView(frames).get, is_limited)
    channel.send_bytes(b"ready")
    while True:
        try:
            kind, *message = pickle.loads(channel.recv_bytes())
        except (EOFError, ConnectionError):
            return
        match kind:
            case "employ":
                host.employ(*message)
            case "dismiss":
                host.dismiss(*message)
            case "ask":
                answer = host.answer(*message)
                try:
                    channel.send_bytes(pickle.dumps(answer, protocol=5))
                except ConnectionError:
                    return


if __name__ == "__main__":
    main(sys.argv[1:])
