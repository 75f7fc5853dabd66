"""Simulated aircraft on the live page of a site without one, started by a click."""

import logging
import socket
import threading
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

from starlette.requests import Request
from starlette.responses import RedirectResponse, Response
from starlette.routing import BaseRoute, Route, WebSocketRoute
from starlette.websockets import WebSocket

from twin.errors import TwinError

from ..site.server import LIVE

if TYPE_CHECKING:
    from ..live.page.feed import PageFeed
    from ..live.page.view import LiveView
    from ..live.session import LiveOptions
    from ..vehicles import Vehicle

_LOG = logging.getLogger(__name__)
VEHICLE = "copter_default"
"""Vehicle of the simulation."""
_SILENT_S = 5.0
"""Time without messages after which the flight has ended, s."""


class DemoFlight:
    """The flight of `uavtwin live --demo`; one at a time.

    Attributes:
        routes: Routes of the live page.
    """

    def __init__(self, begin_page: Callable[[str], Response]) -> None:
        """Set up without a flight.

        Args:
            begin_page: Draws the page with the start button, and the result of the last flight.
        """
        self._begin_page = begin_page
        self._view: LiveView | None = None
        self._thread: threading.Thread | None = None
        self._ended = threading.Event()
        self._said = ""
        self.routes: Sequence[BaseRoute] = (
            Route(LIVE, self._page),
            Route(f"{LIVE}/demo", self._begin, methods=["POST"]),
            WebSocketRoute(f"{LIVE}/stream", self._stream),
        )

    def close(self) -> None:
        """End the flight."""
        self._ended.set()
        if self._thread is not None:
            self._thread.join()

    @property
    def _flies(self) -> bool:
        return self._thread is not None and self._thread.is_alive()

    async def _page(self, request: Request) -> Response:
        if self._view is None or not self._flies:
            return self._begin_page(self._said)
        answer: Response = await self._view.routes[0].endpoint(request)
        return answer

    async def _stream(self, websocket: WebSocket) -> None:
        if self._view is None:
            await websocket.close()
        else:
            await self._view.routes[1].endpoint(websocket)

    async def _begin(self, _: Request) -> Response:
        """Start a flight, unless one is in progress; the page shows it."""
        if not self._flies:
            from ..live.page.view import LiveView
            from ..live.session import LiveOptions
            from ..sockets import Address
            from ..vehicles import load_vehicle

            options = LiveOptions(Address("127.0.0.1", _free_port()), until_silent_s=_SILENT_S)
            vehicle = load_vehicle(VEHICLE)
            self._view = LiveView(vehicle, options.following, True)
            given = vehicle, options, self._view.feed
            self._thread = threading.Thread(target=self._fly, args=given, daemon=True)
            self._thread.start()
        return RedirectResponse(LIVE, 303)

    def _fly(self, vehicle: "Vehicle", options: "LiveOptions", feed: "PageFeed") -> None:
        """Simulate a flight, send it in real time, and receive it."""
        from twin.why.watch import Watch

        from ..demo.in_flight import damaged_flight, ending, sent_meanwhile
        from ..live.session import LiveSession

        try:
            flight = damaged_flight(vehicle)
            session = LiveSession(vehicle, options, lambda: Watch(vehicle), feed)
            with sent_meanwhile(flight, options.listen):
                session.run(self._ended.is_set, feed.known)
            self._said = f"The last demonstration is over: {ending()}."
        except Exception as error:  # the error of a thread is not visible elsewhere
            _LOG.exception("the demonstration failed")
            what = "" if isinstance(error, TwinError) else f"{type(error).__name__}: "
            self._said = f"The last demonstration failed: {what}{error}"


def _free_port() -> int:
    """A free port for datagrams."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as opened:
        opened.bind(("127.0.0.1", 0))
        return int(opened.getsockname()[1])
