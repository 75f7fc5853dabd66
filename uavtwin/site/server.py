"""One application of many pages: doors in front, a navigation on top, a server that carries it."""

import secrets
import socket
import threading
import time
from base64 import b64encode
from collections.abc import Sequence
from hashlib import sha256
from pathlib import Path
from typing import Self
from urllib.parse import quote

import uvicorn
from markupsafe import Markup, escape
from starlette.applications import Starlette
from starlette.datastructures import Headers, QueryParams
from starlette.requests import cookie_parser
from starlette.responses import RedirectResponse, Response
from starlette.routing import BaseRoute
from starlette.types import ASGIApp, Receive, Scope, Send

from twin.errors import TwinError

from .connections import LimitedConnection
from .doors import AccessPolicy, is_loopback

FLIGHTS, LIVE = "/", "/live"
"""Addresses of the list of flights, and of the page of a live flight."""
_COOKIE_S = 365 * 86400
"""Life of the cookie, s."""
_MOST_CONNECTIONS = 256
"""At once; more are refused."""
_GRACE_S = 1
"""For which answers may end by themselves when the server ends, s."""
_START_S = 20.0
"""Longest start of a server in a thread, s. Made up."""
_LONGEST_MESSAGE = 1024
"""Bytes of what a viewer may say through a WebSocket."""


def style() -> str:
    """Of the navigation."""
    return (Path(__file__).parent / "site.css").read_text("utf-8")


def navigation(*links: tuple[str, str]) -> Markup:
    """The bar on top of a page.

    Args:
        links: Word and address of each page it leads to.
    """
    listed = "".join(f'<a href="{escape(to)}">{escape(word)}</a>' for word, to in links)
    return Markup(f'<nav class="site" aria-label="Site">{listed}</nav>')


def hash_of(script: str) -> str:
    """SHA-256 of a script, as a policy names it."""
    return b64encode(sha256(script.encode()).digest()).decode()


def headers(hashes: Sequence[str] = ()) -> dict[str, str]:
    """Of an answer: what a log smuggles into a page does not run, nothing is loaded from elsewhere.

    Args:
        hashes: Of the scripts that run.
    """
    allowed = " ".join(f"'sha256-{h}'" for h in hashes) or "'none'"
    policy = (
        f"default-src 'none'; script-src {allowed}; style-src 'unsafe-inline'; "
        "img-src data: blob:; connect-src 'self'; base-uri 'none'; form-action 'self'; "
        "frame-ancestors 'none'"
    )
    return {
        "Content-Security-Policy": policy,
        "X-Content-Type-Options": "nosniff",
        "Referrer-Policy": "same-origin",
        "Cross-Origin-Resource-Policy": "same-origin",
        "Cross-Origin-Opener-Policy": "same-origin",
        "Cache-Control": "no-store",
    }


def doors_of(host: str, port: int, token: str | None = None) -> AccessPolicy:
    """Who may ask a site at an address: anybody on this machine, beyond it who knows the token.

    Args:
        host: Name or address that is served at.
        port: Of it.
        token: What viewers must know; None: a new one where others can reach the address.

    Raises:
        TwinError: The token is too short.
    """
    if token is None and not is_loopback(host):
        token = secrets.token_urlsafe(24)
    # a browser has one jar of cookies for all ports of a host
    return AccessPolicy(host, token, "" if token is None else f"uavtwin-{port}")


def address_of(host: str, port: int, token: str | None) -> str:
    """For a browser; by the machine's name where it is served at all its addresses."""
    shown = f"[{host}]" if ":" in host else host
    if host in ("0.0.0.0", "::"):
        shown = socket.gethostname()
    return f"http://{shown}:{port}/{f'?token={quote(token)}' if token else ''}"


class Guarded:
    """An application behind doors; a token that fits is stored in a cookie."""

    def __init__(self, app: ASGIApp, doors: AccessPolicy) -> None:
        """Keep both."""
        self._app, self._doors = app, doors

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """As ASGI has it."""
        sent, query = Headers(scope=scope), QueryParams(scope.get("query_string", b""))
        why = self._doors.refusal(sent, query, cookie_parser(sent.get("cookie", "")))
        if why and scope["type"] == "websocket":
            await receive()
            await send({"type": "websocket.close", "code": 1008, "reason": ""})
        elif why:
            await Response(why, 403, headers(), "text/plain")(scope, receive, send)
        elif scope.get("method") == "GET" and self._doors.fits(query.get("token", "")):
            rest = [(k, v) for k, v in query.multi_items() if k != "token"]
            asked = f"?{QueryParams(rest)}" if rest else ""
            path = "/" + scope["path"].lstrip("/\\")  # `//name` would be another server
            answer = RedirectResponse(f"{quote(path)}{asked}", 303, headers())
            cookie = self._doors.cookie, query["token"]
            answer.set_cookie(*cookie, max_age=_COOKIE_S, httponly=True, samesite="lax")
            await answer(scope, receive, send)
        else:
            await self._app(scope, receive, send)


def site_app(routes: Sequence[BaseRoute], doors: AccessPolicy) -> ASGIApp:
    """The application of a site.

    Args:
        routes: Of all its pages.
        doors: Who may ask.
    """
    return Guarded(Starlette(routes=routes), doors)


def _made_server(app: ASGIApp) -> uvicorn.Server:
    """A server that runs until it is told to end."""
    return uvicorn.Server(
        uvicorn.Config(
            app,
            loop="asyncio",
            http=LimitedConnection,
            ws="websockets-sansio",
            ws_max_size=_LONGEST_MESSAGE,
            ws_max_queue=4,
            ws_per_message_deflate=False,
            lifespan="off",
            log_config=None,
            access_log=False,
            server_header=False,
            proxy_headers=False,
            limit_concurrency=_MOST_CONNECTIONS,
            timeout_graceful_shutdown=_GRACE_S,
        )
    )


class SiteServer:
    """A site and where it is served: by `run` until the process is told to end, or by `start`.

    Attributes:
        port: That is served at.
        url: For a browser.
    """

    def __init__(self, opened: socket.socket, app: ASGIApp, doors: AccessPolicy) -> None:
        """Serve nothing yet.

        Args:
            opened: Takes connections; closed at the end.
            app: Of `site_app`.
            doors: In front of it.
        """
        self._socket = opened
        self.port = int(opened.getsockname()[1])
        self.url = address_of(doors.host, self.port, doors.token)
        self._server = _made_server(app)
        self._thread: threading.Thread | None = None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def run(self) -> None:
        """Serve until Ctrl-C or a signal to end."""
        self._server.run(sockets=[self._socket])

    def start(self) -> Self:
        """Serve in a thread, until it is closed.

        Raises:
            TwinError: It has ended at once, or has not started after 20 s.
        """
        self._thread = thread = threading.Thread(target=self.run, name="site", daemon=True)
        thread.start()
        until = time.monotonic() + _START_S
        while not self._server.started and thread.is_alive() and time.monotonic() < until:
            time.sleep(0.01)
        if not self._server.started:
            why = f"has not started within {_START_S:g} s" if thread.is_alive() else "has ended"
            self.close()
            raise TwinError(f"the server at port {self.port} {why}. Try again, or another port.")
        return self

    def close(self) -> None:
        """End; viewers are notified."""
        self._server.should_exit = True
        if self._thread is not None:
            self._thread.join(_GRACE_S + 3)
        self._socket.close()
