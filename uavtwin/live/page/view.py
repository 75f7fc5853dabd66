"""Page of a live flight in a site: one document and one WebSocket."""

import asyncio
import contextlib
import time

import msgspec
from starlette.requests import Request
from starlette.responses import Response
from starlette.routing import Route, WebSocketRoute
from starlette.websockets import WebSocket, WebSocketDisconnect

from twin.vehicle import Vehicle

from ...site.server import FLIGHTS, LIVE, navigation
from ..following import Following
from .document import Document, document
from .feed import Hub, PageFeed, Viewer

_TOO_MANY = 1013
"""Close code of a WebSocket: try again later."""


class _Question(msgspec.Struct):
    """Request of a viewer for the time, with its own time, ms."""

    ping: float


class LiveView:
    """Content of a live flight's page, and its routes in a site.

    Attributes:
        feed: Feed of the displayed data.
        routes: Routes of the page and its WebSocket.
    """

    def __init__(self, vehicle: Vehicle, following: Following, with_flights: bool) -> None:
        """Set up without data.

        Args:
            vehicle: Vehicle of the twin.
            following: Correction of the twin's state.
            with_flights: Whether the site has a list of flights.
        """
        hub = Hub()
        self.feed = PageFeed(hub, vehicle.name, following)
        bar = navigation(("Flights", FLIGHTS), ("Live", LIVE)) if with_flights else ""
        shown = document(vehicle.rotors.count, bar)
        self.routes = live_routes(hub, shown)


def live_routes(hub: Hub, shown: Document) -> tuple[Route, WebSocketRoute]:
    """Routes of a page and of its WebSocket.

    Args:
        hub: Hub of the viewers.
        shown: Page to serve.
    """

    async def page(_: Request) -> Response:
        """The document."""
        return Response(shown.html, media_type="text/html", headers=shown.headers)

    async def stream(websocket: WebSocket) -> None:
        """Stream of changes, as long as the page is open."""
        await _seen(hub, websocket)

    return Route(LIVE, page), WebSocketRoute(f"{LIVE}/stream", stream)


async def _seen(hub: Hub, websocket: WebSocket) -> None:
    """Serve one viewer."""
    loop, bell = asyncio.get_running_loop(), asyncio.Event()
    await websocket.accept()
    viewer = hub.join(lambda: loop.call_soon_threadsafe(bell.set))
    if viewer is None:
        with contextlib.suppress(RuntimeError, WebSocketDisconnect):
            await websocket.close(_TOO_MANY)
        return
    sender = asyncio.create_task(_send(websocket, viewer, bell))
    hearer = asyncio.create_task(_hear(websocket, viewer))
    try:
        await asyncio.wait((sender, hearer), return_when=asyncio.FIRST_COMPLETED)
    finally:
        hub.leave(viewer)
        for task in (sender, hearer):
            task.cancel()
        await asyncio.gather(sender, hearer, return_exceptions=True)
        with contextlib.suppress(RuntimeError, WebSocketDisconnect):  # it is closed already
            await websocket.close()


async def _send(websocket: WebSocket, viewer: Viewer, bell: asyncio.Event) -> None:
    """Send waiting messages as they arrive, as fast as the viewer receives them."""
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
    """Answer requests for the time, until the viewer leaves or sends anything else."""
    with contextlib.suppress(WebSocketDisconnect, msgspec.MsgspecError, KeyError):
        while True:
            question = msgspec.json.decode(await websocket.receive_text(), type=_Question)
            viewer.heard_s = time.monotonic()
            now_ms = 1e3 * time.time()
            answer = {"kind": "pong", "ping": question.ping, "at": now_ms}
            viewer.put(msgspec.json.encode(answer))
