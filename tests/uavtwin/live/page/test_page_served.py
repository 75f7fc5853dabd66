"""The server of the live page, asked over real sockets."""

import json
import socket
import time
from collections.abc import Iterator
from contextlib import contextmanager
from http.client import HTTPConnection
from typing import Any

import numpy as np
import pytest
from serve_rigs.live_sites import live_site
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.sync.client import ClientConnection, connect

from twin.errors import TwinError
from twin.residuals.gap import Channel
from uavtwin.live.page.feed import LEARNT_S, MOST_VIEWERS, QUEUE, SILENT_S, ExpectedBands, Hub
from uavtwin.site.server import SiteServer, doors_of
from uavtwin.sockets import address

TOKEN = "correct horse"


@contextmanager
def served(token: str | None = None, hub: Hub | None = None) -> Iterator[tuple[Hub, SiteServer]]:
    hub = hub or Hub()
    with live_site(hub, token) as server:
        yield hub, server


def get(server: SiteServer, path: str = "/live", **headers: str) -> tuple[int, str, dict[str, str]]:
    connection = HTTPConnection("127.0.0.1", server.port, timeout=60)
    connection.request("GET", path, headers=headers)
    answer = connection.getresponse()
    answered = answer.status, answer.read().decode(), {k.lower(): v for k, v in answer.getheaders()}
    connection.close()
    return answered


def looked(server: SiteServer, query: str = "", **more: Any) -> ClientConnection:
    url = f"ws://127.0.0.1:{server.port}/live/stream{query}"
    viewer: ClientConnection = connect(url, proxy=None, compression=None, open_timeout=60, **more)
    return viewer


def messages(viewer: ClientConnection, count: int) -> list[dict[str, Any]]:
    found: list[dict[str, Any]] = []
    while len(found) < count:
        found += json.loads(viewer.recv(timeout=60))
    return found


def test_the_page_is_one_document_that_may_load_nothing() -> None:
    with served() as (_, server):
        status, text, headers = get(server)
        assert status == 200 and "Flight and twin" in text
        policy = headers["content-security-policy"]
        assert "default-src 'none'" in policy and "frame-ancestors 'none'" in policy
        scripts = policy.partition("script-src ")[2].partition(";")[0].split()
        assert len(scripts) == 3 and all(s.startswith("'sha256-") for s in scripts)
        assert get(server, "/elsewhere")[0] == 404


@pytest.mark.parametrize(
    ("host", "status"),
    [
        ("127.0.0.1:{}", 200),
        ("localhost:{}", 200),
        ("[::1]:{}", 200),
        ("192.0.2.7:{}", 200),  # nobody's name resolves to a literal address
        ("rebound.example:{}", 403),
        ("127.0.0.1.rebound.example:{}", 403),
        ("", 403),
        ("127.0.0.1:{}/", 403),
    ],
)
def test_names_of_others_are_refused(host: str, status: int) -> None:
    with served() as (_, server):
        assert get(server, Host=host.format(server.port))[0] == status


def test_pages_of_others_open_no_socket() -> None:
    with served() as (_, server):
        own = f"http://127.0.0.1:{server.port}"
        with looked(server, origin=own):
            pass
        for origin in ("http://evil.example", "null", "http://127.0.0.1", f"{own}.evil.example"):
            with pytest.raises(InvalidStatus) as refused:
                looked(server, origin=origin)
            assert refused.value.response.status_code == 403


def test_the_token_is_asked_for_everywhere() -> None:
    with served(TOKEN) as (_, server):
        assert [
            get(server, p)[0] for p in ("/", "/?token=", "/?token=correct", "/live/stream")
        ] == [403] * 4
        status, _, headers = get(server, "/live?token=correct%20horse")
        assert status == 303 and headers["location"] == "/live"
        cookie = headers["set-cookie"].partition(";")[0]
        assert get(server, Cookie=cookie)[0] == 200
        with looked(server, additional_headers={"Cookie": cookie}):
            pass
        assert get(server, **{"X-Uavtwin-Token": TOKEN})[0] == 200
        assert get(server, "/?token=%F0%9F%90%8E")[0] == 403
        for query in ("", "?token=wrong%20horse"):
            with pytest.raises(InvalidStatus):
                looked(server, query)
        with looked(server, "?token=correct%20horse"):
            pass


@pytest.mark.parametrize("where", ["8080", "127.0.0.1:99999", "127.0.0.1:0", "a b:80"])
def test_what_is_no_address_is_refused(where: str) -> None:
    with pytest.raises(TwinError, match=r"--serve .*: write HOST:PORT"):
        address(where, "", "--serve")


@pytest.mark.parametrize("host", ["0.0.0.0", "192.0.2.7", "::", "ground.example"])
def test_addresses_that_others_reach_have_a_token(host: str) -> None:
    doors = doors_of(host, 8080)
    assert doors.token is not None and len(doors.token) > 20 and doors.cookie
    assert doors_of(host, 8080).token != doors.token
    assert doors_of(host, 8080, TOKEN).token == TOKEN
    with pytest.raises(TwinError, match="at least 8"):
        doors_of(host, 8080, "short")


@pytest.mark.parametrize("host", ["127.0.0.1", "::1", "localhost"])
def test_this_machine_needs_none(host: str) -> None:
    assert doors_of(host, 8080).token is None


def test_a_taken_port_is_named() -> None:
    with served() as (hub, server), pytest.raises(TwinError, match="Choose another port"):
        live_site(hub, port=server.port)


def test_three_viewers_get_the_same_and_one_who_is_late_the_past() -> None:
    with served() as (hub, server):
        hub.send("health", {"n": -2}, key="health")
        hub.send("health", {"n": -1}, key="health")
        with looked(server) as a, looked(server) as b, looked(server) as c:
            first = [messages(v, 1) for v in (a, b, c)]
            assert first == [[{"kind": "health", "n": -1}]] * 3
            for n in range(30):
                hub.send("now", {"n": n, "x": float("nan")})
            answered = [messages(v, 30) for v in (a, b, c)]
            assert answered[0] == answered[1] == answered[2]
            assert [m["n"] for m in answered[0]] == list(range(30)) and answered[0][0]["x"] is None
            with looked(server) as late:
                assert [m["n"] for m in messages(late, 31)] == [-1, *range(30)]
        until = time.monotonic() + 60
        while hub.viewers and time.monotonic() < until:
            time.sleep(0.01)
        assert hub.viewers == 0


def test_the_past_ends() -> None:
    """By time, and of each key but the newest."""
    now = 0.0
    hub = Hub(history_s=10.0, clock=lambda: now)
    for n in range(20):
        now = float(n)
        hub.send("now", {"n": n})
        hub.send("now", {"n": -n}, keep=False)
        hub.send("alarm", {"n": 100 + n}, key="one")
    viewer = hub.join(lambda: None)
    assert viewer is not None
    assert [m["n"] for m in json.loads(viewer.take())] == [119, *range(9, 20)]
    assert viewer.take() == b""


def test_too_many_viewers_are_turned_away() -> None:
    hub = Hub()
    viewers = [hub.join(lambda: None) for _ in range(MOST_VIEWERS)]
    assert None not in viewers and hub.join(lambda: None) is None
    assert viewers[0] is not None
    hub.leave(viewers[0])
    assert hub.join(lambda: None) is not None


def slow_viewer(server: SiteServer) -> socket.socket:
    """One that opens the WebSocket and never reads."""
    opened = socket.socket()
    opened.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
    opened.settimeout(50)
    opened.connect(("127.0.0.1", server.port))
    host = f"127.0.0.1:{server.port}"
    opened.sendall(
        f"GET /live/stream HTTP/1.1\r\nHost: {host}\r\nUpgrade: websocket\r\n"
        "Connection: Upgrade\r\nSec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\n"
        "Sec-WebSocket-Version: 13\r\n\r\n".encode()
    )
    assert b"101" in opened.recv(64)
    return opened


@pytest.mark.slow
def test_a_slow_viewer_loses_messages_and_slows_nobody() -> None:
    text, count = "x" * 20_000, 1500  # 30 MB: more than kernel and server take for it
    with served() as (hub, server):
        slow = slow_viewer(server)
        with looked(server, max_queue=None) as quick:
            until = time.monotonic() + 60
            while hub.viewers < 2 and time.monotonic() < until:
                time.sleep(0.01)
            there = list(hub._viewers)
            longest, got = 0.0, 0
            for n in range(count):
                began = time.perf_counter()
                hub.send("said", {"n": n, "text": text}, keep=False)
                longest = max(longest, time.perf_counter() - began)
                if n % 30 == 29:  # the quick one keeps up
                    found = messages(quick, 30)
                    assert [m["n"] for m in found] == list(range(n - 29, n + 1))
                    got += len(found)
            dropped = sorted(v.dropped for v in there)
            assert got == count and dropped[0] == 0
            assert count / 4 < dropped[1] < count
            assert max(len(v._queue) for v in there) <= QUEUE
            assert longest < 20.0  # a viewer who is waited for takes nothing, ever
        slow.close()


def test_a_viewer_may_ask_for_the_time_and_nothing_else() -> None:
    with served() as (_, server):
        with looked(server) as viewer:
            before = 1e3 * time.time()
            viewer.send(json.dumps({"ping": 12.5}))
            answer = messages(viewer, 1)[0]
            assert answer["kind"] == "pong" and answer["ping"] == 12.5
            assert before - 1 <= answer["at"] <= 1e3 * time.time() + 1
        for wrong in ("{}", "hello", b"\0", '{"ping": ' + " " * 2000 + "1}"):
            with looked(server) as viewer:
                viewer.send(wrong)
                with pytest.raises(ConnectionClosed):
                    viewer.recv(timeout=60)
        assert get(server)[0] == 200


def channel(t_s: np.ndarray[Any, Any], residual: np.ndarray[Any, Any]) -> Channel:
    phase = np.full(len(t_s), "")
    return Channel("acc_x", "m/s^2", 0.0, t_s, residual, np.zeros(len(t_s)), phase)


def test_the_expected_band_is_that_of_the_first_seconds() -> None:
    """95 % of a normal residual about 3; what comes later does not move it."""
    rng, bands = np.random.default_rng(1), ExpectedBands()
    for second in range(60):
        t_s = second + np.arange(100) / 100
        sd = 1.0 if second <= LEARNT_S else 50.0
        assert bool(bands.bands) == (second > LEARNT_S)
        bands.add([channel(t_s, 3 + sd * rng.standard_normal(100))])
    low, high = bands.bands["acc_x", 0.0]
    assert low == pytest.approx(3 - 1.96, abs=0.15) and high == pytest.approx(3 + 1.96, abs=0.15)


def opened(server: SiteServer, sends: bytes = b"") -> socket.socket:
    """A connection that says something, or nothing, and waits."""
    one = socket.socket()
    one.settimeout(50)
    one.connect(("127.0.0.1", server.port))
    one.sendall(sends)
    return one


@pytest.mark.parametrize(
    "sends",
    [b"", b"G", b"GET / HTTP/1.1\r\nHost: 127.0.0.1\r\nX: "],
    ids=["silent", "byte", "head"],
)
def test_idle_connections_keep_nobody_out(sends: bytes, monkeypatch: pytest.MonkeyPatch) -> None:
    """300 connections that complete no request, and are not closed for that; the page, and a viewer
    of it, do not wait for them."""
    monkeypatch.setattr("uavtwin.site.connections._REQUEST_S", 3600.0)
    with served() as (_, server):
        idle = [opened(server, sends) for _ in range(300)]
        try:
            assert get(server)[0] == 200
            with looked(server):
                pass
        finally:
            for one in idle:
                one.close()


@pytest.mark.slow
def test_a_connection_without_a_request_is_closed(monkeypatch: pytest.MonkeyPatch) -> None:
    """So is one whose answer nobody takes, and one that begins a second request; a viewer stays."""
    for name, value in (("_REQUEST_S", 0.3), ("_ANSWER_S", 0.6), ("_WATCH_S", 0.1)):
        monkeypatch.setattr(f"uavtwin.site.connections.{name}", value)
    whole = b"GET /elsewhere HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n"
    with served() as (hub, server), looked(server) as viewer:
        for sends in (b"", b"G", whole + b"GET "):
            one = opened(server, sends)
            while _left(one):
                pass
            one.close()
        taken = opened(server, b"GET / HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n")
        time.sleep(2.0)
        assert _left_bytes(taken) < 5e6
        taken.close()
        hub.send("said", {"n": 1})
        assert messages(viewer, 1)[0]["n"] == 1


def _left(one: socket.socket) -> bytes:
    try:
        return one.recv(65536)
    except ConnectionResetError:
        return b""


def _left_bytes(one: socket.socket) -> int:
    """Bytes until the connection ends; it must end."""
    count = 0
    while got := _left(one):
        count += len(got)
    return count


def test_a_silent_viewer_gives_its_place_to_a_new_one() -> None:
    now = [0.0]
    hub = Hub(clock=lambda: now[0])
    viewers = [hub.join(lambda: None) for _ in range(MOST_VIEWERS)]
    now[0] = SILENT_S + 1.0
    for viewer in viewers[1:]:
        assert viewer is not None
        viewer.heard_s = now[0]
    assert hub.join(lambda: None) is not None and viewers[0] is not None and viewers[0].ended
    assert hub.join(lambda: None) is None and hub.viewers == MOST_VIEWERS
