"""A live stream over HTTP that stalls, goes on, breaks and comes back: reconnected to, with true times."""

from __future__ import annotations

import io
import threading
import time
from fractions import Fraction
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

import av
import numpy as np
import pytest

from bayesnet_track import open_run, track
from bayesnet_track.journal.events.runs import FramesMissing, SourceStalled
from bayesnet_track.observation.planes import Frame
from bayesnet_track.sources.scenes.library import SceneSource
from bayesnet_track.sources.sources import SourceError, open_source

pytestmark = pytest.mark.slow

RATE, SECONDS, PARTS = 25, 4, 40


def film():
    """Four seconds of a moving square as MPEG-TS."""
    bytes_, noise = io.BytesIO(), np.random.default_rng(3).integers(0, 60, (96, 128, 3), np.uint8)
    with av.open(bytes_, "w", format="mpegts") as container:
        stream = container.add_stream("mpeg2video", rate=RATE)
        stream.width, stream.height, stream.pix_fmt = 128, 96, "yuv420p"
        stream.codec_context.gop_size, stream.codec_context.max_b_frames = 5, 0
        for index in range(RATE * SECONDS):
            image = noise.copy()
            image[30:50, index % 80 : index % 80 + 20] = 220
            frame = av.VideoFrame.from_ndarray(image, format="bgr24")
            frame.pts, frame.time_base = index, Fraction(1, RATE)
            container.mux(stream.encode(frame))
        container.mux(stream.encode())
    return bytes_.getvalue()


@pytest.fixture
def server():
    """The address of a server; its first connection stalls, its second is refused, its third breaks."""
    data, connections, over = film(), [], threading.Event()

    class Handler(BaseHTTPRequestHandler):
        def do_GET(self):
            connections.append(time.monotonic())
            number = len(connections)
            if number == 2:
                self.send_error(503)
                return
            self.send_response(200)
            self.send_header("Content-Type", "video/mp2t")
            self.end_headers()
            size = len(data) // PARTS
            for part in range(PARTS // 2 if number in (1, 3) else PARTS):
                try:
                    self.wfile.write(data[part * size : (part + 1) * size])
                    self.wfile.flush()
                except OSError:
                    return
                time.sleep(0.05)
            if number == 1:
                over.wait(20.0)

        def log_message(self, *_):
            pass

    httpd = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
    httpd.daemon_threads = True
    threading.Thread(target=httpd.serve_forever, daemon=True).start()
    yield f"http://127.0.0.1:{httpd.server_port}/film.ts", connections
    over.set()
    httpd.shutdown()
    httpd.server_close()


def test_a_stream_that_stalls_and_breaks_is_taken_up_again(server, tmp_path):
    address, connections = server
    with pytest.raises(SourceError, match="allow_network=True"):
        open_source(address)
    assert connections == []
    scene = SceneSource.named("two_squares", 0, 3)  # what is compiled for the first frames is there then
    list(track("general", scene, scene.scene.start_box))
    with open_source(address, allow_network=True, live=True) as source:
        assert source.is_live
        taken = []
        for result in track("general", source, (10, 30, 20, 20), out=tmp_path / "run"):
            taken.append((time.monotonic(), result.frame))
            if len(connections) >= 4 and sum(at > connections[3] for at, _ in taken) > 5:
                break
    frames = [frame for _, frame in taken]
    assert all(isinstance(frame, Frame) for frame in frames) and len(frames) > 20
    # Times are those of arrival; the first picture waited until all was ready, and those after it.
    times = np.array([frame.time_s for frame in frames])[2:]
    arrived = np.array([at for at, _ in taken])[2:]
    steps = np.diff(times)
    assert (steps > 0).all() and steps.max() > 1.8, "the stall stands in them"
    assert np.diff(arrived)[steps.argmax()] == pytest.approx(steps.max(), abs=0.6)
    assert times[-1] - times[0] == pytest.approx(arrived[-1] - arrived[0], abs=0.6)
    events = open_run(tmp_path / "run").events
    stalls = [event for event in events if isinstance(event, SourceStalled)]
    assert len(connections) >= 4 and len(stalls) >= 3
    assert [event.attempt for event in stalls][:2] == [1, 2] and stalls[-1].attempt == 1
    # The belief is predicted over the true gap, in frame intervals.
    missing = max(event.missing for event in events if isinstance(event, FramesMissing))
    assert missing >= RATE * steps.max() - 1.5
