"""The local web server of a view: a page, events, pictures, requests, and who may connect.

A connection is unproven until a request on it carries the token. Nobody is turned away for want of room among
the unproven: the oldest one of the client that holds most is closed instead, so that a browser, which sends
its request at once, always gets in. Nothing waits for a slow client: every unproven connection has one time
limit in all, however it trickles.
"""

from __future__ import annotations

import contextlib
import hmac
import ipaddress
import json
import secrets
import socket
import socketserver
import sys
import threading
import time
from collections import Counter
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, HTTPServer
from typing import Any, Protocol
from urllib.parse import parse_qs, urlsplit

from bayesnet_track.runtime.live_view.controls import Refused

MOST_PROVEN = 32
MOST_UNPROVEN = 24
MOST_UNPROVEN_OF_ONE = 8
UNPROVEN_S = 5.0
"""Seconds within which a connection must have shown the token."""


@dataclass(frozen=True, eq=False)
class _Unproven:
    client: str
    since: float


class Connections:
    """The open connections, by their sockets. Called from many threads.

    Args:
        unproven_s: seconds that a connection has to show the token.
        clock: seconds, of any origin.
    """

    def __init__(self, unproven_s: float = UNPROVEN_S, clock: Callable[[], float] = time.monotonic) -> None:
        self._unproven_s, self._clock, self._lock = unproven_s, clock, threading.Lock()
        self._unproven: dict[socket.socket, _Unproven] = {}  # the oldest first
        self._proven: set[socket.socket] = set()

    def enters(self, connection: socket.socket, client: str) -> None:
        """A client has connected; where that is one too many, the oldest of whoever holds most is closed."""
        with self._lock:
            counts = Counter(unproven.client for unproven in self._unproven.values())
            if counts[client] >= MOST_UNPROVEN_OF_ONE:
                self._close_oldest(client)
            elif counts.total() >= MOST_UNPROVEN:
                self._close_oldest(counts.most_common(1)[0][0])
            self._unproven[connection] = _Unproven(client, self._clock())

    def proves(self, connection: socket.socket) -> bool:
        """It has shown the token; False where too many that have are open already."""
        with self._lock:
            if connection in self._proven:
                return True
            if len(self._proven) >= MOST_PROVEN or self._unproven.pop(connection, None) is None:
                return False
            self._proven.add(connection)
            return True

    def leaves(self, connection: socket.socket) -> None:
        """It is closed; safe to call twice."""
        with self._lock:
            self._unproven.pop(connection, None)
            self._proven.discard(connection)

    def sweep(self) -> None:
        """Close those whose time is over; to be called now and then."""
        with self._lock:
            late = self._clock() - self._unproven_s
            for connection in [
                connection_late
                for connection_late, unproven in self._unproven.items()
                if unproven.since < late
            ]:
                self._close(connection)

    def _close_oldest(self, client: str) -> None:
        self._close(
            next(connection for connection, unproven in self._unproven.items() if unproven.client == client)
        )

    def _close(self, connection: socket.socket) -> None:
        # Its thread, which waits for it, finds its end, and closes it.
        del self._unproven[connection]
        with suppress(OSError):
            connection.shutdown(socket.SHUT_RDWR)


FIRST_PORT, PORTS = 8760, 20
LARGEST_REQUEST = 64_000
PATIENCE_S = 20.0
"""Seconds after which a client that neither sends nor takes is let go, with the token or without."""

HEADERS = {
    "Cache-Control": "no-store",
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Cross-Origin-Opener-Policy": "same-origin",
    "X-Frame-Options": "DENY",
}


class Served(Protocol):
    """The content that a server offers. Called from many threads."""

    def page(self) -> tuple[bytes, str]:
        """The page, and its content security policy."""

    def feed(self, first: int, version: int) -> bytes:
        """JSON: lines from number `first` on, and how things stand; waits while `version` is the newest."""

    def picture(self, frame: int) -> tuple[int, bytes] | None:
        """A frame's picture as JPEG, or an earlier one, with its frame."""

    def ask(self, request: Mapping[str, Any]) -> None:
        """Do something; raises Refused."""


class Server(socketserver.ThreadingMixIn, HTTPServer):
    """Serves `served` at an address that holds a random token; whoever does not know it is refused.

    Args:
        served: what is served.
        host: address to listen at.
        port: port to listen at; None for the first free one from 8760 on.

    Raises:
        OSError: the port is taken, or the host is not one of this machine.
    """

    daemon_threads = True
    block_on_close = False
    request_queue_size = 64

    def __init__(self, served: Served, host: str = "127.0.0.1", port: int | None = None) -> None:
        self.served, self.host = served, host
        self.token = secrets.token_urlsafe(18)
        self.address_family = socket.AF_INET6 if ":" in host else socket.AF_INET
        self.connections = Connections()
        # Elsewhere it means that a port is free again at once; on Windows, that two may share one.
        self.allow_reuse_address = sys.platform != "win32"
        tried = [port] if port is not None else [*range(FIRST_PORT, FIRST_PORT + PORTS), 0]
        for number in tried:
            try:
                super().__init__((host, number), Handler)
                break
            except OSError:
                if number == tried[-1]:
                    raise
        self._thread = threading.Thread(target=self.serve_forever, args=(0.1,), name="view", daemon=True)
        self._thread.start()

    @property
    def port(self) -> int:
        """The port on which it listens."""
        return int(self.server_address[1])

    @property
    def address(self) -> str:
        """The page's address."""
        anywhere = {"0.0.0.0": "127.0.0.1", "::": "::1"}
        host = anywhere.get(self.host, self.host)
        return f"http://{f'[{host}]' if ':' in host else host}:{self.port}/{self.token}/"

    def knows(self, host: str) -> bool:
        """True if a request may call this server so: by any name, foreign pages could (DNS rebinding)."""
        name, _, port = host.rpartition(":")
        if port != str(self.port):
            return False
        if name in ("localhost", self.host):
            return True
        with contextlib.suppress(ValueError):
            address = ipaddress.ip_address(name.removeprefix("[").removesuffix("]"))
            return address.is_loopback or not ipaddress.ip_address(self.host).is_loopback
        return False

    def close(self) -> None:
        """Serve no more."""
        self.shutdown()
        self.server_close()

    def server_bind(self) -> None:
        """Bind without asking a name server who this is, as `HTTPServer` does."""
        socketserver.TCPServer.server_bind(self)
        self.server_name, self.server_port = self.host, int(self.server_address[1])

    def process_request(self, request: Any, client_address: Any) -> None:
        """Hand it to a thread."""
        self.connections.enters(request, str(client_address[0]))
        super().process_request(request, client_address)

    def process_request_thread(self, request: Any, client_address: Any) -> None:
        """In its own thread."""
        try:
            super().process_request_thread(request, client_address)
        finally:
            self.connections.leaves(request)

    def service_actions(self) -> None:
        """Several times a second."""
        self.connections.sweep()

    def handle_error(self, request: Any, client_address: Any) -> None:
        """A client that went away, or speaks something else, concerns nobody."""
        if not isinstance(sys.exception(), OSError | ValueError):
            super().handle_error(request, client_address)


class Handler(BaseHTTPRequestHandler):
    """One connection."""

    server: Server
    protocol_version = "HTTP/1.1"
    timeout = PATIENCE_S
    server_version, sys_version = "bayesnet-track", ""

    def do_GET(self) -> None:
        """The page, the feed, or a picture."""
        path = self._allowed()
        if path is None:
            return
        served = self.server.served
        if path == "":
            body, policy = served.page()
            self._answer(body, "text/html; charset=utf-8", {"Content-Security-Policy": policy})
        elif path == "feed":
            first, version = self._number("from"), self._number("seen")
            self._answer(served.feed(first, version), "application/json")
        elif path == "picture":
            picture = served.picture(self._number("frame"))
            if picture is None:
                self._answer(b"", "image/jpeg", {}, HTTPStatus.NO_CONTENT)  # yet
            else:
                self._answer(picture[1], "image/jpeg", {"X-Frame": str(picture[0])})
        else:
            self._refuse(HTTPStatus.NOT_FOUND, "no such page")

    def do_POST(self) -> None:
        """Something is asked for."""
        path = self._allowed()
        if path is None:
            return
        # Only the page itself may ask: another site's page has another origin, and a form has none of JSON.
        if self.headers.get("Origin") != f"http://{self.headers.get('Host')}":
            return self._refuse(HTTPStatus.FORBIDDEN, "another origin")
        if path != "do":
            return self._refuse(HTTPStatus.NOT_FOUND, "no such page")
        if self.headers.get_content_type() != "application/json":
            return self._refuse(HTTPStatus.UNSUPPORTED_MEDIA_TYPE, "JSON is needed")
        length = self.headers.get("Content-Length", "")
        if not (length.isascii() and length.isdigit() and len(length) < 9):
            return self._refuse(HTTPStatus.LENGTH_REQUIRED, "a length is needed")
        if int(length) > LARGEST_REQUEST:
            return self._refuse(HTTPStatus.REQUEST_ENTITY_TOO_LARGE, "too much")
        try:
            request = json.loads(self.rfile.read(int(length)))
            if not isinstance(request, dict):
                raise Refused("an object is needed")
            self.server.served.ask(request)
        except (ValueError, RecursionError) as error:
            reason = str(error) if isinstance(error, Refused) else "not JSON"
            return self._answer(json.dumps({"error": reason}).encode(), "application/json", {}, 400)
        self._answer(b"{}", "application/json")

    def _allowed(self) -> str | None:
        """The path behind the token; None, answered already, if the request is not allowed."""
        if not self.server.knows(self.headers.get("Host", "")):
            self._refuse(HTTPStatus.FORBIDDEN, "not the address of this page")
            return None
        try:
            _, token, path = urlsplit(self.path).path.split("/", 2)
        except ValueError:
            token = path = ""
        if not hmac.compare_digest(token.encode(errors="replace"), self.server.token.encode()):
            self._refuse(HTTPStatus.FORBIDDEN, "the address lacks its token: copy it whole")
            return None
        if not self.server.connections.proves(self.connection):
            self._refuse(HTTPStatus.SERVICE_UNAVAILABLE, "too many connections: close other pages of it")
            return None
        return path

    def _number(self, name: str) -> int:
        text = parse_qs(urlsplit(self.path).query).get(name, ["0"])[0]
        return int(text) if text.isascii() and text.isdigit() and len(text) < 16 else 0

    def _refuse(self, status: HTTPStatus, reason: str) -> None:
        # What else the client sent was not read: nothing more can be understood on this connection.
        self.close_connection = True
        self._answer(reason.encode(), "text/plain; charset=utf-8", {"Connection": "close"}, status)

    def _answer(
        self, body: bytes, kind: str, headers: Mapping[str, str] | None = None, status: int = 200
    ) -> None:
        self.send_response(status)
        for name, value in {**HEADERS, **(headers or {}), "Content-Type": kind}.items():
            self.send_header(name, value)
        self.send_header("Content-Length", str(len(body)))
        self.end_headers()
        self.wfile.write(body)

    def log_message(self, format: str, *args: Any) -> None:
        """Keep quiet: stderr is for the run."""
