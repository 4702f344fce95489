"""Who may hold a connection of the live view: a client that has not shown the token holds few, and not long.

A connection is unproven until a request on it carries the token. Nobody is turned away for want of room among
the unproven: the oldest one of the client that holds most is closed instead, so that a browser, which sends
its request at once, always gets in. Nothing waits for a slow client: every unproven connection has one time
limit in all, however it trickles.
"""

from __future__ import annotations

import socket
import threading
import time
from collections import Counter
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass

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
            held = Counter(one.client for one in self._unproven.values())
            if held[client] >= MOST_UNPROVEN_OF_ONE:
                self._close_oldest(client)
            elif held.total() >= MOST_UNPROVEN:
                self._close_oldest(held.most_common(1)[0][0])
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
            for connection in [one for one, about in self._unproven.items() if about.since < late]:
                self._close(connection)

    def _close_oldest(self, client: str) -> None:
        self._close(next(one for one, about in self._unproven.items() if about.client == client))

    def _close(self, connection: socket.socket) -> None:
        # Its thread, which waits for it, finds its end, and closes it.
        del self._unproven[connection]
        with suppress(OSError):
            connection.shutdown(socket.SHUT_RDWR)
