"""Set-up of a site with stored flights, a live flight, or both, for the verbs `serve` and
`live`."""

from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING

from twin.errors import TwinError, install_command

from ..site.doors import is_loopback
from ..sockets import address, listening

if TYPE_CHECKING:
    from ..live.page.view import LiveView
    from ..site.server import SiteServer
    from .schedule import Limits

_OF_SITE, _OF_STORE = ("starlette", "uvicorn", "websockets"), ("duckdb",)
"""Packages of any site, and of one with stored flights."""
Add = Callable[[Path, str], str]
"""Function that adds a log to the flights, by file and name."""


def lacking(with_flights: bool) -> list[str]:
    """Necessary packages that are not installed.

    Args:
        with_flights: Whether the site has a list of flights.
    """
    needed = (*_OF_SITE, *(_OF_STORE if with_flights else ()))
    return [n for n in needed if find_spec(n) is None]


@contextmanager
def open_site(
    where: str,
    option: str,
    store: Path | None,
    limits: "Limits | None" = None,
    live: "LiveView | None" = None,
    token: str | None = None,
) -> Iterator[tuple["SiteServer", Add | None]]:
    """A site ready to be served, and the function that adds a log to its flights.

    Args:
        where: Address HOST:PORT.
        option: Option with that address.
        store: Folder of the flights; None: the site is only the page of the live flight.
        limits: Limits for a log and a job; None: the defaults.
        live: The live flight.
        token: Token of viewers; None: that of the store, else a new one for other machines.

    Raises:
        TwinError: The address is invalid or in use, the token is too short, the store is in use, or
            packages are missing.
    """
    if missing := lacking(store is not None):
        extra = "live" if store is None else "serve"
        raise TwinError(f"{option} needs {', '.join(missing)}: {install_command(extra)}.")
    from starlette.responses import RedirectResponse
    from starlette.routing import Route

    from ..site.server import FLIGHTS, LIVE, SiteServer, doors_of, site_app

    place = address(where, "", option)
    host, port = place.pair
    given = None if token is None else doors_of(host, port, token)
    routes = () if live is None else live.routes
    with ExitStack() as opened:
        taken = opened.enter_context(listening(place, connections=True))
        if store is None:
            doors = given or doors_of(host, port)
            first = Route(FLIGHTS, lambda _: RedirectResponse(LIVE))
            app, add = site_app((first, *routes), doors), None
        else:
            from .schedule import Limits
            from .server import Site
            from .store import Store

            with ExitStack() as failed:
                flights = Store(store)
                failed.callback(flights.close)
                of_store = None if given or is_loopback(host) else flights.token()
                doors = given or doors_of(host, port, of_store)
                site = Site(flights, limits or Limits(), doors, routes)
                failed.pop_all()
            opened.callback(site.close)
            app, add = site.app, site.add
        yield opened.enter_context(SiteServer(taken, app, doors)), add
