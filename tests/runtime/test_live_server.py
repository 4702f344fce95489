"""Only who knows the token, comes under this machine's name and from the page itself gets anything."""

import contextlib
import http.client
import json
import re
import socket
import time

import pytest

from bayesnet_track.runtime.live_view import server as serving
from bayesnet_track.runtime.live_view.controls import Refused
from bayesnet_track.runtime.live_view.server import (
    MOST_PROVEN,
    MOST_UNPROVEN,
    MOST_UNPROVEN_OF_ONE,
    Connections,
    Handler,
    Server,
)


class Served:
    def __init__(self):
        self.asked = []

    def page(self):
        return b"<p>page", "default-src 'none'"

    def feed(self, first, seen):
        return json.dumps([first, seen]).encode()

    def picture(self, frame):
        return (frame - 1, b"jpeg") if frame else None

    def ask(self, what):
        if what.get("do") == "no":
            raise Refused("not so")
        self.asked.append(what)


@pytest.fixture(scope="module")
def server():
    made = Server(Served())
    yield made
    made.close()


def ask(server, path, method="GET", body=None, **headers):
    connection = http.client.HTTPConnection("127.0.0.1", server.port, timeout=5)
    path = path.replace("TOKEN", server.token)
    sent = {name.replace("_", "-"): value for name, value in headers.items()}
    connection.request(method, path, body, sent)
    answer = connection.getresponse()
    try:
        return answer.status, answer.read(), dict(answer.getheaders())
    finally:
        connection.close()


def post(server, body, **headers):
    own = {"Origin": f"http://127.0.0.1:{server.port}", "Content_Type": "application/json", **headers}
    own = {name: value for name, value in own.items() if value is not None}
    return ask(server, "/TOKEN/do", "POST", body, **own)


def test_what_is_served(server):
    status, body, headers = ask(server, "/TOKEN/")
    assert (status, body) == (200, b"<p>page")
    assert headers["Content-Security-Policy"] == "default-src 'none'"
    assert headers["Referrer-Policy"] == "no-referrer" and headers["Cache-Control"] == "no-store"
    assert ask(server, "/TOKEN/feed?from=7&seen=3")[1] == b"[7, 3]"
    assert ask(server, "/TOKEN/feed?from=-7&seen=x")[1] == b"[0, 0]"
    status, body, headers = ask(server, "/TOKEN/picture?frame=9")
    assert (status, body, headers["X-Frame"]) == (200, b"jpeg", "8")
    assert ask(server, "/TOKEN/picture?frame=0")[0] == 204
    assert server.address == f"http://127.0.0.1:{server.port}/{server.token}/"


@pytest.mark.parametrize(
    "path",
    ["/", "", "/favicon.ico", "/feed", "/x/", "/TOKEN", "/TOKENx/", "/token/", "/?TOKEN/", "*"]
    + ["/../TOKEN/", "/%2e%2e/etc/passwd", "http://other/x/"],
)
def test_without_the_token_everything_is_refused(server, path):
    status, body, _ = ask(server, path)
    assert status == 403 and b"<p>page" not in body


@pytest.mark.parametrize(
    "path",
    ["/TOKEN/x", "/TOKEN/../", "/TOKEN//", "/TOKEN/feed/", "/TOKEN/../../etc/passwd", "/TOKEN/run_page.js"],
)
def test_with_it_there_are_no_other_paths(server, path):
    assert ask(server, path)[0] == 404


@pytest.mark.parametrize("host", ["evil.example", "evil.example:PORT", "127.0.0.1:1", "localhost.evil:PORT"])
def test_under_another_name_everything_is_refused(server, host):
    assert ask(server, "/TOKEN/", Host=host.replace("PORT", str(server.port)))[0] == 403
    assert ask(server, "/TOKEN/feed", Host=host.replace("PORT", str(server.port)))[0] == 403


@pytest.mark.parametrize("host", ["localhost", "127.0.0.1", "[::1]"])
def test_under_its_own_names_it_answers(server, host):
    assert ask(server, "/TOKEN/", Host=f"{host}:{server.port}")[0] == 200


def test_only_the_page_itself_may_ask_for_something(server):
    body = json.dumps({"do": "pause"})
    assert post(server, body)[0] == 200
    assert server.served.asked == [{"do": "pause"}]
    for origin in (
        None,
        "null",
        "http://evil.example",
        f"https://127.0.0.1:{server.port}",
        "http://127.0.0.1",
    ):
        assert post(server, body, Origin=origin)[0] == 403
    # What a form can send without asking first.
    for kind in ("text/plain", "application/x-www-form-urlencoded", None):
        assert post(server, body, Content_Type=kind)[0] == 415
    assert ask(server, "/TOKEN/feed", "POST", body, Origin=f"http://127.0.0.1:{server.port}")[0] == 404
    assert server.served.asked == [{"do": "pause"}]


@pytest.mark.parametrize("body", [b"", b"{", b"[]", b"[" * 60_000, b"\xff", b'"do"', b"1" * 5000])
def test_what_is_no_object_is_refused(server, body):
    status, answer, _ = post(server, body)
    assert status == 400 and json.loads(answer)["error"]


def test_a_refusal_says_why(server):
    status, answer, _ = post(server, b'{"do": "no"}')
    assert (status, json.loads(answer)) == (400, {"error": "not so"})


def test_a_request_that_is_too_large_is_not_read(server):
    assert post(server, b"x" * 64_001)[0] == 413


def test_other_methods_are_not_known(server):
    for method in ("PUT", "DELETE", "OPTIONS", "TRACE"):
        assert ask(server, "/TOKEN/", method)[0] == 501


def test_a_client_that_says_nothing_is_let_go_and_never_bars_the_others(monkeypatch):
    monkeypatch.setattr(Handler, "timeout", 0.3)
    made = Server(Served())
    try:
        silent = [socket.create_connection(("127.0.0.1", made.port)) for _ in range(37)]
        # Those beyond the limit are closed at once, the others when their time is over.
        for one in silent:
            one.settimeout(5)
            assert one.recv(1) == b""
            one.close()
        assert ask(made, "/TOKEN/")[0] == 200
    finally:
        made.close()


def opened(server, sent=b""):
    one = socket.create_connection(("127.0.0.1", server.port), timeout=10)
    one.sendall(sent)
    return one


def test_who_lacks_the_token_never_bars_who_has_it(server):
    """It held all connections for as long as it sent a byte now and then: nobody else was served."""
    slow = [opened(server, b"GET /guess/ HTTP/1.1\r\nX-Long: ") for _ in range(60)]
    try:
        for number in range(5):
            assert ask(server, f"/TOKEN/feed?from={number}")[:2] == (200, b"[%d, 0]" % number)
            for one in slow:
                with contextlib.suppress(OSError):
                    one.send(b"x")
    finally:
        for one in slow:
            one.close()


def test_who_trickles_without_the_token_is_closed_in_time(monkeypatch):
    monkeypatch.setattr(serving, "Connections", lambda: Connections(0.4))
    made = Server(Served())
    try:
        slow, held = opened(made, b"GET / HTTP/1.1\r\n"), opened(made)
        held.sendall(f"GET /{made.token}/ HTTP/1.1\r\nHost: 127.0.0.1:{made.port}\r\n\r\n".encode())
        assert held.recv(12) == b"HTTP/1.1 200"
        began = time.monotonic()
        with contextlib.suppress(OSError):
            while time.monotonic() - began < 10:
                slow.sendall(b"X")
                time.sleep(0.05)
        assert time.monotonic() - began < 8
        slow.close()
        # With the token a connection stays.
        held.sendall(f"GET /{made.token}/feed HTTP/1.1\r\nHost: 127.0.0.1:{made.port}\r\n\r\n".encode())
        answer = b""
        while b"[0, 0]" not in answer:
            part = held.recv(4096)
            assert part, "it was closed"
            answer += part
        held.close()
    finally:
        made.close()


class Pipe:
    """A socket, as far as it can be shut."""

    def __init__(self):
        self.is_shut = False

    def shutdown(self, how):
        self.is_shut = True


def test_the_oldest_of_whoever_holds_most_gives_way():
    now = [0.0]
    connections = Connections(5.0, lambda: now[0])
    browser, proven = Pipe(), Pipe()
    connections.enters(browser, "a")
    connections.enters(proven, "a")
    assert connections.proves(proven) and connections.proves(proven)
    others = [Pipe() for _ in range(60)]
    for number, one in enumerate(others):
        connections.enters(one, f"b{number % 4}")
    assert not browser.is_shut and sum(not one.is_shut for one in others) == MOST_UNPROVEN - 1
    own = [Pipe() for _ in range(MOST_UNPROVEN_OF_ONE)]
    for one in own:
        connections.enters(one, "a")
    assert browser.is_shut and not own[-1].is_shut, "now it is the one that holds most, and its newest is in"
    assert sum(not one.is_shut for one in (browser, *own, *others)) == MOST_UNPROVEN
    now[0] = 5.1
    connections.sweep()
    assert all(one.is_shut for one in (*others, *own)) and not proven.is_shut
    assert not connections.proves(browser), "too late"


def test_those_with_the_token_are_counted_too():
    connections = Connections()
    pipes = [Pipe() for _ in range(MOST_PROVEN + 1)]
    shown = []
    for one in pipes:
        connections.enters(one, "a")
        shown.append(connections.proves(one))
    assert shown == [True] * MOST_PROVEN + [False]
    connections.leaves(pipes[0])
    assert connections.proves(pipes[-1])


def test_a_taken_port_is_passed_over_and_a_named_one_is_refused(monkeypatch):
    first = Server(Served())
    monkeypatch.setattr(serving, "FIRST_PORT", first.port)
    second = Server(Served())
    try:
        assert second.port != first.port
        with pytest.raises(OSError):
            Server(Served(), port=first.port)
        assert first.token != second.token and re.fullmatch(r"[\w-]{24}", first.token)
    finally:
        second.close()
        first.close()


def test_beyond_this_machine_only_numbers_are_names():
    made = Server(Served(), "0.0.0.0")
    try:
        assert ask(made, "/TOKEN/", Host=f"192.168.1.7:{made.port}")[0] == 200
        assert ask(made, "/TOKEN/", Host=f"evil.example:{made.port}")[0] == 403
        assert made.address.startswith("http://127.0.0.1:")
    finally:
        made.close()


def test_it_ends_quickly(server):
    made = Server(Served())
    began = time.monotonic()
    made.close()
    assert time.monotonic() - began < 1.0
    with pytest.raises(OSError):
        socket.create_connection(("127.0.0.1", made.port), timeout=1)
