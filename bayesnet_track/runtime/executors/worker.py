"""The program of the fork server and of its workers: cues at work in another process.

`workers.ForkServer` starts it; its input are the engine's cue files. The fork server imports once what cues
need. A worker forked from it is ready within milliseconds, and shares that memory. It has one thread, so that
forking is safe. It holds nothing between frames but copies of what the engine told it, so that a new one
answers alike.
"""

from __future__ import annotations

import ctypes
import gc
import os
import signal
import socket
import sys
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from bayesnet_track.observation.child import die_with, end_with
from bayesnet_track.observation.cue import FAULTS, AnyCue, Measurement, foreign_part, real_numbers, text_of
from bayesnet_track.observation.planes import Frame, FramePair, PlaneCache, shown
from bayesnet_track.runtime.executors.messages import (
    LEARN_AND_BLEND,
    CallOutcome,
    CueCall,
    Dismiss,
    Employ,
    EncodedReference,
    Foreign,
    Received,
    receive,
    send,
)
from bayesnet_track.runtime.executors.workers import END_S, NUMBER, READY, UNKNOWN, WORKER


def own_bytes() -> int:
    """Address space of this process, bytes; on systems that do not tell, its largest resident size."""
    try:
        import resource

        pages = int(Path("/proc/self/statm").read_text().split()[0])
        return pages * resource.getpagesize()
    except OSError:
        import resource

        return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss << 10


def limit_memory(megabytes: int) -> None:
    """Let this process have so much above what it has now; 0 does not limit it."""
    if megabytes > 0:
        import resource

        limit = own_bytes() + (megabytes << 20)
        resource.setrlimit(resource.RLIMIT_AS, (limit, limit))


CACHES = 2
"""Pairs of frames whose planes are kept."""


class AgentHost:
    """Cues by agent, the planes of the current frames, and the references that were told.

    `frame_of` fetches a frame from where `Call.frames` says that it lies; `is_limited` says that memory
    is, so that running out of it is nothing that the cue does everywhere.
    """

    def __init__(self, frame_of: Callable[[Any], Frame], is_limited: bool = False) -> None:
        self._frame_of, self._is_limited = frame_of, is_limited
        self._cues: dict[str, AnyCue] = {}
        self._received = Received()
        self._caches: dict[tuple[int, int], PlaneCache] = {}

    def assign(self, agent: str, make: Callable[[Any], AnyCue], parameters: Any) -> None:
        """Make the cue of an agent."""
        self._cues[agent] = make(parameters)

    def unassign(self, agent: str) -> None:
        """Drop the cue of an agent."""
        self._cues.pop(agent, None)

    def answer(self, question: CueCall) -> CallOutcome:
        """Ask the cue; an exception that it raises becomes part of the answer."""
        began_s = time.perf_counter()
        try:
            value = self._ask(question)
            return CallOutcome(value, seconds=time.perf_counter() - began_s)
        except FAULTS as error:  # a guest's code: the engine decides what comes of it
            seconds = time.perf_counter() - began_s
            if self._is_limited and _is_shortage(error):
                return CallOutcome(out_of_memory=True, seconds=seconds)
            return CallOutcome(raised=(type(error).__name__, text_of(error)), seconds=seconds)

    def _ask(self, question: CueCall) -> Any:
        received = self._received
        received.forget(question.forget)
        cue: Any = self._cues[question.agent]
        arguments: list[Any] = [
            shown(received.reference(part)) if isinstance(part, EncodedReference) else part
            for part in question.arguments
        ]
        if question.frames is not None:
            assert question.region is not None
            planes = self._cache(question.frames).planes(cue.needs, question.region)
            arguments.insert(1 if question.method == LEARN_AND_BLEND else 0, planes)
        if question.method == LEARN_AND_BLEND:
            learn, planes_of_question, learned, rate, *box = arguments
            returned = cue.blend(learned, getattr(cue, learn)(planes_of_question, *box), rate)
        else:
            returned = getattr(cue, question.method)(*arguments)
        match question.method:
            case "log_likelihood":
                numbers = real_numbers(returned)
                return Foreign(numbers) if isinstance(numbers, str) else numbers
            case "measure":
                return _measurement(returned)
            case "open" | "read_next":  # of a stream: what is known of it, frames without pixels, and events
                return returned
        if returned is None and question.method == "adapt":
            return None
        # As the engine looks at what a cue learnt: what is no mapping fails in the same words.
        reference: Mapping[str, Any] = dict(returned.items())
        references = [part for part in question.arguments if isinstance(part, EncodedReference)]
        return received.encode(reference, references, question.next_number)

    def _cache(self, frames: tuple[Any, Any]) -> PlaneCache:
        current, previous = frames
        key = (current.number, -1 if previous is None else previous.number)
        cache = self._caches.get(key)
        if cache is None:
            while len(self._caches) >= CACHES:
                del self._caches[next(iter(self._caches))]
            pair = FramePair(self._frame(current), None if previous is None else self._frame(previous))
            cache = self._caches[key] = PlaneCache(pair)
        return cache

    def _frame(self, place: Any) -> Frame:
        """The frame of a place: of a stream that is here, or in the shared memory."""
        stream: Any = self._cues.get(getattr(place, "stream", ""))
        frame: Frame = self._frame_of(place) if stream is None else stream.frame(place.number)
        return frame


def _measurement(returned: Any) -> Measurement | Foreign | None:
    """A measurement of plain arrays, which the engine checks; another object as what it is not."""
    if returned is None:
        return None
    is_measurement = isinstance(returned, Measurement)
    foreign = foreign_part(returned) if is_measurement else type(returned).__name__
    if foreign:
        return Foreign(foreign)
    fields = tuple(str(name) for name in returned.fields)
    mean, covariance = np.array(returned.mean, float), np.array(returned.covariance, float)
    choices: list[tuple[float, Measurement]] = []
    for weight, choice in returned.choices:
        measured = _measurement(choice)
        if not isinstance(measured, Measurement):
            return Foreign("Measurement with a choice that is none")
        choices.append((float(weight), measured))
    return Measurement(fields, mean, covariance, returned.floor, tuple(choices), returned.confidence)


def _is_shortage(error: BaseException) -> bool:
    return isinstance(error, MemoryError) or "Insufficient memory" in text_of(error)


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
    deadline = time.monotonic() + END_S
    for child in children:
        _wait_for_end(child, deadline)


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
    import bayesnet_track.numerics.kernels.box_kernels
    import bayesnet_track.runtime.executors.frames  # noqa: F401
    from bayesnet_track.observation.cue_files import unpack_cue_files

    cv2.setNumThreads(1)
    unpack_cue_files(cue_files)
    gc.collect()
    gc.freeze()  # workers share that memory, and none looks through it again


def _wait_for_end(child: int, deadline: float) -> int:
    """The exit code of a child, minus the signal that killed it; after `deadline` it is killed.

    UNKNOWN where it is no child of this fork server but of one before it.
    """
    while True:
        try:
            ended, status = os.waitpid(child, os.WNOHANG)
        except ChildProcessError:
            return UNKNOWN
        if ended:
            return os.waitstatus_to_exitcode(status)
        if time.monotonic() >= deadline:
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
    """Answer questions until the channel closes; `frames` is -1 where no memory is shared."""
    from bayesnet_track.runtime.executors.frames import FrameView

    host = AgentHost(FrameView(frames).get, is_limited)
    with suppress(EOFError, ConnectionError):
        while True:
            match receive(channel):
                case Employ(agent, make, parameters):
                    host.assign(agent, make, parameters)
                case Dismiss(agent):
                    host.unassign(agent)
                case question:
                    send(channel, host.answer(question))


NAMES = ("scipy_openblas_{}64_", "scipy_openblas_{}", "openblas_{}64_", "openblas_{}")


@contextmanager
def one_thread_inside(opencv: bool) -> Iterator[None]:
    """While entered, NumPy's matrix products use one thread each, and so do, with `opencv`, its functions.

    The last bits of a matrix product depend on the number of its threads. Workers have one, and so the engine
    must, for the same bytes; none of OpenCV's functions that are used here depends on it.
    """
    import cv2

    blas = _blas()
    thread_counts = cv2.getNumThreads(), [get() for get, _ in blas]
    if opencv:
        cv2.setNumThreads(1)
    for _, set_threads in blas:
        set_threads(1)
    try:
        yield
    finally:
        if opencv:
            cv2.setNumThreads(thread_counts[0])
        for (_, set_threads), threads in zip(blas, thread_counts[1], strict=True):
            set_threads(threads)


@cache
def _blas() -> list[tuple[Any, Any]]:
    """Functions that get and set the number of threads of each OpenBLAS in the wheels of NumPy and SciPy."""
    site = Path(np.__file__).parent.parent
    functions = []
    for package in ("numpy", "scipy"):
        if package not in sys.modules:
            continue
        for file in sorted((site / f"{package}.libs").glob("*openblas*")):
            try:
                library = ctypes.CDLL(str(file))
            except OSError:
                continue
            for name in NAMES:
                get = getattr(library, name.format("get_num_threads"), None)
                set_threads = getattr(library, name.format("set_num_threads"), None)
                if get is not None and set_threads is not None:
                    functions.append((get, set_threads))
                    break
    return functions


class CameraHost:
    """The host of a camera as a Ray actor."""

    def serve(self, address: tuple[str, int], token: bytes, cue_files: bytes) -> None:
        """Connect to the engine at `address`, say which machine this is, and answer until it goes."""
        from bayesnet_track.runtime.checkpoints.origins import describe_machine

        with socket.create_connection(address) as channel:
            channel.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            channel.sendall(token)
            _load(cue_files)
            send(channel, dict(describe_machine()))
            with one_thread_inside(opencv=True):
                _serve(channel, -1, False)
