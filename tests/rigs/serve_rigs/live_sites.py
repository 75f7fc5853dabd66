"""The page of a live flight in a site of its own."""

from starlette.responses import RedirectResponse
from starlette.routing import Route

from uavtwin.live.page.document import document
from uavtwin.live.page.feed import Hub
from uavtwin.live.page.view import live_routes
from uavtwin.site.server import FLIGHTS, LIVE, SiteServer, doors_of, site_app
from uavtwin.sockets import Address, listening


def live_site(hub: Hub, token: str | None = None, port: int = 0) -> SiteServer:
    """A site that is served, of an aircraft with four rotors; close it."""
    taken = listening(Address("127.0.0.1", port), connections=True)
    doors = doors_of("127.0.0.1", int(taken.getsockname()[1]), token)
    first = Route(FLIGHTS, lambda _: RedirectResponse(LIVE))
    app = site_app([first, *live_routes(hub, document(4))], doors)
    return SiteServer(taken, app, doors).start()
