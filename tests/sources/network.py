"""A camera over HTTP on this computer: it serves what a test tells it to, connection by connection."""

from __future__ import annotations

import threading
import time
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

import cv2
import numpy as np

NOISE = cv2.blur(np.random.default_rng(5).integers(0, 60, (96, 128, 3), np.uint8), (5, 5))


def image(index):
    """A bright square that moves over noise, in the frame of this number."""
    picture = NOISE.copy()
    at = 10 + 2 * (index % 40)
    picture[30:50, at : at + 20] = (40, 60, 230)
    return picture


def number_of(picture):
    """The number, modulo 40, of the frame that a decoded image shows, and the mean difference from it."""
    unlike = [np.abs(picture.astype(int) - image(number)).mean() for number in range(40)]
    return int(np.argmin(unlike)), min(unlike)


def jpeg(picture):
    return cv2.imencode(".jpg", picture)[1].tobytes()


def part(data, boundary="frame"):
    head = f"--{boundary}\r\nContent-Type: image/jpeg\r\nContent-Length: {len(data)}\r\n\r\n"
    return head.encode() + data + b"\r\n"


def multipart(pictures, interval_s):
    """A connection that gives JPEG data, one an interval, and then ends."""

    def serve(handler):
        handler.send_response(200)
        handler.send_header("Content-Type", "multipart/x-mixed-replace; boundary=frame")
        handler.end_headers()
        for data in pictures:
            handler.wfile.write(part(data))
            time.sleep(interval_s)

    return serve


def hanging(serve, over):
    """As `serve`, and then it says nothing more until `over`."""

    def hang(handler):
        serve(handler)
        over.wait(20.0)

    return hang


@contextmanager
def camera(*connections, path="cam.mjpg"):
    """Serve these connections in turn, and refuse what comes then; (address, moments of the connections)."""
    moments, lock = [], threading.Lock()

    class Handler(BaseHTTPRequestHandler):
        def do_GET(self):
            with lock:
                number = len(moments)
                moments.append(time.monotonic())
            try:
                if number < len(connections):
                    connections[number](self)
                else:
                    self.send_error(503)
            except OSError:
                pass

        def log_message(self, *_):
            pass

    server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
    server.daemon_threads = True
    threading.Thread(target=server.serve_forever, args=(0.05,), daemon=True).start()
    try:
        yield f"http://127.0.0.1:{server.server_port}/{path}", moments
    finally:
        server.shutdown()
        server.server_close()
