"""One application of many pages: access rules, a navigation bar, and the server."""

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
"""Lifetime of the cookie, s."""
_MOST_CONNECTIONS = 256
"""Largest number of simultaneous connections; more are refused."""
_GRACE_S = 1
"""Time in which answers may be completed when the server ends, s."""
_START_S = 20.0
"""Longest start of a server in a thread, s. Made up."""
_LONGEST_MESSAGE = 1024
"""Largest size of a message from a viewer through a WebSocket."""


def style() -> str:
    """Style sheet of the navigation."""
    return (Path(__file__).parent / "site.css").read_text("utf-8")


def navigation(*links: tuple[str, str]) -> Markup:
    """Navigation bar of a page.

    Args:
        links: Text and address of each link.
    """
    listed = "".join(f'<a href="{escape(to)}">{escape(word)}</a>' for word, to in links)
    return Markup(f'<nav class="site" aria-label="Site">{listed}</nav>')


def hash_of(script: str) -> str:
    """SHA-256 of a script, in the form of a content security policy."""
    return b64encode(sha256(script.encode()).digest()).decode()


def headers(hashes: Sequence[str] = ()) -> dict[str, str]:
    """Headers of an answer: injected scripts do not run, nothing is loaded from elsewhere.

    Args:
        hashes: Hashes of the allowed scripts.
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
    """Access rules of a site at an address: anybody on this machine, from others with the token.

    Args:
        host: Name or address of the server.
        port: Port of the server.
        token: Token of viewers; None: a new one where other machines can reach the address.

    Raises:
        TwinError: The token is too short.
    """
    if token is None and not is_loopback(host):
        token = secrets.token_urlsafe(24)
    # a browser shares cookies between all ports of a host
    return AccessPolicy(host, token, "" if token is None else f"uavtwin-{port}")


def address_of(host: str, port: int, token: str | None) -> str:
    """Address for a browser; with the machine's name where the server uses all its addresses."""
    shown = f"[{host}]" if ":" in host else host
    if host in ("0.0.0.0", "::"):
        shown = socket.gethostname()
    return f"http://{shown}:{port}/{f'?token={quote(token)}' if token else ''}"


class Guarded:
    """An application with access rules; a valid token is stored in a cookie."""

    def __init__(self, app: ASGIApp, doors: AccessPolicy) -> None:
        """Set up an application with its rules."""
        self._app, self._doors = app, doors

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Handle a connection, as in ASGI."""
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
        routes: Routes of all its pages.
        doors: Access rules.
    """
    return Guarded(Starlette(routes=routes), doors)


def _made_server(app: ASGIApp) -> uvicorn.Server:
    """A server that runs until a signal to end."""
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
    """A site and its address: served by `run` until a signal to end, or by `start`.

    Attributes:
        port: Port of the server.
        url: Address for a browser.
    """

    def __init__(self, opened: socket.socket, app: ASGIApp, doors: AccessPolicy) -> None:
        """Set up without serving.

        Args:
            opened: Socket that accepts connections; closed at the end.
            app: Application from `site_app`.
            doors: Access rules of the application.
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
            TwinError: It ended immediately, or has not started after 20 s.
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
