"""Routes of the site's flights and their actions."""

import asyncio
import contextlib
import math
from collections.abc import AsyncIterator, Awaitable, Callable, Sequence
from pathlib import Path
from urllib.parse import parse_qsl, quote

import msgspec
from starlette.requests import ClientDisconnect, Request
from starlette.responses import (
    FileResponse,
    JSONResponse,
    RedirectResponse,
    Response,
    StreamingResponse,
)
from starlette.routing import BaseRoute, Route
from starlette.types import ASGIApp

from twin.errors import TwinError
from twin.topic_mapping import MOST_MAPPING
from twin.vehicle_file import builtin_vehicles

from ..output import write_json
from ..site.doors import AccessPolicy
from ..site.server import FLIGHTS, LIVE, headers, site_app
from .demo import DemoFlight
from .pages import FILES, REPORTS, Pages
from .schedule import Limits, Scheduler
from .store import LONGEST_TAGS, OF_VEHICLE, FlightRow, Store, is_mapping
from .work import explained_file

MOST_LISTENERS = 64
"""Largest number of open pages with live updates."""
_FORM_BYTES = 16_384
"""Largest size of a form."""
_PAUSE_S, _SILENT_S = 0.2, 15.0
"""Interval between two messages to a page, and interval of empty keep-alive messages, s."""
_BLOCK = 1 << 20
"""Block size for copying, bytes."""


class Listener:
    """A page that receives the names of changed flights."""

    def __init__(self, only: str) -> None:
        """Set up without changes.

        Args:
            only: Flight of the page; "": all of them.
        """
        self.only = only
        self._flights: dict[str, None] = {}
        self._loop, self._bell = asyncio.get_running_loop(), asyncio.Event()

    def put(self, flight: str) -> None:
        """Add a changed flight; from any thread."""
        if not self.only or flight == self.only:
            with contextlib.suppress(RuntimeError):  # the server has ended
                self._loop.call_soon_threadsafe(self._add, flight)

    def _add(self, flight: str) -> None:
        self._flights[flight] = None
        self._bell.set()

    async def news(self) -> list[str]:
        """Changed flights, waiting for them; none after a period without changes."""
        with contextlib.suppress(TimeoutError):
            await asyncio.wait_for(self._bell.wait(), _SILENT_S)
        self._bell.clear()
        found, self._flights = list(self._flights), {}
        return found


class Site:
    """The pages of a store, and their jobs.

    Attributes:
        app: Application for an ASGI server.
    """

    def __init__(
        self, store: Store, limits: Limits, doors: AccessPolicy, live: Sequence[BaseRoute] = ()
    ) -> None:
        """Set up and start the queued jobs.

        Args:
            store: Open store.
            limits: Limits for a log and a job.
            doors: Access rules.
            live: Routes of the page of a live flight; none: a simulated flight on request.
        """
        self._store, self._limits = store, limits
        self._listeners: set[Listener] = set()
        self._jobs = Scheduler(store, limits, self.changed)
        self._pages = Pages(store, self._jobs.done, builtin_vehicles())
        of_flight: list[tuple[str, str, Callable[[Request, FlightRow], Awaitable[Response]]]] = [
            ("GET", "", self._flight),
            ("GET", "/{kind}", self._report),
            ("GET", "/compare/{other}", self._compared),
            ("GET", "/files/{name:path}", self._file),
            ("POST", "/jobs/{kind}", self._begin),
            ("POST", "/jobs/{kind}/cancel", self._cancel),
            ("POST", "/tags", self._tags),
            ("POST", "/vehicle", self._vehicle),
            ("POST", "/draft", self._draft),
            ("POST", "/delete", self._delete),
        ]
        self._demo = DemoFlight(self._nothing_flies)
        routes = [
            *(live or self._demo.routes),
            Route(FLIGHTS, self._list),
            Route("/events", self._events),
            Route("/compare", self._compare),
            *(
                Route(path, self._upload, methods=["PUT", "POST"])
                for path in ("/upload", "/upload/{name:path}")
            ),
            *(
                Route(f"/flights/{{flight}}{path}", self._with_flight(answer), methods=[method])
                for method, path, answer in of_flight
            ),
        ]
        self.app: ASGIApp = site_app(routes, doors)
        self._jobs.start()

    def close(self) -> None:
        """End running jobs; the next server continues."""
        self._demo.close()
        self._jobs.close()
        self._store.close()

    def changed(self, flight: str) -> None:
        """Notify of a changed flight; from any thread."""
        for listener in list(self._listeners):
            listener.put(flight)

    def _page(self, text: str, status: int = 200) -> Response:
        return Response(text, status, self._pages.headers, "text/html")

    def _queue(self, flight: str, kind: str, other: str = "") -> None:
        """Queue a job."""
        if self._store.queue(flight, kind, other):
            self.changed(flight)
            self._jobs.wake()

    # -- the list -------------------------------------------------------------------------------

    async def _list(self, request: Request) -> Response:
        return self._page(self._pages.listed(request.query_params.get("q", "")[:LONGEST_TAGS]))

    async def _upload(self, request: Request) -> Response:
        """Store an uploaded file, block by block."""
        name = str(request.path_params.get("name", "")) or "log"
        mapping, most = is_mapping(name), self._limits.most_bytes
        given = (MOST_MAPPING, f"of {name}, a mapping; leave out signals") if mapping else (most,)
        try:
            with self._store.upload(*given) as coming:
                coming.check(int(request.headers.get("content-length") or 0))
                async for part in request.stream():
                    coming.write(part)
                if mapping:
                    return self._mapped(name, coming.path)
                flight, created = self._store.add(name, coming.path, coming.sha256, coming.size)
        except (TwinError, ValueError) as error:
            return JSONResponse({"error": str(error)}, 400 if mapping else 413, _closing())
        except ClientDisconnect:
            return Response(status_code=400)
        self.changed(flight)
        self._jobs.wake()
        content = {"flight": flight, "address": f"/flights/{flight}", "created": created}
        return JSONResponse(content, 201 if created else 200)

    def _mapped(self, name: str, file: Path) -> Response:
        """Store a mapping file of ROS 2 bags."""
        bags = self._jobs.map_topics(name, file)
        again = ", ".join(dict.fromkeys(kind for kinds in bags.values() for kind in kinds))
        note = f"its bag is read again: {again}" if bags else "waits for a bag of its name"
        return JSONResponse({"flights": list(bags), "note": note, "created": True}, 201)

    async def _events(self, request: Request) -> Response:
        """Stream of changes, as long as the page is open."""
        only = request.query_params.get("flight", "")
        if len(self._listeners) >= MOST_LISTENERS:
            return self._page(self._pages.said("Too many pages", "Close one of the others."), 503)
        at_once = {"X-Accel-Buffering": "no"}  # for a proxy, which would buffer small messages
        return StreamingResponse(
            self._messages(Listener(only)),
            media_type="text/event-stream",
            headers={**headers(), **at_once},
        )

    async def _messages(self, listener: Listener) -> AsyncIterator[bytes]:
        self._listeners.add(listener)
        try:
            yield b"retry: 1000\n\n"
            flights = [listener.only] if listener.only else self._newest()
            while True:
                for flight in flights:
                    yield self._message(flight, bool(listener.only))
                    await asyncio.sleep(0)
                await asyncio.sleep(_PAUSE_S)
                flights = await listener.news()
                if not flights:
                    yield b": still there\n\n"
        finally:
            self._listeners.discard(listener)

    def _newest(self) -> list[str]:
        """Newest flights of the list, oldest first, as a page inserts each at the top."""
        return [f.id for f in reversed(self._store.flights()[0])]

    def _message(self, flight: str, whole: bool) -> bytes:
        """A flight as shown on a page, by identifier; null where it was deleted."""
        found = self._store.flight(flight)
        parts: dict[str, str | None] = {f"flight-{flight}": None}
        if found is not None:
            row = {f"flight-{flight}": self._pages.row(found)}
            parts |= self._pages.parts(found) if whole else row
        return b"data: " + msgspec.json.encode(parts) + b"\n\n"

    async def _compare(self, request: Request) -> Response:
        chosen = list(dict.fromkeys(request.query_params.getlist("f")))
        if len(chosen) != 2:
            text = "Tick two flights of the list, then compare."
            return self._page(self._pages.said("Which two?", text), 400)
        return RedirectResponse(f"/flights/{quote(chosen[0])}/compare/{quote(chosen[1])}", 303)

    def _nothing_flies(self, last: str) -> Response:
        """The live page of a site without an aircraft.

        Args:
            last: Result of the last demonstration; "": there was none.
        """
        text = (
            "Nothing flies: this server reads logs. The demonstration simulates a flight in which "
            "a rotor is damaged, and shows it here beside its twin. For your own "
            "aircraft end this server, and start uavtwin live --vehicle FILE "
            f"--store {self._store.folder.name}: the same flights, and what it hears on this page."
        )
        begin = "Begin the demonstration", f"{LIVE}/demo"
        return self._page(self._pages.said("Live", f"{last} {text}".strip(), None, *begin))

    def add(self, file: Path, name: str) -> str:
        """Copy a file into the store as a log; returns the identifier of its flight.

        Args:
            file: Path of the log.
            name: Name in the list.

        Raises:
            TwinError: It is too large.
        """
        with self._store.upload(self._limits.most_bytes) as coming, file.open("rb") as source:
            while part := source.read(_BLOCK):
                coming.write(part)
            flight, _ = self._store.add(name, coming.path, coming.sha256, coming.size)
        self.changed(flight)
        self._jobs.wake()
        return flight

    # -- a flight -------------------------------------------------------------------------------

    def _with_flight(
        self, answer: Callable[[Request, FlightRow], Awaitable[Response]]
    ) -> Callable[[Request], Awaitable[Response]]:
        """Route for an existing flight."""

        async def found(request: Request) -> Response:
            """Answer of the route, or an error."""
            flight = self._store.flight(str(request.path_params["flight"]))
            if flight is None:
                return self._missing("no such flight")
            try:
                return await answer(request, flight)
            except TwinError as error:
                return self._page(self._pages.said("That does not work", str(error)), 400)

        return found

    def _missing(self, text: str) -> Response:
        return self._page(self._pages.said("Not found", f"{text}."), 404)

    def _back(self, flight: FlightRow) -> Response:
        """Redirect to the page of a flight, after a form."""
        self.changed(flight.id)
        return RedirectResponse(f"/flights/{flight.id}", 303)

    async def _flight(self, _: Request, flight: FlightRow) -> Response:
        return self._page(self._pages.flight(flight))

    async def _report(self, request: Request, flight: FlightRow) -> Response:
        name = REPORTS.get(str(request.path_params["kind"]), "")
        file = self._store.results(flight.id) / name
        return (
            self._page(self._pages.report(flight, file))
            if name and file.is_file()
            else (self._missing("this report is not made yet"))
        )

    async def _compared(self, request: Request, flight: FlightRow) -> Response:
        """Comparison of two flights, created on first request."""
        other = self._store.flight(str(request.path_params["other"]))
        if other is None or other.id == flight.id:
            return self._missing("no such other flight")
        file = self._store.results(flight.id) / f"compare-{other.id}.html"
        job = self._store.job(flight.id, "compare", other.id)
        if job is not None and job.state == "done" and file.is_file():
            return self._page(self._pages.report(flight, file))
        for each in (flight, other):
            if each.verdict in (None, "unreadable"):
                text = f"{each.name}: {each.check_text or 'is being read'}"
                again_s = 2 if each.verdict is None else None
                return self._page(self._pages.said("Not yet to compare", text, again_s))
        if job is not None and job.state == "failed":
            self._queue(flight.id, "compare", other.id)
            return self._page(self._pages.said("That does not work", job.text or "it failed"), 400)
        self._queue(flight.id, "compare", other.id)
        text = f"{flight.name} and {other.name} are drawn over each other."
        return self._page(self._pages.said("One moment", text, 1))

    async def _file(self, request: Request, flight: FlightRow) -> Response:
        name = str(request.path_params["name"])
        stem = Path(flight.name).stem
        if name == "log":
            return _download(self._store.log(flight), flight.name)
        place = self._store.results(flight.id)
        vehicles = {
            "vehicle.toml": self._store.vehicle_file(flight.vehicle or ""),
            "explained.toml": explained_file(place, flight.id),
        }
        vehicle = vehicles.get(name)
        if vehicle is not None and vehicle.is_file():
            return _download(vehicle, vehicle.name)
        file = place / name
        if name in FILES and file.is_file():
            return _download(file, f"{stem}.{file.name}")
        return self._missing("no such file")

    async def _begin(self, request: Request, flight: FlightRow) -> Response:
        kind = str(request.path_params["kind"])
        if kind not in ("check", "why", "mcap", *OF_VEHICLE):
            return self._missing("no such job")
        if kind in OF_VEHICLE and not flight.vehicle:
            raise TwinError(f"{kind}: choose or draft a vehicle first.")
        self._queue(flight.id, kind)
        return self._back(flight)

    async def _cancel(self, request: Request, flight: FlightRow) -> Response:
        await asyncio.to_thread(self._jobs.cancel, flight.id, str(request.path_params["kind"]))
        return self._back(flight)

    async def _tags(self, request: Request, flight: FlightRow) -> Response:
        words = (await _form(request)).get("tags", "").split()
        self._store.note(flight.id, tags=" ".join(words)[:LONGEST_TAGS])
        return self._back(flight)

    async def _vehicle(self, request: Request, flight: FlightRow) -> Response:
        name = (await _form(request)).get("vehicle", "")
        if name not in (*builtin_vehicles(), *self._store.vehicles()):
            raise TwinError(f"vehicle {name}: there is none of this name.")
        await asyncio.to_thread(self._jobs.choose, flight.id, name)
        return self._back(flight)

    async def _draft(self, request: Request, flight: FlightRow) -> Response:
        form = await _form(request)
        wheelbase_mm = _positive(form, "wheelbase_mm")
        known = {
            "mass_kg": _positive(form, "mass_kg"),
            "wheelbase_m": None if wheelbase_mm is None else wheelbase_mm / 1e3,
            "propeller": form.get("propeller") or None,
            "frame": form.get("frame") or None,
        }
        if known["mass_kg"] is None:
            raise TwinError("mass: a log tells force over mass alone. Weigh the aircraft.")
        await asyncio.to_thread(self._jobs.cancel, flight.id, "draft")  # a draft with other values
        write_json(self._store.results(flight.id) / "draft.json", known)
        self._queue(flight.id, "draft")
        return self._back(flight)

    async def _delete(self, _: Request, flight: FlightRow) -> Response:
        for job in self._store.jobs(flight.id):
            self._jobs.cancel(job.flight, job.kind, job.other)
        self._store.delete(flight)
        self.changed(flight.id)
        return RedirectResponse("/", 303)


def _closing() -> dict[str, str]:
    """Headers of an answer before the whole request was read."""
    return {"Connection": "close"}


def _download(file: Path, name: str) -> Response:
    return FileResponse(file, 200, headers(), "application/octet-stream", filename=name)


async def _form(request: Request) -> dict[str, str]:
    """Fields of a form.

    Raises:
        TwinError: It is too long.
    """
    content = b""
    async for part in request.stream():
        content += part
        if len(content) > _FORM_BYTES:
            raise TwinError(f"a form of over {_FORM_BYTES} bytes.")
    return dict(parse_qsl(content.decode("utf-8", "replace")))


def _positive(form: dict[str, str], name: str) -> float | None:
    """A number of a form; None where it is missing.

    Raises:
        TwinError: It is no number, or not positive.
    """
    text = form.get(name, "")
    if not text:
        return None
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not 0 < value < math.inf:
        raise TwinError(f"{name} = {text}: needs a positive number.")
    return value
