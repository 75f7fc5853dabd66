"""The page of a live flight, opened: feed and server together; its packages are optional."""

from dataclasses import dataclass
from importlib.util import find_spec
from typing import TYPE_CHECKING, Self

from twin.errors import TwinError, install_command
from twin.vehicle import Vehicle

from ..following import Following
from .feed import Hub, PageFeed

if TYPE_CHECKING:
    from .server import PageServer

NEEDED = ("starlette", "uvicorn", "websockets")  # packages of the page


@dataclass(frozen=True, slots=True)
class OpenPage:
    """A page that is served.

    Attributes:
        feed: Takes what it shows.
        server: Serves it.
    """

    feed: PageFeed
    server: "PageServer"

    @property
    def url(self) -> str:
        """For a browser."""
        return self.server.url

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.server.close()


def lacking() -> list[str]:
    """Packages that the page needs and that are not installed."""
    return [n for n in NEEDED if find_spec(n) is None]


def open_page(serve: str, token: str | None, vehicle: Vehicle, following: Following) -> OpenPage:
    """Serve the page of a live flight.

    Args:
        serve: HOST:PORT.
        token: What viewers must know; None: nothing.
        vehicle: The twin.
        following: How the state of the twin is corrected.

    Raises:
        TwinError: The address is none, is taken, or needs a token; or packages are missing.
    """
    if missing := lacking():
        raise TwinError(f"--serve needs {', '.join(missing)}: {install_command('live')}.")
    from .document import document  # what serves is optional
    from .server import PageServer, page_address

    where = page_address(serve, token)
    hub = Hub()
    feed = PageFeed(hub, vehicle.name, following)
    return OpenPage(feed, PageServer(where, hub, document(vehicle.rotors.count), token))
