"""A camera that serves MJPEG over HTTP is live; a film over HTTP is a file; passwords are shown nowhere."""

from __future__ import annotations

import json
import threading
import time
import warnings

import av
import numpy as np
import pytest

from bayesnet_track import track
from bayesnet_track.journal.events.runs import (
    FramesDropped,
    FrameSizeChanged,
    FramesMissing,
    SourceDamaged,
    SourceStalled,
)
from bayesnet_track.observation.planes import Frame
from bayesnet_track.sources.entrances.notices import InputNotice
from bayesnet_track.sources.sources import SourceError, open_source
from tests.sources.network import camera, hanging, image, jpeg, multipart, number_of, part

JPEGS = [jpeg(image(index)) for index in range(40)]


def of(kind, items):
    return [item for item in items if isinstance(item, kind)]


def read(address, pause_s=0.0, until=lambda items: False, **options):
    """What a source gives until `until` says that it is enough."""
    items = []
    with open_source(address, allow_network=True, **options) as source:
        assert source.is_live
        for item in source:
            items.append(item)
            if until(items):
                break
            if isinstance(item, Frame):
                time.sleep(pause_s)
    return source, items


def frames_from(count):
    return lambda items: len(of(Frame, items)) >= count


def test_a_camera_that_breaks_once_is_one_line_and_goes_on():
    with camera(multipart(JPEGS[:15], 0.02), multipart(JPEGS, 0.02)) as (address, moments):
        _, items = read(address, until=lambda items: len(moments) > 1 and isinstance(items[-1], Frame))
    assert not of(SourceDamaged, items)
    (stall,) = of(SourceStalled, items)
    assert stall.reason.startswith("the connection broke") and stall.attempt == 1
    frames = of(Frame, items)
    after = next(frame for frame in frames if frame.index >= stall.frame)
    assert number_of(after.image)[0] < 10, "the second connection begins anew"


def test_a_slow_tracker_gets_the_newest_frame_and_the_rate_is_measured():
    with camera(multipart(JPEGS, 0.05)) as (address, _):
        source, items = read(address, 0.25, frames_from(5))
    assert 1.0 / source.frame_interval_s == pytest.approx(20, abs=2), "FFmpeg says 25, whatever comes"
    frames, dropped = of(Frame, items), of(FramesDropped, items)
    assert frames[0].index == 0 and frames[-1].index >= 12
    assert dropped and dropped[0].reason == "newer ones had arrived"
    for frame in frames[1:]:  # it is of the moment at which it was taken, up to one interval
        behind = number_of(frame.image)[0] - number_of(frames[0].image)[0] - frame.time_s / 0.05
        assert abs(behind) <= 2


@pytest.mark.slow
def test_a_slow_camera_misses_no_frame():
    with camera(multipart(JPEGS, 0.3)) as (address, _):
        source, items = read(address, until=frames_from(6))
    assert 1.0 / source.frame_interval_s == pytest.approx(3, abs=0.4)
    assert not of(FramesMissing, items) and not of(FramesDropped, items)


@pytest.mark.slow
def test_a_camera_that_hangs_and_is_away_is_waited_for():
    over = threading.Event()

    def busy(handler):
        handler.send_error(503, "busy")

    connections = hanging(multipart(JPEGS[:20], 0.02), over), busy, busy, busy, multipart(JPEGS, 0.02)
    with camera(*connections) as (address, moments):
        _, items = read(address, until=lambda items: len(moments) > 4 and isinstance(items[-1], Frame))
        over.set()
    stalls = of(SourceStalled, items)
    assert [stall.attempt for stall in stalls] == [1, 2], "the third attempt fails as the second does"
    assert stalls[0].reason == "no picture for 2 s" and "5XX" in stalls[1].reason
    assert of(Frame, items)[-1].time_s - of(Frame, items)[-2].time_s > 2.0
    assert of(FramesMissing, items), "the belief is predicted over the gap"


def test_half_an_image_is_left_out_and_counted():
    given = [data if index % 4 else data[: len(data) // 2] for index, data in enumerate(JPEGS)]
    with camera(multipart(given, 0.03)) as (address, _):
        _, items = read(address, until=frames_from(20))
    for frame in of(Frame, items):
        assert number_of(frame.image)[1] < 3, "no image is half gray"
    (fault, *_) = [item for item in of(FramesDropped, items) if "cut off" in item.reason]
    assert "no end marker" in fault.describe()


@pytest.mark.parametrize("length", [True, False])
def test_a_wrong_boundary_is_read_all_the_same(length):
    def serve(handler):
        handler.send_response(200)
        handler.send_header("Content-Type", "multipart/x-mixed-replace; boundary=frame")
        handler.end_headers()
        for data in JPEGS:
            head, _, rest = part(data, "another").partition(b"\r\nContent-Length")
            handler.wfile.write(part(data, "another") if length else head + rest[rest.index(b"\r\n\r\n") :])
            time.sleep(0.02)

    with camera(serve) as (address, _):
        _, items = read(address, until=frames_from(5))
    assert not of(SourceDamaged, items) and not of(SourceStalled, items)


@pytest.mark.parametrize("on_resize", ["stop", "rescale"])
def test_another_size_ends_the_run_or_is_scaled(on_resize):
    larger = [jpeg(np.repeat(np.repeat(image(n), 2, 0), 2, 1)) for n in range(30)]
    with camera(multipart(JPEGS[:15] + larger, 0.02)) as (address, _):
        changed = lambda items: of(FrameSizeChanged, items) and isinstance(items[-1], Frame)  # noqa: E731
        _, items = read(address, until=changed, on_resize=on_resize)
    (change,) = of(FrameSizeChanged, items)
    assert (change.width, change.height, change.action) == (256, 192, on_resize)
    assert {frame.image.shape for frame in of(Frame, items)} == {(96, 128, 3)}


def test_no_live_reads_every_frame():
    with (
        camera(multipart(JPEGS, 0.0)) as (address, moments),
        open_source(address, allow_network=True, live=False) as source,
    ):
        assert not source.is_live
        items = list(source)
    assert [frame.index for frame in of(Frame, items)] == list(range(40)) and len(moments) == 1
    (damage,) = of(SourceDamaged, items)
    assert damage.reason == "the connection broke: Input/output error" and damage.frame == 40


def film(path, format_=None, rate=25):
    with av.open(str(path), "w", format=format_) as container:
        stream = container.add_stream("mpeg4" if format_ != "mpegts" else "mpeg2video", rate=rate)
        stream.width, stream.height, stream.pix_fmt = 128, 96, "yuv420p"
        for index in range(50):
            container.mux(stream.encode(av.VideoFrame.from_ndarray(image(index), format="bgr24")))
        container.mux(stream.encode())
    return path.read_bytes()


def whole(data, kind, with_length=True):
    """A connection that gives a file; those after it, too."""

    def serve(handler):
        handler.send_response(200)
        handler.send_header("Content-Type", kind)
        if with_length:
            handler.send_header("Content-Length", str(len(data)))
        handler.end_headers()
        handler.wfile.write(data)

    return serve


def test_a_film_over_http_is_a_file(tmp_path):
    serve = whole(film(tmp_path / "film.mp4"), "video/mp4")
    with camera(*[serve] * 9) as (address, _), open_source(address, allow_network=True) as source:
        assert not source.is_live
        indices = []
        for item in source:
            assert isinstance(item, Frame), item
            indices.append(item.index)
            time.sleep(0.002)
    assert indices == list(range(50))


def test_a_stream_of_no_declared_length_is_taken_as_live_with_a_notice(tmp_path):
    serve = whole(film(tmp_path / "film.ts", "mpegts"), "video/mp2t", with_length=False)
    with camera(*[serve] * 9) as (address, _):
        with (
            pytest.warns(InputNotice, match=r"no length.*live=False"),
            open_source(address, allow_network=True) as source,
        ):
            assert source.is_live
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            with open_source(address, allow_network=True, live=False) as source:
                assert len(of(Frame, source)) == 50
            with open_source(address, allow_network=True, live=True) as source:
                assert source.is_live


def playlist(tmp_path, ending):
    """Segments of a second, and a server of them by name."""
    with av.open(str(tmp_path / "list.m3u8"), "w", format="hls", options={"hls_time": "1"}) as container:
        stream = container.add_stream("mpeg2video", rate=25)
        stream.width, stream.height, stream.pix_fmt = 128, 96, "yuv420p"
        stream.codec_context.gop_size, stream.codec_context.max_b_frames = 25, 0
        for index in range(100):
            container.mux(stream.encode(av.VideoFrame.from_ndarray(image(index), format="bgr24")))
        container.mux(stream.encode())
    text = (tmp_path / "list.m3u8").read_text()
    assert "#EXT-X-ENDLIST" in text
    if not ending:
        (tmp_path / "list.m3u8").write_text(text.replace("#EXT-X-ENDLIST", ""))

    def serve(handler):
        data = (tmp_path / handler.path.lstrip("/")).read_bytes()
        whole(data, "application/vnd.apple.mpegurl" if handler.path.endswith("8") else "video/mp2t")(handler)

    return serve


@pytest.mark.parametrize("ending", [True, False])
def test_a_playlist_is_live_while_it_may_grow(tmp_path, ending):
    serve = playlist(tmp_path, ending)
    with (
        camera(*[serve] * 99, path="list.m3u8") as (address, _),
        open_source(address, allow_network=True) as source,
    ):
        assert source.is_live is not ending
        if ending:
            assert len(of(Frame, source)) == 100
            return
        items = []
        while len(of(Frame, items)) < 20:
            items.append(next(source))
    frames = of(Frame, items)
    # A segment comes at once: its frames are given at the pace of their times, none is dropped.
    assert frames[-1].time_s - frames[0].time_s == pytest.approx(19 / 25, abs=0.2)
    assert [frame.index for frame in frames] == list(range(20))


def test_live_and_no_live_where_they_mean_nothing(tmp_path):
    path = tmp_path / "film.mp4"
    film(path)
    with pytest.raises(SourceError, match="a file is not live: every frame of it is read"):
        open_source(str(path), live=True)
    with pytest.raises(SourceError, match="a camera has no end"):
        open_source("0", live=False)


def test_a_redirected_camera_is_live_and_its_password_is_written_nowhere(tmp_path, capfd):
    asked = []

    def moved(handler):
        asked.append(handler.headers["Authorization"])
        handler.send_response(302)
        handler.send_header("Location", f"http://{handler.headers['Host']}/other.mjpg?token=geheim2")
        handler.end_headers()

    def guarded(handler):
        handler.send_response(401)
        handler.send_header("WWW-Authenticate", 'Basic realm="cam"')
        handler.end_headers()

    connections = guarded, moved, multipart(JPEGS, 0.02)
    with camera(*connections) as (address, _):
        with_password = address.replace("//", "//admin:geheim1@") + "?pwd=geheim3"
        results = track("general", with_password, (10, 30, 20, 20), out=tmp_path / "run", allow_network=True)
        for result in results:
            if result.frame.index >= 3:
                break
        results.close()
        assert asked and asked[0].startswith("Basic ")
    written = [path for path in (tmp_path / "run").rglob("*") if path.is_file()]
    assert written and not [path for path in written if b"geheim" in path.read_bytes()]
    recipe = json.loads((tmp_path / "run" / "run.json").read_text())
    assert "***@127.0.0.1" in json.dumps(recipe)
    assert "geheim" not in "".join(capfd.readouterr())


@pytest.mark.parametrize("scheme", ["http", "rtsp"])
@pytest.mark.parametrize("allow", [True, False])
def test_no_message_holds_a_password(scheme, allow):
    with pytest.raises(SourceError) as raised:
        open_source(f"{scheme}://admin:geheim1@127.0.0.1:9/x?token=geheim2", allow_network=allow)
    assert "geheim" not in str(raised.value) and "***@127.0.0.1:9" in str(raised.value)
    assert "geheim" not in repr(raised.value.args)
