"""Video file or network stream as a source, decoded by PyAV: true times, true sizes, damage reported.

OpenCV's reader is not used: at damage it ends as if the file did, and it rescales a change of size unseen.
"""

from __future__ import annotations

import heapq
import math
from collections.abc import Iterator
from fractions import Fraction
from functools import partial
from pathlib import Path
from typing import Any

import av
import numpy as np
from av.video.reformatter import VideoReformatter
from numpy.typing import NDArray

from bayesnet_track.observation.image_files import MAX_PIXELS
from bayesnet_track.sources.decoding import (
    DEFERRABLE,
    FAULTS,
    NETWORK_TIMEOUT_S,
    DecodedPicture,
    DeferredDecoder,
    Waiting,
    begins_group,
    pixels_of,
    words_of,
)
from bayesnet_track.sources.entrances.levels import Levels, ValueRange
from bayesnet_track.sources.entrances.notices import notice
from bayesnet_track.sources.paths import SourceError, shown_address
from bayesnet_track.sources.timing import (
    Damage,
    Declared,
    Decoded,
    Flow,
    Picture,
    Pixels,
    Timing,
    declared_by,
    flow_of,
    timing_of,
)

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
    """Parts of a container that are not read, and differences of its frames from those of a player."""
    sizes = [
        f"{video.codec_context.width}x{video.codec_context.height}" for video in shown_streams(container)
    ]
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
        displayed = round(width * Fraction(aspect))
        yield (
            f"a player shows its {width}x{height} px at {displayed}x{height}, since they are not square; "
            f"frames and boxes are of the {width}x{height} stored px"
        )


def explain_frame(frame: Any) -> str | None:
    """Difference of a frame, which is turned by quarter turns, from that of a player."""
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


# Playlists and scripts (hls, concat, ...) name other files and hosts: only self-contained formats are read.
FORMATS = (
    "mov,mp4,m4a,3gp,3g2,mj2,matroska,webm,avi,mpegts,mpeg,mpegvideo,m4v,h264,hevc,av1,obu,ivf,ogg,flv,asf,"
    "mjpeg,gif,apng,nut,dv,mxf,yuv4mpegpipe,wtv,rm,swf,amv"
)
NETWORK_FORMATS = f"{FORMATS},hls,dash,rtsp,sdp,rtp,mpjpeg,live_flv"
NETWORK_PROTOCOLS = "http,https,httpproxy,tcp,tls,udp,rtp,rtsp"
PROBE_PACKETS = 300
MAX_FAILURES = 50
MOST_UNREAD = 0.1
"""Share of a Matroska file that may follow the last picture: its index, its tags, the end of the sound."""
# Titles need not be UTF-8, and are not needed. From PyAV 19 they are always read so, without an option.
TOLERANT_METADATA: dict[str, Any] = (
    {"metadata_errors": "replace"} if int(av.__version__.split(".")[0]) < 19 else {}
)
STAMPED = frozenset({"mov", "matroska"})
"""Containers in which each packet says when its picture is shown."""

# In others a packet may hold a picture that is never shown; a transport stream may begin before a key frame.
ONE_PICTURE_A_PACKET = frozenset({"h264", "hevc", "mpeg4", "mjpeg"})
END_OF_JPEG, PADDING = b"\xff\xd9", 1 << 12
"""The marker that ends an image, and how many bytes may follow it."""


class VideoReader:
    """Pictures of the first video stream, in display order and upright (a stored rotation is applied).

    A stream whose pixel format has no colour is gray; the pixels of a colour format are not looked at.
    After the last picture the declared length is compared with what was there.

    With `lazy` pictures of MP4 and Matroska files that begin with a key frame, and go on to have some, are
    decoded when their pixels are asked for, and whoever asks is told of damage.

    Attributes:
        flow: how pictures come over the network.

    Raises:
        SourceError: not a video, or none of the formats that stand on their own.
    """

    def __init__(
        self, text: str, network: bool = False, value_range: ValueRange | None = None, lazy: bool = False
    ) -> None:
        self._text = text
        self._levels = Levels(text, value_range)
        stamps: list[int] = []
        unordered, has_keys = False, False
        if not network:
            with _open(text, network) as container:
                stamps, unordered, has_keys = _probe(container, _video_stream(text, container))
        self._container = _open(text, network)
        self._stream = _video_stream(text, self._container)
        for reason in explain_stream(self._container, self._stream):
            notice(f"{shown_address(text)}: {reason}")
        self._stream.codec_context.options = {"max_pixels": str(MAX_PIXELS)}
        self._timing: Timing = timing_of(self._stream, stamps)
        self._declared: Declared = declared_by(self._container, self._stream, self._timing)
        self._bytes = 0 if network else Path(text).stat().st_size
        self.flow = flow_of(self._container, self._stream) if network else Flow()
        self._is_cut_where_unended = network and self._stream.codec_context.name == "mjpeg"
        self._broken: tuple[type[BaseException], ...] = (OSError, av.error.ExitError) if network else ()
        self._read_to = 0
        self.declared_frames = self._declared.frames
        self.frame_interval_s = self._timing.interval_s
        self.gap_from = self._timing.gap_from
        # One for all: each would start threads of its own, which end only when the frame is collected.
        self._reformatter, self._shrinking = VideoReformatter(), VideoReformatter()
        self._index = 0
        self._packets = 0
        self._silent = 0
        self._lost = 0
        self._end_s = 0.0
        # AVI has no presentation times, and some programs write decoding times in their place. Where pictures
        # are reordered, the n-th of them then has the n-th smallest decoding time.
        self._is_avi = self._container.format.name == "avi"
        unordered = (self._is_avi or unordered) and bool(self._stream.codec_context.has_b_frames)
        self._untimed: list[int] | None = [] if unordered else None
        codec, formats = self._stream.codec_context, self._container.format.name.split(",")
        is_indexed = has_keys and not unordered and not STAMPED.isdisjoint(formats)
        is_lazy = lazy and is_indexed
        self._deferred = DeferredDecoder(codec) if is_lazy else None
        self._origin: int | None = stamps[0] if stamps and self._untimed is None else None

    def close(self) -> None:
        """Let go of the file or connection."""
        self._container.close()

    def __iter__(self) -> Iterator[Picture | Damage]:
        failures = 0
        packets = self._container.demux(self._stream)
        while failures < MAX_FAILURES:
            try:
                packet = next(packets)
            except StopIteration:
                break
            except self._broken as error:
                yield Damage(self._index, f"the connection broke: {words_of(error)}")
                break
            except FAULTS as error:
                yield Damage(self._index, f"the container is damaged: {words_of(error)}")
                failures += 1
                packets = self._container.demux(self._stream)
                continue
            # An empty packet would tell the decoder that the stream is over.
            if packet.size == 0:
                continue
            failures = 0
            yield from self._decode(packet)
        yield from self._decode(None)
        yield from self._ending()

    def _decode(self, packet: Any) -> Iterator[Picture | Damage]:
        if packet is not None:
            self._packets += 1
            self._lost = 0
            self._read_to = max(self._read_to, (packet.pos or 0) + packet.size)
            self._silent += bool(getattr(packet, "is_discard", False))
            if packet.is_corrupt:
                yield Damage(self._index, "a packet is cut off or damaged")
            # The decoder would make a whole image of half a one, without a word.
            if self._is_cut_where_unended and END_OF_JPEG not in bytes(memoryview(packet)[-PADDING:]):
                yield Damage(self._index, "an image is cut off: it has no end marker")
                self._index += 1
                return
            if self._untimed is not None and packet.dts is not None:
                heapq.heappush(self._untimed, packet.dts)
        if self._deferred is not None:
            if packet is not None and packet.pts is None:
                yield Damage(self._index, "a packet does not say when its picture is shown")
                return
            for waiting in self._deferred.add(packet):
                yield self._deferred_picture(waiting)
            return
        try:
            frames = self._stream.codec_context.decode(packet)
        except FAULTS as error:
            yield Damage(self._index, f"the decoder refused a frame: {words_of(error)}")
            if packet is not None:
                self._lost = int(packet.is_corrupt)  # the last one is where the file was cut
                self._index += 1
                if self._untimed and packet.dts in self._untimed:
                    self._untimed.remove(packet.dts)
                    heapq.heapify(self._untimed)
            return
        for frame in frames:
            picture = self._picture(frame)
            if isinstance(picture, Picture):
                self._index += 1
            yield picture

    def _deferred_picture(self, waiting: Waiting) -> Picture | Damage:
        deferred, is_first = self._deferred, self._index == 0
        assert deferred is not None

        def make_pixels() -> tuple[NDArray[np.uint8], bool]:
            frame = deferred.frame(waiting)
            self._explain(frame, is_first)
            return pixels_of(frame, self._reformatter, self._levels)

        picture = self._picture_at(waiting.stamp, make_pixels)
        self._index += isinstance(picture, Picture)
        return picture

    def _explain(self, frame: Any, is_first: bool) -> None:
        if is_first and (reason := explain_frame(frame)) is not None:
            notice(f"{shown_address(self._text)}: {reason}")

    def _picture(self, frame: Any) -> Picture | Damage:
        if self._untimed is not None:
            stamp = heapq.heappop(self._untimed) if self._untimed else None
        else:
            stamp = frame.pts if frame.pts is not None else frame.dts
        self._explain(frame, self._index == 0)
        pixels = partial(pixels_of, frame, self._reformatter, self._levels)
        return self._picture_at(
            stamp, pixels, DecodedPicture.from_frame(frame, self._reformatter, self._shrinking, self._levels)
        )

    def _picture_at(
        self, stamp: int | None, pixels: Pixels, decoded: Decoded | None = None
    ) -> Picture | Damage:
        if stamp is None:
            time = self._end_s / self.frame_interval_s
        else:
            self._origin = stamp if self._origin is None else self._origin
            time = self._timing.intervals(stamp - self._origin)
        seconds = time * self.frame_interval_s
        limit = self._declared.duration_s
        if limit is not None and seconds > limit + 1.0:
            return Damage(
                self._index, f"a frame's time, {seconds:.3f} s, is past the declared end, {limit:.3f} s"
            )
        self._end_s = max(self._end_s, seconds + self.frame_interval_s)
        return Picture(self._index, time, seconds, pixels, decoded=decoded)

    def _ending(self) -> Iterator[Damage]:
        frames, duration = self._stream.frames, self._declared.duration_s
        blank = self._packets - self._silent - self._index
        has_duration = self._declared.duration_s is not None
        if has_duration and blank > 0 and self._stream.codec_context.name in ONE_PICTURE_A_PACKET:
            yield Damage(self._index, f"{blank} damaged frames gave no picture")
        end = self._end_s
        if self._declared.from_zero and self._origin is not None:
            end += float(self._origin * self._timing.tick)
        if frames > 0:
            # AVI counts the frames that were left out, too.
            read = max(self._packets - self._lost, round(end / self.frame_interval_s) if self._is_avi else 0)
            if read < frames:
                yield Damage(self._index, f"the file is truncated: read {read} of {frames} frames", True)
        elif duration is not None and end < duration - self._declared.slack_s:
            read_of = f"{self._index} of {self.declared_frames} frames, " if self.declared_frames else ""
            reason = f"the file is truncated: read {read_of}{end:.3f} of {duration:.3f} s"
            yield Damage(self._index, reason, True)
        elif duration is None and "matroska" in self._container.format.name:
            # Written live, it declares no length, but ends with a picture.
            unread = self._bytes - self._read_to
            if unread > MOST_UNREAD * self._bytes:
                reason = f"the file declares no length, and {unread} of its {self._bytes} bytes were not read"
                yield Damage(self._index, reason, True)


def _open(text: str, network: bool) -> Any:
    options = {"protocol_whitelist": NETWORK_PROTOCOLS, "format_whitelist": NETWORK_FORMATS}
    if not network:
        # The explicit protocol keeps FFmpeg from reading a protocol into the file's name.
        options = {"protocol_whitelist": "file", "format_whitelist": FORMATS}
    name = text if network else f"file:{Path(text).absolute()}"
    timeout = (NETWORK_TIMEOUT_S, NETWORK_TIMEOUT_S) if network else None
    try:
        return av.open(name, mode="r", options=options, timeout=timeout, **TOLERANT_METADATA)
    except FAULTS as error:
        if network:
            raise _unreachable(text, words_of(error)) from error
        raise _not_a_video(text, words_of(error)) from error


def _unreachable(text: str, fault: str) -> SourceError:
    return SourceError(
        text,
        f"nothing to be watched at this address: {fault}",
        "an address that a video player opens",
        "check it, and user and password (http://USER:PASSWORD@HOST/...)",
    )


def _video_stream(text: str, container: Any) -> Any:
    for stream in shown_streams(container):
        return stream
    raise _not_a_video(text, "no video stream that can be decoded in it")


def _not_a_video(text: str, fault: str) -> SourceError:
    return SourceError(
        text,
        f"not a readable video: {fault}",
        "videos that FFmpeg reads and that stand on their own (MP4, MKV, AVI, TS, ...)",
        "check that the file is whole; an MP4 whose writing was cut short has lost its index",
    )


def _probe(container: Any, stream: Any) -> tuple[list[int], bool, bool]:
    """The sorted times of the first packets, in the stream's time base, and whether all are decoding times.

    Every picture up to the last decoding time is among them; later ones would leave holes. The last is
    whether the first packet begins a group, and another does where there are so many.
    """
    stamps: list[int] = []
    known_until: int | None = None
    all_decoding, groups = True, list[bool]()
    is_stamped = stream.codec_context.name in DEFERRABLE
    try:
        for packet in container.demux(stream):
            stamp = packet.pts if packet.pts is not None else packet.dts
            is_stamped = is_stamped and (packet.pts is not None or not packet.size)
            if packet.size and stamp is not None and not getattr(packet, "is_discard", False):
                stamps.append(stamp)
                known_until = packet.dts if packet.dts is not None else known_until
                all_decoding = all_decoding and stamp == packet.dts
                groups.append(is_stamped and begins_group(packet, stream.codec_context))
            if len(stamps) >= PROBE_PACKETS:
                break
    except FAULTS:
        pass
    has_keys = groups[:1] == [True] and (sum(groups) > 1 or len(stamps) < PROBE_PACKETS)
    ordered = sorted(stamp for stamp in stamps if known_until is None or stamp <= known_until)
    return ordered, all_decoding, has_keys
