"""The small server of the page, one page and one WebSocket in a thread of its own."""

import asyncio
import contextlib
import threading
import time
from typing import Self

import msgspec
import uvicorn
from starlette.applications import Starlette
from starlette.datastructures import Headers, QueryParams
from starlette.requests import Request
from starlette.responses import PlainTextResponse, Response
from starlette.routing import Route, WebSocketRoute
from starlette.types import ASGIApp, Receive, Scope, Send
from starlette.websockets import WebSocket, WebSocketDisconnect

from twin.errors import TwinError

from ...connections import LimitedConnection
from ...doors import SHORTEST_TOKEN, Doors, host_and_port, is_loopback
from ..datagrams import Address, listening
from .document import Document
from .feed import Hub, Viewer


def page_address(text: str, token: str | None) -> Address:
    """The address of `--serve`.

    Raises:
        TwinError: It is none, or others can reach it and there is no token to keep them out.
    """
    where = Address(*host_and_port(text, "--serve"))
    if token is not None and len(token) < SHORTEST_TOKEN:
        raise TwinError(f"--token: {len(token)} characters, at least {SHORTEST_TOKEN} are needed.")
    if token is None and not is_loopback(where.host):
        raise TwinError(
            f"--serve {text}: others can reach that address. Give --token TEXT, which they then "
            f"need, or serve at 127.0.0.1:{where.port}."
        )
    return where


_LONGEST = 1024
"""Bytes of what a viewer may say."""
_START_S = 20.0
"""Longest start of the server, s. Made up."""
_GRACE_S = 2
"""For which connections may end by themselves, s. Made up."""
_TOO_MANY = 1013
"""WebSocket: try again later."""


class _Question(msgspec.Struct):
    """What a viewer asks: the time, with its own, ms."""

    ping: float


class _Guarded:
    """The application behind its doors."""

    def __init__(self, app: ASGIApp, doors: Doors) -> None:
        self._app, self._doors = app, doors

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """As ASGI has it."""
        query = QueryParams(scope.get("query_string", b""))
        why = self._doors.refusal(Headers(scope=scope), query)
        if not why:
            await self._app(scope, receive, send)
        elif scope["type"] == "websocket":
            await receive()
            await send({"type": "websocket.close", "code": 1008, "reason": ""})
        else:
            await PlainTextResponse(why, 403)(scope, receive, send)


class PageServer:
    """Serves the page of a live flight until it is closed."""

    def __init__(self, where: Address, hub: Hub, document: Document, token: str | None) -> None:
        """Begin to serve.

        Args:
            where: Address; port 0: any that is free.
            hub: What viewers get.
            document: The page.
            token: What a viewer must know; None: nothing.

        Raises:
            TwinError: The address cannot be used.
        """
        self._hub, self._document = hub, document
        self._socket = listening(where, connections=True)
        self.where = Address(where.host, int(self._socket.getsockname()[1]))
        routes = [Route("/", self._page), WebSocketRoute("/live", self._live)]
        config = uvicorn.Config(
            _Guarded(Starlette(routes=routes), Doors(where.host, token)),
            loop="asyncio",
            http=LimitedConnection,
            ws="websockets-sansio",
            ws_max_size=_LONGEST,
            ws_max_queue=4,
            ws_per_message_deflate=False,
            lifespan="off",
            log_config=None,
            access_log=False,
            server_header=False,
            proxy_headers=False,
            timeout_graceful_shutdown=_GRACE_S,
        )
        self._server = uvicorn.Server(config)
        self._thread = threading.Thread(target=self._run, name="page", daemon=True)
        self._thread.start()
        until = time.monotonic() + _START_S
        while not self._server.started and self._thread.is_alive() and time.monotonic() < until:
            time.sleep(0.01)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    @property
    def url(self) -> str:
        """For a browser, without the token."""
        host = f"[{self.where.host}]" if ":" in self.where.host else self.where.host
        return f"http://{host}:{self.where.port}/"

    def close(self) -> None:
        """End; viewers are notified."""
        self._server.should_exit = True
        self._thread.join(_GRACE_S + 3)
        self._socket.close()

    def _run(self) -> None:
        self._server.run(sockets=[self._socket])

    async def _page(self, _: Request) -> Response:
        return Response(self._document.html, media_type="text/html", headers=self._document.headers)

    async def _live(self, websocket: WebSocket) -> None:
        """One viewer."""
        loop, bell = asyncio.get_running_loop(), asyncio.Event()
        await websocket.accept()
        viewer = self._hub.join(lambda: loop.call_soon_threadsafe(bell.set))
        if viewer is None:
            with contextlib.suppress(RuntimeError, WebSocketDisconnect):
                await websocket.close(_TOO_MANY)
            return
        sender = asyncio.create_task(_send(websocket, viewer, bell))
        hearer = asyncio.create_task(_hear(websocket, viewer))
        try:
            await asyncio.wait((sender, hearer), return_when=asyncio.FIRST_COMPLETED)
        finally:
            self._hub.leave(viewer)
            for task in (sender, hearer):
                task.cancel()
            await asyncio.gather(sender, hearer, return_exceptions=True)
            with contextlib.suppress(RuntimeError, WebSocketDisconnect):  # it is closed already
                await websocket.close()


async def _send(websocket: WebSocket, viewer: Viewer, bell: asyncio.Event) -> None:
    """All that waits, whenever something does; as fast as the viewer takes it."""
    reported = 0
    while not viewer.ended:
        bell.clear()
        if waiting := viewer.take():
            await websocket.send_text(waiting.decode())
        if viewer.dropped != reported:
            reported = viewer.dropped
            lost = msgspec.json.encode([{"kind": "dropped", "count": reported}])
            await websocket.send_text(lost.decode())
        await bell.wait()


async def _hear(websocket: WebSocket, viewer: Viewer) -> None:
    """Answer questions for the time, until it leaves or says anything else."""
    with contextlib.suppress(WebSocketDisconnect, msgspec.MsgspecError, KeyError):
        while True:
            question = msgspec.json.decode(await websocket.receive_text(), type=_Question)
            viewer.heard_s = time.monotonic()
            now_ms = 1e3 * time.time()
            answer = {"kind": "pong", "ping": question.ping, "at": now_ms}
            viewer.put(msgspec.json.encode(answer))
