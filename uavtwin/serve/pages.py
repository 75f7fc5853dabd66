"""Pages of the server: the list, a flight, reports with the navigation bar of the site."""

import gzip
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from time import localtime, strftime
from typing import Any

import jinja2
from markupsafe import Markup

from twin.vehicle.layouts import FRAMES

from ..report.page import HERE as REPORT
from ..site.server import hash_of, headers
from ..site.server import style as style_of_site
from .store import OF_VEHICLE, FlightRow, JobRow, Run, Store
from .work import LONG, TABLE, explained_file

HERE = Path(__file__).parent
"""Folder of templates, style and script."""
WORDS = {
    "check": "Check",
    "why": "Why",
    "gap": "Gap",
    "explain": "Explain",
    "draft": "Vehicle draft",
    "mcap": "MCAP",
    "fmu": "FMU",
}
"""Names of the kinds of jobs on a flight's page."""
OFFERED = {
    "explain": "names the physical effect that the vehicle lacks; takes minutes",
    "mcap": "the flight for Foxglove and PlotJuggler",
    "fmu": "the twin of the vehicle for Simulink, OpenModelica, FMPy",
}
"""Description of jobs that were not requested yet."""
REPORTS = {"why": "why.html", "gap": "gap.html", "explain": "explain/report.html"}
"""Report files of a flight, by kind of job."""
FILES = {
    TABLE: "series, SI, NED (Parquet)",
    "flight.mcap": "series for Foxglove and PlotJuggler (MCAP)",
    "flight.foxglove.json": "layout for it: Foxglove, Import from file",
    "flight.plotjuggler.xml": "layout for it: PlotJuggler, Load Layout",
    "twin.fmu": "the twin of the vehicle (FMU)",
    "check.json": "what check says (JSON)",
    "why.json": "what why says (JSON)",
    "gap.json": "what gap says (JSON)",
    "explain/explain.json": "what explain says (JSON)",
}
"""Downloadable files of a flight, besides its log and its vehicle file."""
MOST_MOMENTS = 40
"""Largest number of linked moments of a flight."""


@cache
def _environment() -> jinja2.Environment:
    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("uavtwin.serve", "templates"),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters |= {"size": _size, "when": _when, "seconds": _seconds}
    environment.globals |= {
        "style": Markup((REPORT / "page.css").read_text("utf-8") + _style()),
        "script": Markup(_script()),
        "words": WORDS,
    }
    return environment


@cache
def _style() -> str:
    return style_of_site() + (HERE / "serve.css").read_text("utf-8")


@cache
def _script() -> str:
    return (HERE / "serve.js").read_text("utf-8")


def _size(count: int) -> str:
    if count < 1000:
        return f"{count} bytes"
    return f"{count / 1e6:.1f} MB" if count >= 1e5 else f"{count / 1e3:.1f} kB"


def _when(at_s: float) -> str:
    return strftime("%Y-%m-%d %H:%M", localtime(at_s))


def _seconds(span_s: float) -> str:
    whole = round(span_s)
    return f"{span_s:.0f} s" if whole < 120 else f"{whole // 60} min {whole % 60} s"


@cache
def scripts() -> tuple[str, ...]:
    """Hashes of the scripts of this version: of the site, of reports, of the plotting library."""
    bundle = gzip.decompress((REPORT / "vendor" / "plotly-basic.min.js.gz").read_bytes())
    report = (REPORT / "page.js").read_text("utf-8")
    return tuple(map(hash_of, (f"\n{_script()}\n", f"\n{report}\n", bundle.decode())))


@dataclass(frozen=True, slots=True)
class Action:
    """A kind of job in the list on a flight's page.

    Attributes:
        kind: Kind of the job.
        state: State of the job; "": not requested.
        done: Completed share, 0..1; None: not known.
        text: Result, or the reason of failure.
        link: Address of the result, "" without one.
        offered: Label of the button that starts it, "" without one.
    """

    kind: str
    state: str
    done: float | None
    text: str
    link: str
    offered: str


class Pages:
    """Pages of a store.

    Attributes:
        headers: HTTP headers of the pages; scripts of reports written by earlier versions are
            allowed too.
    """

    def __init__(self, store: Store, done: Mapping[Run, float], vehicles: Sequence[str]) -> None:
        """Set up for a store.

        Args:
            store: Flights, jobs and results.
            done: Completed share of running jobs.
            vehicles: Names of the built-in vehicles.
        """
        self._store, self._done, self._vehicles = store, done, tuple(vehicles)
        self.headers = headers(store.known_scripts(scripts()))

    def _text(self, template: str, **content: Any) -> str:
        page = _environment().get_template(template).render(**content)
        return page.encode("utf-8", "backslashreplace").decode("utf-8")

    def listed(self, search: str) -> str:
        """The page with the drop zone and the list of flights."""
        flights, count = self._store.flights(search)
        rows = Markup("").join(Markup(self.row(f)) for f in flights)
        return self._text("list.html.j2", rows=rows, count=count, shown=len(flights), search=search)

    def row(self, flight: FlightRow) -> str:
        """Row of a flight in the list."""
        jobs = [j for j in self._store.jobs(flight.id) if j.state in ("queued", "running")]
        return self._text("row.html.j2", flight=flight, jobs=jobs, share=self._share(jobs))

    def _share(self, jobs: Sequence[JobRow]) -> float | None:
        """Completed share of running jobs; None: not known."""
        running = [j for j in jobs if j.state == "running"]
        return self._done.get(running[0].run) if running else None

    def flight(self, flight: FlightRow) -> str:
        """The page of a flight."""
        return self._text(
            "flight.html.j2",
            flight=flight,
            parts=list(map(Markup, self.parts(flight).values())),
            built_in=self._vehicles,
            own=self._store.vehicles(),
            frames=list(FRAMES),
            bar=self.bar(flight),
        )

    def parts(self, flight: FlightRow) -> dict[str, str]:
        """Parts of a flight's page that change while jobs run, by identifier."""
        check = self._result(flight, "check.json")
        said = 0 if check is None else len(check["problems"]) + len(check["warnings"])
        return {
            f"flight-{flight.id}": self._text(
                "status.html.j2",
                flight=flight,
                actions=self._actions(flight),
                more=max(0, said - 1),
                moments=self._moments(flight),
            ),
            f"more-{flight.id}": self._text(
                "more.html.j2", flight=flight, check=check, files=self._files(flight)
            ),
        }

    def _result(self, flight: FlightRow, name: str) -> dict[str, Any] | None:
        """A result in JSON; None: there is none."""
        try:
            content = json.loads((self._store.results(flight.id) / name).read_text("utf-8"))
        except (OSError, ValueError):
            return None
        return content if isinstance(content, dict) else None

    def _actions(self, flight: FlightRow) -> list[Action]:
        jobs = {j.kind: j for j in self._store.jobs(flight.id) if not j.other}
        return [
            self._action(flight, kind, jobs.get(kind))
            for kind in WORDS
            if kind in jobs or (kind != "draft" and flight.verdict not in (None, "unreadable"))
        ]

    def _action(self, flight: FlightRow, kind: str, job: JobRow | None) -> Action:
        state = "" if job is None else job.state
        text = {
            "check": flight.check_text,
            "why": flight.why_text,
            "gap": flight.gap_text,
            "explain": flight.explain_text,
            "draft": flight.vehicle,
        }.get(kind)
        file = {"mcap": "flight.mcap", "fmu": "twin.fmu"}.get(kind)
        link = ""
        if state == "done" and kind in REPORTS:
            link = f"/flights/{flight.id}/{kind}"
        elif state == "done" and file:
            link = f"/flights/{flight.id}/files/{file}"
        if job is not None and job.state == "failed":
            text = job.text
        offered = {"failed": "Try again", "cancelled": "Do it again"}.get(state, "")
        if not state:
            text, offered = OFFERED.get(kind, ""), "Explain" if kind == "explain" else "Make"
        if state == "done" and kind in (*LONG, "gap"):
            offered = "Do it again"
        if kind in OF_VEHICLE and not flight.vehicle:
            offered, text = "", "needs a vehicle: choose or draft one below"
        done = None if job is None else self._done.get(job.run)
        return Action(kind, state, done, text or "", link, offered)

    def _moments(self, flight: FlightRow) -> list[tuple[float, str, str]]:
        """Time, kind and text of events, in order of time."""
        why = self._result(flight, "why.json") or {}
        events = [
            (e["onset_s"], "consequence" if e["consequence"] else "cause", e["text"])
            for e in why.get("events", ())
            if e.get("onset_s") is not None
        ]
        others = [
            (i["t_s"], i["kind"], i["text"].removeprefix(f"{i['kind']} "))
            for i in why.get("timeline", ())
        ]
        return sorted([*events, *others])[:MOST_MOMENTS]

    def _files(self, flight: FlightRow) -> list[tuple[str, str]]:
        """Name and description of downloadable files."""
        place = self._store.results(flight.id)
        found = [("log", f"the log as it came ({flight.name})")]
        found += [(name, about) for name, about in FILES.items() if (place / name).is_file()]
        if self._store.vehicle_file(flight.vehicle or "") is not None:
            found.append(("vehicle.toml", f"vehicle file ({flight.vehicle})"))
        if explained_file(place, flight.id).is_file():
            found.append(("explained.toml", "vehicle file with the effects that explain named"))
        return found

    def bar(self, flight: FlightRow) -> Markup:
        """Navigation bar between the pages of a flight."""
        jobs = {j.kind: j.state for j in self._store.jobs(flight.id)}
        there = [k for k in REPORTS if jobs.get(k) == "done"]
        return Markup(self._text("bar.html.j2", flight=flight, there=there))

    def report(self, flight: FlightRow, file: Path) -> str:
        """A report with the navigation bar."""
        page = file.read_text("utf-8")
        own = f"<body>\n<style>\n{_style()}\n</style>\n{self.bar(flight)}"
        return page.replace("<body>", own, 1)

    def said(
        self,
        title: str,
        text: str,
        again_s: int | None = None,
        button: str = "",
        action: str = "",
    ) -> str:
        """A page with one sentence.

        Args:
            title: Title of the page.
            text: The sentence.
            again_s: Interval at which the browser reloads the page; None: never.
            button: Label of a button below.
            action: Address to which the button posts; "": no button.
        """
        return self._text(
            "said.html.j2", title=title, text=text, again_s=again_s, button=button, action=action
        )
