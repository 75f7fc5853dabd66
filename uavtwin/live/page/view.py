"""The page of a live flight in a site: one document and one WebSocket."""

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
"""WebSocket: try again later."""


class _Question(msgspec.Struct):
    """What a viewer asks: the time, with its own, ms."""

    ping: float


class LiveView:
    """What a live flight shows, and the routes by which a site shows it.

    Attributes:
        feed: Takes what is shown.
        routes: Of the page and its WebSocket.
    """

    def __init__(self, vehicle: Vehicle, following: Following, with_flights: bool) -> None:
        """Nothing is heard yet.

        Args:
            vehicle: The twin.
            following: How the state of the twin is corrected.
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
        hub: What viewers get.
        shown: The page.
    """

    async def page(_: Request) -> Response:
        """The document."""
        return Response(shown.html, media_type="text/html", headers=shown.headers)

    async def stream(websocket: WebSocket) -> None:
        """What is new, as long as the page is open."""
        await _seen(hub, websocket)

    return Route(LIVE, page), WebSocketRoute(f"{LIVE}/stream", stream)


async def _seen(hub: Hub, websocket: WebSocket) -> None:
    """One viewer."""
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
