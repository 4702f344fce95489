"""The decoding process of an isolated source: reads pictures, gives up its rights first, tells its parent.

Its standard input tells it what to read, as JSON behind eight bytes of length; every byte after that lends it
a slot of the memory that it shares with its parent. It answers on its standard output, in lines of JSON.
"""

from __future__ import annotations

import json
import mmap
import os
import pkgutil
import signal
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import asdict
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

from bayesnet_track.observation.image_size import PictureError
from bayesnet_track.sources.entrances.levels import explain_loss, value_range_of
from bayesnet_track.sources.entrances.notices import heard
from bayesnet_track.sources.network.flow import Flow
from bayesnet_track.sources.paths import SourceError
from bayesnet_track.sources.readers import Damage, Picture, Reader
from bayesnet_track.sources.sandbox import Limits, begin_picture, give_up_rights

SLOTS = 3
"""Pictures that may be on their way: one is read while others wait."""

SLOT_BYTES = 3 << 27
"""Room of one picture: 2^27 pixels, as the decoder may give; only what is written to takes memory."""

OUT_OF_MEMORY = 86
"""Exit code when the limit on memory is met."""

Opener = Callable[[Mapping[str, Any]], Reader]


def serve(opener: Opener) -> None:
    """Carry out one job from the standard input and leave."""
    code, answers = 1, -1
    try:
        signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C reaches the whole group; the parent decides
        job = json.loads(_exactly(int.from_bytes(_exactly(8))))
        limits, answers = Limits(**job["limits"]), os.dup(1)
        os.dup2(2, 1)  # what libraries print must not stand among the answers
        _load_libraries()
        slots = _Slots(int(job["shared"]), answers)
        _send(answers, {"is": "ready"})
        give_up_rights(limits, job["files"])
        begin_picture(limits)
        _read(opener, job, limits, slots, answers)
        code = 0
    except MemoryError:
        code = OUT_OF_MEMORY
    except (BrokenPipeError, EOFError):
        code = 0  # the parent has closed the source
    except Exception as error:
        with suppress(OSError):
            _send(answers, {"is": "failed", "reason": f"{type(error).__name__}: {error}"[:2000]})
    finally:
        os._exit(code)


def opened(job: Mapping[str, Any]) -> Reader:
    """The reader that a job asks for; raises SourceError."""
    if job["kind"] == "images":
        from bayesnet_track.sources.images import ImageReader

        return ImageReader(job["text"], [Path(path) for path in job["paths"]], value_range_of(job["range"]))
    from bayesnet_track.sources.video import VideoReader

    return VideoReader(job["text"], bool(job["network"]), value_range_of(job["range"]))


def _exactly(count: int) -> bytes:
    """So many bytes of the standard input, and none of those behind them; raises EOFError."""
    data = b""
    while len(data) < count:
        part = os.read(0, count - len(data))
        if not part:
            raise EOFError
        data += part
    return data


def _load_libraries() -> None:
    """All that is imported late: no file may be opened later on."""
    import av
    import cv2  # noqa: F401

    from bayesnet_track.sources import (
        video,  # noqa: F401
    )

    for module in pkgutil.walk_packages(av.__path__, "av."):  # some are imported when a stream is met
        if module.name not in ("av.__main__", "av.datasets"):
            import_module(module.name)
    frame = av.VideoFrame.from_ndarray(np.zeros((16, 16, 3), np.uint8), format="bgr24")
    frame.reformat(format="yuv420p").to_ndarray(format="bgr24")
    explain_loss(np.arange(64, dtype=np.float32), np.zeros(1, np.uint8))  # parts of NumPy are imported late


def _read(opener: Opener, job: Mapping[str, Any], limits: Limits, slots: _Slots, answers: int) -> None:
    notices: list[str] = []
    try:
        with heard(notices.append):
            reader = opener(job)
    except SourceError as error:
        said = {name: getattr(error, name) for name in ("given", "found", "allowed", "mend")}
        return _send(answers, {"is": "refused", **said})
    _send(
        answers,
        {
            "is": "opened",
            "declared_frames": reader.declared_frames,
            "frame_interval_s": float(reader.frame_interval_s),
            "gap_from": float(reader.gap_from),
            "notices": [text[:2000] for text in notices],
            "flow": asdict(getattr(reader, "flow", Flow())),
        },
    )
    with heard(slots.notices.append):
        for item in reader:
            if isinstance(item, Damage):
                what = {"reason": item.reason[:2000], "truncated": item.truncated}
                _send(answers, {"is": "damage", "index": item.index, **what})
            elif isinstance(item, Picture):  # files and URLs give nothing else
                slots.show(item, is_wanted=item.index >= job["start"])
            begin_picture(limits)
    _send(answers, {"is": "end"})


class _Slots:
    """Pictures into shared memory, as far as the parent has slots to lend."""

    def __init__(self, shared: int, answers: int) -> None:
        self._view, self._answers = mmap.mmap(shared, SLOTS * SLOT_BYTES), answers
        self._free = list(range(SLOTS))
        self.notices: list[str] = []

    def show(self, picture: Picture, is_wanted: bool) -> None:
        message: dict[str, Any] = {
            "is": "picture",
            "index": picture.index,
            "time": float(picture.time),
            "time_s": float(picture.time_s),
        }
        if is_wanted:
            try:
                image, has_color = picture.pixels()
                message["notices"] = [text[:2000] for text in self.notices]
                self.notices.clear()
            except PictureError as error:
                message["error"] = str(error)[:2000]
            else:
                if image.nbytes > SLOT_BYTES:
                    raise MemoryError
                slot = self._borrow()
                at = slot * SLOT_BYTES
                self._view[at : at + image.nbytes] = image.tobytes()
                height, width = image.shape[:2]
                message |= {"slot": slot, "height": height, "width": width, "has_color": has_color}
        _send(self._answers, message)

    def _borrow(self) -> int:
        if not self._free:
            returned = os.read(0, SLOTS)
            if not returned:
                raise EOFError
            self._free += returned
        return self._free.pop(0)


def _send(answers: int, message: Mapping[str, Any]) -> None:
    line = json.dumps(message).encode() + b"\n"
    while line:
        line = line[os.write(answers, line) :]
