"""Pictures of a video's decoder: when they are decoded, and the pixels that they give.

Packets may wait until somebody asks for their picture. It is decoded from the last key frame that is shown no
later, or from where the decoder is if that is on the way; what nobody asks for is skipped where a key frame
follows, and in between where no other picture refers to it. The packet says what a key frame is, not the
container: a refresh in stripes is marked as one, and no picture is whole until it has passed.
"""

from __future__ import annotations

import heapq
import math
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any, Self
from weakref import ReferenceType, ref

import av
import numpy as np
from numpy.typing import NDArray

from bayesnet_track.numerics.arrays import Array
from bayesnet_track.observation.image_files import PictureError
from bayesnet_track.sources.entrances.levels import Levels
from bayesnet_track.sources.timing import Size

FAULTS = (av.error.FFmpegError, ValueError, OverflowError, MemoryError)
NETWORK_TIMEOUT_S = 10.0

REORDERED = 17
"""Pictures that are held back, more than any codec shows later than it decodes them (16)."""

KEPT = 4
"""Decoded pictures that are kept: the one before is often asked for, too."""


DEFERRABLE = frozenset({"h264", "hevc", "mjpeg"})
"""Codecs of a picture a packet that begin at a key frame, and may leave out what no other refers to."""

# NAL units, ITU-T H.264 table 7-1 and H.265 table 7-1, and the recovery point of H.264 D.1.8.
H264_SLICES, H264_IDR, H264_SEI, RECOVERY_POINT, AT_ONCE = range(1, 6), 5, 6, 6, 0b11
H265_SLICES, H265_KEYS = range(32), range(16, 22)


def begins_group(packet: Any, codec: Any) -> bool:
    """True of a picture of a `DEFERRABLE` codec from which all that are shown later are decoded exactly."""
    if codec.name == "mjpeg" or not packet.is_keyframe:
        return bool(packet.is_keyframe)
    settings, place = codec.extradata or b"", 4 if codec.name == "h264" else 21
    if len(settings) <= place or settings[0] != 1:  # units between start codes
        return False
    data, length = memoryview(packet), (settings[place] & 3) + 1
    recovers, offset = False, 0
    while offset + length < len(data):
        size, head = int.from_bytes(data[offset : offset + length], "big"), data[offset + length]
        if codec.name == "hevc" and (kind := head >> 1 & 63) in H265_SLICES:
            return kind in H265_KEYS
        if codec.name == "h264" and (kind := head & 31) in H264_SLICES:
            return kind == H264_IDR or recovers
        if codec.name == "h264" and kind == H264_SEI:
            recovers = recovers or _recovers(bytes(data[offset + length + 1 : offset + length + size]))
        offset += length + size
    return False


def _recovers(messages: bytes) -> bool:
    """True if a message of the unit says that pictures are exact from this one on."""
    offset, numbers = 0, [0, 0]
    messages = messages.replace(b"\0\0\3", b"\0\0")
    while offset + 2 < len(messages):
        for part in (0, 1):  # kind and size, the sum of bytes up to one that is not full
            numbers[part] = 0
            while offset + 1 < len(messages) and messages[offset] == 0xFF:
                numbers[part] += 0xFF
                offset += 1
            numbers[part] += int.from_bytes(messages[offset : offset + 1], "big")  # 0 where it is cut off
            offset += 1
        if numbers[0] == RECOVERY_POINT and offset < len(messages):
            return messages[offset] >> 6 == AT_ONCE  # 0 frames later, and exactly
        offset += numbers[1]
    return False


@dataclass(eq=False)
class Group:
    """A key frame and the packets up to the next one, as they are decoded.

    It keeps its own packets, and not those of the `following` one: nobody may ask for hours.
    """

    start: int
    packets: list[Any] = field(default_factory=list)
    following: ReferenceType[Group] | None = None

    @property
    def next_group(self) -> Group | None:
        """The group after it, while somebody may ask for a picture of that."""
        return None if self.following is None else self.following()


@dataclass(frozen=True, eq=False)
class Waiting:
    """A picture that can be decoded.

    Attributes:
        stamp: when it is shown, in the stream's time base.
        group: the one that it is decoded from.
        home: the one that its packet is in: of pictures shown before a key frame that is decoded first, the
            next one.
    """

    stamp: int
    group: Group
    home: Group


class DeferredDecoder:
    """The pictures of a stream in the order in which they are shown, each decoded when it is asked for."""

    def __init__(self, codec: Any) -> None:
        self._codec = codec
        self._waiting: list[tuple[int, int, Waiting]] = []
        self._packets = 0
        self._previous: Group | None = None
        self._last: Group | None = None
        self._at: Group | None = None
        self._fed = 0
        self._shown = -math.inf
        self._decoded: dict[int, Any] = {}

    def add(self, packet: Any) -> Iterator[Waiting]:
        """The pictures that are shown before all that is still to come; None: nothing is."""
        if packet is not None:
            stamp = packet.pts
            if self._last is None or begins_group(packet, self._codec):
                self._previous, self._last = self._last, Group(stamp)
                if self._previous is not None:
                    self._previous.following = ref(self._last)
            group = home = self._last
            home.packets.append(packet)
            if stamp < home.start and self._previous is not None:
                group = self._previous
            self._packets += 1
            if not getattr(packet, "is_discard", False):  # decoded, and not shown
                heapq.heappush(self._waiting, (stamp, self._packets, Waiting(stamp, group, home)))
        while len(self._waiting) > (0 if packet is None else REORDERED):
            yield heapq.heappop(self._waiting)[-1]

    def frame(self, waiting: Waiting) -> Any:
        """The decoded frame of a picture.

        Raises:
            PictureError: its packets give none.
        """
        stamp = waiting.stamp
        if stamp not in self._decoded:
            on_the_way = (waiting.group, waiting.home, waiting.home.next_group)
            if self._at is None or self._at not in on_the_way or stamp <= self._shown:
                self._codec.flush_buffers()
                self._at, self._fed, self._shown = waiting.group, 0, -math.inf
            while stamp not in self._decoded and self._shown <= stamp and self._at is not None:
                self._feed(stamp)
        if stamp not in self._decoded:
            raise PictureError("a damaged frame gave no picture")
        return self._decoded[stamp]

    def _feed(self, stamp: int) -> None:
        group = self._at
        assert group is not None
        if self._fed == len(group.packets) and group.next_group is not None:
            self._at = group = group.next_group
            self._fed = 0
        packet = group.packets[self._fed] if self._fed < len(group.packets) else None
        self._fed += 1
        self._codec.skip_frame = "NONREF" if packet is not None and packet.pts < stamp else "DEFAULT"
        try:
            frames = self._codec.decode(packet)
        except FAULTS:
            frames = []
        if packet is None:  # the decoder takes nothing more
            self._at = None
        for frame in frames:
            self._decoded[frame.pts], self._shown = frame, frame.pts
        for earlier in sorted(key for key in self._decoded if key < stamp)[:-KEPT]:
            del self._decoded[earlier]


def pixels_of(frame: Any, reformatter: Any, levels: Levels) -> tuple[NDArray[np.uint8], bool]:
    """The pixels of a decoded frame, upright, as ((H, W, 3) uint8 BGR, has_color).

    By a range the values are those of the file where it is gray, and 8 or 16 bit where it has colour. Where
    pixels can be transparent, the frame is laid over black, as images are (`levels.to_bgr`).

    Raises:
        PictureError: the pixel format cannot be converted.
    """
    name, bits = frame.format.name, max(part.bits for part in frame.format.components)
    has_color = _has_color(name)
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
        raise PictureError(f"a frame cannot be converted: {words_of(error)}") from error
    return _upright(image, _quarter_turns(frame)), has_color


@dataclass(frozen=True, eq=False)
class DecodedPicture:
    """A decoded frame of which smaller pixels are made without the whole ones (`frames.Decoded`).

    A converter keeps what it prepared for one size: there is one for the whole size and one for a smaller.
    """

    frame: Any
    converter: Any
    shrinker: Any
    levels: Levels

    @classmethod
    def from_frame(cls, frame: Any, converter: Any, shrinker: Any, levels: Levels) -> Self | None:
        """Of a frame; None where its values are looked at one by one."""
        parts = frame.format.components
        is_plain = levels.value_range is None and not any(part.is_alpha for part in parts)
        if is_plain and (_has_color(frame.format.name) or max(part.bits for part in parts) <= 8):
            return cls(frame, converter, shrinker, levels)
        return None

    @property
    def size(self) -> Size:
        """Width and height, upright."""
        size = self.frame.width, self.frame.height
        return size[::-1] if _quarter_turns(self.frame) % 2 else size

    @property
    def has_color(self) -> bool:
        """False where its format has none."""
        return _has_color(self.frame.format.name)

    def pixels(self, size: Size) -> NDArray[np.uint8]:
        """(H, W, 3) uint8 BGR, upright: the stored values are averaged over areas before they become BGR.

        Raises:
            PictureError: the pixel format cannot be converted.
        """
        if size == self.size:
            return pixels_of(self.frame, self.converter, self.levels)[0]
        turns = _quarter_turns(self.frame)
        width, height = size[::-1] if turns % 2 else size
        kind = "bgr24" if self.has_color else "gray"
        try:
            image = self.shrinker.reformat(self.frame, width, height, kind, interpolation="AREA").to_ndarray()
        except FAULTS as error:
            raise PictureError(f"a frame cannot be converted: {words_of(error)}") from error
        return _upright(image, turns)


def _has_color(name: str) -> bool:
    return not name.startswith(("gray", "mono", "ya8", "ya16"))


def _upright(image: NDArray[np.uint8], turns: int) -> NDArray[np.uint8]:
    if image.ndim == 2:
        image = np.repeat(image[:, :, np.newaxis], 3, axis=2)
    return np.ascontiguousarray(np.rot90(image, turns))


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
    """Number of quarter turns against the clock that bring the stored picture upright."""
    degrees = getattr(frame, "rotation", None)
    if degrees is None:  # PyAV 12; asking for side data leaves frames to the garbage collector
        stored = frame.side_data.get("DISPLAYMATRIX")
        matrix = np.array([1, 0]) if stored is None else np.frombuffer(stored, dtype=np.int32)
        degrees = math.degrees(-math.atan2(matrix[1], matrix[0]))
    return round(degrees / 90) % 4


def words_of(error: BaseException) -> str:
    """Text of a decoder's error."""
    if isinstance(error, av.error.ExitError):  # only the time-out asks for that
        return f"no answer within {NETWORK_TIMEOUT_S:g} s"
    return str(getattr(error, "strerror", None) or error or type(error).__name__)
