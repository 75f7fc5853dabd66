"""What the site answers, over a real socket; jobs stay in the queue where nothing does them."""

import asyncio
import contextlib
import json
import os
import re
import socket
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from serve_rigs.sites import Asked, site
from starlette.responses import PlainTextResponse
from starlette.types import Message

from twin.errors import TwinError
from uavtwin.serve.opened import open_site
from uavtwin.serve.store import Store
from uavtwin.site import server
from uavtwin.site.doors import AccessPolicy
from uavtwin.site.server import Guarded, SiteServer, address_of, doors_of
from uavtwin.sockets import Address, listening

pytestmark = pytest.mark.slow
HOSTILE = '"><img src=x onerror=alert(1)><script>alert(1)</script>.ulg'


@pytest.fixture
def asked(tmp_path: Path) -> Iterator[Asked]:
    with site(tmp_path, most_bytes=1000) as opened:
        yield opened


def uploaded(asked: Asked, name: str = "a.ulg", content: bytes = b"log") -> str:
    status, text, _ = asked.ask(f"/upload/{name}", "PUT", content)
    assert status in (200, 201), text
    return str(json.loads(text)["flight"])


def test_a_log_is_in_the_list_at_once(asked: Asked) -> None:
    assert "No flight yet" in asked.ask("/")[1]
    flight = uploaded(asked)
    page = asked.ask("/")[1]
    assert f"/flights/{flight}" in page and ">a.ulg<" in page
    assert asked.ask("/upload", "PUT", b"of no name")[0] == 201
    status, text, _ = asked.ask("/upload/b.ulg", "PUT", b"log")
    assert status == 200 and json.loads(text) == {
        "flight": flight,
        "address": f"/flights/{flight}",
        "created": False,
    }


def test_every_page_may_run_our_scripts_alone(asked: Asked) -> None:
    flight = uploaded(asked)
    for path in ("/", f"/flights/{flight}", "/flights/none", f"/flights/{flight}/why"):
        policy = asked.ask(path)[2]["content-security-policy"]
        assert "default-src 'none'" in policy and "frame-ancestors 'none'" in policy
        allowed = policy.partition("script-src ")[2].partition(";")[0].split()
        assert len(allowed) == 3 and all(s.startswith("'sha256-") for s in allowed)


def test_the_page_of_live_says_how_something_flies(asked: Asked) -> None:
    status, text, _ = asked.ask("/live")
    assert status == 200 and "uavtwin live --vehicle FILE --store" in text
    assert '<a href="/live">Live</a>' in asked.ask("/")[1]


def test_scripts_of_reports_that_earlier_versions_wrote_still_run(tmp_path: Path) -> None:
    store = Store(tmp_path)
    store.known_scripts(["of-an-earlier-version"])
    store.close()
    with site(tmp_path) as asked:
        assert "'sha256-of-an-earlier-version'" in asked.ask("/")[2]["content-security-policy"]


def test_a_hostile_name_is_text(asked: Asked) -> None:
    flight = uploaded(asked, "".join(f"%{b:02x}" for b in HOSTILE.encode()), b"x")
    for path in ("/", f"/flights/{flight}"):
        text = asked.ask(path)[1]
        assert "<img" not in text and "alert(1)<" not in text


def test_a_search_is_text(asked: Asked) -> None:
    text = asked.ask("/?q=%3Cscript%3Ealert(1)%3C/script%3E")[1]
    assert "<script>alert" not in text and "No flight holds" in text


def test_too_large_a_log_is_refused_with_the_limit(asked: Asked) -> None:
    status, text, _ = asked.ask("/upload/a.ulg", "PUT", bytes(1001))
    assert status == 413 and "--size-limit" in json.loads(text)["error"]
    chunked = {"Transfer-Encoding": "chunked"}
    many = b"".join(b"200\r\n" + bytes(512) + b"\r\n" for _ in range(3)) + b"0\r\n\r\n"
    assert asked.ask("/upload/a.ulg", "PUT", many, chunked)[0] == 413
    assert "No flight yet" in asked.ask("/")[1]


def test_forms_change_what_they_say(asked: Asked) -> None:
    flight = uploaded(asked)
    assert asked.ask(f"/flights/{flight}/tags", "POST", b"tags=windy+%3Cb%3E")[0] == 303
    assert "windy &lt;b&gt;" in asked.ask("/?q=windy")[1]
    assert asked.ask(f"/flights/{flight}/vehicle", "POST", b"vehicle=copter_default")[0] == 303
    page = asked.ask(f"/flights/{flight}")[1]
    assert "<option>hex x</option>" in page
    assert "waits for a free worker" in page and "<option selected>copter_default" in page
    assert asked.ask(f"/flights/{flight}/jobs/gap/cancel", "POST")[0] == 303
    assert "<b>Cancelled.</b>" in asked.ask(f"/flights/{flight}")[1]
    assert asked.ask(f"/flights/{flight}/delete", "POST")[0] == 303
    assert asked.ask(f"/flights/{flight}")[0] == 404


@pytest.mark.parametrize(
    ("path", "body", "status", "says"),
    [
        ("vehicle", b"vehicle=../../etc/passwd", 400, "there is none of this name"),
        ("draft", b"mass_kg=heavy", 400, "needs a positive number"),
        ("draft", b"", 400, "Weigh the aircraft"),
        ("jobs/gap", b"", 400, "choose or draft a vehicle first"),
        ("jobs/nonsense", b"", 404, "no such job"),
        ("tags", b"tags=" + bytes(20_000), 400, "a form of over"),
    ],
)
def test_what_does_not_fit_is_said(
    asked: Asked, path: str, body: bytes, status: int, says: str
) -> None:
    found, text, _ = asked.ask(f"/flights/{uploaded(asked)}/{path}", "POST", body)
    assert found == status and says in text


@pytest.mark.parametrize(
    "name",
    ["../../store.duckdb", "..%2f..%2ftoken", "%2e%2e/%2e%2e/token", "draft.json", "nothing"],
)
def test_only_results_are_served(asked: Asked, name: str) -> None:
    flight = uploaded(asked)
    assert asked.ask(f"/flights/{flight}/files/{name}")[0] == 404


def test_a_log_comes_back_as_a_download_that_nothing_runs(asked: Asked) -> None:
    flight = uploaded(asked, "a.html", b"<script>alert(1)</script>")
    status, text, headers = asked.ask(f"/flights/{flight}/files/log")
    assert status == 200 and text == "<script>alert(1)</script>"
    assert headers["content-type"] == "application/octet-stream"
    assert headers["content-disposition"] == 'attachment; filename="a.html"'
    assert headers["x-content-type-options"] == "nosniff"


def test_two_flights_are_needed_to_compare(asked: Asked) -> None:
    one, other = uploaded(asked), uploaded(asked, "b.ulg", b"other")
    assert asked.ask(f"/compare?f={one}")[0] == 400
    status, _, headers = asked.ask(f"/compare?f={one}&f={other}")
    assert (status, headers["location"]) == (303, f"/flights/{one}/compare/{other}")
    assert "is being read" in asked.ask(headers["location"])[1]
    assert asked.ask(f"/flights/{one}/compare/{one}")[0] == 404


@pytest.mark.parametrize(
    ("headers", "status"),
    [
        ({}, 200),
        ({"Host": "localhost:80"}, 200),
        ({"Host": "rebound.example"}, 403),
        ({"Origin": "http://elsewhere.example"}, 403),
        ({"Origin": "null"}, 403),
    ],
)
def test_names_and_pages_of_others_are_refused(
    asked: Asked, headers: dict[str, str], status: int
) -> None:
    assert asked.ask("/", headers=headers)[0] == status
    assert (asked.ask("/upload/a", "PUT", b"x", headers)[0] == 403) == (status == 403)


def test_the_address_of_a_site_at_all_addresses_has_the_name_of_the_machine() -> None:
    assert address_of("0.0.0.0", 80, "t") == f"http://{socket.gethostname()}:80/?token=t"
    assert address_of("192.0.2.7", 80, None) == "http://192.0.2.7:80/"


COOKIE = doors_of("0.0.0.0", 8080).cookie


def answered(
    doors: AccessPolicy, query: bytes = b"", cookie: str = "", path: str = "/a"
) -> tuple[int, dict[str, str]]:
    """Status and headers of a page behind doors."""
    sent: list[Message] = []

    async def send(message: Message) -> None:
        sent.append(message)

    async def receive() -> Message:
        return {"type": "http.request", "body": b"", "more_body": False}

    headers = [(b"host", b"twin.example:8080")] + [(b"cookie", cookie.encode())] * bool(cookie)
    scope = {"type": "http", "method": "GET", "path": path, "query_string": query}
    scope |= {"headers": headers}
    asyncio.run(Guarded(PlainTextResponse("inside"), doors)(scope, receive, send))
    return sent[0]["status"], {k.decode(): v.decode() for k, v in sent[0]["headers"]}


def test_beyond_this_machine_the_token_is_needed_once() -> None:
    doors = AccessPolicy("0.0.0.0", "correct horse", COOKIE)
    assert answered(doors)[0] == 403
    assert answered(doors, b"token=wrong")[0] == 403
    assert answered(doors, cookie=f"{COOKIE}=wrong")[0] == 403
    status, headers = answered(doors, b"token=correct+horse&q=x")
    assert status == 303 and headers["location"] == "/a?q=x"
    cookie = headers["set-cookie"]
    assert "HttpOnly" in cookie and "samesite=lax" in cookie.lower()
    value = re.match(rf"{COOKIE}=(\"?[^;]*)", cookie)
    assert value is not None
    assert answered(doors, cookie=value[0])[0] == 200
    assert answered(doors, cookie=value[0].replace("8080", "8081"))[0] == 403


def test_a_link_with_the_token_leads_to_no_other_server() -> None:
    doors = AccessPolicy("0.0.0.0", "correct horse", COOKIE)
    for path in ("//evil.example/x", "/\\evil.example/x", "\\/evil.example/x"):
        _, headers = answered(doors, b"token=correct+horse", path=path)
        assert headers["location"] == "/evil.example/x"
    known = f'{COOKIE}="correct horse"'
    assert answered(doors, b"token=", known, "//evil.example/x")[0] == 200


def test_an_empty_token_opens_nothing() -> None:
    for token in ("", "short"):
        with pytest.raises(TwinError, match="at least 8"):
            AccessPolicy("0.0.0.0", token)


@pytest.mark.parametrize("with_flights", [False, True], ids=["alone", "with flights"])
@pytest.mark.parametrize("token", ["", "short"])
def test_a_short_token_opens_no_site(tmp_path: Path, with_flights: bool, token: str) -> None:
    folder = tmp_path / "store"
    with (
        pytest.raises(TwinError, match="at least 8"),
        open_site(free_address(), "--serve", folder if with_flights else None, token=token),
    ):
        pass
    assert not folder.exists(), "nothing was opened before the token was checked"


def test_a_site_that_cannot_be_made_leaves_the_store_closed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fails(*_: object) -> None:
        raise TwinError("no site")

    with monkeypatch.context() as patched:
        patched.setattr("uavtwin.serve.server.Site", fails)
        with (
            pytest.raises(TwinError, match="no site"),
            open_site(free_address(), "--serve", tmp_path),
        ):
            pass
    handles = [os.readlink(f) for f in Path("/proc/self/fd").iterdir() if f.exists()]
    assert str(tmp_path / "store.duckdb") not in handles


def free_address() -> str:
    with socket.create_server(("127.0.0.1", 0)) as free:
        return f"127.0.0.1:{free.getsockname()[1]}"


@pytest.mark.parametrize("ends", [True, False], ids=["ends at once", "never starts"])
def test_a_server_that_does_not_start_is_an_error(
    monkeypatch: pytest.MonkeyPatch, ends: bool
) -> None:
    over = threading.Event()
    monkeypatch.setattr(server, "_START_S", 0.2)
    doors = doors_of("127.0.0.1", 1)
    made = SiteServer(
        listening(Address("127.0.0.1", 0), connections=True), PlainTextResponse("inside"), doors
    )
    monkeypatch.setattr(made, "run", (lambda: None) if ends else over.wait)
    monkeypatch.setattr(server, "_GRACE_S", -3)  # close does not wait for it
    why = "has ended" if ends else r"has not started within 0\.2 s"
    with pytest.raises(TwinError, match=why):
        made.start()
    over.set()


def opened(asked: Asked, sends: bytes = b"") -> socket.socket:
    """A connection that has sent something, or nothing."""
    one = socket.create_connection(("127.0.0.1", asked.port), timeout=50)
    one.sendall(sends)
    return one


@pytest.mark.parametrize("sends", [b"", b"GET / HTTP/1.1\r\nHost: 127.0.0.1\r\nX: "])
def test_idle_connections_keep_nobody_out(asked: Asked, sends: bytes) -> None:
    with contextlib.ExitStack() as idle:
        for _ in range(300):
            idle.enter_context(opened(asked, sends))
        assert asked.ask("/")[0] == 200


def ended_s(one: socket.socket) -> float:
    """After which the server closes a connection, s."""
    began = time.monotonic()
    with contextlib.suppress(ConnectionError):
        while one.recv(65536):
            pass
    return time.monotonic() - began


def test_who_does_nothing_is_closed_and_who_is_slow_is_not(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Events without end, an upload and a download last longer than any limit."""
    for name, value in (("_REQUEST_S", 0.3), ("_ANSWER_S", 3.0), ("_WATCH_S", 0.1)):
        monkeypatch.setattr(f"uavtwin.site.connections.{name}", value)
    content = bytes(range(256)) * 40_000
    head = b" HTTP/1.1\r\nHost: 127.0.0.1\r\n"
    with site(tmp_path, most_bytes=20_000_000) as asked:
        large = uploaded(asked, "large.ulg", content)
        with contextlib.ExitStack() as all_of_them:
            connected = [
                all_of_them.enter_context(opened(asked, sends))
                for sends in (
                    b"GET /events" + head + b"\r\n",
                    b"PUT /upload/slow.ulg" + head + b"Content-Length: 20\r\n\r\n",
                    b"GET /flights/%b/files/log" % large.encode() + head + b"\r\n",
                    b"PUT /upload/none.ulg" + head + b"Content-Length: 20\r\n\r\nhalf",
                    b"GET /flights/%b/files/log" % large.encode() + head + b"\r\n",
                    b"G",
                )
            ]
            events, slow, download, half, untaken, byte = connected
            taken = 0
            for _ in range(20):
                time.sleep(0.2)
                slow.sendall(b"x")
                taken += len(download.recv(400_000))
            assert b"201 Created" in slow.recv(4096)
            while taken < len(content) and (part := download.recv(400_000)):
                taken += len(part)
            assert taken >= len(content)
            for one in (half, untaken, byte):
                assert ended_s(one) < 50.0  # without these limits a minute
            asked.ask(f"/flights/{large}/tags", "POST", b"tags=fresh")
            text = b""
            while b"fresh" not in text and (part := events.recv(65536)):
                text += part
            assert b"fresh" in text


def test_events_begin_with_all_flights(asked: Asked) -> None:
    flight = uploaded(asked)
    with socket.create_connection(("127.0.0.1", asked.port), timeout=50) as connection:
        connection.sendall(b"GET /events HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n")
        text = b""
        while b"a.ulg" not in text:
            text += connection.recv(65536)
        assert b"text/event-stream" in text and b"x-accel-buffering: no" in text.lower()
        assert f"flight-{flight}".encode() in text
        asked.ask(f"/flights/{flight}/tags", "POST", b"tags=fresh")
        while b"fresh" not in text:
            text += connection.recv(65536)


@pytest.mark.parametrize("content", [b"\0nonsense", b"#" * 64_001])
def test_what_is_no_mapping_is_refused_by_name(asked: Asked, content: bytes) -> None:
    status, text, _ = asked.ask("/upload/day.topics.toml", "PUT", content)
    assert status == 400
    assert "day.topics.toml" in json.loads(text)["error"]


def test_a_demonstration_that_breaks_says_so(
    asked: Asked, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    def broken(_: object) -> None:
        raise MemoryError("no room")

    monkeypatch.setattr("uavtwin.demo.in_flight.damaged_flight", broken)
    assert asked.ask("/live/demo", "POST")[0] == 303
    page = asked.wait("/live", "The last demonstration failed")
    assert "MemoryError: no room" in page
    assert "Traceback" in caplog.text
