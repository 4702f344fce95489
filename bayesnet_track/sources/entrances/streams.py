"""The pixels of a decoded frame, and what of a video file is not shown as it stands there."""

from __future__ import annotations

import math
from collections.abc import Iterator
from fractions import Fraction
from typing import Any

import av
import numpy as np
from numpy.typing import NDArray

from bayesnet_track.numerics.arrays import Array
from bayesnet_track.observation.image_headers import PictureError
from bayesnet_track.sources.entrances.levels import Levels

FAULTS = (av.error.FFmpegError, ValueError, OverflowError, MemoryError)
NETWORK_TIMEOUT_S = 10.0
ATTACHED_PICTURE = 0x0400
LEAST_TURN = 1.0
"""Degrees by which a stored rotation may differ from quarter turns."""


def shown_streams(container: Any) -> Iterator[Any]:
    """The video streams of a container that can be decoded and are no cover picture."""
    for stream in container.streams.video:
        if stream.codec_context is None:  # and PyAV 12 would say that its flags are None
            continue
        # A cover picture is a video stream of one frame. Its flag is an enum or, in older versions, absent.
        flags = getattr(stream, "disposition", 0)
        if not getattr(flags, "value", flags) & ATTACHED_PICTURE:
            yield stream


def explain_stream(container: Any, stream: Any) -> Iterator[str]:
    """What of a container is not read, and how its frames differ from what a player shows."""
    sizes = [f"{one.codec_context.width}x{one.codec_context.height}" for one in shown_streams(container)]
    if len(sizes) > 1:
        yield (
            f"{len(sizes)} video streams, {', '.join(sizes)}; the first one is read "
            "(`ffmpeg -i FILE -map 0:v:1 -c copy OTHER` takes out the second)"
        )
    if stream.metadata.get("alpha_mode") == "1" and "a" not in stream.codec_context.pix_fmt.split("p")[0]:
        yield "its alpha channel cannot be decoded here: frames are opaque, as if nothing were transparent"
    aspect = getattr(stream, "sample_aspect_ratio", None) or stream.codec_context.sample_aspect_ratio
    if aspect and Fraction(aspect) != 1:
        width, height = stream.codec_context.width, stream.codec_context.height
        shown = round(width * Fraction(aspect))
        yield (
            f"a player shows its {width}x{height} px at {shown}x{height}, since they are not square; frames "
            f"and boxes are of the {width}x{height} stored px"
        )


def explain_frame(frame: Any) -> str | None:
    """How a frame, which is turned by quarter turns, differs from what a player shows."""
    stored = frame.side_data.get("DISPLAYMATRIX")
    if stored is None:
        return None
    a, b, _, c, d = (int(value) for value in np.frombuffer(stored, dtype=np.int32)[:5])
    if a * d - b * c < 0:
        return "a player shows it mirrored; frames are not mirrored, only turned"
    degrees = math.degrees(math.atan2(b, a))
    if abs(degrees - 90.0 * round(degrees / 90.0)) > LEAST_TURN:
        return f"a player turns it by {degrees:.0f} degrees; frames are turned by quarter turns only"
    return None


def pixels_of(frame: Any, reformatter: Any, levels: Levels) -> tuple[NDArray[np.uint8], bool]:
    """The pixels of a decoded frame, upright, as ((H, W, 3) uint8 BGR, has_color).

    By a range the values are those of the file where it is gray, and 8 or 16 bit where it has colour. Where
    pixels can be transparent, the frame is laid over black, as images are (`levels.to_bgr`).

    Raises:
        PictureError: the pixel format cannot be converted.
    """
    name, bits = frame.format.name, max(part.bits for part in frame.format.components)
    has_color = not name.startswith(("gray", "mono", "ya8", "ya16"))
    is_clear = any(part.is_alpha for part in frame.format.components)
    is_wide = levels.value_range is not None and bits > 8
    try:
        if is_clear:
            wide = "bgra64le" if is_wide else "bgra"
            image = levels(_samples(frame if name == wide else reformatter.reformat(frame, format=wide)))[0]
        elif levels.value_range is not None:
            wide = ("bgr48le" if is_wide else "bgr24") if has_color else _plain_gray(name, bits)
            image = levels(_samples(frame if name == wide else reformatter.reformat(frame, format=wide)))[0]
        else:
            image = reformatter.reformat(frame, format="bgr24" if has_color else "gray").to_ndarray()
            if bits > 8 and not has_color:  # a colour format says itself which values are black and white
                wide = _plain_gray(name, bits)
                stored = frame if name == wide else reformatter.reformat(frame, format=wide)
                levels.look(_samples(stored), image)
    except FAULTS as error:
        raise PictureError(f"a frame cannot be converted: {words(error)}") from error
    if image.ndim == 2:
        image = np.repeat(image[:, :, np.newaxis], 3, axis=2)
    return np.ascontiguousarray(np.rot90(image, _quarter_turns(frame))), has_color


def _plain_gray(name: str, bits: int) -> str:
    """The format in which the values of a gray one are read: its own where it has nothing else."""
    return name if name.startswith("gray") else "gray16le" if bits > 8 else "gray"


def _samples(frame: Any) -> Array:
    """The values of a packed frame as they are stored, (H, W), (H, W, 3) or (H, W, 4)."""
    name, bits = frame.format.name, max(part.bits for part in frame.format.components)
    channels = 4 if name.startswith("bgra") else 3 if name.startswith("bgr") else 1
    kind = "u1" if bits <= 8 else "f4" if bits == 32 else "u2"
    values = np.frombuffer(frame.planes[0], f"{'>' if name.endswith('be') else '<'}{kind}")
    rows = values.reshape(frame.planes[0].height, -1)[:, : channels * frame.width]
    image = rows.astype(np.dtype(kind))
    return image if channels == 1 else image.reshape(*rows.shape[:1], -1, channels)


def _quarter_turns(frame: Any) -> int:
    """How many quarter turns against the clock bring the stored picture upright."""
    degrees = getattr(frame, "rotation", None)
    if degrees is None:  # PyAV 12; asking for side data leaves frames to the garbage collector
        stored = frame.side_data.get("DISPLAYMATRIX")
        matrix = np.array([1, 0]) if stored is None else np.frombuffer(stored, dtype=np.int32)
        degrees = math.degrees(-math.atan2(matrix[1], matrix[0]))
    return round(degrees / 90) % 4


def words(error: BaseException) -> str:
    """What a fault of a decoder says."""
    if isinstance(error, av.error.ExitError):  # only the time-out asks for that
        return f"no answer within {NETWORK_TIMEOUT_S:g} s"
    return str(getattr(error, "strerror", None) or error or type(error).__name__)
