"""Videos: true times and sizes, gaps, changes of size, gray, and what is refused."""

import struct
from dataclasses import fields
from fractions import Fraction

import av
import numpy as np
import pytest

from bayesnet_track.journal.events.runs import FrameSizeChanged, FramesMissing, SourceDamaged
from bayesnet_track.observation.planes import Frame
from bayesnet_track.sources.sources import SourceError, open_source
from bayesnet_track.sources.timing import Timing, timing_of

CONTAINERS = [
    ("a.mp4", "libx264"),
    ("a.mkv", "libx264"),
    ("a.avi", "mpeg4"),
    ("b.avi", "libx264"),
    ("a.ts", "libx264"),
    ("a.webm", "libvpx"),
]


def read(path, **settings):
    with open_source(str(path), **settings) as source:
        items = list(source)
    return source, [i for i in items if isinstance(i, Frame)], [i for i in items if not isinstance(i, Frame)]


@pytest.mark.parametrize(("name", "codec"), CONTAINERS)
@pytest.mark.parametrize(
    "rate", [Fraction(30000, 1001), *(pytest.param(rate, marks=pytest.mark.slow) for rate in (25, 30, 60))]
)
def test_a_gapless_video_has_times_0_1_2(make_video, name, codec, rate):
    source, frames, events = read(make_video(name, codec=codec, rate=rate))
    assert events == []
    assert [f.time for f in frames] == [float(n) for n in range(40)]
    assert [f.index for f in frames] == list(range(40))
    assert source.frame_interval_s == pytest.approx(float(1 / Fraction(rate)), rel=1e-9)
    assert frames[10].time_s == pytest.approx(10 / float(rate), rel=1e-9)
    assert (source.width, source.height, source.has_color) == (64, 48, True)
    assert source.end_reason == "end_of_source"
    assert source.frames == 40


@pytest.mark.parametrize(("name", "declared"), [("a.mp4", 40), ("a.mkv", 40), ("a.avi", 40), ("a.ts", None)])
def test_the_declared_number_of_frames(make_video, name, declared):
    source, _, _ = read(make_video(name))
    assert source.declared_frames == declared


def test_lossless_pixels_come_out_as_they_went_in(make_video):
    _, frames, _ = read(make_video("a.mkv", codec="ffv1", pix="bgr0"))
    from_first = frames[3].image[5:15, 6:16]
    assert frames[3].image.dtype == np.uint8
    assert np.array_equal(from_first, np.broadcast_to((40, 120, 250), (10, 10, 3)))


def test_a_gray_video_has_no_color_and_equal_channels(make_video):
    source, frames, _ = read(make_video("a.mkv", codec="ffv1", pix="gray"))
    assert not source.has_color
    assert not frames[0].has_color
    assert np.array_equal(frames[0].image[..., 0], frames[0].image[..., 2])
    assert np.ptp(frames[0].image) > 100


def test_sixteen_bit_gray_video_is_read(make_video):
    source, frames, _ = read(make_video("a.mkv", codec="ffv1", pix="gray16le"))
    assert not source.has_color
    assert frames[0].image.shape == (48, 64, 3)


@pytest.mark.parametrize("name", ["a.mp4", "a.mkv", "a.avi"])
def test_missing_frames_are_a_jump_in_time_with_an_event(make_video, name):
    stamps = [n for n in range(50) if not 20 <= n < 30]
    source, frames, events = read(make_video(name, stamps=stamps))
    assert [f.time for f in frames] == [float(n) for n in stamps]
    assert events == [FramesMissing(20, 10.0)]
    assert source.end_reason == "end_of_source"


@pytest.mark.parametrize("name", ["a.mp4", "a.mkv"])
def test_a_variable_rate_keeps_true_times_and_is_no_gap(make_video, name):
    rng = np.random.default_rng(5)
    steps = rng.choice([2, 3, 4, 5, 6], size=59)
    stamps = [0, *np.cumsum(steps).tolist()]
    source, frames, events = read(make_video(name, stamps=stamps, rate=100))
    assert events == []
    assert source.end_reason == "end_of_source"
    # Seconds are exact to the container's tick, at most 1 ms.
    assert np.allclose([f.time_s for f in frames], np.array(stamps) / 100, atol=1.001e-3)
    assert source.frame_interval_s == pytest.approx(np.median(steps) / 100)


def test_time_that_stands_still_ends_the_source(make_video, monkeypatch):
    path = make_video("a.mkv")
    monkeypatch.setattr(Timing, "intervals", lambda self, ticks: min(ticks // 40, 7) + 0.0)
    source, frames, events = read(path)
    assert len(frames) == 8
    assert [(type(e), e.frame) for e in events] == [(SourceDamaged, 8)]
    assert "time runs backwards or stands still" in events[0].reason
    assert source.end_reason == "source_damaged"


def test_decoding_times_in_place_of_presentation_times_are_put_in_order(tmp_path):
    """As some programs write them: where pictures are reordered, their times would run backwards."""
    path, packets = tmp_path / "decoding.mp4", []
    with av.open(str(path), "w") as container:
        stream = container.add_stream("libx264", rate=25, options={"bf": "2", "b-adapt": "0"})
        stream.width, stream.height, stream.pix_fmt = 64, 48, "yuv420p"
        for n in [*range(20), None]:
            frame = None
            if n is not None:
                frame = av.VideoFrame.from_ndarray(np.full((48, 64, 3), 10 * n, np.uint8), format="bgr24")
                frame.pts, frame.time_base = n, Fraction(1, 25)
            packets += stream.encode(frame)
        first = packets[0].dts
        assert any(packet.pts - packet.dts != packets[0].pts - first for packet in packets)
        for packet in packets:
            packet.pts = packet.dts = packet.dts - first
            container.mux(packet)
    source, frames, events = read(path)
    assert events == [] and source.end_reason == "end_of_source"
    assert [f.time for f in frames] == [float(n) for n in range(20)]
    assert [round(f.image.mean() / 10) for f in frames] == list(range(20))


def test_a_title_need_not_be_utf8(tmp_path):
    path = tmp_path / "title.mp4"
    with av.open(str(path), "w") as container:
        container.metadata["title"] = "Stra--e"
        stream = container.add_stream("mpeg4", rate=25)
        stream.width, stream.height, stream.pix_fmt = 64, 48, "yuv420p"
        for packet in [*stream.encode(av.VideoFrame(64, 48, "yuv420p")), *stream.encode(None)]:
            container.mux(packet)
    whole = path.read_bytes()
    assert b"Stra--e" in whole
    path.write_bytes(whole.replace(b"Stra--e", b"Stra\xff\xfee"))
    assert len(read(path)[1]) == 1


def test_stamps_that_run_backwards_end_the_source(tmp_path):
    path = tmp_path / "back.ts"
    with av.open(str(path), "w") as container:
        stream = container.add_stream("mpeg2video", rate=25)
        stream.width, stream.height, stream.pix_fmt = 64, 48, "yuv420p"
        stream.codec_context.gop_size = 1
        for n in range(20):
            frame = av.VideoFrame.from_ndarray(np.full((48, 64, 3), 9 * n, np.uint8), format="bgr24")
            frame.pts, frame.time_base = n, Fraction(1, 25)
            for packet in stream.encode(frame):
                container.mux(packet)
    # A transport stream twice: the clock starts again in the middle.
    path.write_bytes(path.read_bytes() * 2)
    source, frames, events = read(path)
    assert 18 <= len(frames) <= 20
    assert isinstance(events[-1], SourceDamaged)
    assert "time runs backwards" in events[-1].reason
    assert source.end_reason == "source_damaged"


RESIZED = [("a.avi", "mjpeg", "yuvj420p"), ("a.ts", "libx264", "yuv420p")]


@pytest.mark.parametrize(("name", "codec", "pix"), RESIZED)
def test_a_change_of_size_stops_the_source(make_video, name, codec, pix):
    path = make_video(name, codec=codec, pix=pix, then=(96, 80))
    source, frames, events = read(path)
    assert len(frames) == 20
    assert events == [FrameSizeChanged(20, 96, 80, "stop")]
    assert source.end_reason == "frame_size_changed"


@pytest.mark.parametrize(("name", "codec", "pix"), RESIZED)
def test_a_change_of_size_can_be_rescaled(make_video, name, codec, pix):
    path = make_video(name, codec=codec, pix=pix, then=(96, 80))
    source, frames, events = read(path, on_resize="rescale")
    assert len(frames) == 40
    assert events == [FrameSizeChanged(20, 96, 80, "rescale")]
    assert {f.image.shape for f in frames} == {(48, 64, 3)}
    assert source.end_reason == "end_of_source"


@pytest.mark.parametrize(("start", "end", "expected"), [(5, 9, 4), (None, 3, 3), (38, None, 2), (39, 99, 1)])
def test_start_and_end(whole_videos, start, end, expected):
    source, frames, events = read(whole_videos["start.mp4"], start=start, end=end)
    first = start or 0
    assert [f.index for f in frames] == list(range(first, first + expected))
    assert [f.time for f in frames] == [float(f.index) for f in frames]
    assert (source.expected_frames, source.end_reason, events) == (expected, "end_of_source", [])


@pytest.mark.parametrize(("start", "end"), [(3, 3), (5, 2), (-1, None), (0, 0)])
def test_an_empty_range_is_refused(whole_videos, start, end):
    with pytest.raises(SourceError, match="hold no frame"):
        open_source(str(whole_videos["xvid.avi"]), start=start, end=end)


def test_a_start_past_the_end_is_refused(whole_videos):
    with pytest.raises(SourceError, match=r"no frame can be read from frame 40 on.*declares 40 frames"):
        open_source(str(whole_videos["xvid.avi"]), start=40)


def test_a_stored_rotation_is_applied(tmp_path):
    path = tmp_path / "turned.mp4"
    image = np.zeros((48, 64, 3), np.uint8)
    image[:16, :16] = 255
    with av.open(str(path), "w") as container:
        stream = container.add_stream("mpeg4", rate=25)
        stream.width, stream.height, stream.pix_fmt = 64, 48, "yuv420p"
        for n in range(3):
            frame = av.VideoFrame.from_ndarray(image, format="bgr24")
            frame.pts, frame.time_base = n, Fraction(1, 25)
            container.mux(stream.encode(frame))
        container.mux(stream.encode())
    # The track header's matrix (a b u, c d v, x y w): (x, y) is shown at (y, -x), a quarter turn.
    one, unit = 1 << 16, 1 << 30
    straight = struct.pack(">9i", one, 0, 0, 0, one, 0, 0, 0, unit)
    turned = struct.pack(">9i", 0, -one, 0, one, 0, 0, 0, 0, unit)
    data = path.read_bytes()
    header = data.index(b"tkhd")
    path.write_bytes(data[:header] + data[header:].replace(straight, turned, 1))
    source, frames, _ = read(path)
    assert (source.width, source.height) == (48, 64)
    # A quarter turn against the clock takes the top-left corner to the bottom-left one.
    upright = frames[0].image
    assert upright[-14:, :14].min() > 150
    assert upright[:14, :14].max() < 100


def test_a_video_without_frames_is_refused(tmp_path):
    path = tmp_path / "none.mkv"
    with av.open(str(path), "w") as container:
        stream = container.add_stream("mpeg4", rate=25)
        stream.width, stream.height, stream.pix_fmt = 64, 48, "yuv420p"
        container.start_encoding()
    with pytest.raises(SourceError, match=r"no frame can be read|not a readable video"):
        open_source(str(path))


def test_audio_alone_is_refused(tmp_path):
    path = tmp_path / "sound.mkv"
    with av.open(str(path), "w") as container:
        stream = container.add_stream("pcm_s16le", rate=8000)
        sound = av.AudioFrame.from_ndarray(np.zeros((1, 800), np.int16), format="s16", layout="mono")
        sound.sample_rate, sound.pts = 8000, 0
        container.mux(stream.encode(sound))
    with pytest.raises(SourceError, match="no video stream"):
        open_source(str(path))


@pytest.mark.parametrize(
    "script",
    [
        "ffconcat version 1.0\nfile 'secret.mp4'\n",
        "#EXTM3U\n#EXT-X-TARGETDURATION:2\n#EXTINF:2,\nsecret.mp4\n#EXT-X-ENDLIST\n",
        "v=0\no=- 0 0 IN IP4 127.0.0.1\ns=x\nc=IN IP4 127.0.0.1\nt=0 0\nm=video 5004 RTP/AVP 96\n",
    ],
    ids=["concat", "hls", "sdp"],
)
def test_a_file_that_names_other_files_is_refused(make_video, tmp_path, script):
    make_video("secret.mp4")
    path = tmp_path / "innocent.mp4"
    path.write_text(script)
    with pytest.raises(SourceError, match="not a readable video"):
        open_source(str(path))


class FakeStream:
    def __init__(self, tick, **rates):
        self.time_base = tick
        self.guessed_rate = self.average_rate = self.base_rate = None
        self.__dict__.update(rates)


def test_without_a_declared_rate_the_rounded_stamps_give_the_mean_interval():
    stamps = [round(n * 1000 / 30) for n in range(301)]
    timing = timing_of(FakeStream(Fraction(1, 1000)), stamps)
    # 300 steps are exactly 10 s.
    assert timing.interval == Fraction(1, 30)
    assert [timing.intervals(s) for s in stamps] == [float(n) for n in range(301)]


def test_a_declared_rate_that_the_stamps_deny_is_not_taken():
    timing = timing_of(FakeStream(Fraction(1, 90000), average_rate=Fraction(50)), list(range(0, 90000, 3600)))
    assert timing.interval == Fraction(1, 25)


def test_few_stamps_with_holes_do_not_deny_a_declared_rate():
    # Pictures 0, 2, 4 of a file cut through its reordering.
    assert timing_of(
        FakeStream(Fraction(1, 1000), average_rate=Fraction(25)), [0, 80, 160]
    ).interval == Fraction(1, 25)


def test_a_declared_rate_that_is_only_the_tick_is_not_taken():
    assert timing_of(
        FakeStream(Fraction(1, 1000), guessed_rate=Fraction(1000)), [0, 40, 80]
    ).interval == Fraction(1, 25)


def test_a_single_stamp_falls_back_to_a_rate():
    assert timing_of(FakeStream(Fraction(1, 1000)), [5]).interval == Fraction(1, 25)
    assert timing_of(FakeStream(Fraction(1, 1000), guessed_rate=Fraction(10)), []).interval == Fraction(1, 10)


def test_a_decoded_frame_has_every_field_of_a_frame(make_video):
    _, frames, _ = read(make_video("a.mkv"))
    assert [field.name for field in fields(Frame) if not hasattr(frames[0], field.name)] == []
