"""The program of the fork server and of its worker processes, which answer questions about agents.

What it reads from its input are the engine's cue files.

`fork_server.ForkServer` starts it.

The fork server imports once what cues need. A worker forked from it is ready within milliseconds, and shares
that memory. It has one thread, so that forking is safe.
"""

from __future__ import annotations

import gc
import os
import signal
import socket
import sys
import time
from contextlib import suppress

from bayesnet_track.observation.child import die_with, end_with
from bayesnet_track.runtime.executors.fork_server import END_S, NUMBER, READY, UNKNOWN, WORKER
from bayesnet_track.runtime.executors.memory import limit_memory

POLL_S = 0.002


def main(control_number: int, frames: int, memory_mb: int) -> None:
    """Fork workers, and see them off, until the control channel closes.

    Args:
        control_number: descriptor of that channel.
        frames: descriptor of the frames' memory.
        memory_mb: what a worker may take above what it starts with; 0 for no limit.
    """
    for descriptor in (control_number, frames):
        os.set_inheritable(descriptor, False)
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, signal.SIG_DFL)
    control = socket.socket(fileno=control_number)
    _load(sys.stdin.buffer.read())
    children: set[int] = set()
    with suppress(ConnectionError):  # the engine has gone, perhaps while it waited for an answer
        control.sendall(NUMBER.pack(READY))
        _fork_and_reap(control, children, frames, memory_mb)
    until = time.monotonic() + END_S
    for child in children:
        _wait_for_end(child, until)


def _fork_and_reap(control: socket.socket, children: set[int], frames: int, memory_mb: int) -> None:
    """Do what the engine asks for until it closes the channel; `children` are those that are left."""
    while True:
        request, files, _, _ = socket.recv_fds(control, 1 + NUMBER.size, 2)
        if not request:
            return
        if request[:1] == WORKER:
            child = os.fork()
            if child == 0:
                control.close()
                _work(files[0], files[1], frames, memory_mb)
            children.add(child)
            if not end_with(child, files[1]):
                os.kill(child, signal.SIGKILL)
            for file in files:
                os.close(file)
            control.sendall(NUMBER.pack(child))
        else:
            (child,) = NUMBER.unpack(request[1:])
            children.discard(child)
            control.sendall(NUMBER.pack(_wait_for_end(child, time.monotonic() + END_S)))


def _load(cue_files: bytes) -> None:
    """Import what cues need, and run the engine's cue files, so that a worker answers at once."""
    import cv2
    import numba  # noqa: F401

    import bayesnet_track.inference.compile
    import bayesnet_track.numerics.kernels.kinematic_kernels
    import bayesnet_track.runtime.executors.frames
    import bayesnet_track.runtime.executors.host
    import bayesnet_track.runtime.executors.wire  # noqa: F401
    from bayesnet_track.observation.cue_files import unpack

    cv2.setNumThreads(1)
    unpack(cue_files)
    gc.collect()
    gc.freeze()  # workers share that memory, and none looks through it again


def _wait_for_end(child: int, until: float) -> int:
    """The exit code of a child, minus the signal that killed it; after `until` it is killed.

    UNKNOWN where it is no child of this fork server but of one before it.
    """
    while True:
        try:
            found, status = os.waitpid(child, os.WNOHANG)
        except ChildProcessError:
            return UNKNOWN
        if found:
            return os.waitstatus_to_exitcode(status)
        if time.monotonic() >= until:
            os.kill(child, signal.SIGKILL)
            return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
        time.sleep(POLL_S)


def _work(channel: int, lifeline: int, frames: int, memory_mb: int) -> None:
    """Be a worker; does not return."""
    code = 1
    try:
        die_with(lifeline)
        limit_memory(memory_mb)
        _serve(socket.socket(fileno=channel), frames, memory_mb > 0)
        code = 0
    except BaseException:
        sys.excepthook(*sys.exc_info())
    finally:
        os._exit(code)


def _serve(channel: socket.socket, frames: int, is_limited: bool) -> None:
    from bayesnet_track.observation.planes import Region
    from bayesnet_track.runtime.executors.frames import SLOTS, FrameView, SharedFrame
    from bayesnet_track.runtime.executors.host import AgentHost
    from bayesnet_track.runtime.executors.questions import Call
    from bayesnet_track.runtime.executors.wire import DISMISS, EMPLOY, receive, send

    host = AgentHost(FrameView(frames).get, is_limited)
    known_frames: dict[int | None, SharedFrame | None] = {None: None}
    while True:
        try:
            (kind, agent, *plain), values = receive(channel)
        except (EOFError, ConnectionError):
            return
        if kind == EMPLOY:
            host.assign(agent, *values)
            continue
        if kind == DISMISS:
            host.unassign(agent)
            continue
        method, numbers, where, next_number, forget, new = plain
        for frame in [values.pop() for _ in range(new)]:
            known_frames[frame.number] = frame
            if len(known_frames) > 4 * SLOTS:
                for number in [n for n in known_frames if n is not None and n <= frame.number - SLOTS]:
                    del known_frames[number]
        both = None if numbers is None else (known_frames[numbers[0]], known_frames[numbers[1]])
        region = None if where is None else Region(*where)
        question = Call(agent, method, both, region, tuple(values), next_number, forget)
        answer = host.answer(question)
        try:
            send(channel, (answer.raised, answer.out_of_memory, answer.seconds), answer.value)
        except ConnectionError:
            return
