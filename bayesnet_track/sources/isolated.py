"""A reader that decodes in a process of its own: what a file does to the decoder ends there.

The process may take so much memory and so much time per picture, writes no file, and opens none but its
own (`sandbox`). It hands pictures over in shared memory. When it dies, hangs or takes too much, the source is
damaged from there on, and the run goes on to its end in order.
"""

from __future__ import annotations

import json
import mmap
import os
import select
import signal
import subprocess
import tempfile
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bayesnet_track.observation.child import cut, python, tie
from bayesnet_track.observation.image_size import PictureError
from bayesnet_track.sources.decoding import OUT_OF_MEMORY, SLOT_BYTES, SLOTS
from bayesnet_track.sources.entrances.levels import ValueRange
from bayesnet_track.sources.entrances.notices import notice
from bayesnet_track.sources.images import ImageReader
from bayesnet_track.sources.network.flow import Flow
from bayesnet_track.sources.paths import SourceError
from bayesnet_track.sources.readers import Damage, Picture
from bayesnet_track.sources.sandbox import Limits

MODULE = "bayesnet_track.sources.decoding"
MAX_LINE = 1 << 16
MOST_NOTICES = 3
NETWORK_S = 30.0
"""Seconds for one picture of the network, which has its own waits."""


class IsolatedReader:
    """Pictures that another process decodes: the same as without.

    `files` are the images to read, and None reads a video; `command` is what to run in place of the decoder.

    Raises:
        SourceError: it cannot be opened, the process came to an end over it, or the system has no limits on
            processes (Windows).
    """

    def __init__(
        self,
        text: str,
        files: ImageReader | None = None,
        network: bool = False,
        start: int = 0,
        limits: Limits | None = None,
        command: Sequence[str] | None = None,
        value_range: ValueRange | None = None,
    ) -> None:
        if os.name != "posix":
            found = "this system cannot hold a process down"
            raise SourceError(text, found, "isolation on Linux and macOS", "read it without isolation")
        self._text, self._index, self._buffer = text, start, b""
        self.files, self._value_range = files, value_range
        self._limits = limits or Limits(picture_s=NETWORK_S if network else Limits.picture_s)
        self._shared = _shared_memory(SLOTS * SLOT_BYTES)
        held, self._lifeline = tie()
        environment = {**os.environ, "MALLOC_ARENA_MAX": "2", "OPENBLAS_NUM_THREADS": "1"}
        try:
            self._process = subprocess.Popen(
                command or python(f"from {MODULE} import opened, serve; serve(opened)", held=held),
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=subprocess.DEVNULL,
                bufsize=0,
                pass_fds=[self._shared, held],
                env=environment,
            )
        except BaseException:
            cut(self._shared, self._lifeline)
            raise
        finally:
            cut(held)
        try:
            self._open(network, start)
        except BaseException:
            self.close()
            raise

    def _open(self, network: bool, start: int) -> None:
        job = {
            "kind": "video" if self.files is None else "images",
            "text": self._text,
            "paths": [str(path) for path in self.files.paths] if self.files is not None else [],
            "network": network,
            "start": start,
            "range": self._value_range,
            "files": None if network else 1,
            "limits": asdict(self._limits),
            "shared": self._shared,
        }
        asked = json.dumps(job).encode()
        self._write(len(asked).to_bytes(8) + asked)
        try:
            self._message(self._limits.starting_s)
            answer = self._message(self._limits.picture_s)
            if answer["is"] == "refused":
                raise SourceError(*(str(answer[name]) for name in ("given", "found", "allowed", "mend")))
            declared = answer["declared_frames"]
            self.declared_frames = None if declared is None else int(declared)
            self.frame_interval_s = float(answer["frame_interval_s"])
            self.gap_from = float(answer["gap_from"])
            self.flow = Flow(**answer["flow"])
            _repeat(answer)
        except _Ended as error:
            mend = "check that it is whole, and where it comes from"
            raise SourceError(self._text, str(error), "a source that can be decoded", mend) from None
        except (KeyError, TypeError, ValueError, OverflowError) as error:
            if isinstance(error, SourceError):
                raise
            mend = "check where it comes from"
            raise SourceError(self._text, NONSENSE, "a source that can be decoded", mend) from None

    def __iter__(self) -> Iterator[Picture | Damage]:
        while True:
            try:
                answer = self._message(self._limits.picture_s)
                if answer["is"] == "end":
                    return
                item = self._item(answer)
            except _Ended as error:
                yield Damage(self._index, str(error))
                return
            except (KeyError, TypeError, ValueError, OverflowError):  # an index of Infinity overflows
                yield Damage(self._index, NONSENSE)
                return
            yield item

    def cancel(self) -> None:
        """End the process, from any thread; who waits for a picture is told that there is none."""
        self._process.kill()

    def close(self) -> None:
        """End the process; safe to call twice."""
        if self._shared < 0:
            return
        self._process.kill()
        self._process.wait()
        for pipe in (self._process.stdin, self._process.stdout):
            if pipe is not None:
                pipe.close()
        cut(self._shared, self._lifeline)
        self._shared = self._lifeline = -1

    def _item(self, answer: Mapping[str, Any]) -> Picture | Damage:
        index = int(answer["index"])
        if answer["is"] == "damage":
            return Damage(index, str(answer["reason"]), bool(answer["truncated"]))
        if answer["is"] != "picture":
            raise ValueError
        self._index = index + 1
        time_s = float(answer["time_s"])
        if "slot" not in answer:
            error = PictureError(str(answer.get("error", "the picture lies before the start")))
            return Picture(index, float(answer["time"]), time_s, _Refused(error))
        image, has_color = self._image(answer), bool(answer["has_color"])
        _repeat(answer)
        return Picture(index, float(answer["time"]), time_s, lambda: (image, has_color))

    def _image(self, answer: Mapping[str, Any]) -> NDArray[np.uint8]:
        """The pixels, copied out of shared memory: its slot is lent again at once."""
        slot, height, width = int(answer["slot"]), int(answer["height"]), int(answer["width"])
        if not (0 <= slot < SLOTS and height > 0 and width > 0 and 3 * height * width <= SLOT_BYTES):
            raise ValueError
        image = np.empty((height, width, 3), np.uint8)
        # Read, not mapped: the other process could cut the file short, and a mapped page would be no more.
        todo, done = memoryview(image.reshape(-1)), 0  # type: ignore[arg-type]
        while done < len(todo):
            read = os.preadv(self._shared, [todo[done:]], slot * SLOT_BYTES + done)
            if read == 0:
                raise ValueError
            done += read
        self._write(bytes([slot]))
        return image

    def _write(self, data: bytes) -> None:
        assert self._process.stdin is not None
        try:
            while data:
                data = data[self._process.stdin.write(data) or 0 :]
        except BrokenPipeError:
            pass  # it has died: the next answer tells how

    def _message(self, seconds: float) -> dict[str, Any]:
        """The next answer; raises _Ended when there is none in time."""
        assert self._process.stdout is not None
        pipe = self._process.stdout.fileno()
        until = time.monotonic() + seconds
        while b"\n" not in self._buffer:
            left = until - time.monotonic()
            poll = select.poll()
            poll.register(pipe, select.POLLIN)
            if left <= 0 or not poll.poll(max(1, round(left * 1000))):
                raise _Ended(f"the decoder hung: no picture in {seconds:g} s")
            part = os.read(pipe, MAX_LINE)
            if not part:
                raise _Ended(self._how_it_ended())
            self._buffer += part
            if len(self._buffer) > 2 * MAX_LINE:
                raise _Ended(NONSENSE)
        line, _, self._buffer = self._buffer.partition(b"\n")
        try:
            answer = json.loads(line)
        except RecursionError as error:
            raise ValueError("nested too deeply") from error
        if not isinstance(answer, dict):
            raise ValueError
        if answer.get("is") == "failed":
            raise _Ended(f"the decoder failed: {answer['reason']}")
        return answer

    def _how_it_ended(self) -> str:
        try:
            code = self._process.wait(timeout=self._limits.picture_s)
        except subprocess.TimeoutExpired:
            return NONSENSE
        if code == OUT_OF_MEMORY:
            return f"the decoder took more than {self._limits.memory_bytes >> 20} MB of memory"
        if code == -signal.SIGXCPU:
            return f"the decoder took more than {self._limits.picture_s:g} s of CPU time for a picture"
        if code < 0:
            return f"the decoder crashed ({signal.Signals(-code).name})"
        return f"the decoder ended early (exit code {code})"


NONSENSE = "the decoder gave an answer that makes no sense"


def _repeat(answer: Mapping[str, Any]) -> None:
    """Give the notices that the other process had to give."""
    for text in answer.get("notices", ())[:MOST_NOTICES]:
        notice(str(text))


class _Ended(Exception):
    """There will be no further answer; says why."""


class _Refused:
    """The pixels of a picture that cannot be converted."""

    def __init__(self, error: PictureError) -> None:
        self._error = error

    def __call__(self) -> tuple[NDArray[np.uint8], bool]:
        raise self._error


def _shared_memory(size: int) -> int:
    """A file in memory of this length, which only takes what is written to."""
    if hasattr(os, "memfd_create"):
        shared = os.memfd_create("bayesnet_track", os.MFD_CLOEXEC)
    else:
        with tempfile.TemporaryFile() as file:
            shared = os.dup(file.fileno())
    os.ftruncate(shared, -(-size // mmap.PAGESIZE) * mmap.PAGESIZE)
    return shared
